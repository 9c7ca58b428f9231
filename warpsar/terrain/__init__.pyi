from .files import image_dataset as image_dataset
from .files import map_dataset as map_dataset
from .result import SimulatedProduct as SimulatedProduct

__all__ = ["SimulatedProduct", "image_dataset", "map_dataset"]
