"""The command `rcs`: report.html, rcs.csv, Parquet where a library for it is there, a plot, and rcs.json."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.forecast import forecast
from warpsar.coherent.interval import CONFIDENCE
from warpsar.coherent.isar import refuse_steps, write_isar
from warpsar.coherent.left_out import left_out
from warpsar.coherent.rcs import FREQUENCIES_HZ, Rcs, RcsRequest, swept
from warpsar.coherent.report import write_report
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
from warpsar.world.library.fill import material as surface
from warpsar.world.library.surfaces import SURFACES
from warpsar.world.mesh import read_mesh
from warpsar.world.objects.table import UNITS
from warpsar.world.tables import Material, Radar
from warpsar.world.units import guessed_unit
from warpsar.world.world import NO_IMAGE

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
    "low_dbsm",
    "high_dbsm",
)
LAYER_COLUMNS = (*COLUMNS[:4], "layer", *COLUMNS[4:7])
METAL = "metal"
"""What --material calls a smooth perfect conductor."""
_STYLES = ("-", "--", "-.", ":")
_FLOOR_DB, _POLAR_FLOOR_DB = 80.0, 60.0  # of a plot, under its highest value
_MOST_PANELS = 6


def run(
    path: Path | str,
    out: Path | str,
    *,
    azimuths: str,
    material: str | None = None,
    incidences: str = "90",
    frequencies: str | None = None,
    device: str | None = None,
    rays_per_wavelength: float = RAYS_PER_WAVELENGTH,
    isar: bool = False,
    layers: bool = False,
    max_memory_gib: float | None = None,
    units: str | None = None,
    up: str | None = None,
) -> dict[str, Any]:
    """`warpsar rcs`: the files of the sweep in `out`. Returns the JSON's content.

    `path` is a scene file, or a mesh file whose one `material` is "metal" or a surface of the library; `units` and `up`
    are of a mesh file, as in `new_scene`. Raises InputError and DeviceError.
    """
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
    scene, unit, guess = scene_of(Path(path), material, frequency, units, up)
    out = Path(out)
    if guess is not None:
        console.say(guess)
    if isar:
        refuse_steps(scene, azimuth, incidence, frequency or [scene.radar.frequency_hz])
    asked = RcsRequest.of(scene, azimuth, incidence, frequency, device, rays_per_wavelength, layers, max_memory_gib)
    where = asked.body.device
    make_folder(out)  # nothing is written for what is refused
    console.say_device(where)
    fixed = held(scene.materials, scene.radar.frequency_hz, frequency or ())
    console.warn((*scene.warnings, *fixed, *asked.cautions))
    with busy("estimating time and memory"):
        expected = forecast(scene, asked, layers)
    if expected is not None:
        console.say(str(expected))
    found = swept(scene, asked, layers)
    console.warn(found.warnings[len(asked.cautions) :])
    files = ["report.html", "rcs.csv", "rcs.png", "rcs_polar.png", "rcs.json"]
    _write(out / "rcs.csv", COLUMNS, rows(found))
    if layers:
        files.append("layers.csv")
        _write(out / "layers.csv", LAYER_COLUMNS, layer_rows(found))
    if parquet(found, out / "rcs.parquet"):
        files.append("rcs.parquet")
    plot(found, out / "rcs.png")
    plot_polar(found, out / "rcs_polar.png")
    if isar:
        with busy("focusing"):
            files += write_isar(found, scene, out)
    content = {
        "directions": found.amplitude_m.shape[0] * found.amplitude_m.shape[1],
        "frequencies_hz": found.frequency_hz,
        "polarizations": found.polarizations,
        "terms": list(found.terms_m),
        "not_applied": list(left_out(scene, "rcs")),
        "ray_spacing_m": found.ray_spacing_m,
        "spacing_error_db": {"median": _finite(np.median, found), "largest": _finite(np.max, found)},
        "interval": {"confidence": CONFIDENCE, "width_db": _widths(found)},
        "segments": found.segments,
        "refined_share": float(found.refined.max()),
        "aliased_share": float(found.aliased.max()),
        "warnings": [*scene.warnings, *fixed, *found.warnings],
        "files": files,
    }
    content = write_json(out / "rcs.json", scene, where, None, started, content)
    words = ["warpsar", "rcs", str(path), "-o", str(out), "--azimuths", azimuths, "--incidences", incidences]
    words += ["--rays-per-wavelength", f"{rays_per_wavelength:g}", "--device", where.alias]
    words += [] if material is None else ["--material", material, "--units", unit]
    words += [] if up is None else ["--up", up]
    words += [] if frequencies is None else ["--frequencies", frequencies]
    words += ["--isar"] * isar + ["--layers"] * layers
    write_report(out, found, content, words)
    console.say(f"{out}: {', '.join(files)}")
    return content


def scene_of(
    path: Path, material: str | None, frequency_hz: list[float] | None, units: str | None = None, up: str | None = None
) -> tuple[Scene, str, str | None]:
    """The scene of a scene file, or of a mesh file in one material; its unit, and how that was guessed, in words."""
    if path.suffix.lower() == ".toml":
        for option, value, what in (
            ("--material", material, "its materials"),
            ("--units", units, "metres"),
            ("--up", up, "what is up"),
        ):
            if value is not None:
                raise InputError(f"{option}: found {value!r}; must be left out, since {path} states {what}")
        return Scene.load(path), "m", None
    missing = []
    if material is None:
        missing.append(
            f"--material: missing; a mesh file ({path}) needs metal, or one of {', '.join(SURFACES)}; a scene file "
            "(.toml) states its own"
        )
    if frequency_hz is None:
        missing.append(f"--frequencies: missing; a mesh file ({path}) states none")
    if material is None or frequency_hz is None:
        raise InputError("; ".join(missing))
    mesh = read_mesh(path, up=up)
    unit, guess = (units, None) if units is not None else guessed_unit(path, mesh.vertices)
    mesh = replace(mesh, vertices=UNITS[unit] * mesh.vertices)
    made = Material(conductor=True) if material == METAL else surface(material, frequency_hz[-1])
    radar = Radar(frequency_hz=frequency_hz[-1], polarizations=("HH", "VV"))
    warnings = tuple(f"{path}: {warning}" for warning in mesh.warnings)
    named = dict.fromkeys(mesh.materials, made)
    scene = Scene(mesh=mesh, radar=radar, grid=NO_IMAGE, materials=named, views=[], mesh_path=path, warnings=warnings)
    return scene, unit, guess


def _finite(what: Callable[..., Any], found: Rcs) -> float | None:
    errors = found.spacing_error_db[np.isfinite(found.spacing_error_db)]
    return float(what(errors)) if errors.size else None


def _widths(found: Rcs) -> dict[str, float] | None:
    """Of the intervals [dB]; None where there are none."""
    low, high = found.interval_dbsm
    widths = (high - low)[np.isfinite(low)]
    return {"median": float(np.median(widths)), "largest": float(widths.max())} if widths.size else None


def rows(found: Rcs) -> Iterator[tuple[Any, ...]]:
    """The lines of the table, in the order of `COLUMNS`. A Fresnel number that does not exist is left empty."""
    decibels, errors = found.rcs_dbsm, found.spacing_error_db
    low, high = found.interval_dbsm
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
            *("" if np.isnan(end[a, i, f, p]) else f"{end[a, i, f, p]:.3f}" for end in (low, high)),
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

    Shaded: the 95 % interval for what the model leaves out, and darker what the spacing of the tubes leaves open.
    """
    angle, by_azimuth, other, decibels, errors = _cut(found)
    ends = [each[:, 0] if by_azimuth else each[0] for each in found.interval_dbsm]
    count = min(found.frequency_hz.size, _MOST_PANELS)
    figure, panels = figures.new(8.0, 1.0 + 2.6 * count, nrows=count, sharex=True, squeeze=False)
    for f, panel in zip(_shown(found), panels[:, 0], strict=True):
        highest = decibels[:, f].max()
        for p, name in enumerate(found.polarizations):
            line = np.maximum(decibels[:, f, p], highest - _FLOOR_DB)
            (drawn,) = panel.plot(angle, line, lw=1.0, ls=_STYLES[p], label=name)
            about = np.nan_to_num(errors[:, f, p], posinf=_FLOOR_DB)
            low = np.maximum(line - about, highest - _FLOOR_DB)
            panel.fill_between(angle, low, line + about, color=drawn.get_color(), alpha=0.3, lw=0.0)
            bottom, top = (np.maximum(end[:, f, p], highest - _FLOOR_DB) for end in ends)
            panel.fill_between(angle, bottom, top, color=drawn.get_color(), alpha=0.12, lw=0.0)
        panel.set_ylabel("RCS [dBsm]")
        panel.set_title(f"{found.frequency_hz[f] / 1e9:g} GHz, {other}", fontsize=10)
        panel.grid(alpha=0.3)
    panels[0, 0].legend(frameon=False)
    panels[-1, 0].set_xlabel("azimuth [deg]" if by_azimuth else "incidence [deg]")
    figures.save(figure, path)


def plot_polar(found: Rcs, path: Path) -> None:
    """The same around the body: azimuth clockwise from north, incidence from the zenith; dBsm outward."""
    angle, by_azimuth, other, decibels, _ = _cut(found)
    around = closed(angle)
    count = min(found.frequency_hz.size, _MOST_PANELS)
    columns = min(count, 2)
    rows_of = -(-count // columns)
    figure, panels = figures.new(
        5.2 * columns,
        0.4 + 5.0 * rows_of,
        nrows=rows_of,
        ncols=columns,
        squeeze=False,
        subplot_kw={"projection": "polar"},
    )
    for place, panel in enumerate(panels.ravel()):
        if place >= count:
            panel.set_visible(False)
            continue
        f = _shown(found)[place]
        highest = decibels[:, f].max()
        for p, name in enumerate(found.polarizations):
            line = np.maximum(decibels[around, f, p], highest - _POLAR_FLOOR_DB)
            panel.plot(np.deg2rad(angle[around]), line, lw=1.0, ls=_STYLES[p], label=name)
        panel.set_theta_zero_location("N")
        panel.set_theta_direction(-1)
        if np.isfinite(highest):
            panel.set_ylim(highest - _POLAR_FLOOR_DB, highest + 3.0)
        panel.set_rlabel_position(100.0)
        what = "azimuth" if by_azimuth else "incidence"
        panel.set_title(f"RCS [dBsm] against {what}, {found.frequency_hz[f] / 1e9:g} GHz, {other}", fontsize=9)
        panel.grid(alpha=0.4)
        panel.tick_params(labelsize=8)
    panels[0, 0].legend(frameon=False, loc="lower left", bbox_to_anchor=(-0.12, -0.1))
    figures.save(figure, path)


def closed(angle_deg: NDArray[np.float64]) -> NDArray[np.intp]:
    """Numbers of the angles in their order; of a whole turn the first again, so that the line has no gap."""
    order = np.arange(angle_deg.size)
    if angle_deg.size < 3:
        return order
    gap = angle_deg[0] + 360.0 - angle_deg[-1]
    return np.append(order, 0) if 0.0 < gap <= 1.01 * np.diff(angle_deg).max() else order


def _cut(
    found: Rcs,
) -> tuple[NDArray[np.float64], bool, str, NDArray[np.float64], NDArray[np.float64]]:
    """The angle that has more values [deg], whether it is the azimuth, the other one in words; RCS and error of the
    spacing along it, (angles, frequencies, polarizations)."""
    by_azimuth = found.azimuth_deg.size >= found.incidence_deg.size
    angle = found.azimuth_deg if by_azimuth else found.incidence_deg
    decibels, errors = (each[:, 0] if by_azimuth else each[0] for each in (found.rcs_dbsm, found.spacing_error_db))
    other = f"incidence {found.incidence_deg[0]:g}°" if by_azimuth else f"azimuth {found.azimuth_deg[0]:g}°"
    return angle, by_azimuth, other, decibels, errors


def _shown(found: Rcs) -> list[int]:
    """Numbers of the frequencies that are drawn: all, or as many as there are panels, evenly."""
    count = found.frequency_hz.size
    return [int(i) for i in np.linspace(0, count - 1, min(count, _MOST_PANELS)).round()]
