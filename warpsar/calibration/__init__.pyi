from .attitude import Facing as Facing
from .command import ReflectorResult as ReflectorResult
from .explain import Explanation as Explanation
from .forecast import Forecast as Forecast
from .geolocation import Geolocation as Geolocation
from .joint import JointFit as JointFit
from .measure import ReflectorObservation as ReflectorObservation
from .presence import FoundPlace as FoundPlace
from .presence import Presence as Presence
from .sites import ReflectorSite as ReflectorSite
from .turns import AttitudeSolution as AttitudeSolution

__all__ = [
    "AttitudeSolution",
    "Explanation",
    "Facing",
    "Forecast",
    "FoundPlace",
    "Geolocation",
    "JointFit",
    "Presence",
    "ReflectorObservation",
    "ReflectorResult",
    "ReflectorSite",
]
