"""Rays over several surfaces, for the effect `multibounce`.

`tracing.py`: paths and the angles on them, traced and merged once. `cells.py`: their fields, summed over resolution
cells. `lobe.py` and `roughness.py`: what they return, by each of the two readings of a reflection. `gaps.py`: corners
of the mesh that stand open. `curved.py`: pieces of curved surfaces.
"""
