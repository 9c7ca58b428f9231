"""From a mesh and a view to hits: which faces the rays meet, and into which bins of range and azimuth they fall.

trace: a view traced. target: a mesh on a device. rays: the grid of rays. hits:
what rays find. exact: the same without rays, from exact areas. exact_adjoint: the gradient of such areas to the
vertices. merge: records sorted and cut. layers: incidence, layover, shadow and material of each pixel.
"""
