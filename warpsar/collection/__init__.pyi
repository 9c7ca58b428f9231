from .history import Collected as Collected
from .history import PhaseHistoryMap as PhaseHistoryMap
from .slc import Slc as Slc

__all__ = ["Collected", "PhaseHistoryMap", "Slc"]
