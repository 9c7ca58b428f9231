"""What is looked at: the mesh, its materials, and the views of it.

world: all data of a scene. tables: the tables of a scene file. mesh: triangles, and `read_mesh`. meshes/: a reader
for each mesh format. mesh_arrays: are these arrays a mesh? upright: Y up
or Z up. obj: a mesh written. models: what a backscatter model takes. sigma0_table, scattering_term: files that a
material names. curve: `[[curves]]`. pixels: an image in memory. problems: what is wrong with a table, in words.
smooth: normals of smooth surfaces.
frame: the axes of a view. earth: the world on the ellipsoid. site: the reference point there. track: where a sensor is.
objects/: bodies that a scene places. sound_objects: those that cannot be meant. library/: surfaces by name.
sensors: public civil sensors, for first scenes. taper: windows over a band or an aperture.
units: the unit of a mesh file that states none.
collection: `[collection]`. tolerance: how well the value at a key is known.
transform: the coordinate in which a fit moves a value.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
