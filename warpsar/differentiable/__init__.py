"""How do images change with the parameters? The renderer for gradients, and its faces for PyTorch and JAX.

parameters: what may change, by name, and what of the geometry may move. derivatives: images, `vjp` and `jvp` with
NumPy arrays. renderer: `warpsar.renderer`. pytorch, jax_callback: the same as a function of either library.
vertex_slopes: a view's gradient to the vertices. geometry: exact images, and their change along one move.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # public: __init__.pyi
