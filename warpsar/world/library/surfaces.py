"""The surfaces of the library: a permittivity, and a roughness with its range."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial

from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.library import permittivity as eps
from warpsar.world.tables import SurfaceKey

Range = tuple[float, float]
KH, KL = 0.29, 1.5
"""k h and k l of a surface rougher than small perturbation takes (k h < 0.3), where a scene asks for that model."""
WATER_C = 15.0
"""Temperature of water [deg C]."""
ROUGH: tuple[SurfaceKey, ...] = ("rms_height_m", "correlation_length_m")
ALL: tuple[SurfaceKey, ...] = ("eps_r", *ROUGH)
DEFAULT, MADE, NATURAL = "ka_spm", "two_scale", "i2em"
"""The default of all materials; the model of smooth surfaces, as those that are made and water; and that of ground,
which is rougher than small perturbation takes."""
BANDS_HZ = {"L": 1.3e9, "C": 5.4e9, "X": 9.6e9, "Ku": 16e9}
"""Carriers at which levels are listed."""


def band_of(frequency_hz: float) -> str:
    """The band of `BANDS_HZ` whose carrier is nearest to a frequency [Hz], by their ratio."""
    return min(BANDS_HZ, key=lambda band: abs(math.log(BANDS_HZ[band] / frequency_hz)))


@dataclass(frozen=True)
class LibrarySurface:
    """A material of the library. Lengths are in millimetres here, for people who read the list.

    `permittivity` takes a frequency [Hz] and gives eps' - j eps''; `source` states it, and `band_ghz` is where that
    holds. The ranges of rms height and correlation length, `stated_mm` of the two, and `slope_variance` of the large
    scale (of the model two_scale; per axis) are our choice and not a measurement. `spread_db` is one standard deviation
    of the level [dB] from place to place, without speckle; it is our choice, too, and stands for C to Ku band alone.
    `off_db` says in which bands, of `BANDS_HZ`, a published mean lies beyond it: by how much [dB], at 40 degrees, in HH
    or VV, whichever is more. `published` says what published levels the roughness was set beside, and is empty where we
    could read none. `choice` says how it was chosen. `lacks` says what makes the real surface brighter and has no model
    here.
    """

    words: str
    permittivity: Callable[[float], complex]
    source: str
    band_ghz: Range
    height_range_mm: Range
    length_range_mm: Range
    stated_mm: tuple[float, float]
    spread_db: float
    choice: str
    published: str = ""
    slope_variance: float | None = None
    learn: tuple[SurfaceKey, ...] = ALL
    lacks: str = ""
    off_db: Mapping[str, float] = field(default_factory=dict)

    def spread_at(self, frequency_hz: float) -> float:
        """One standard deviation of the level [dB] in the band of `BANDS_HZ` that is nearest to a frequency [Hz]: from
        place to place and, where published means lie beyond that, of the surface's own error, too."""
        return math.hypot(self.spread_db, self.off_db.get(band_of(frequency_hz), 0.0))

    def spread_known(self, frequency_hz: float) -> bool:
        """Whether the spread stands for a frequency [Hz]: at L band it does where a published mean is beside it."""
        return band_of(frequency_hz) != "L" or "L" in self.off_db

    @property
    def model(self) -> str:
        """The surface's own backscatter model."""
        return NATURAL if self.slope_variance is None else MADE

    def roughness_mm(self, frequency_hz: float, model: str | None = None) -> tuple[float, float]:
        """The rms height and the correlation length for `model`, by default the surface's own.

        A scene may ask for `ka_spm` where the surface is too rough for it. It then gets the most that small
        perturbation allows at the frequency, within the surface's ranges.
        """
        if model != DEFAULT or self.model != NATURAL:
            return self.stated_mm
        k = 2.0e-3 * math.pi * frequency_hz / SPEED_OF_LIGHT  # rad/mm
        h, length = (
            min(max(value / k, low), high)
            for value, (low, high) in ((KH, self.height_range_mm), (KL, self.length_range_mm))
        )
        return float(f"{h:.3g}"), float(f"{length:.3g}")

    def table(self, frequency_hz: float, model: str | None = None) -> dict[str, object]:
        """The keys of `[materials.NAME]` at this frequency; `model` as in `roughness_mm`."""
        value = self.permittivity(frequency_hz)
        real = float(f"{value.real:.4g}")
        height, length = self.roughness_mm(frequency_hz, model)
        table: dict[str, object] = {
            "eps_r": [real, float(f"{value.imag:.4g}")] if value.imag else real,
            "rms_height_m": round(height / 1000.0, 7),
            "correlation_length_m": round(length / 1000.0, 7),
            "spectrum": "exponential",
        }
        table["model"] = model or self.model
        if table["model"] == MADE and self.slope_variance is not None:
            table["slope_variance"] = self.slope_variance
        return table if self.learn == ALL else {**table, "learn": list(self.learn)}


def _building(
    row: str,
    words: str,
    heights: Range,
    lengths: Range,
    stated: tuple[float, float],
    slope_variance: float | None,
    spread_db: float,
    choice: str,
    published: str = "",
    learn: tuple[SurfaceKey, ...] = ALL,
) -> LibrarySurface:
    source, band = f"ITU-R P.2040-3, {row}", eps.BUILDING[row][4:]
    of = partial(eps.building, row)
    return LibrarySurface(
        words, of, source, band, heights, lengths, stated, spread_db, choice, published, slope_variance, learn
    )


def _ground(
    words: str,
    kind: str,
    moisture: float,
    lengths: Range,
    stated: tuple[float, float],
    spread_db: float,
    choice: str,
    off_at_l_db: float,
) -> LibrarySurface:
    def permittivity(frequency_hz: float) -> complex:
        return eps.soil(kind, frequency_hz, moisture)

    source = f"ITU-R P.527-4, {kind}, {100 * moisture:g} % water"
    heights, band = (1.0, 30.0), (1.0, 1000.0)
    given = heights, lengths, stated, spread_db, choice, _HANDBOOK
    return LibrarySurface(words, permittivity, source, band, *given, off_db={"L": off_at_l_db})


def _sea(frequency_hz: float) -> complex:
    return eps.sea_water(frequency_hz, WATER_C)


def _dry_snow(frequency_hz: float) -> complex:
    return eps.dry_snow(0.3)


def _wet_snow(frequency_hz: float) -> complex:
    return eps.wet_snow(frequency_hz, 0.3, 3.0)


_SEA = (_sea, "ITU-R P.527-4, sea water, 35 g/kg, 15 deg C", (0.01, 1000.0))
_SEA_LENGTHS: Range = (5.0, 300.0)
_SNOW: tuple[Range, Range, tuple[float, float], float] = ((0.5, 10.0), (5.0, 100.0), (8.8, 40.0), 4.0)
_HANDBOOK = "Ulaby and Dobson (1989), L and C"
_SMOOTH_SOILS = "Oh (2004) at the same eps' and h"
_NRL = "Gregers-Hansen and Mital (2012), sea state {}; CMOD5.N at {} m/s, C, VV"
_AFTER_ASPHALT = "h, l and slopes by comparison with asphalt"
_AS_SNOW = "rougher than snow is: the roughness stands for what its volume adds"

SURFACES: dict[str, LibrarySurface] = {
    "asphalt": _building(
        *("asphalt", "a road of asphalt", (0.2, 2.0), (2.0, 20.0), (1.0, 12.0), 0.07, 3.0),
        "h by the level in HH at X, l by that at Ku, the slopes by VV - HH",
        f"{_SMOOTH_SOILS}; roads of the Gotcha scene, X, HH, 5 to 8 dB below its grass",
    ),
    "concrete": _building(
        *("concrete", "cast concrete", (0.1, 1.0), (3.0, 50.0), (0.6, 6.0), 0.05, 3.0), _AFTER_ASPHALT, _SMOOTH_SOILS
    ),
    "brick": _building(*("brick", "a brick wall", (0.3, 2.0), (3.0, 30.0), (0.7, 7.0), 0.05, 3.0), _AFTER_ASPHALT),
    "roof_tiles": _building(
        *("brick", "a roof of fired clay tiles", (0.5, 5.0), (4.0, 50.0), (1.0, 8.0), 0.08, 4.0), _AFTER_ASPHALT
    ),
    "gravel": _building(
        *("very dry ground", "dry gravel", (1.0, 10.0), (5.0, 50.0), (5.0, 25.0), None, 3.0), "h and l by its stones"
    ),
    "stone": _building(*("marble", "cut stone", (0.05, 1.0), (3.0, 50.0), (0.5, 8.0), 0.05, 4.0), _AFTER_ASPHALT),
    "wood": _building(*("wood", "planks", (0.1, 2.0), (3.0, 50.0), (0.7, 7.0), 0.05, 4.0), _AFTER_ASPHALT),
    "glass": _building(
        *("glass", "window panes", (0.01, 0.1), (5.0, 100.0), (0.05, 20.0), 0.001, 6.0), "a smooth pane, nearly flat"
    ),
    "metal": _building(
        *("metal", "sheet metal", (0.01, 0.5), (5.0, 100.0), (0.15, 15.0), 0.005, 6.0),
        "a rolled sheet with shallow dents",
        learn=ROUGH,
    ),
    "painted_steel": _building(
        *("metal", "steel under paint", (0.05, 0.5), (5.0, 100.0), (0.25, 12.0), 0.01, 5.0),
        "a sheet with dents, rougher than bare metal",
        learn=ROUGH,
    ),
    "soil_dry": _ground(
        *("bare dry soil", "sandy loam", 0.05, (5.0, 200.0), (9.0, 90.0), 4.0), "h and l by the level at C", 6.8
    ),
    "soil_wet": _ground(
        *("bare wet soil", "loam", 0.30, (5.0, 200.0), (6.0, 90.0), 4.0), "h and l by the level at C", 6.7
    ),
    "grass": _ground(
        *("short grass on moist soil, as bare soil", "sandy loam", 0.20, (5.0, 200.0), (8.0, 150.0), 3.0),
        "a soil as bright as grass, by the level at C",
        3.9,
    ),
    "water_calm": LibrarySurface(
        *("calm sea", *_SEA, (0.0, 0.5), _SEA_LENGTHS, (0.5, 60.0), 6.0),
        "h, l and slopes by all four bands",
        _NRL.format("0", "2"),
        0.01,
        off_db={"L": 7.4},
    ),
    "water_rough": LibrarySurface(
        *("sea with waves of wind", *_SEA, (0.5, 3.0), _SEA_LENGTHS, (1.2, 100.0), 4.0),
        "h, l and slopes by all four bands",
        _NRL.format("3", "7"),
        0.02,
        off_db={"L": 6.3},
    ),
    "snow_dry": LibrarySurface(
        *("surface of dry snow, 0.3 g/cm3", _dry_snow, "Maetzler (1996)", (0.1, 40.0), *_SNOW),
        _AS_SNOW,
        _HANDBOOK,
        lacks="snow's grains and the ground below",
        off_db={"L": 8.0, "C": 7.3},
    ),
    "snow_wet": LibrarySurface(
        "surface of wet snow, 0.3 g/cm3, 3 % water",
        _wet_snow,
        "Hallikainen, Ulaby, Abdelrazik (1986)",
        (3.0, 37.0),
        *_SNOW,
        _AS_SNOW,
        _HANDBOOK,
        lacks="snow's grains",
        off_db={"L": 6.6},
    ),
}
"""Every surface, by the name that a scene file says."""
