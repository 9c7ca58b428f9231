"""Kernels of the coherent engine: rays and their tubes, what facets, tubes and edges radiate.

cells: cells across the line of sight, their parts, and sums over them. tubes: rays, their hits and how they spread.
free_lanes: which points the radar sees, on the CPU eight at once.
reflection: at a face, and the currents on it. radiate: what faces and tubes send back. edges: what edges send back.
coated_edges: the same of metal under layers.
edge_waves: what goes from edge to edge along a thin plate, and then back.
rough: scatterers of rough faces. placing: where they lie, drawn by their numbers. rough_models: those of models beside
ka_spm. slopes: the same for reverse mode. borders: where
neighbouring rays meet other surfaces. transmission: tubes in solid dielectrics.
bistatic: what a rough plane scatters to other directions. diffuse: what rough faces scatter of tubes.
numbers: complex numbers in float64.
"""
