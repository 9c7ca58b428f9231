"""The learned term of a material's sigma0, trained through the renderer from the measured images.

Its units stand at the material's own eps, h and l, steps of incidence apart, over what the images have seen of it. The
weights minimise the loss of all `train` views, with the size that is expected of the term as their prior: what
`scattering_term.learned` does for a table, here by Warp's adjoint of the images to the weights.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.kernels.codes import Polarization
from warpsar.learning.device_values import SEEN, DeviceBlock, most_likely, refuse_run, seen_cosines
from warpsar.learning.metrics import pooled_metrics
from warpsar.learning.problem import FitProblem
from warpsar.scene.beside import file_stem
from warpsar.scene.scene import Scene
from warpsar.surface.surface import KEYS
from warpsar.world.models import TERM
from warpsar.world.scattering_term import DB, ScatteringTerm

WIDTH = (0.1, 1.0, 1.0, 1.0)  # of a unit: cos theta, ln kh, ln kl, ln(eps - 1)
SPREAD_DB = 3.0
NOISE_DB = 0.25

Prepared = Callable[[Scene], FitProblem]
"""The fit problem of a scene's `train` views."""


@dataclass(frozen=True)
class Trained:
    """A term and its `file`; pooled metrics of the `train` views without and with it, and the steps that it took."""

    term: ScatteringTerm
    file: Path
    before: dict[str, float]
    after: dict[str, float]
    steps: int

    def content(self) -> dict[str, Any]:
        """What learn.json says of it."""
        return {
            "file": self.file.name,
            "units": len(self.term.places),
            "cos_incidence": [float(self.term.places[:, 0].min()), float(self.term.places[:, 0].max())],
            "before": self.before,
            "after": self.after,
            "steps": self.steps,
        }


def taught(scene: Scene) -> list[str]:
    """The materials whose `learn` names the learned term."""
    return [name for name, material in scene.materials.items() if TERM in material.learn]


def with_trained_terms(scene: Scene, folder: Path | None, prepared: Prepared) -> tuple[Scene, dict[str, Trained]]:
    """The scene with a trained term in each material that asks for one, one after the other, and what was found.

    The materials' eps, h and l are held, and what effects declare. Files go into `folder`. Raises InputError without
    one, with several processes, and where a view's hits do not fit into memory.
    """
    found = {}
    for name in taught(scene):
        folder = refuse_run(scene, name, TERM, folder)
        folder.mkdir(parents=True, exist_ok=True)
        found[name] = _trained(
            scene, name, folder / f"{file_stem(tuple(scene.materials), name, 'term')}.json", prepared
        )
        scene = _with_file(scene, name, found[name].file)
    return scene, found


def _with_file(scene: Scene, name: str, file: Path) -> Scene:
    material = scene.materials[name].model_copy(update={TERM: file.resolve(), "learn": ()})
    return replace(scene, materials=scene.materials | {name: material})


def as_asked(final: Scene, asked: Scene, terms: Collection[str]) -> Scene:
    """The learned scene, whose materials with a trained term ask for it again."""
    again = {name: final.materials[name].model_copy(update={"learn": asked.materials[name].learn}) for name in terms}
    return replace(final, materials=final.materials | again)


def _trained(scene: Scene, name: str, file: Path, prepared: Prepared) -> Trained:
    channels: list[str] = sorted({"HV" if one == "VH" else one for one in scene.radar.polarizations})
    model = scene.materials[name].model
    start = np.zeros((1, len(WIDTH)))
    empty = ScatteringTerm(model, start, np.array(WIDTH), {c: np.zeros(1) for c in channels}, SPREAD_DB, NOISE_DB)
    empty.save(file)
    places = _places(prepared(_with_file(scene, name, file)), name)
    used = {c: np.ones(len(places), bool) for c in channels}
    none = {c: np.zeros(len(places)) for c in channels}
    term = replace(empty, places=places, weights=none, used=used)
    term.save(file)
    problem = prepared(_with_file(scene, name, file))
    before = pooled_metrics(problem, problem.x0)
    columns = [[int(p) for p in Polarization if ("HV" if p.crossed else p.name) == c] for c in channels]
    assert problem.stage.terms is not None
    first = int(problem.stage.terms.first.numpy()[problem.surface.materials.index(name), 0])
    root = np.linalg.cholesky(term.units(places) + (NOISE_DB / SPREAD_DB) ** 2 * np.eye(len(places)))
    unit = np.linalg.inv(root).T * (SPREAD_DB / DB)
    start = np.zeros((len(channels), len(places)))
    block = DeviceBlock(slice(first, first + len(places)), columns, start, unit)
    [weights], x, steps = most_likely(problem, problem.stage.terms.weights, [block])
    term = replace(term, weights=dict(zip(channels, weights, strict=True)))
    term.save(file)
    after = pooled_metrics(problem, x)
    return Trained(term, file, before, after, steps)


def _places(problem: FitProblem, name: str) -> np.ndarray:
    """Places of the units, (n, 4), at the middle of the material's eps, h and l, over what was seen of it."""
    cosines, wavenumber = seen_cosines(problem, name, TERM), problem.views[-1].render.whole.shaded.geometry.wavenumber
    low, high = np.percentile(cosines, SEEN)
    count = max(int(np.ceil((high - low) / WIDTH[0])), 1) + 1
    middle = (low + high) / 2 + (np.arange(count) - (count - 1) / 2) * WIDTH[0]
    eps, height, length = (float(np.median(problem.surface.values(name, key))) for key in KEYS[:3])
    here = [np.log(wavenumber * height), np.log(wavenumber * length), np.log(eps - 1.0)]
    return np.column_stack([middle, np.tile(here, (count, 1))])
