"""SAR images of triangle meshes, surface parameters learned from measured ones, and what the model is missing.

scene = warpsar.Scene.load("scene.toml")
images = warpsar.simulate(scene)
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from warpsar.errors import DeviceError, InputError, WarpsarError
from warpsar.version import __version__

_LAZY = {
    "Scene": "warpsar.scene.scene",
    "diagnose": "warpsar.diagnosis.result",
    "evaluate": "warpsar.evaluation.command",
    "learn": "warpsar.learning.command",
    "simulate": "warpsar.simulation.command",
    "to_xarray": "warpsar.simulation.dataset",
}
__all__ = [
    "DeviceError",
    "InputError",
    "Scene",
    "WarpsarError",
    "__version__",
    "diagnose",
    "evaluate",
    "learn",
    "simulate",
    "to_xarray",
]


def __getattr__(name: str) -> Any:
    if name in _LAZY:
        return getattr(import_module(_LAZY[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
