"""SAR images of triangle meshes, surface parameters learned from measured ones, and what the model is missing.

scene = warpsar.Scene.load("scene.toml")
images = warpsar.simulate(scene)
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from warpsar.errors import DeviceError, InputError, WarpsarError

__version__ = "0.1.0"

_LAZY = {
    "Scene": "warpsar.scene",
    "diagnose": "warpsar.diagnosis.command",
    "evaluate": "warpsar.evaluation",
    "learn": "warpsar.learning",
    "simulate": "warpsar.simulation",
}
__all__ = ["DeviceError", "InputError", "Scene", "WarpsarError", "diagnose", "evaluate", "learn", "simulate"]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
