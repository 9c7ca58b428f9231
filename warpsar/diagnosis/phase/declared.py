"""The phase of a scene's complex images: what each view is asked, and the scene that declares what was found."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.diagnosis.phase.ask import PhaseFound, asked, folds_of
from warpsar.diagnosis.phase.fit import KNOTS
from warpsar.diagnosis.phase.spectrum import BORDER_CELLS, AzimuthSpectrum
from warpsar.effects.base.phase import Response
from warpsar.effects.base.slow_time import phase_at
from warpsar.effects.registry import declared
from warpsar.io import complex_image
from warpsar.runtime import console
from warpsar.runtime.busy import busy
from warpsar.scene.scene import Scene
from warpsar.world.tables import View

EFFECT = "phase_error"
_POLYNOMIAL = ("quadratic_rad", "cubic_rad", "quartic_rad")
MOST_SIDE = 2048
"""Rows and columns of an image that are looked at, about its middle."""
_MARGINS = 3
"""Of borders at either end of a row, in what must be left between them."""


@dataclass(frozen=True)
class PhaseAsked:
    """What a view's complex images say."""

    view: str
    found: PhaseFound

    @property
    def named(self) -> bool:
        return self.found.outcome == "named"

    @property
    def words(self) -> str:
        """One sentence."""
        one = self.found
        if not self.named:
            return f"{self.view}: {EFFECT}: {one.outcome}: {one.why}"
        pairs = [f"{value:.3g} +- {error:.2g}" for value, error in zip(one.coefficients, one.error, strict=True)]
        what = f"{one.family} of {', '.join(pairs)} rad"
        return f"{self.view}: {EFFECT}: named, {what}: {one.why}"

    def phase(self, place: NDArray[np.float64]) -> NDArray[np.float64]:
        """The phase that was named [rad] at places of the aperture, -1 to 1, as the effect has it."""
        table = self.table()
        polynomial = [table.get(key, 0.0) for key in _POLYNOMIAL]
        return phase_at(place, polynomial, table.get("spline_rad", 0.0), table.get("spline_shape"))

    def content(self) -> dict[str, Any]:
        """For diagnosis.json."""
        return {"view": self.view, **asdict(self.found)}

    def table(self) -> dict[str, Any]:
        """What `[effects.phase_error]` says of the view."""
        numbers = [round(float(value), 4) for value in self.found.coefficients]
        if self.found.family == "spline":
            assert len(numbers) == KNOTS - 2
            return {"spline_rad": 1.0, "spline_shape": [0.0, *numbers, 0.0]}
        return dict(zip(_POLYNOMIAL[: len(numbers)], numbers, strict=True))


def ask_phase(scene: Scene) -> list[PhaseAsked]:
    """What the complex images of each view say of a phase error over slow time; empty without such images.

    All views are asked, whatever their role: the phase of a view comes from its own samples, and no model of the
    ground has a part in it. Raises InputError for a file that is no complex image.
    """
    found = []
    for view in scene.views:
        if not view.slc:
            continue
        with busy(f"{view.name}: phase over slow time"):
            found.append(PhaseAsked(view.name, _asked(scene, view)))
        console.say(found[-1].words)
    return found


def _asked(scene: Scene, view: View) -> PhaseFound:
    if EFFECT in scene.effects:
        return PhaseFound("declared", "the scene file declares it")
    widths = [one.effect.response(one.values, one.settings) for one in declared(scene, view)]
    cells = _cells(widths)
    if cells is None:
        return PhaseFound("not testable", "no effects.point_spread says how wide the aperture is")
    folds: list[list[AzimuthSpectrum]] = [[], []]
    for polarization, path in view.slc.items():
        image, range_m, azimuth_m = complex_image.read(path, polarization)
        spacing = (float(range_m[1] - range_m[0]), float(azimuth_m[1] - azimuth_m[0]))
        image = _middle(image)
        if spacing[1] > cells[1]:
            why = f"samples are {spacing[1]:.3g} m apart in azimuth, and a cell is {cells[1]:.3g} m: the phase is lost"
            return PhaseFound("not testable", why)
        if image.shape[1] * spacing[1] < 2 * _MARGINS * BORDER_CELLS * cells[1]:
            return PhaseFound("not testable", f"its rows are shorter than {2 * _MARGINS * BORDER_CELLS} cells")
        known = np.where(np.isfinite(image), image, 0.0).astype(np.complex64)
        for fold, mask in zip(folds, folds_of(len(known), spacing[0], cells[0]), strict=True):
            fold.append(AzimuthSpectrum.of(known[mask], spacing, cells))
    joined = [one[0].with_spectrum(np.concatenate([each.spectrum for each in one])) for one in folds]
    return asked(joined, seed=scene.sampling.seed)


def _cells(widths: list[Response]) -> tuple[float, float] | None:
    for one in widths:
        (across, _), (along, _) = one.cells()
        if across > 0.0 and along > 0.0:
            return across, along
    return None


def _middle(image: NDArray[np.complex64]) -> NDArray[np.complex64]:
    """At most `MOST_SIDE` rows and columns."""
    starts = [max(0, (side - MOST_SIDE) // 2) for side in image.shape]
    return image[starts[0] : starts[0] + MOST_SIDE, starts[1] : starts[1] + MOST_SIDE]


def with_phase_errors(scene: Scene, found: list[PhaseAsked]) -> Scene:
    """The scene that declares the phase errors that were named. Fits hold them: power does not tell them again."""
    named = [one for one in found if one.named]
    if not named:
        return scene
    table: dict[str, Any] = {"fixed": True}
    for one in named:
        for key, value in one.table().items():
            table.setdefault(key, {})[one.view] = value
    return replace(scene, effects={**scene.effects, EFFECT: table})


def named_in(found: list[PhaseAsked]) -> list[str]:
    """For the verdict: the effect, where any view has it."""
    return [EFFECT] if any(one.named for one in found) else []
