"""Size and attitude of the vehicle, and the slope of its ground, from chips that were left out (btr70.py)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from btr70_jobs import Job, done
from btr70_measures import SIZE, Chip, aimed, best_shift
from btr70_model import HEADER_M, SPACING_M, held_out, predicted, with_tables
from scipy.ndimage import gaussian_filter
from scipy.stats import t as student

from warpsar.scene.scene import Scene

CAD_M = {"length": 7.65, "width": 2.66, "height": 2.61}
CAD_SD = 0.10  # of the CAD's size: its prior
HEADER_DEG = {"roll_deg": -1.18, "pitch_deg": -1.42}
AREA_PX = 2.4  # pixels of speckle that share a draw: spacing 0.20 m, widths 0.30 and 0.32 m
ARCS = 9  # of neighbours in azimuth: their misfit is alike, so the jackknife leaves out an arc at a time
INTERVAL = 0.95
REPLICATES = 40  # of the chips on which the intervals are tried
FRESH_M = (0.96, 0.98, 1.0, 1.02, 1.04)  # places of a size there
START = {"btr70": {"scale": (1.0, 1.0, 1.0), **HEADER_DEG}, "ground": {"roll_deg": 0.0, "pitch_deg": 0.0}}
Tables = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Quantity:
    """A number in the table of an object: an angle [deg], or the factor on a size along `axis`.

    `wide` are the places of a first profile, `near` those of a second one: about what was found, times it for a size.
    """

    name: str
    body: str
    key: str
    axis: int | None
    wide: tuple[float, ...]
    near: tuple[float, ...]

    def of(self, tables: Tables) -> float:
        value = tables[self.body][self.key]
        return float(value if self.axis is None else value[self.axis])

    def moved(self, tables: Tables, place: float) -> dict[str, dict[str, Any]]:
        """The tables with one more place."""
        now = tables[self.body][self.key]
        value = place if self.axis is None else tuple(place if k == self.axis else one for k, one in enumerate(now))
        return {name: dict(table) | ({self.key: value} if name == self.body else {}) for name, table in tables.items()}

    def places(self, about: float | None) -> tuple[float, ...]:
        if about is None:
            return self.wide
        return tuple(round(about * p if self.axis is not None else about + p, 5) for p in self.near)


SIZES, CLOSE = (0.8, 0.85, 0.9, 0.95, 1.0, 1.05, 1.1), (0.94, 0.97, 1.0, 1.03, 1.06)
TILTS, SLIGHT = (-3.0, -1.5, 0.0, 1.5, 3.0), (-2.0, -1.0, 0.0, 1.0, 2.0)
MOVED = (
    Quantity("height", "btr70", "scale", 2, SIZES, CLOSE),
    Quantity("ground_roll_deg", "ground", "roll_deg", None, TILTS, SLIGHT),
    Quantity("ground_pitch_deg", "ground", "pitch_deg", None, TILTS, SLIGHT),
    Quantity("width", "btr70", "scale", 1, SIZES, (0.88, 0.94, 1.0, 1.06, 1.12)),
    Quantity("length", "btr70", "scale", 0, SIZES, CLOSE),
)
"""What the step moves, in this order. Roll and pitch of the vehicle are known, by the header."""
ASKED = tuple(
    Quantity(name, "btr70", name, None, TILTS, (-6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0))
    for name in ("roll_deg", "pitch_deg")
)
"""What the images are asked, and what moves nothing."""


def minimum(places: Sequence[float], losses: Sequence[float]) -> float:
    """Where the quartic through a profile (cubic and less for fewer than six places) has its least value, inside it.

    A profile is not even about its least value. A parabola would put it aside: 0.3 % of a height."""
    at, loss = np.array(places), np.array(losses)
    middle, half = 0.5 * (at.min() + at.max()), 0.5 * float(np.ptp(at))
    curve = np.poly1d(np.polyfit((at - middle) / half, loss, min(4, len(at) - 1)))
    flat = [float(root.real) for root in curve.deriv().roots if abs(root.imag) < 1e-6 and abs(root.real) <= 1.0]
    return float(middle + half * min([-1.0, 1.0, *flat], key=curve))


def likeliest(
    places: Sequence[float], scores: np.ndarray, sd: float | None = None, arcs: int | None = None
) -> tuple[float, float, float]:
    """Where the chips' mean deviances, (places, chips), are least, its standard deviation, and the half width of the
    interval that holds it in `INTERVAL` of all cases.

    The standard deviation is the jackknife's over `arcs` of neighbours; by default over the chips. With `sd`, the
    places are known to be 1 to so much before the images are asked."""
    losses = 0.5 * SIZE**2 / AREA_PX * np.asarray(scores)
    pull = np.zeros(len(places)) if sd is None else 0.5 * ((np.array(places) - 1.0) / sd) ** 2
    n = losses.shape[1]
    groups = np.array_split(np.arange(n), arcs or n)
    rest = [np.setdiff1d(np.arange(n), group) for group in groups]
    without = [minimum(places, (losses[:, some].sum(axis=1) * n / some.size + pull).tolist()) for some in rest]
    error = float(np.std(without) * np.sqrt(len(groups) - 1))
    found = minimum(places, (losses.sum(axis=1) + pull).tolist())
    return found, error, float(student.ppf(0.5 + 0.5 * INTERVAL, len(groups) - 1)) * error


def left_out(sources: Sequence[Path], chips: Sequence[Sequence[Chip]], changed: Tables) -> dict[str, Any]:
    """The scores of the chips that each scene left out, by chip, with other values in the tables of its objects."""
    found: dict[str, float] = {}
    for source, some in zip(sources, chips, strict=True):
        scores = held_out(with_tables(Scene.load(source), changed), some)
        found |= dict(zip((chip.name for chip in some), scores, strict=True))
    return {"scores": found}


@dataclass(frozen=True)
class Profiles:
    """Profiles of the score of left-out chips, each kept in `out`."""

    sources: Sequence[Path]
    chips: Sequence[Sequence[Chip]]
    out: Path
    processes: int

    @property
    def names(self) -> list[str]:
        """All chips, by azimuth."""
        return [chip.name for chip in sorted((c for some in self.chips for c in some), key=lambda c: c.azimuth_deg)]

    def at(self, name: str, tables: Tables) -> np.ndarray:
        """The scores of all chips, by azimuth, (chips,)."""
        scores = Job(self.out / f"{name}.json", left_out, (self.sources, self.chips, tables))()["scores"]
        return np.array([scores[name] for name in self.names])

    def along(self, asked: Quantity, tables: Tables, about: float | None) -> dict[str, Any]:
        """Where the scores are best along one quantity, all else as in `tables`."""
        places = asked.places(about)
        paths = [self.out / f"{asked.name}_{k}.json" for k in range(len(places))]
        moved = [asked.moved(tables, place) for place in places]
        jobs = [Job(path, left_out, (self.sources, self.chips, one)) for path, one in zip(paths, moved, strict=True)]
        scores = np.array([[one["scores"][name] for name in self.names] for one in done(jobs, self.processes)])
        best, sd, half = likeliest(places, scores, CAD_SD if asked.axis is not None else None, ARCS)
        profile = scores.mean(axis=1).tolist()
        return {"value": best, "sd": sd, "half": half, "places": list(places), "scores": profile}


def shape(profiles: Profiles, begun: Tables, *, near: bool) -> dict[str, Any]:
    """Size and slope, one after the other, by the score of left-out chips; `near`: about `begun`, and attitude too.

    Sizes are factors on the CAD, known to 10 %. All else of the model stays as fitted."""
    tables: Tables = begun
    found: dict[str, Any] = {}
    base = profiles.at("declared", tables)
    for one in MOVED:
        found[one.name] = profiles.along(one, tables, one.of(tables) if near else None)
        tables = one.moved(tables, round(found[one.name]["value"], 4))
    gain = base - profiles.at("found", tables)
    if near:
        found |= {one.name: profiles.along(one, tables, 0.0) for one in ASKED}
        back = {**tables, "btr70": {**tables["btr70"], "heading_deg": 180.0}}
        worse = profiles.at("turned", back) - profiles.at("found", tables)
        found["turned"] = {"value": float(worse.mean()), "sd": float(worse.std(ddof=1) / np.sqrt(worse.size))}
    return {**found, "tables": tables, "gains": gain.tolist()}


def speckled(image: np.ndarray, chip: Chip, draws: np.random.Generator) -> Chip:
    """A chip as the radar would give it, [DN^2]: speckle of one look, as wide as the header says, at the gain of a
    measured `chip`, in 8 bits, clipped."""
    sigma = [np.sqrt(2.0) / 2.3548 * w / s for w, s in zip(HEADER_M.values(), SPACING_M, strict=True)]
    field = [gaussian_filter(draws.standard_normal(image.shape), sigma) for _ in range(2)]
    power = image * sum((one / one.std()) ** 2 for one in field) / 2.0
    levels = np.round(np.sqrt(power * np.median(chip.power) / np.median(power)))
    return Chip(chip.name, chip.azimuth_deg, chip.depression_deg, np.clip(levels, 1.0, 255.0) ** 2)


def asked_again(source: Path, train: Sequence[Chip], name: str, places: Sequence[float]) -> dict[str, Any]:
    """Chips that the model itself makes of the train views, asked for one quantity: its truth, and what is found.

    What is found has a small bias, since an aim point between pixels is interpolated. The bias of one half of the
    replicates is taken off the other half (a parametric bootstrap), and then the intervals are asked for the truth."""
    scene = Scene.load(source)
    asked = next(one for one in (*MOVED, *ASKED) if one.name == name)
    tables = {one.label: one.model_dump() for one in scene.objects}
    truth, chips = asked.of(tables), sorted(train, key=lambda chip: chip.azimuth_deg)
    tried = [truth * place if asked.axis is not None else truth + place for place in places]
    images = [predicted(with_tables(scene, _only(asked, tables, place)), chips) for place in tried]
    exact = predicted(scene, chips)
    draws, found = np.random.default_rng(0), []
    for _ in range(REPLICATES):
        made = [speckled(exact[chip.name], chip, draws) for chip in chips]
        starts = [best_shift(one.power, exact[one.name])[1] for one in made]
        both = list(zip(made, starts, strict=True))
        scores = np.array([[aimed(one.power, image[one.name], at) for one, at in both] for image in images])
        found.append(likeliest(tried, scores, None, ARCS))
    off = np.array([value - truth for value, _, _ in found])
    half = np.sqrt(1.0 + 2.0 / REPLICATES) * np.array([half for *_, half in found])  # the bias has an error, too
    first = np.arange(REPLICATES) < REPLICATES // 2
    free = off - np.where(first, off[~first].mean(), off[first].mean())
    return {
        "truth": truth,
        "replicates": REPLICATES,
        "inside": int((np.abs(free) < half).sum()),
        "bias": float(off.mean()),
        "sd_of_found": float(off.std(ddof=1)),
        "sd_stated": float(np.mean([sd for _, sd, _ in found])),
    }


def _only(asked: Quantity, tables: Tables, place: float) -> dict[str, dict[str, Any]]:
    return {asked.body: {asked.key: asked.moved(tables, place)[asked.body][asked.key]}}


AGAIN = {
    "height": FRESH_M,
    "width": FRESH_M,
    "length": FRESH_M,
    "roll_deg": (-4.0, -2.0, 0.0, 2.0, 4.0),
    "pitch_deg": (-4.0, -2.0, 0.0, 2.0, 4.0),
    "ground_roll_deg": (-2.0, -1.0, 0.0, 1.0, 2.0),
}


def coverage(source: Path, train: Sequence[Chip], out: Path, processes: int) -> dict[str, Any]:
    """How often each interval holds the truth, on chips that the model made of the train views."""
    jobs = [Job(out / f"{name}.json", asked_again, (source, train, name, places)) for name, places in AGAIN.items()]
    return dict(zip(AGAIN, done(jobs, processes), strict=True))
