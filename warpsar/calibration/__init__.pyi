from .attitude import Facing as Facing
from .command import ReflectorResult as ReflectorResult
from .explain import Explanation as Explanation
from .measure import ReflectorObservation as ReflectorObservation
from .sites import ReflectorSite as ReflectorSite

__all__ = ["Explanation", "Facing", "ReflectorObservation", "ReflectorResult", "ReflectorSite"]
