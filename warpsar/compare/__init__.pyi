from .comparison import Comparison as Comparison
from .curve import CurveComparison as CurveComparison
from .evaluation import Evaluation as Evaluation

__all__ = ["Comparison", "CurveComparison", "Evaluation"]
