"""How do images change with the parameters? The renderer for gradients, and its faces for PyTorch and JAX.

parameters: what may change, by name. derivatives: images, `vjp` and `jvp` with NumPy arrays. renderer:
`warpsar.renderer`. pytorch, jax_callback: the same as a function of either library.
"""
