"""Public civil sensors, for first scenes: each number as its operator or its distributor states it, with the source.

A sensor stands here if the frequency and the resolution of one mode were found in a source that anybody can read. A
noise or a range of incidences that we could not read is None, and a first scene says so. Some sources are the manual of
a program (catalyst.earth) that reads the products and takes the numbers from the operator's own documentation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sensor:
    """One mode of a sensor.

    `resolution_m`: as stated, taken for the half-power width in slant range and in azimuth. `nesz_db`: noise-equivalent
    sigma zero, the bound that is stated. `incidence_deg`: the range of incidences. `source`: where each number stands.
    None: we could not read it.
    """

    title: str
    frequency_hz: float
    resolution_m: tuple[float, float]
    nesz_db: float | None
    incidence_deg: tuple[float, float] | None
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
    "capella": Sensor(
        "Capella, spotlight",
        9.65e9,
        (0.3, 0.5),
        -17.0,
        (25.0, 40.0),
        (
            "frequency, resolution in range, NESZ and incidences: catalyst.earth, GDB Reference, Capella, Spot",
            "resolution in azimuth: progea4d.pl, Capella X-SAR, Spot",
        ),
    ),
    "rcm": Sensor(
        "RADARSAT Constellation, stripmap of four polarizations",
        5.405e9,
        (6.5, 2.9),
        -24.0,
        None,
        ("frequency, resolution and NESZ: catalyst.earth, GDB Reference, RADARSAT Constellation, Quad-Polarization",),
    ),
    "radarsat-2": Sensor(
        "RADARSAT-2, ultra-fine",
        5.405e9,
        (1.6, 2.8),
        None,
        (20.0, 54.0),
        (
            "frequency: jstna.org, RADARSAT-II characteristics, table 1",
            "resolution and incidences: MDA, RN-SP-52-1238, issue 1/13, table 1-3, Ultra-Fine, SLC",
        ),
    ),
    "terrasar-x": Sensor(
        "TerraSAR-X, spotlight",
        9.65e9,
        (1.0, 1.0),
        None,
        (19.7, 55.2),
        (
            "frequency and resolution: terra-vocabulary.org, TSX-1, spotlight, the best that is stated",
            "incidences: DLR, TX-GS-DD-3302, issue 1.7, table 2-6, spotlight",
        ),
    ),
    "cosmo-skymed": Sensor(
        "COSMO-SkyMed, stripmap Himage",
        9.65e9,
        (3.0, 3.0),
        None,
        None,
        ("frequency and resolution: catalyst.earth, GDB Reference, COSMO-SkyMed, Himage",),
    ),
    "umbra": Sensor(
        "Umbra, spotlight",
        9.8e9,
        (0.25, 0.25),
        None,
        (20.0, 70.0),
        (
            "frequency (nominal) and incidences (grazing, 20 to 70 degrees): catalyst.earth, GDB Reference, Umbra",
            "resolution: eo-atlas.org, UMBRA-SAR, Spotlight, the best that is stated",
        ),
    ),
    "nisar": Sensor(
        "NISAR, L band, widest swath",
        1.25e9,
        (8.0, 7.0),
        None,
        None,
        (
            "frequency: CEOS database (database.eohandbook.com), L-band SAR (NISAR)",
            "resolution: earthdata.nasa.gov, NISAR L-band SAR, the coarsest across track that is stated (2 to 8 m)",
        ),
    ),
}


def noise_beta0(nesz_db: float, incidence_deg: float) -> float:
    """Noise as beta0, linear: sigma0 of level ground is beta0 sin(incidence)."""
    return float(10.0 ** (nesz_db / 10.0) / np.sin(np.deg2rad(incidence_deg)))
