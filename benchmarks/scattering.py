"""Backscatter models against a full-wave table, and their speed.

    python benchmarks/scattering.py DATA/nmm3d/NMM3D_LUT_NRCS_40degree.dat [--write]
    python benchmarks/scattering.py DATA/... --learned [--term soil.json] [--write]
    python benchmarks/scattering.py --speed [--device cuda] [--write]

The table has 162 exponential surfaces at 40 degrees: incidence, l / h, eps', eps'', h / wavelength, VV, HH, HV [dB].
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tables
import warp as wp

from warpsar.kernels import crossed_spline, crossed_table
from warpsar.kernels.codes import FRACTION_LIMIT, Polarization, Spectrum
from warpsar.kernels.incidence_table import DOUBLE, SINGLE
from warpsar.kernels.lane_kernels import LANES, at_once
from warpsar.kernels.scatter import scatter_kernel, sigma0_of
from warpsar.kernels.shade import HitSurfaces
from warpsar.models.base.model import DEFAULT
from warpsar.render.ways.i2em import table
from warpsar.runtime.structs import fill
from warpsar.world.scattering_term import learned

FREQUENCY_HZ = 5.405e9  # the table has none; Dubois alone depends on it
WAVENUMBER = 2 * np.pi * FREQUENCY_HZ / 299792458.0
CHANNELS = ("VV", "HH", "HV")
HITS = {"cpu": 2**20, "cuda": 2**24}  # of a pass: launches must not count
ROUNDS = 4
MODELS_TIMED = ("ka_spm", "i2em", "oh", "dubois")
SURFACES_TIMED = ((0.1, 1.0), (0.3, 3.0), (0.6, 5.0), (1.3, 10.0))  # kh, kl
VARYING, BY_HIT = "HV, varying", "HV, hit by hit"
CHANNELS_TIMED = {"HH": Polarization.HH, "HV": Polarization.HV, VARYING: Polarization.HV, BY_HIT: Polarization.HV}


@cache
def surface_kernel(model: str) -> wp.Kernel:
    value_of = sigma0_of(model)

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def surface_kernel(
        polarization: int,
        wavenumber: wp.float64,
        given: wp.array2d(dtype=wp.float64),
        out: wp.array(dtype=wp.float64),
    ):
        """Rows of `given`: cos theta, eps'', ln(eps' - 1), ln h, ln l, cos psi."""
        i = wp.tid()
        zero = wp.float64(0.0)
        one = wp.float64(1.0)
        zeta = wp.vec4d(given[i, 2], given[i, 3], given[i, 4], -wp.float64(FRACTION_LIMIT))
        psi = given[i, 5]
        exponential = int(Spectrum.EXPONENTIAL)
        out[i] = value_of(polarization, exponential, 0, wavenumber, given[i, 0], psi, zero, given[i, 1], one, zeta)

    return surface_kernel


def sigma0_db(model: str, polarization: str, rows: np.ndarray) -> np.ndarray:
    """sigma0 [dB] of the table's surfaces, (rows,); -inf where a model has none."""
    kh = 2 * np.pi * rows[:, 4]
    lengths = np.log(kh / WAVENUMBER), np.log(kh * rows[:, 1] / WAVENUMBER)
    columns = [np.cos(np.radians(rows[:, 0])), rows[:, 3], np.log(rows[:, 2] - 1.0), *lengths]
    given = wp.array(np.stack([*columns, np.ones(len(rows))], axis=1), dtype=wp.float64, device="cpu")
    out = wp.zeros(len(rows), dtype=wp.float64, device="cpu")
    inputs = [int(Polarization[polarization]), WAVENUMBER, given]
    wp.launch(surface_kernel(model), len(rows), inputs=inputs, outputs=[out], device="cpu")
    with np.errstate(divide="ignore"):
        return 10 * np.log10(out.numpy())


def read(path: Path) -> np.ndarray:
    """The surfaces, (n, 8); -Inf where the full-wave method has not converged."""
    rows = np.loadtxt(path)
    if rows.ndim != 2 or rows.shape[1] != 8:
        raise SystemExit(f"{path}: found the shape {rows.shape}; must be rows of 8 numbers")
    return rows


def against_one(rows: np.ndarray, model: str, channel: str) -> np.ndarray:
    """Model minus full wave [dB], (rows,), NaN where either has none."""
    modelled_db, truth = sigma0_db(model, channel, rows), rows[:, 5 + CHANNELS.index(channel)]
    known = np.isfinite(modelled_db) & np.isfinite(truth)
    off = np.full(len(rows), np.nan)
    off[known] = modelled_db[known] - truth[known]
    return off


def against(rows: np.ndarray) -> dict[str, dict[str, np.ndarray]]:
    """By model and channel: model minus full wave [dB], (rows,), NaN where either has none."""
    found: dict[str, dict[str, np.ndarray]] = {}
    for model in ("ka_spm", "i2em", "oh", "dubois"):
        off = {channel: against_one(rows, model, channel) for channel in CHANNELS}
        off["VV-HH"] = off["VV"] - off["HH"]
        found[model] = off
    return found


def _pair(off: np.ndarray) -> str:
    off = off[np.isfinite(off)]
    return "none" if not off.size else f"{np.sqrt(np.mean(off**2)):.2f}, {off.mean():+.2f}"


def accuracy(path: Path, write: bool) -> None:
    rows = read(path)
    found = against(rows)
    summary = [
        [f"`{model}`", *(_pair(off[channel]) for channel in (*CHANNELS, "VV-HH"))] for model, off in found.items()
    ]
    heights = np.unique(rows[:, 4])
    by_roughness = []
    for height in heights:
        here = rows[:, 4] == height
        truth = (rows[here, 5] - rows[here, 6]).mean()
        hv = rows[here, 7] - rows[here, 5]
        level = hv[np.isfinite(hv)]
        biases = [found[m]["VV-HH"][here].mean() for m in found]
        line = found["i2em"]["HV"][here]
        by_roughness.append(
            [
                f"{2 * np.pi * height:.2f}",
                f"{truth:.2f}",
                *(f"{bias:+.2f}" for bias in biases),
                "none" if not level.size else f"{level.mean():.1f}",
                "none" if not np.isfinite(line).any() else f"{np.nanmean(line):+.2f}",
            ]
        )
    head = ["model", "VV", "HH", "HV", "VV - HH"]
    rough = ["kh", "VV - HH, full wave", *(f"`{m}`" for m in found), "HV - VV, full wave", "`i2em` HV"]
    by_permittivity = []
    for eps in np.unique(rows[:, 2]):
        here = rows[:, 2] == eps
        biases = [found["i2em"][channel][here] for channel in (*CHANNELS, "VV-HH")]
        by_permittivity.append([f"{eps:g}", *(f"{np.nanmean(one):+.2f}" for one in biases)])
    made = {
        "models": tables.markdown(head, summary),
        "roughness": tables.markdown(rough, by_roughness),
        "permittivity": tables.markdown(["eps'", *head[1:]], by_permittivity),
    }
    _told(made, write)


def _told(made: dict[str, str], write: bool) -> None:
    tables.publish({f"scattering.{name}": text for name, text in made.items()}, {"made": tables.made()}, write)


def places_of(rows: np.ndarray) -> np.ndarray:
    """The features of the learned term, (n, 4)."""
    kh = 2 * np.pi * rows[:, 4]
    columns = [np.cos(np.radians(rows[:, 0])), np.log(kh), np.log(kh * rows[:, 1]), np.log(rows[:, 2] - 1)]
    return np.stack(columns, axis=1)


def left_out(rows: np.ndarray, model: str, group: np.ndarray) -> list[list[str]]:
    """A row for each value of `group`: error and expected error [dB] of surfaces of which the term has learned none."""
    places, off = places_of(rows), {c: -against_one(rows, model, c) for c in CHANNELS}
    made = []
    for value in np.unique(group):
        out = group == value
        term = learned(model, places[~out], {c: one[~out] for c, one in off.items()})
        cells = []
        for channel in CHANNELS:
            truth = off[channel][out]
            known = np.isfinite(truth)
            error = term.db(channel, places[out]) - truth
            sd = term.sd_db(channel, places[out])
            if known.any():
                rms = np.sqrt(np.mean(error[known] ** 2))
                inside = np.mean(np.abs(error[known]) < 1.96 * sd[known])
                cells.append(f"{rms:.2f} / {sd[known].mean():.2f} / {100 * inside:.0f} %")
            else:
                cells.append("none")
        made.append([f"{value:.3g}", *cells])
    return made


def teach(path: Path, term_path: Path | None, write: bool) -> None:
    rows = read(path)
    bodies = {}
    for model in ("ka_spm", "i2em"):
        lines = [["l / h", *line] for line in left_out(rows, model, rows[:, 1])]
        lines += [["kh", *line] for line in left_out(rows, model, np.round(2 * np.pi * rows[:, 4], 2))]
        bodies[f"left-out-{model}"] = tables.markdown(["left out", "value", *CHANNELS], lines)
    if term_path is not None:
        off = {channel: -against_one(rows, "i2em", channel) for channel in CHANNELS}
        learned("i2em", places_of(rows), off).save(term_path)
    _told(bodies, write)


def hits_of(device: str) -> int:
    return HITS["cuda" if wp.get_device(device).is_cuda else "cpu"]


def _arrays(device: str, kh: float, kl: float, spectrum: int) -> dict[str, Any]:
    random = np.random.default_rng(0)
    count = hits_of(device)

    def put(values: Any, dtype: Any = float) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

    zeta = np.tile(np.array([np.log(8.0), np.log(kh / 200), np.log(kl / 200), -50.0], np.float32), (count, 1))
    varying = zeta + random.uniform(-0.3, 0.3, zeta.shape).astype(np.float32)
    zero = np.zeros(count, np.int32)
    return {
        "mine": put(np.arange(count, dtype=np.int32), int),
        "face": put(zero, int),
        "material": put(zero[:1], int),
        "cosine": put(np.cos(random.uniform(0.3, 1.2, count)).astype(np.float32)),
        "twist": put(random.uniform(0.9, 1.0, count).astype(np.float32)),
        "azimuth": put(np.full(count, 0.5, np.float32)),
        "spectrum": put(np.array([spectrum], np.int32), int),
        "loss": put(np.array([1.0], np.float32)),
        "aspect": put(np.ones(1, np.float32)),
        "zeta": put(zeta, wp.vec4),
        "varying": put(varying, wp.vec4),
        "sigma": put(np.zeros(count, np.float32)),
        "slopes": put(np.zeros((count, 4), np.float32), wp.vec4),
        "none": wp.empty(0, dtype=wp.vec4, device=device),
    }


def tables_of(a: dict[str, Any], device: str) -> tuple[list[wp.array], list[Any]]:
    """The two tables of HV, and the launches that make them for the one material."""
    wave = wp.zeros((1, DOUBLE, crossed_table.WAVES), dtype=wp.vec4d, device=device)
    once = wp.zeros((1, SINGLE), dtype=wp.vec4, device=device)
    twice = wp.zeros((1, DOUBLE), dtype=wp.vec4, device=device)
    own = wp.array(np.zeros((1, 2), np.int32), dtype=wp.vec2i, device=device)
    given = [wp.float64(200.0), own, a["spectrum"]]
    commands = [
        wp.launch(kernel, dim, inputs=[*given, *inputs], outputs=[out], device=device, record_cmd=True)
        for kernel, dim, inputs, out in (
            (crossed_table.wave_kernel, wave.shape, [a["loss"], a["zeta"]], wave),
            (crossed_table.double_kernel, twice.shape, [a["zeta"], wave], twice),
            (crossed_table.single_kernel, once.shape, [a["loss"], a["zeta"]], once),
        )
    ]
    return [once, twice], commands


def launcher(model: str, channel: str, a: dict[str, Any], device: str, *, slopes: bool) -> Callable[[], None]:
    """One pass over all hits, on the CPU by one thread.

    "HV" of i2em is that of a uniform material, whose tables are made again. The spline of "HV, varying" is made once.
    """
    polarization = CHANNELS_TIMED[channel]
    before: list[Any] = []
    after: list[Any] = []
    cpu, count = device == "cpu", hits_of(device)
    surfaces = fill(
        HitSurfaces,
        polarization=polarization,
        wavenumber=200.0,
        face=a["face"],
        face_material=a["material"],
        cos_incidence=a["cosine"],
        cos_twist=a["twist"],
        cos2_azimuth=a["azimuth"],
        spectrum=a["spectrum"],
        eps_im=a["loss"],
        aspect=a["aspect"],
    )
    out = [a["sigma"], a["slopes"] if slopes else a["none"]]
    if model == "i2em" and channel == "HV":
        made, before = tables_of(a, device)
        inputs = [a["mine"], surfaces, *made]
        kernel = crossed_table.scatter_kernel(slopes)
    elif model == "i2em" and channel == VARYING:
        made = table(((int(a["spectrum"].numpy()[0]), 1.0),), wp.get_device(device))
        row = wp.zeros(1, dtype=int, device=device)
        inputs = [a["mine"], surfaces, a["varying"], row, made]
        kernel = crossed_spline.scatter_kernel(slopes, beyond=cpu)
        if not cpu:
            beyond = crossed_spline.beyond_kernel
            after = [wp.launch(beyond, count, inputs=inputs[:-2], outputs=out, device=device, record_cmd=True)]
    else:
        inputs = [a["mine"], surfaces, a["zeta"]]
        default = model == DEFAULT
        fixed = None if cpu or default else Polarization(polarization)
        kernel = scatter_kernel(model, slopes, fixed, some=not default)
    kernel, block = (at_once(kernel), LANES) if cpu else (kernel, 1)
    command = wp.launch(kernel, count // block, inputs=inputs, outputs=out, device=device, record_cmd=True)

    def run() -> None:
        for launch in (*before, command, *after):
            launch.launch()

    return run


def nanoseconds(run: Callable[[], None], device: str, seconds: float = 0.1) -> float:
    """Of a hit: the best of many passes."""
    run()
    wp.synchronize_device(device)
    best, end = np.inf, time.perf_counter() + seconds
    while time.perf_counter() < end:
        begin = time.perf_counter()
        run()
        wp.synchronize_device(device)
        best = min(best, time.perf_counter() - begin)
    return float(best / hits_of(device) * 1e9)


def timed(device: str) -> dict[tuple[Spectrum, str, float, str, bool], float]:
    """Nanoseconds of a hit by spectrum, channel, kh, model and whether with slopes.

    The best of some rounds on a CPU: while other work disturbs one of them, it may not disturb the next.
    """
    best: dict[tuple[Spectrum, str, float, str, bool], float] = {}
    for _ in range(1 if wp.get_device(device).is_cuda else ROUNDS):
        for spectrum, (kh, kl) in product((Spectrum.GAUSSIAN, Spectrum.EXPONENTIAL), SURFACES_TIMED):
            arrays = _arrays(device, kh, kl, spectrum)
            for channel, model, slopes in product(CHANNELS_TIMED, MODELS_TIMED, (False, True)):
                took = nanoseconds(launcher(model, channel, arrays, device, slopes=slopes), device)
                key = spectrum, channel, kh, model, slopes
                best[key] = min(took, best.get(key, np.inf))
    return best


def speed(device: str, write: bool) -> None:
    rows, found, best = [], {}, timed(device)
    for spectrum, channel, kh in dict.fromkeys(key[:3] for key in best):
        took = {(m, s): best[spectrum, channel, kh, m, s] for m in MODELS_TIMED for s in (False, True)}
        cells = [" / ".join(f"{took[model, slopes]:.3g}" for slopes in (False, True)) for model in MODELS_TIMED]
        ratio = " / ".join(f"{took['i2em', s] / took['ka_spm', s]:.1f}" for s in (False, True))
        rows.append([spectrum.name.lower(), channel, kh, *cells, ratio])
        found[f"{spectrum.name} {channel} {kh}"] = {
            f"{m.upper()} {'slopes' if s else 'value'}": t for (m, s), t in took.items()
        }
    head = ["spectrum", "channel", "kh", "`ka_spm`", "`i2em`", "`oh`", "`dubois`", "`i2em` over `ka_spm`"]
    where = wp.get_device(device)
    print(json.dumps({"device": where.name, "nanoseconds": found}, indent=1))
    name = "speed-cuda" if where.is_cuda else "speed"
    _told({name: tables.markdown(head, rows)}, write)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("table", type=Path, nargs="?", help="the full-wave table")
    parser.add_argument("--learned", action="store_true", help="learn a term from it, with parts left out")
    parser.add_argument("--term", type=Path, help="where the term that has learned all of it goes (JSON, for i2em)")
    parser.add_argument("--speed", action="store_true", help="time the models instead")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--write", action="store_true", help="put the tables into docs/")
    given = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    if given.speed:
        speed(given.device, given.write)
    elif given.table is None:
        parser.error("needs the full-wave table, or --speed")
    elif given.learned:
        teach(given.table, given.term, given.write)
    else:
        accuracy(given.table, given.write)


if __name__ == "__main__":
    main()
