"""What the measured curves tell of the bodies:

Plate, ducts, calibration, background, and what stands in the range beside them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import rcs_bodies as bodies
from numpy.typing import NDArray
from rcs_curves import LOBES_DEG, Work

from warpsar.curves import metrics, sectors
from warpsar.curves.noise import Noises, densities, fit
from warpsar.curves.observe import amplitudes
from warpsar.curves.observed import ObservedCurve
from warpsar.curves.search import ask
from warpsar.curves.shape import likelihood, on_grid, profiles
from warpsar.world.frame import SPEED_OF_LIGHT

LEARN_PER_DIRECTION = 3.0
HUMP_DEG = 1.0
"""Half of the window over which power is averaged before that is asked."""
HUMP_DB = 3.0
"""An excess over model and background, at one angle in every curve, that stands in the range and not on the body."""


def slab(eps: complex, thickness_m: float, frequency_hz: float, cos: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Coefficient of reflection of a slab in air, TE."""
    root = np.sqrt(eps - (1.0 - cos**2) + 0j)
    face = (cos - root) / (cos + root)
    turn = np.exp(-2j * 2.0 * np.pi * frequency_hz / SPEED_OF_LIGHT * thickness_m * root)
    return face * (1.0 - turn) / (1.0 - face**2 * turn)


def calibration(curves: Sequence[ObservedCurve], names: Sequence[str]) -> dict[str, Any]:
    """Measured over modelled power of the metal plate's main lobe [dB], by curve:

    What the calibration may be wrong by.
    """
    found = {}
    for one in curves:
        main = np.abs(90.0 - one.azimuth_deg) < 0.6 * one.step_deg
        model = np.abs(one.amplitude(names)) ** 2
        found[one.name] = -metrics.level_db(one.measured_m2[main], model[main])
    first = [v for k, v in found.items() if any(code in k for code in (".f9.", ".f10.", ".fx1."))]
    return {"calibration_db": {"mean": float(np.mean(first)), "sd": float(np.std(first, ddof=1)), "curves": found}}


def named(
    work: Work, curves: Sequence[ObservedCurve], predict: Callable[[ObservedCurve], NDArray[np.float64]]
) -> dict[str, Any]:
    """What stays at one angle at all frequencies, in both polarizations:

    It is of the range, since what is of the body moves.
    """
    first = [one for file, one in zip(work.files, curves, strict=True) if file.first]
    grid = np.unique(np.concatenate([one.azimuth_deg for one in first]))
    mean = np.abs(grid[:, None] - grid) <= HUMP_DEG
    mean = mean / mean.sum(axis=1, keepdims=True)

    def smoothed(one: ObservedCurve, power: NDArray[np.float64]) -> NDArray[np.float64]:
        order = np.argsort(one.azimuth_deg)
        return metrics.decibels(mean @ np.interp(grid, one.azimuth_deg[order], power[order]))

    measured = np.array([smoothed(one, one.measured_m2) for one in first])
    common = (measured - np.array([smoothed(one, predict(one)) for one in first])).min(axis=0)
    place = int(common.argmax())
    if common[place] < HUMP_DB:
        return {"spurious": None}
    wide = np.flatnonzero(common > 0.5 * common[place])
    hump = {
        "phi_deg": float(90.0 - grid[place]),
        "width_deg": float(np.ptp(grid[wide])),
        "least_excess_db": float(common[place]),
        "level_dbsm": [float(measured[:, place].min()), float(measured[:, place].max())],
    }
    return {"spurious": hump}


def saturation(work: Work, names: Sequence[str]) -> dict[str, float]:
    """How far the strongest direction, phi = 90 of a box, is measured below the model [dB], by curve."""
    found = {}
    for file in work.files:
        at = np.abs(file.table.azimuth_deg) < 0.01
        if file.first and at.any():
            frequency, pol = float(file.table.frequency_hz[0]), file.table.polarization[0]
            scene = work.body.scene(work.mesh, frequency)
            made = amplitudes(scene, np.zeros(1), 90.0, frequency, cache=work.cache, device=work.device)
            model = np.abs(sum(made.of(pol)[name] for name in names)) ** 2
            found[file.path.name] = metrics.level_db(file.table.rcs_m2[at], model)
    return found


def offered_duct(work: Work, data: Path, names: Sequence[str]) -> dict[str, Any]:
    """The closed box, offered the cobra's duct: what the duct adds to it, in the directions that would see into it."""
    mesh = bodies.stl_box(data, "cobra")
    normals = sectors.apertures(mesh)
    curves = []
    for file, one in zip(work.files, work.curves, strict=True):
        if file.first:
            other = work.observed(file, mesh)
            duct = other.amplitude(("single", "edges", "multibounce")) - one.amplitude(names)
            inside = sectors.sectors(normals, one.azimuth_deg, one.incidence_deg)["aperture"]
            curves.append(one.beside({**one.terms, "duct": duct}).where(inside).thinned(6.0))
    return {"the cobra's duct": asdict(ask(curves, names, "multibounce", "duct"))}


def duct(work: Work, names: Sequence[str], cache: Path, device: str | None) -> tuple[dict[str, Any], bodies.Duct]:
    """Radius, length and offset of the duct by likelihood, from the train curves in the directions that see it."""
    pairs = [(file, one) for file, one in zip(work.files, work.curves, strict=True) if file.first]

    def some(one: bodies.Duct, role: str) -> list[ObservedCurve]:
        mesh = bodies.cylinder_box(one)
        found = []
        for file, given in pairs:
            if given.role == role:
                thin = given.where(work.sector(given, "aperture")).thinned(LEARN_PER_DIRECTION)
                table = replace_rows(file, thin.azimuth_deg)
                found.append(work.observed(table, mesh))
        return found

    def twice_log(role: str, **moved: float) -> float:
        return likelihood(some(replace(bodies.MODEL, **moved), role), names)

    def ahead(moved: Sequence[Mapping[str, float]]) -> None:
        """Fill the cache with the sweeps of some shapes, several processes side by side."""
        shapes = [replace(bodies.MODEL, **one) for one in moved]
        tables = [
            replace_rows(
                file, given.where(work.sector(given, "aperture")).thinned(LEARN_PER_DIRECTION).azimuth_deg
            ).table
            for file, given in pairs
            if given.role == "train"
        ]
        swept(work.jobs, [(shape, table, cache, device) for shape in shapes for table in tables])

    axes = {"radius_m": np.arange(0.1450, 0.1536, 0.0010), "length_m": np.arange(0.2970, 0.3031, 0.0015)}
    ahead([dict(zip(axes, map(float, point), strict=True)) for point in product(*axes.values())])
    grid = on_grid(axes, lambda x: twice_log("train", **x))
    told = profiles(axes, grid)
    best = {name: one.value for name, one in told.items()}
    for name, axis in {"right_m": np.arange(-0.012, 0.0121, 0.004), "up_m": np.arange(-0.006, 0.0061, 0.002)}.items():
        ahead([{**best, name: float(each)} for each in axis])
        line = on_grid({name: axis}, lambda x: twice_log("train", **best, **x))
        told |= profiles({name: axis}, line)
    result = replace(bodies.MODEL, **best)
    stated = {"drawing": bodies.DRAWING, "model": bodies.MODEL, "learned": result}
    sums = {name: {role: twice_log(role, **asdict(one)) for role in ("train", "test")} for name, one in stated.items()}
    dimensions = {name: asdict(one) for name, one in stated.items()}
    return {"duct": {name: one.content() for name, one in told.items()}, "twice_log_likelihood": sums,
            "dimensions": dimensions}, result  # fmt: skip


def swept(jobs: int, sweeps: Sequence[tuple[bodies.Duct, Any, Path, str | None]]) -> None:
    """Put the amplitudes of shapes and curves into the cache, `jobs` processes side by side; nothing with one."""
    if jobs > 1:
        # a fresh process for each: Warp's threads do not survive a fork
        with ProcessPoolExecutor(jobs, mp_context=get_context("spawn")) as pool:
            list(pool.map(sweep_of, sweeps))


def sweep_of(given: tuple[bodies.Duct, Any, Path, str | None]) -> None:
    """One of `swept`, on one thread."""
    duct, table, cache, device = given
    os.environ["WARPSAR_THREADS"] = "1"
    frequency, incidence = float(table.frequency_hz[0]), float(np.median(table.incidence_deg))
    scene = bodies.scene(bodies.cylinder_box(duct))
    amplitudes(scene, table.azimuth_deg, incidence, frequency, cache=cache, device=device)


def replace_rows(file: Any, azimuth_deg: NDArray[np.float64]) -> Any:
    """A curve file with some of its directions alone."""
    table = file.table
    keep = np.isin(table.azimuth_deg.round(6), azimuth_deg.round(6))
    polarization = tuple(np.array(table.polarization)[keep].tolist())
    arrays = {name: getattr(table, name)[keep] for name in ("frequency_hz", "azimuth_deg", "incidence_deg", "rcs_m2")}
    return replace(file, table=replace(table, **arrays, polarization=polarization))


def dielectric(work: Work, metal: Mapping[str, Any]) -> tuple[dict[str, Any], list[ObservedCurve]]:
    """Permittivity and thickness of the plate, from its lobes;

    The calibration is that of the metal plate, and as uncertain.
    """
    known = metal.get("calibration_db", {"mean": 0.0, "sd": 0.5})
    bare = [
        one.where(90.0 - one.azimuth_deg < LOBES_DEG).thinned(6.0)
        for file, one in zip(work.files, work.curves, strict=True)
        if file.first
    ]
    by_role = {role: [one for one in bare if one.role == role] for role in ("train", "test")}
    stated_eps, stated_m = 2.61, bodies.DIELECTRIC_THICKNESS_M

    def at(one: ObservedCurve, product_mm: float, eps: float, gain_db: float) -> ObservedCurve:
        return scaled(one, eps, product_mm * 1e-3 / (eps - 1.0), gain_db)

    def score(curves: Sequence[ObservedCurve], noise: Noises, *values: float) -> float:
        moved = [at(one, *values) for one in curves]
        return 2.0 * sum(float(densities(o, o.amplitude(["model"]), noise[o.polarization]).sum()) for o in moved)

    axes = {
        "product_mm": np.linspace(1.9, 3.3, 57),
        "eps_r": np.geomspace(1.3, 8.0, 31),
        "gain_db": known["mean"] + known["sd"] * np.linspace(-3.0, 3.0, 9),
    }
    prior = -(((axes["gain_db"] - known["mean"]) / known["sd"]) ** 2)
    values = ((stated_eps - 1.0) * stated_m * 1e3, stated_eps, float(known["mean"]))
    for _ in range(2):  # the noise is that of the likeliest plate, which hardly moves it
        noise = fit([at(one, *values) for one in by_role["train"]], ["model"]).noise
        grid = np.array([score(by_role["train"], noise, *each) for each in product(*axes.values())])
        grid = grid.reshape([len(axis) for axis in axes.values()]) + prior
        where = np.unravel_index(int(grid.argmax()), grid.shape)
        values = tuple(float(axis[i]) for axis, i in zip(axes.values(), where, strict=True))
    told = profiles(axes, grid)
    stated = (stated_eps - 1.0) * stated_m * 1e3
    best, gain = told["product_mm"].value, told["gain_db"].value
    tried = {
        "as stated": (stated, stated_eps, float(known["mean"])),
        "as stated, a calibration of its own": (
            stated,
            stated_eps,
            _own_gain(by_role["train"], noise, score, stated, stated_eps),
        ),
        "thicker": (best, stated_eps, gain),
        "learned": values,
    }
    explained = {
        name: {
            "product_mm": each[0], "eps_r": each[1], "thickness_mm": each[0] / (each[1] - 1.0), "gain_db": each[2],
            **{f"{role}_twice_log_likelihood": score(curves, noise, *each) for role, curves in by_role.items()},
            **{f"{role}_error_db": error(curves, noise, at, each) for role, curves in by_role.items()},
        }
        for name, each in tried.items()
    }  # fmt: skip
    final = [
        parts(scaled(one, values[1], values[0] * 1e-3 / (values[1] - 1.0), values[2]), values[1]) for one in work.curves
    ]
    return {
        "plate": {name: one.content() for name, one in told.items()},
        "stated": {"product_mm": stated, "eps_r": stated_eps},
        "explained": explained,
    }, final


def parts(one: ObservedCurve, eps: float) -> ObservedCurve:
    """The learned plate's curve in the two terms:

    What physical optics has of it, and the polarization across the slab.
    """
    cos2 = np.sin(np.deg2rad(one.azimuth_deg)) ** 2
    across = (1.0 - cos2) / eps
    share = 2.0 * across / (cos2 + across) if one.polarization == "HH" else np.zeros(len(cos2))
    whole = one.terms["model"]
    return one.beside({"single": (1.0 - share) * whole, "normal": share * whole})


def _own_gain(curves: Sequence[ObservedCurve], noise: Noises, score: Any, product_mm: float, eps: float) -> float:
    gains = np.linspace(-1.0, 3.0, 81)
    return float(gains[int(np.argmax([score(curves, noise, product_mm, eps, gain) for gain in gains]))])


def error(curves: Sequence[ObservedCurve], noise: Noises, at: Any, values: tuple[float, float, float]) -> float:
    """Mean abs(dB) of some curves within the lobes, the background counted."""
    found = []
    for one in curves:
        model = np.abs(at(one, *values).terms["model"]) ** 2 + noise[one.polarization].background_m2
        found.append(metrics.error_db(one.measured_m2, model))
    return float(np.mean(found))


def scaled(one: ObservedCurve, eps: float, thickness_m: float, gain_db: float) -> ObservedCurve:
    """The plate's curve with another slab, as the term `model`:

    The declared one in VV, times the ratio of reflections.
    """
    cos = np.abs(np.sin(np.deg2rad(one.azimuth_deg)))
    lossy, stated = eps - 0.0354j, 2.61 - 0.0354j
    ratio = slab(lossy, thickness_m, one.frequency_hz, cos)
    ratio = ratio / slab(stated, bodies.DIELECTRIC_THICKNESS_M, one.frequency_hz, cos)
    if one.polarization == "HH":
        ratio = ratio * (cos**2 + (1.0 - cos**2) / lossy) / (cos**2 + (1.0 - cos**2) / stated)
    whole = one.amplitude(("single", "normal"))
    return one.beside({**one.terms, "model": 10.0 ** (gain_db / 20.0) * ratio * whole})
