from .gradients import RcsGradients as RcsGradients
from .rcs import Rcs as Rcs

__all__ = ["Rcs", "RcsGradients"]
