from .geometry.missing_object import proposed as proposed
from .result import Diagnosed as Diagnosed

__all__ = ["Diagnosed", "proposed"]
