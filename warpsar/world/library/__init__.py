"""A library of surfaces: what a material is where the scene file gives no more than a name.

permittivity: published models, each with its equation. surfaces: the list, with roughness. fill: keys of a material's
table that the user left out. names: which surface a mesh means by the name of a material. clutter: published means of
sigma0, to look at beside the list.
"""
