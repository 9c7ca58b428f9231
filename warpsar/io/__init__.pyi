from . import complex_image as complex_image
from .images import write_tiff as write_tiff

__all__ = ["complex_image", "write_tiff"]
