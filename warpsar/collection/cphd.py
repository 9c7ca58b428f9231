"""CPHD 1.1.0 (NGA.STND.0068) of a collection, written with sarkit: one channel for each polarization."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.collection.history import Collected
from warpsar.collection.plan import MOST
from warpsar.errors import InputError
from warpsar.io.images import replacing
from warpsar.measured.earth import ecef_to_geodetic
from warpsar.version import __version__
from warpsar.world.frame import SPEED_OF_LIGHT

if TYPE_CHECKING:
    pass

NAMESPACE = "http://api.nsgreg.nga.mil/schema/cphd/1.1.0"
START = "2026-01-01T00:00:00"
"""A simulated collection has no date of its own."""
_FIELDS = (
    *("TxTime", "TxPos", "TxVel", "RcvTime", "RcvPos", "RcvVel", "SRPPos", "aFDOP", "aFRR1", "aFRR2", "FX1", "FX2"),
    *("TOA1", "TOA2", "TDTropoSRP", "SC0", "SCSS", "SIGNAL"),
)


def write(path: Path, made: Collected) -> None:
    """The file, whole or not at all. Raises InputError where sarkit is missing."""
    try:
        import lxml.etree
        import sarkit.cphd as sarkit_cphd
    except ImportError as error:
        raise InputError(f'{path}: CPHD needs sarkit: pip install "warpsar[sicd]"') from error
    root = lxml.etree.Element(f"{{{NAMESPACE}}}CPHD", nsmap={None: NAMESPACE})
    tables = sarkit_cphd.ElementWrapper(root)
    times = made.plan.track.time_s - made.plan.track.time_s[0]
    toa = 0.5 * MOST / made.plan.step_hz
    names = [str(number) for number in range(1, len(made.polarizations) + 1)]
    for name, table in (_head(made, times, toa) | _channels(made, names, times, toa)).items():
        tables[name] = table
    vectors = _vectors(made, sarkit_cphd.get_pvp_dtype(root.getroottree()), times, toa)
    tables["ReferenceGeometry"] = sarkit_cphd.compute_reference_geometry(root.getroottree(), vectors)
    metadata = sarkit_cphd.Metadata(xmltree=root.getroottree())
    with replacing(path) as temporary, temporary.open("wb") as file, sarkit_cphd.Writer(file, metadata) as writer:
        for name, samples in zip(names, made.samples, strict=True):
            writer.write_signal(name, np.ascontiguousarray(samples.T))
            writer.write_pvp(name, vectors)


def _head(made: Collected, times: np.ndarray, toa: float) -> dict[str, Any]:
    """What was collected, when, and where."""
    low, high = made.frequency_hz[[0, -1]].tolist()
    return {
        "CollectionID": {
            "CollectorName": f"warpsar {__version__}",
            "CoreName": made.plan.view.name,
            "CollectType": "BISTATIC" if made.plan.track.bistatic else "MONOSTATIC",
            "RadarMode": {"ModeType": "STRIPMAP" if made.plan.stripmap else "SPOTLIGHT"},
            "Classification": "UNCLASSIFIED",
            "ReleaseInfo": "UNRESTRICTED",
        },
        "Global": {
            "DomainType": "FX",
            "SGN": -1,
            "Timeline": {
                "CollectionStart": np.datetime64(START).astype(object),
                "TxTime1": times[0],
                "TxTime2": times[-1],
            },
            "FxBand": {"FxMin": low, "FxMax": high},
            "TOASwath": {"TOAMin": -toa, "TOAMax": toa},
        },
        "SceneCoordinates": _scene(made),
    }


def _channels(made: Collected, names: list[str], times: np.ndarray, toa: float) -> dict[str, Any]:
    """A channel for each polarization, and how its vectors lie in the file."""
    low, high = made.frequency_hz[[0, -1]].tolist()
    layout, size = _layout()
    pulses = len(times)
    fixed = {"FXFixed": True, "TOAFixed": True, "SRPFixed": True}
    middle, dwell = np.full((1, 1), times.mean()), np.full((1, 1), times[-1])
    return {
        "Data": {
            "SignalArrayFormat": "CF8",
            "NumBytesPVP": size,
            "NumCPHDChannels": len(names),
            "Channel": [
                {
                    "Identifier": name,
                    "NumVectors": pulses,
                    "NumSamples": made.plan.frequencies,
                    "SignalArrayByteOffset": index * pulses * made.plan.frequencies * 8,
                    "PVPArrayByteOffset": index * pulses * size,
                }
                for index, name in enumerate(names)
            ],
            "NumSupportArrays": 0,
        },
        "Channel": {
            "RefChId": "1",
            "FXFixedCPHD": True,
            "TOAFixedCPHD": True,
            "SRPFixedCPHD": True,
            "Parameters": [
                {
                    "Identifier": name,
                    "RefVectorIndex": made.plan.middle,
                    **fixed,
                    "Polarization": {"TxPol": pol[0], "RcvPol": pol[1]},
                    "FxC": (low + high) / 2,
                    "FxBW": high - low,
                    "TOASaved": 2 * toa,
                    "DwellTimes": {"CODId": "1", "DwellId": "1"},
                }
                for name, pol in zip(names, made.polarizations, strict=True)
            ],
        },
        "PVP": layout,
        "Dwell": {
            "NumCODTimes": 1,
            "CODTime": [{"Identifier": "1", "CODTimePoly": middle}],
            "NumDwellTimes": 1,
            "DwellTime": [{"Identifier": "1", "DwellTimePoly": dwell}],
        },
    }


def _layout() -> tuple[dict[str, Any], int]:
    """Every parameter's place in a vector, and the vector's size [bytes]."""
    layout, offset = {}, 0
    for name in _FIELDS:
        size = 3 if name.endswith(("Pos", "Vel")) else 1
        kind = np.dtype("3f8") if size == 3 else np.dtype("i8" if name == "SIGNAL" else "f8")
        layout[name] = {"Offset": offset, "Size": size, "dtype": kind}
        offset += size
    return layout, 8 * offset


def _scene(made: Collected) -> dict[str, Any]:
    """The reference point, and the box about the mesh on the plane through it."""
    site, corners = made.plan.site, made.plan.corners_m
    low, high = corners[:, :2].min(axis=0) - 1.0, corners[:, :2].max(axis=0) + 1.0
    ends = np.array([[low[0], low[1], 0.0], [low[0], high[1], 0.0], [high[0], high[1], 0.0], [high[0], low[1], 0.0]])
    return {
        "EarthModel": "WGS_84",
        "IARP": {"ECF": site.ecef, "LLH": site.geodetic},
        "ReferenceSurface": {"Planar": {"uIAX": site.axes[0], "uIAY": site.axes[1]}},
        "ImageArea": {"X1Y1": low, "X2Y2": high},
        "ImageAreaCornerPoints": ecef_to_geodetic(site.to_ecef(ends))[:, :2],
        "ImageGrid": {
            "IARPLocation": np.array([0.0, 0.0]),
            "IAXExtent": _extent("Line", low[0], high[0], made.plan.cells_m[0]),
            "IAYExtent": _extent("Sample", low[1], high[1], made.plan.cells_m[1]),
        },
    }


def _extent(name: str, low: float, high: float, step: float) -> dict[str, Any]:
    """Lines or samples of a grid, a cell apart, of which number 0 is the reference point."""
    first = int(np.ceil(low / step))
    return {f"{name}Spacing": step, f"First{name}": first, f"Num{name}s": int(np.floor(high / step)) - first + 1}


def _vectors(made: Collected, kind: np.dtype, times: np.ndarray, toa: float) -> np.ndarray:
    """Parameters of each pulse."""
    plan, track = made.plan, made.plan.track
    received, sent = track.velocity_m_s()
    vectors = np.zeros(len(times), kind)
    vectors["TxTime"] = times
    vectors["RcvTime"] = times + 2.0 * track.reference_m() / SPEED_OF_LIGHT
    vectors["TxPos"], vectors["RcvPos"] = (plan.site.to_ecef(one) for one in (track.transmitter_m, track.receiver_m))
    vectors["TxVel"], vectors["RcvVel"] = sent @ plan.site.axes, received @ plan.site.axes
    vectors["SRPPos"] = plan.site.ecef
    toward = [place / np.linalg.norm(place, axis=1, keepdims=True) for place in (track.transmitter_m, track.receiver_m)]
    rate = (toward[0] * sent + toward[1] * received).sum(axis=1)  # of both ways [m/s]
    vectors["aFDOP"] = -rate / SPEED_OF_LIGHT
    # Of the shortest pulse that has the band: its sweep takes 1 / B, in which a sensor moves by v / B, 0.03 mm. Zeros
    # say an endless rate, by which readers divide.
    vectors["aFRR2"] = 2.0 / (SPEED_OF_LIGHT * plan.bandwidth_hz**2)
    vectors["aFRR1"] = 0.5 * (made.frequency_hz[0] + made.frequency_hz[-1]) * vectors["aFRR2"]
    vectors["FX1"], vectors["FX2"] = made.frequency_hz[[0, -1]]
    vectors["SC0"], vectors["SCSS"] = plan.start_hz, plan.step_hz
    vectors["TOA1"], vectors["TOA2"], vectors["SIGNAL"] = -toa, toa, 1
    return vectors
