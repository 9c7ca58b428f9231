"""Public civil sensors, for first scenes: each number as its operator or its distributor states it, with the source.

A sensor stands here only if all its numbers were found in a source that anybody can read, those of one mode. Of ICEYE
that source is the manual of a program that reads its products and takes them from ICEYE's own documentation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sensor:
    """One mode of a sensor.

    `resolution_m`: as stated, taken for the half-power width in slant range and in azimuth. `nesz_db`: noise-equivalent
    sigma zero, the bound that is stated. `incidence_deg`: the range of incidences. `source`: where each number stands.
    """

    title: str
    frequency_hz: float
    resolution_m: tuple[float, float]
    nesz_db: float
    incidence_deg: tuple[float, float]
    source: tuple[str, ...]


SENSORS: dict[str, Sensor] = {
    "sentinel-1": Sensor(
        "Sentinel-1, stripmap",
        5.405e9,
        (5.0, 5.0),
        -22.0,
        (18.3, 46.8),
        (
            "frequency and resolution: ESA, sentinel.esa.int, Sentinel-1 instrument payload",
            "NESZ and incidences: ESA, Sentinel-1 SAR User Guide, Stripmap, table 1",
        ),
    ),
    "palsar": Sensor(
        "ALOS PALSAR, fine beam, single polarization",
        1.27e9,
        (10.0, 10.0),
        -23.0,
        (8.0, 60.0),
        (
            "frequency, NESZ (swath of 70 km) and incidences: alos-pasco.com, PALSAR main specifications",
            "resolution: Alaska Satellite Facility, PALSAR technical specs",
        ),
    ),
    "iceye": Sensor(
        "ICEYE, spotlight",
        9.65e9,
        (0.6, 1.0),
        -17.0,
        (20.0, 35.0),
        ("all numbers: catalyst.earth, GDB Reference, ICEYE, table of modes, spotlight with 300 MHz",),
    ),
}


def noise_beta0(nesz_db: float, incidence_deg: float) -> float:
    """Noise as beta0, linear: sigma0 of level ground is beta0 sin(incidence)."""
    return float(10.0 ** (nesz_db / 10.0) / np.sin(np.deg2rad(incidence_deg)))
