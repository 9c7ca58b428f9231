from .view import SimulatedView as SimulatedView

__all__ = ["SimulatedView"]
