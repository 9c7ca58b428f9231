"""The phase of a scene's complex images: what each view is asked, and the scene that declares what was found."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.diagnosis.phase.ask import MotionFound, Outcome, PhaseFound, asked, folds_of
from warpsar.diagnosis.phase.fit import KNOTS
from warpsar.diagnosis.phase.spectrum import BORDER_CELLS, AzimuthSpectrum
from warpsar.effects.base.slow_time import phase_at
from warpsar.effects.registry import declared, response_of
from warpsar.io import complex_image
from warpsar.runtime import console
from warpsar.runtime.busy import busy
from warpsar.scene.scene import Scene
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import View

EFFECT = "phase_error"
MOTION_ERROR = "motion_error"
_POLYNOMIAL = ("quadratic_rad", "cubic_rad", "quartic_rad")
MOST_COLUMNS = 2048
"""Of an image that are looked at, about its middle."""
_MARGINS = 3
"""Of borders at either end of a row, in what must be left between them."""


@dataclass(frozen=True)
class PhaseAsked:
    """What a view's complex images say."""

    view: str
    found: PhaseFound
    motion: MotionFound | None = None
    """None where nothing could be asked."""
    aside_m: float | None = None
    """Track error across the line of sight for each radian of `motion.aside` [m]; None where no range is known."""
    along_m: float = 0.0
    """Track error along it for each radian that all ranges share [m]."""

    @property
    def named(self) -> bool:
        """Whether the phase is wrong, by an error of its own or by one of the track."""
        return self.found.outcome == "named" or self.moved

    @property
    def moved(self) -> bool:
        """Whether it changes with range as that of a track error does."""
        return self.motion is not None and self.motion.outcome == "named"

    @property
    def cause(self) -> str:
        """What a verdict calls it."""
        return MOTION_ERROR if self.moved else EFFECT

    @property
    def words(self) -> str:
        """One or two sentences."""
        text = self._of_phase()
        return text if (more := self._of_motion()) is None else f"{text}. {more}"

    def _of_motion(self) -> str | None:
        one = self.motion
        if one is None:
            return None
        if self.moved and self.aside_m is not None:
            along, aside = self.along_m * one.same[0], self.aside_m * one.aside[0]
            what = f"quadratic of {1e3 * along:.3g} mm along the line of sight and {aside:.3g} m across it"
            return f"{MOTION_ERROR}: named, {what}: {one.why}"
        if self.found.outcome != "named":
            return f"{MOTION_ERROR}: {one.outcome}: {one.why}"
        tied = f"{MOTION_ERROR}: tied: an error of the track along the line of sight gives all ranges this phase, too"
        if one.least_rad is None or self.aside_m is None:
            return f"{tied}; whether the phase changes with range cannot be told here"
        return f"{tied}; one across it would be found from {one.least_rad * self.aside_m:.3g} m on"

    def _of_phase(self) -> str:
        one = self.found
        if one.outcome != "named":
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
        motion = None
        if self.motion is not None:
            scales = {"along_m": self.along_m, "aside_m": self.aside_m}
            motion = {**asdict(self.motion), **scales, "tied": self.found.outcome == "named" and not self.moved}
        return {"view": self.view, **asdict(self.found), "motion": motion}

    def table(self) -> dict[str, Any]:
        """What `[effects.phase_error]` says of the view: of a track error the part that all ranges share."""
        if self.moved and self.motion is not None:
            return dict(zip(_POLYNOMIAL, (round(value, 4) for value in self.motion.same), strict=True))
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
            found.append(_asked(scene, view))
        console.say(found[-1].words)
    return found


def _asked(scene: Scene, view: View) -> PhaseAsked:
    def nothing(outcome: Outcome, why: str) -> PhaseAsked:
        return PhaseAsked(view.name, PhaseFound(outcome, why))

    if EFFECT in scene.effects:
        return nothing("declared", "the scene file declares it")
    (across, _), (along, _) = response_of(declared(scene, view)).cells()
    cells = across, along
    if min(cells) <= 0.0:
        return nothing("not testable", "no effects.point_spread says how wide the aperture is")
    folds: list[list[AzimuthSpectrum]] = [[], []]
    for polarization, path in view.slc.items():
        image, range_m, azimuth_m = complex_image.read(path, polarization)
        spacing = (float(range_m[1] - range_m[0]), float(azimuth_m[1] - azimuth_m[0]))
        image = _middle(image)
        if spacing[1] > cells[1]:
            why = f"samples are {spacing[1]:.3g} m apart in azimuth, and a cell is {cells[1]:.3g} m: the phase is lost"
            return nothing("not testable", why)
        if image.shape[1] * spacing[1] < 2 * _MARGINS * BORDER_CELLS * cells[1]:
            return nothing("not testable", f"its rows are shorter than {2 * _MARGINS * BORDER_CELLS} cells")
        aside, slant = _aside(scene, view, range_m), scene.slant_range_m(view)
        stretch = None if slant is None else (slant + range_m) / slant
        widest = 0.0 if aside is None else float(np.abs(aside).max())
        ratio = np.zeros(len(image)) if aside is None or not widest else aside / widest
        known = np.where(np.isfinite(image), image, 0.0).astype(np.complex64)
        for fold, mask in zip(folds, folds_of(len(known), spacing[0], cells[0]), strict=True):
            fold.append(
                AzimuthSpectrum.of(known[mask], spacing, cells, ratio[mask], None if stretch is None else stretch[mask])
            )
    joined, seed = [AzimuthSpectrum.joined(one) for one in folds], scene.sampling.seed
    found, motion = asked(joined, seed=seed)
    if found.outcome == "not testable":
        return PhaseAsked(view.name, found)
    metre = SPEED_OF_LIGHT / (4.0 * np.pi * (view.frequency_hz or scene.radar.frequency_hz))
    return PhaseAsked(view.name, found, motion, metre / widest if widest else None, metre)


def _aside(scene: Scene, view: View, range_m: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Sine of the angle between the look direction at ranges about the reference point (n,) and that of the reference
    point, over level ground; None where no slant range is known."""
    slant = scene.slant_range_m(view)
    if slant is None:
        return None
    incidence = np.deg2rad(view.incidence_deg)
    level = slant * np.cos(incidence) / np.maximum(slant + range_m, slant * np.cos(incidence))
    return np.asarray(np.sin(np.arccos(level) - incidence))


def _middle(image: NDArray[Any]) -> NDArray[Any]:
    """At most `MOST_COLUMNS` columns."""
    start = max(0, (image.shape[1] - MOST_COLUMNS) // 2)
    return image[:, start : start + MOST_COLUMNS]


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
    """For the verdict: what any view has."""
    causes = {one.cause for one in found if one.named}
    return [name for name in (EFFECT, MOTION_ERROR) if name in causes]
