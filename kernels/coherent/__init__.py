"""Kernels of the coherent engine: rays and their tubes, what facets, tubes and edges radiate."""
