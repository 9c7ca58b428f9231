from .derivatives import Derivatives as Derivatives
from .geometry import image_slopes as image_slopes
from .jax_callback import JaxRenderer as JaxRenderer
from .parameters import RenderParameter as RenderParameter
from .pytorch import TorchRenderer as TorchRenderer
from .renderer import Renderer as Renderer

__all__ = ["Derivatives", "JaxRenderer", "RenderParameter", "Renderer", "TorchRenderer", "image_slopes"]
