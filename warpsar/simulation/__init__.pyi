from .materials import levels as levels
from .view import SimulatedView as SimulatedView

__all__ = ["SimulatedView", "levels"]
