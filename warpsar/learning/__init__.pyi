from .identify import Identified as Identified
from .learn import Learned as Learned
from .pose_search import FoundPoses as FoundPoses
from .pose_search import find_poses as find_poses

__all__ = ["FoundPoses", "Identified", "Learned", "find_poses"]
