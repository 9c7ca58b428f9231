"""How do images change with the parameters? The renderer for gradients, and its faces for PyTorch and JAX.

- `parameters.py`: what may change, by name, and its place among the surface's nodes and the effects' values.
- `renderer.py`: images, `vjp` and `jvp` of a scene, with NumPy arrays.
- `pytorch.py`, `jax_callback.py`: the same as a function of either library.
"""
