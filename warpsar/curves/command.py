"""What `evaluate`, `learn` and `diagnose` do with the curves of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.coherent.left_out import left_out, said_left_out
from warpsar.curves import metrics, rivals
from warpsar.curves.noise import Fit, fit
from warpsar.curves.observe import observe
from warpsar.curves.observed import Observed
from warpsar.curves.search import CANDIDATES, Found, by_sector
from warpsar.curves.sectors import apertures
from warpsar.curves.shape import Told, likelihood, on_grid, profiles
from warpsar.errors import InputError
from warpsar.parameters.at import at
from warpsar.runtime import console
from warpsar.scene.scene import Scene

PEAK_DB = 80.0
"""How far under a curve's peak values still count: the suite's measure."""
PASSES = 2
POINTS = 9
FIRST_REACH = 1.6
"""Factor by which the first grid of a learned value reaches up and down.

Each further one reaches a third of its logarithm.
"""


def alone(scene: Scene) -> bool:
    """Whether a scene has curves and no images. Raises InputError where it has both, which no fit takes together."""
    images = any(view.images for view in scene.views)
    if scene.curves and images:
        raise InputError(f"{scene.name}: found curves and images; must have one of them where something is fitted")
    return bool(scene.curves)


def _said(scene: Scene) -> dict[str, Any]:
    """Warn of what curves do not have, and the entry of it in a command's JSON."""
    console.warn(said_left_out(scene, "a curve"))
    return {"not_applied_to_curves": list(left_out(scene))}


def evaluated(scene: Scene, cache: Path, device: str | None = None) -> dict[str, Any]:
    """How well the declared terms explain each curve, beside what needs no physics."""
    return {**_said(scene), **_evaluated(scene, cache, device)}


def _evaluated(scene: Scene, cache: Path, device: str | None) -> dict[str, Any]:
    curves = observe(scene, cache=cache, device=device)
    terms = scene.radar.terms
    noise = _noise(curves, terms)
    return {"curves": [_entry(one, terms) for one in curves], "noise": _levels(noise)}


def _noise(curves: Sequence[Observed], terms: Sequence[str]) -> Fit:
    train = [one for one in curves if one.role == "train"]
    return fit(train or list(curves), terms)


def _levels(noise: Fit) -> dict[str, Any]:
    return {
        pol: {"background_dbsm": float(metrics.decibels(np.array(one.background_m2))), "error_db": one.error_db}
        for pol, one in noise.noise.items()
    }


def _entry(one: Observed, terms: Sequence[str]) -> dict[str, Any]:
    model = np.abs(one.amplitude(terms)) ** 2
    low = float(metrics.decibels(one.measured_m2).max()) - PEAK_DB
    rival = {"null": rivals.constant([one]), "smooth": rivals.smooth([one])}
    return {
        "name": one.name,
        "role": one.role,
        "frequency_hz": one.frequency_hz,
        "polarization": one.polarization,
        "directions": len(one.measured_m2),
        "independent_directions": float(one.weight.sum()),
        "error_db": {
            "model": metrics.error_db(one.measured_m2, model, low),
            **{name: metrics.error_db(one.measured_m2, each.model_m2[0], low) for name, each in rival.items()},
        },
        "correlation": metrics.correlation(one.measured_m2, model, low),
        "level_db": metrics.level_db(one.measured_m2, model),
    }


def in_short(entries: Sequence[dict[str, Any]]) -> str:
    """One line: mean abs(dB) of the train and the test curves."""
    words = []
    for role in ("train", "test"):
        errors = [one["error_db"]["model"] for one in entries if one["role"] == role]
        words += [f"{role} curves {np.mean(errors):.2f} dB"] if errors else []
    return ", ".join(words)


@dataclass(frozen=True)
class LearnedCurves:
    """A scene whose permittivities were fitted to its curves."""

    scene: Scene
    told: dict[str, Told]
    """Under "material.eps_r"."""
    content: dict[str, Any]


def learned(scene: Scene, cache: Path, device: str | None = None) -> LearnedCurves:
    """Fit eps_r of every material that names it in `learn` to the train curves, by likelihood on grids that grow finer.

    One value is fitted at a time, twice around. Its interval is that of its profile with the others as found: where
    several trade against each other it is too narrow, and learn.json says how many there are. Raises InputError where
    there is nothing to learn or to learn it from.
    """
    if not any(curve.role == "train" for curve in scene.curves):
        raise InputError(f"{scene.name}: curves: found no train curve; must have one to learn from")
    wanted = [
        one.owner
        for one in scene.parameters.values()
        if one.key == "eps_r" and one.freed and one.layout == "number" and not scene.materials[one.owner].conductor
    ]
    if not wanted:
        raise InputError(
            f"{scene.name}: found nothing to learn from curves; a material must be no conductor and have "
            '"eps_r" in learn'
        )
    said = _said(scene)
    train = replace(scene, curves=tuple(curve for curve in scene.curves if curve.role == "train"))
    told: dict[str, Told] = {}
    now = scene
    for turn in range(PASSES):
        for name in wanted:
            middle = float(now.parameters[f"materials.{name}.eps_r"].value) - 1.0
            reach = np.log(FIRST_REACH) / 3.0**turn
            axes = {"eps_r": 1.0 + middle * np.exp(np.linspace(-reach, reach, POINTS))}

            def twice_log(x: Any, name: str = name, now: Scene = now) -> float:
                one = now.parameters[f"materials.{name}.eps_r"]
                moved = replace(train, materials=at(now, {one: x["eps_r"]}).materials)
                return likelihood(observe(moved, device=device), scene.radar.terms)

            found = profiles(axes, on_grid(axes, twice_log))["eps_r"]
            told[f"{name}.eps_r"] = found
            now = at(now, {now.parameters[f"materials.{name}.eps_r"]: found.value})
    content = {
        **said,
        "materials": {key: one.content() for key, one in told.items()},
        "fitted_together": len(wanted),
        "before": _evaluated(scene, cache, device),
        "after": _evaluated(now, cache, device),
    }
    return LearnedCurves(now, told, content)


@dataclass(frozen=True)
class DiagnosedCurves:
    """A scene with the terms that its curves ask for."""

    scene: Scene
    found: dict[str, Found]
    """By sector."""
    content: dict[str, Any]


def diagnosed(scene: Scene, cache: Path, device: str | None = None) -> DiagnosedCurves:
    """Which terms of the engine the curves show and `[radar] terms` does not declare.

    Raises InputError without train curves.
    """
    if not any(curve.role == "train" for curve in scene.curves):
        raise InputError(f"{scene.name}: curves: found no train curve; must have one to name anything")
    said = _said(scene)
    declared = scene.radar.terms
    every = tuple(dict.fromkeys((*declared, *CANDIDATES.values())))
    whole = replace(scene, radar=scene.radar.model_copy(update={"terms": every}))
    curves = observe(whole, cache=cache, device=device)
    found = by_sector(curves, apertures(scene.mesh), declared)
    terms = tuple(dict.fromkeys(term for one in found.values() for term in one.terms))
    verdict = list(dict.fromkeys(effect for one in found.values() for effect in one.verdict))
    level = list(dict.fromkeys(effect for one in found.values() for effect in one.level_only))
    after = replace(scene, radar=scene.radar.model_copy(update={"terms": terms}))
    content = {
        **said,
        "verdict": verdict,
        "level_only": [one for one in level if one not in verdict],
        "sectors": {name: [asdict(each) for each in one.asked] for name, one in found.items()},
        "before": {"curves": [_entry(one, declared) for one in curves], "noise": _levels(_noise(curves, declared))},
        "after": {"curves": [_entry(one, terms) for one in curves], "noise": _levels(_noise(curves, terms))},
    }
    return DiagnosedCurves(after, found, content)
