"""Launches of the backscatter models that need more than their functions at each hit: a file for each, by its name.

Each has `ways(asked, mine)`: the launches for the hits `mine` of its materials, one after the other, or None where the
model's functions do.
"""
