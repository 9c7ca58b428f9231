"""The learned term of a material's sigma0, trained through the renderer from the measured images.

Its units stand at the material's own eps, h and l, steps of incidence apart, over what the images have seen of it. The
weights are a part of x, with the size that is expected of the term as their prior: what `scattering_term.learned` does
for a table, here from images.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.errors import InputError
from warpsar.kernels.codes import Polarization
from warpsar.learning.device_values import DeviceBlock
from warpsar.learning.problem import FitProblem
from warpsar.runtime import once
from warpsar.scene.beside import file_stem
from warpsar.scene.scene import Scene
from warpsar.surface.surface import KEYS
from warpsar.world.models import TERM
from warpsar.world.scattering_term import ScatteringTerm

WIDTH = (0.1, 1.0, 1.0, 1.0)  # of a unit: cos theta, ln kh, ln kl, ln(eps - 1)
SPREAD_DB = 3.0
NOISE_DB = 0.25
SEEN = (0.5, 99.5)  # percentiles of the hits' cos theta, between which a material counts as seen

Prepared = Callable[[Scene], FitProblem]
"""The fit problem of a scene's `train` views."""


@dataclass(frozen=True)
class Trained:
    """A term and its `file`; pooled metrics of the `train` views without and with it, and the fit's iterations."""

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


@dataclass(frozen=True)
class UntrainedTerm:
    """A term without weights yet, and its `file`."""

    term: ScatteringTerm
    file: Path

    def block(self, scene: Scene, material: str) -> DeviceBlock:
        """The weights of a scene's material, as a part of x."""
        weights = {
            channel: scene.parameters[f"materials.{material}.{TERM}[{channel}]"] for channel in self.term.weights
        }
        columns = [[int(p) for p in Polarization if ("HV" if p.crossed else p.name) == c] for c in weights]
        return DeviceBlock.of(list(weights.values()), columns)

    def save(self) -> None:
        """Write the file, which all processes then read."""

        def write() -> None:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            self.term.save(self.file)

        once.find(write)

    def trained(self, weights: np.ndarray, **fit: Any) -> Trained:
        """The term with its weights, (channels, n), which is written; `fit` as `Trained` has it."""
        own = replace(self, term=replace(self.term, weights=dict(zip(self.term.weights, weights, strict=True))))
        own.save()
        return Trained(own.term, self.file, **fit)


def with_untrained_terms(
    scene: Scene, folder: Path | None, prepared: Prepared
) -> tuple[Scene, dict[str, UntrainedTerm]]:
    """The scene with a term without weights in each material whose `learn` names one, and these.

    The materials' eps, h and l are held. Files go into `folder`. Raises InputError without one, and where a view's hits
    do not fit into memory.
    """
    wanted = [name for name, material in scene.materials.items() if TERM in material.learn]
    untrained: dict[str, UntrainedTerm] = {}
    channels: list[str] = sorted({"HV" if one == "VH" else one for one in scene.radar.polarizations})
    for name in wanted:
        file = folder_of(scene, name, TERM, folder) / f"{file_stem(tuple(scene.materials), name, 'term')}.json"
        none = {c: np.zeros(1) for c in channels}
        model, place = scene.materials[name].model, np.zeros((1, len(WIDTH)))
        untrained[name] = UntrainedTerm(ScatteringTerm(model, place, np.array(WIDTH), none, SPREAD_DB, NOISE_DB), file)
        untrained[name].save()
        held = scene.materials[name].model_copy(update={TERM: file.resolve(), "learn": ()})
        scene = replace(scene, materials=scene.materials | {name: held})
    if not untrained:
        return scene, {}
    problem = prepared(scene)
    for name, one in untrained.items():
        places = _places(problem, name)
        used = {c: np.ones(len(places), bool) for c in channels}
        none = {c: np.zeros(len(places)) for c in channels}
        untrained[name] = replace(one, term=replace(one.term, places=places, weights=none, used=used))
        untrained[name].save()
    return replace(scene), untrained  # of whose parameters nothing is kept from before the files were written


def as_asked(final: Scene, asked: Scene, terms: Collection[str]) -> Scene:
    """The learned scene, whose materials with a trained term ask for it again."""
    again = {name: final.materials[name].model_copy(update={"learn": asked.materials[name].learn}) for name in terms}
    return replace(final, materials=final.materials | again)


def _places(problem: FitProblem, name: str) -> np.ndarray:
    """Places of the units, (n, 4), at the middle of the material's eps, h and l, over what was seen of it."""
    cosines, wavenumber = seen_cosines(problem, name, TERM), problem.scene.wavenumber(problem.chosen[-1])
    low, high = np.percentile(cosines, SEEN)
    count = max(int(np.ceil((high - low) / WIDTH[0])), 1) + 1
    middle = (low + high) / 2 + (np.arange(count) - (count - 1) / 2) * WIDTH[0]
    eps, height, length = (float(np.median(problem.surface.values(name, key))) for key in KEYS[:3])
    here = [np.log(wavenumber * height), np.log(wavenumber * length), np.log(eps - 1.0)]
    return np.column_stack([middle, np.tile(here, (count, 1))])


def folder_of(scene: Scene, name: str, key: str, folder: Path | None) -> Path:
    """The folder for a material's new file. Raises InputError without one."""
    if folder is None:
        raise InputError(f"{scene.name}: materials.{name}.learn: {key}: needs a folder for its file")
    return folder


def seen_cosines(problem: FitProblem, name: str, key: str) -> np.ndarray:
    """cos theta of the hits that all views have of a material, float32, in no order.

    Raises InputError where there is none, or where they are not in memory.
    """
    if not problem.keeps_hits:
        raise InputError(f"{problem.scene.name}: {key} is trained with all hits in memory; --max-memory is too low")
    materials, own = problem.stage.face_material.numpy(), problem.surface.materials.index(name)
    seen = []
    for view in problem.views:
        hits = view.render.whole.shaded
        seen.append(hits.cos_incidence.numpy()[materials[hits.face.numpy()] == own])
    cosines = problem.of_all_views(np.concatenate([np.zeros(0, np.float32), *seen]))
    if not cosines.size:
        raise InputError(f"{problem.scene.name}: materials.{name}.learn: {key}: no train view sees the material")
    return cosines
