"""SAR images of triangle meshes, surface parameters learned from measured ones, and what the model is missing.

scene = warpsar.Scene.load("scene.toml")
images = warpsar.simulate(scene)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from warpsar.errors import DeviceError, InputError, WarpsarError
from warpsar.version import __version__

if TYPE_CHECKING:
    from warpsar.calibration.command import reflectors
    from warpsar.coherent.gradients import rcs_gradients
    from warpsar.coherent.rcs import rcs
    from warpsar.collection.command import phase_history, slc
    from warpsar.diagnosis.found import DiagnoseOptions
    from warpsar.diagnosis.result import diagnose
    from warpsar.differentiable.renderer import renderer
    from warpsar.evaluation.command import evaluate
    from warpsar.learning.command import LearnOptions, learn
    from warpsar.scene.scene import Scene
    from warpsar.simulation.command import simulate
    from warpsar.speckle.coherence import coherence
    from warpsar.terrain.command import twin
    from warpsar.world.mesh import Mesh
    from warpsar.world.tables import Grid, Material, Radar, Sampling, View

# Imported when first asked for: `import warpsar` and `warpsar --help` need no engine. A type checker reads the above.
_LAZY = {
    "DiagnoseOptions": "warpsar.diagnosis.found",
    "Grid": "warpsar.world.tables",
    "LearnOptions": "warpsar.learning.command",
    "Material": "warpsar.world.tables",
    "Mesh": "warpsar.world.mesh",
    "Radar": "warpsar.world.tables",
    "Sampling": "warpsar.world.tables",
    "Scene": "warpsar.scene.scene",
    "View": "warpsar.world.tables",
    "coherence": "warpsar.speckle.coherence",
    "diagnose": "warpsar.diagnosis.result",
    "evaluate": "warpsar.evaluation.command",
    "learn": "warpsar.learning.command",
    "phase_history": "warpsar.collection.command",
    "rcs": "warpsar.coherent.rcs",
    "rcs_gradients": "warpsar.coherent.gradients",
    "reflectors": "warpsar.calibration.command",
    "renderer": "warpsar.differentiable.renderer",
    "simulate": "warpsar.simulation.command",
    "slc": "warpsar.collection.command",
    "to_xarray": "warpsar.simulation.dataset",
    "twin": "warpsar.terrain.command",
}
__all__ = [
    "DeviceError",
    "DiagnoseOptions",
    "Grid",
    "InputError",
    "LearnOptions",
    "Material",
    "Mesh",
    "Radar",
    "Sampling",
    "Scene",
    "View",
    "WarpsarError",
    "__version__",
    "coherence",
    "diagnose",
    "evaluate",
    "learn",
    "phase_history",
    "rcs",
    "rcs_gradients",
    "reflectors",
    "renderer",
    "simulate",
    "slc",
    "to_xarray",
    "twin",
]


if not TYPE_CHECKING:  # to a type checker every name that is not above is a mistake

    def __getattr__(name: str) -> Any:
        if name in _LAZY:
            return getattr(import_module(_LAZY[name]), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
