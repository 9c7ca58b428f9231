from .new import new_scene as new_scene
from .placing import with_objects as with_objects

__all__ = ["new_scene", "with_objects"]
