"""The command `rcs`: rcs.csv, Parquet where a library for it is there, a plot, and rcs.json."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Iterator
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.coherent.forecast import forecast
from warpsar.coherent.left_out import left_out
from warpsar.coherent.rcs import FREQUENCIES_HZ, Rcs, RcsRequest, swept
from warpsar.coherent.sweep import RAYS_PER_WAVELENGTH
from warpsar.errors import InputError
from warpsar.io import figures
from warpsar.io.images import replacing
from warpsar.runtime import console
from warpsar.runtime.busy import busy
from warpsar.scene.scene import Scene
from warpsar.simulation.naming import angles
from warpsar.simulation.outputs import make_folder, write_json
from warpsar.world.library.fill import held

COLUMNS = (
    "azimuth_deg",
    "incidence_deg",
    "frequency_hz",
    "polarization",
    "rcs_dbsm",
    "amplitude_re_m",
    "amplitude_im_m",
    "fresnel_number",
    "ray_spacing_m",
    "spacing_error_db",
)
LAYER_COLUMNS = (*COLUMNS[:4], "layer", *COLUMNS[4:7])
_STYLES = ("-", "--", "-.", ":")
_FLOOR_DB = 80.0  # of a plot, under its highest value


def run(
    scene_path: Path | str,
    out: Path | str,
    *,
    azimuths: str,
    incidences: str = "90",
    frequencies: str | None = None,
    device: str | None = None,
    rays_per_wavelength: float = RAYS_PER_WAVELENGTH,
    layers: bool = False,
    max_memory_gib: float | None = None,
) -> dict[str, Any]:
    """`warpsar rcs`: the files of the sweep in `out`. Returns the JSON's content. Raises InputError and DeviceError."""
    started = time.perf_counter()
    azimuth = [float(a) for a in angles(azimuths, "--azimuths", -360.0, 360.0, ends=True)]
    incidence = [float(a) for a in angles(incidences, "--incidences", 0.0, 180.0, ends=True)]
    frequency = None
    if frequencies is not None:
        frequency = [
            float(f) for f in angles(frequencies, "--frequencies", *FREQUENCIES_HZ, what="frequencies", ends=True)
        ]
        if frequency != sorted(frequency):
            raise InputError(f"--frequencies: found {frequencies!r}; must ascend")
    scene = Scene.load(scene_path)
    out = Path(out)
    asked = RcsRequest.of(scene, azimuth, incidence, frequency, device, rays_per_wavelength, layers, max_memory_gib)
    where = asked.body.device
    make_folder(out)  # nothing is written for what is refused
    console.say_device(where)
    fixed = held(scene.materials, scene.radar.frequency_hz, frequency or ())
    console.warn((*scene.warnings, *fixed, *asked.cautions))
    with busy("estimating time and memory"):
        told = forecast(scene, asked, layers)
    if told is not None:
        console.say(str(told))
    found = swept(scene, asked, layers)
    console.warn(found.warnings[len(asked.cautions) :])
    files = ["rcs.csv", "rcs.png", "rcs.json"]
    _write(out / "rcs.csv", COLUMNS, rows(found))
    if layers:
        files.append("layers.csv")
        _write(out / "layers.csv", LAYER_COLUMNS, layer_rows(found))
    if parquet(found, out / "rcs.parquet"):
        files.append("rcs.parquet")
    plot(found, out / "rcs.png")
    content = {
        "directions": found.amplitude_m.shape[0] * found.amplitude_m.shape[1],
        "frequencies_hz": found.frequency_hz,
        "polarizations": found.polarizations,
        "terms": list(found.terms_m),
        "not_applied": list(left_out(scene, "rcs")),
        "ray_spacing_m": found.ray_spacing_m,
        "spacing_error_db": {"median": _finite(np.median, found), "largest": _finite(np.max, found)},
        "segments": found.segments,
        "refined_share": float(found.refined.max()),
        "aliased_share": float(found.aliased.max()),
        "warnings": [*scene.warnings, *fixed, *found.warnings],
        "files": files,
    }
    content = write_json(out / "rcs.json", scene, where, None, started, content)
    console.say(f"{out}: {', '.join(files)}")
    return content


def _finite(what: Callable[..., Any], found: Rcs) -> float | None:
    errors = found.spacing_error_db[np.isfinite(found.spacing_error_db)]
    return float(what(errors)) if errors.size else None


def rows(found: Rcs) -> Iterator[tuple[Any, ...]]:
    """The lines of the table, in the order of `COLUMNS`. A Fresnel number that does not exist is left empty."""
    decibels, errors = found.rcs_dbsm, found.spacing_error_db
    for (a, i, f, p), amplitude in np.ndenumerate(found.amplitude_m):
        number = found.fresnel_number[a, i, f]
        yield (
            repr(float(found.azimuth_deg[a])),
            repr(float(found.incidence_deg[i])),
            repr(float(found.frequency_hz[f])),
            found.polarizations[p],
            f"{decibels[a, i, f, p]:.6f}",
            f"{amplitude.real:.9e}",
            f"{amplitude.imag:.9e}",
            "" if np.isnan(number) else f"{number:.4g}",
            f"{found.ray_spacing_m:.6g}",
            "" if np.isnan(errors[a, i, f, p]) else f"{errors[a, i, f, p]:.4f}",
        )


def layer_rows(found: Rcs) -> Iterator[tuple[Any, ...]]:
    """What each term sends by itself, and each number of bounces, in the order of `LAYER_COLUMNS`."""
    layers = dict(found.terms_m)
    layers |= {f"{bounces} bounces": amplitude for bounces, amplitude in found.bounces_m.items()}
    for a, i, f, p in np.ndindex(found.amplitude_m.shape):
        for name, amplitudes in layers.items():
            amplitude = amplitudes[a, i, f, p]
            area = 4.0 * np.pi * abs(amplitude) ** 2
            yield (
                repr(float(found.azimuth_deg[a])),
                repr(float(found.incidence_deg[i])),
                repr(float(found.frequency_hz[f])),
                found.polarizations[p],
                name,
                f"{10.0 * np.log10(area):.6f}" if area > 0.0 else "-inf",
                f"{amplitude.real:.9e}",
                f"{amplitude.imag:.9e}",
            )


def _write(path: Path, columns: tuple[str, ...], lines: Iterator[tuple[Any, ...]]) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(lines)


def parquet(found: Rcs, path: Path) -> bool:
    """Write the same table as Parquet, where pyarrow is there; whether it was."""
    if find_spec("pyarrow") is None:
        return False
    pyarrow, writer = import_module("pyarrow"), import_module("pyarrow.parquet")
    columns = [list(each) for each in zip(*rows(found), strict=True)]
    table = {
        name: column if name == "polarization" else [float(value) if value else None for value in column]
        for name, column in zip(COLUMNS, columns, strict=True)
    }
    with replacing(path) as temporary:
        writer.write_table(pyarrow.table(table), temporary)
    return True


def plot(found: Rcs, path: Path) -> None:
    """RCS against the angle that has more values, a panel for each frequency, a line for each polarization.

    Shaded: what the spacing of the tubes leaves open.
    """
    by_azimuth = found.azimuth_deg.size >= found.incidence_deg.size
    angle = found.azimuth_deg if by_azimuth else found.incidence_deg
    decibels, errors = (each[:, 0] if by_azimuth else each[0] for each in (found.rcs_dbsm, found.spacing_error_db))
    other = f"incidence {found.incidence_deg[0]:g}°" if by_azimuth else f"azimuth {found.azimuth_deg[0]:g}°"
    count = found.frequency_hz.size
    figure, panels = figures.new(8.0, 1.0 + 2.6 * min(count, 6), nrows=min(count, 6), sharex=True, squeeze=False)
    for f, panel in enumerate(panels[:, 0]):
        highest = decibels[:, f].max()
        for p, name in enumerate(found.polarizations):
            line = np.maximum(decibels[:, f, p], highest - _FLOOR_DB)
            (drawn,) = panel.plot(angle, line, lw=1.0, ls=_STYLES[p], label=name)
            about = np.nan_to_num(errors[:, f, p], posinf=_FLOOR_DB)
            low = np.maximum(line - about, highest - _FLOOR_DB)
            panel.fill_between(angle, low, line + about, color=drawn.get_color(), alpha=0.2, lw=0.0)
        panel.set_ylabel("RCS [dBsm]")
        panel.set_title(f"{found.frequency_hz[f] / 1e9:g} GHz, {other}", fontsize=10)
        panel.grid(alpha=0.3)
    panels[0, 0].legend(frameon=False)
    panels[-1, 0].set_xlabel("azimuth [deg]" if by_azimuth else "incidence [deg]")
    figures.save(figure, path)
