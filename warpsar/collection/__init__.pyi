from .history import Collected as Collected
from .slc import Slc as Slc

__all__ = ["Collected", "Slc"]
