"""`warpsar materials`: the library of surfaces as a list, and their sigma0 against incidence as a picture."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from warpsar.errors import InputError, did_you_mean
from warpsar.io import figures
from warpsar.kernels.codes import Polarization, Spectrum
from warpsar.kernels.incidence import sigma0_kernel
from warpsar.runtime import console, devices
from warpsar.surface.surface import places_of
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.library import clutter
from warpsar.world.library.fill import material
from warpsar.world.library.surfaces import BANDS_HZ, SURFACES
from warpsar.world.tables import Material

if TYPE_CHECKING:
    from matplotlib.axes import Axes

INCIDENCE_DEG = np.arange(10.0, 80.5, 1.0)
LISTED_DEG = 40.0
_COLUMNS = 6


def sigma0_db(surface: Material, polarization: str, frequency_hz: float, incidence_deg: np.ndarray) -> np.ndarray:
    """sigma0 [dB] of a level surface with one value of each key, of the shape of `incidence_deg`."""
    eps = surface.eps_r
    eps_im = eps[1] if isinstance(eps, tuple) else 0.0
    device = devices.resolve_device("cpu")
    cosine: wp.array = wp.array(np.cos(np.radians(incidence_deg)), dtype=wp.float64, device=device)
    found = wp.zeros_like(cosine)
    wavenumber = 2.0 * math.pi * frequency_hz / SPEED_OF_LIGHT
    codes = [int(Polarization[polarization]), int(Spectrum[surface.spectrum.upper()])]
    values = ((kind, getattr(surface, kind.key)) for kind in places_of(surface.model))
    stated = ((kind, value[0] if isinstance(value, tuple) else value) for kind, value in values)
    # a place that the model does not look at may have no value
    zeta = wp.vec4d(*(0.0 if value is None else float(kind.to_coordinate(value)) for kind, value in stated))
    inputs = [cosine, *codes, wavenumber, -eps_im, zeta]
    wp.launch(sigma0_kernel(surface.model), dim=cosine.size, inputs=inputs, outputs=[found], device=device)
    return np.asarray(10.0 * np.log10(np.maximum(found.numpy(), 1e-30)))


def levels(name: str, incidence_deg: Sequence[float] = (20.0, 40.0, 60.0)) -> dict[str, dict[str, np.ndarray]]:
    """Median sigma0 [dB] of a surface of the library at incidences [deg], by band (L, C, X, Ku) and polarization (HH,
    VV, HV). It is computed by the surface's model. Places differ from it by the surface's `spread_at` the band."""
    angles = np.asarray(incidence_deg, dtype=float)
    return {
        band: {one: sigma0_db(material(name, hertz), one, hertz, angles) for one in ("HH", "VV", "HV")}
        for band, hertz in BANDS_HZ.items()
    }


def run(names: Sequence[str], frequency_hz: float, picture: Path | None) -> list[str]:
    """The list's lines, and the picture where a path is given. Raises InputError for a name that is not known."""
    for name in names:
        if name not in SURFACES:
            raise InputError(
                f"NAME: found {name!r}; must be one of {', '.join(SURFACES)}{did_you_mean(name, SURFACES)}"
            )
    chosen = list(dict.fromkeys(names)) or list(SURFACES)
    if picture is not None:
        plot(chosen, frequency_hz, picture)
        console.say(f"written: {picture}")
    return _listed(chosen, frequency_hz)


def _listed(names: Sequence[str], frequency_hz: float) -> list[str]:
    """A table in text: what a surface is, its values at this frequency, and where its permittivity comes from."""
    angle = f"{LISTED_DEG:g} deg"
    head = ["name", "eps_r", "model", "h [mm]", "l [mm]", f"HH {angle}", f"VV {angle}", f"HV {angle}", "spread"]
    rows = [[*head, "surface; source of eps_r"]]
    for name in names:
        surface, one = material(name, frequency_hz), SURFACES[name]
        found = [sigma0_db(surface, pol, frequency_hz, np.array([LISTED_DEG]))[0] for pol in ("HH", "VV", "HV")]
        eps = surface.eps_r
        shown = f"{eps[0]:.3g} - {-eps[1]:.3g}j" if isinstance(eps, tuple) else f"{eps:.3g}"
        lengths = one.roughness_mm(frequency_hz)
        spans = (one.height_range_mm, one.length_range_mm)
        ranges = [f"{value:g} ({low:g} to {high:g})" for value, (low, high) in zip(lengths, spans, strict=True)]
        words = f"{one.words}, without {one.lacks}" if one.lacks else one.words
        shown_db = [f"{db:.1f} dB" for db in found]
        spread = f"{one.spread_at(frequency_hz):.2g} dB" if one.spread_known(frequency_hz) else "not known"
        rows.append([name, shown, surface.model, *ranges, *shown_db, spread, f"{words}; {one.source}"])
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def plot(names: Sequence[str], frequency_hz: float, path: Path) -> None:
    """sigma0 against incidence, HH and VV, a small diagram for each surface; published means beside it in grey."""
    columns = min(_COLUMNS, len(names))
    rows = -(-len(names) // columns)
    figure, axes = figures.new(
        1.9 * columns + 0.6, 1.9 * rows + 0.8, nrows=rows, ncols=columns, sharex=True, sharey=True, squeeze=False
    )
    for axis in axes.flat[len(names) :]:
        axis.set_visible(False)
    for name, axis in zip(names, axes.flat, strict=False):
        surface = material(name, frequency_hz)
        for polarization, colour in (("HH", "tab:blue"), ("VV", "tab:orange")):
            found = sigma0_db(surface, polarization, frequency_hz, INCIDENCE_DEG)
            axis.plot(INCIDENCE_DEG, found, color=colour, label=f"{polarization}, warpsar")
        _published(axis, name, frequency_hz)
        axis.set_title(name, fontsize=9)
        if lacks := SURFACES[name].lacks:
            text = textwrap.fill(f"without {lacks}", 22)
            axis.text(0.5, 0.04, text, transform=axis.transAxes, ha="center", va="bottom", fontsize=7)
        axis.grid(alpha=0.3, lw=0.4)
        axis.set_xlim(INCIDENCE_DEG[0], INCIDENCE_DEG[-1])
        axis.set_ylim(-60.0, 5.0)
    handles = {
        label: handle for axis in axes.flat for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
    }
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    for axis in axes.flat[max(0, len(names) - columns) : len(names)]:
        axis.set_xlabel("incidence [deg]", fontsize=9)
        axis.tick_params(labelbottom=True)
    figure.supylabel(f"sigma0 [dB] at {frequency_hz / 1e9:g} GHz", fontsize=9)
    figures.save(figure, path)


def _published(axis: Axes, name: str, frequency_hz: float) -> None:
    """Published means of sigma0 where there are some for this surface and this band."""
    handbook, gamma = clutter.BESIDE.get(name, (None, None))
    band = clutter.handbook_band(frequency_hz)
    for polarization, style in (("HH", "-"), ("VV", "--")):
        if handbook is not None and band is not None:
            found = clutter.handbook_db(band, handbook, polarization, INCIDENCE_DEG)
            axis.plot(INCIDENCE_DEG, found, style, color="0.55", label=f"{polarization}, handbook's mean, {band} band")
        if name in clutter.SEA:
            found = clutter.sea_db(clutter.SEA[name][0], polarization, frequency_hz, INCIDENCE_DEG)
            axis.plot(INCIDENCE_DEG, found, style, color="0.75", label=f"{polarization}, mean of the sea")
    if gamma is not None:
        found = clutter.gamma_db(gamma, frequency_hz, INCIDENCE_DEG)
        axis.plot(INCIDENCE_DEG, found, ":", color="0.35", label="constant gamma, flatland or farmland")
