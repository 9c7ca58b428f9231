"""CPHD (Compensated Phase History Data, NGA.STND.0068), read and written with sarkit.

FX domain alone. What is written is CPHD 1.1.0, one channel for each polarization.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.formats.base.acquisition import START, RecordedSignal
from warpsar.formats.base.data import PhaseHistory, reading
from warpsar.formats.base.format import Format, Stated
from warpsar.io.images import replacing
from warpsar.runtime.extra import Extra
from warpsar.version import __version__
from warpsar.world.earth import LocalEarth, ecef_to_geodetic
from warpsar.world.frame import SPEED_OF_LIGHT

if TYPE_CHECKING:
    import sarkit.cphd as sarkit_cphd
    from lxml.etree import _ElementTree as ElementTree

MAGIC = b"CPHD/"
EXTRA = Extra("sicd", ("sarkit",))
NAMESPACE = "http://api.nsgreg.nga.mil/schema/cphd/1.1.0"
_FIELDS = (
    *("TxTime", "TxPos", "TxVel", "RcvTime", "RcvPos", "RcvVel", "SRPPos", "aFDOP", "aFRR1", "aFRR2", "FX1", "FX2"),
    *("TOA1", "TOA2", "TDTropoSRP", "SC0", "SCSS", "SIGNAL"),
)


def read(path: Path, stated: Stated) -> PhaseHistory:
    """The channel of the polarization, or the only one. Without a frame the world's origin is the scene's IARP.

    A point's echo has the phase SGN 2 pi f dTOA (standard, section 2); samples of SGN = +1 are conjugated. Left out are
    vectors that the file marks as bad (SIGNAL = 0), and frequencies outside the band FX1 to FX2 of any vector.
    """
    with _opened(path) as (reader, blocks):
        tree = reader.metadata.xmltree
        domain, kind = tree.findtext("{*}Global/{*}DomainType"), tree.findtext("{*}CollectionID/{*}CollectType")
        if domain != "FX":
            raise InputError(f"{path}: found {kind}, domain {domain}; data in the FX domain can be focused")
        channel, found = _channel(path, tree, stated.polarization)
        _check_arrays(path, tree, channel, blocks)
        signal, pvp = reader.read_channel(channel)
        sgn = int(tree.findtext("{*}Global/{*}SGN"))
        iarp = _vector(tree, "{*}SceneCoordinates/{*}IARP/{*}ECF")
    if signal.ndim != 2:
        raise InputError(
            f"{path}: channel {channel} is compressed ({signal.shape[0]} bytes); only plain samples are known"
        )
    if signal.shape[0] < 1:
        raise InputError(f"{path}: channel {channel} has no pulses")
    with reading(path, "CPHD file"):
        named = pvp.dtype.names or ()
        good = pvp["SIGNAL"] > 0 if "SIGNAL" in named else np.ones(pvp.size, bool)
        pvp, signal = pvp[good], signal[good]
        if not pvp.size:
            raise InputError(f"{path}: channel {channel} has no pulses that are marked as good (SIGNAL = 1)")
        start, step = pvp["SC0"].astype(np.float64), pvp["SCSS"].astype(np.float64)
        samples = _complex(signal, pvp["AmpSF"] if "AmpSF" in named else None)
        first, last = _shared_band(pvp, start, step, samples.shape[1])
        samples, start = samples[:, first:last], start + first * step
        if sgn > 0:
            samples = samples.conj()
        # The phase centre half way between sending and receiving: for one antenna in flight the sum of both distances
        # differs from twice this one by |sent - received|^2 / 4 R, which cancels against the reference point's.
        arp = (pvp["TxPos"].astype(np.float64) + pvp["RcvPos"].astype(np.float64)) / 2.0
        sent = None
        if kind == "BISTATIC":
            arp, sent = pvp["RcvPos"].astype(np.float64), pvp["TxPos"].astype(np.float64)
        ends = (arp, arp if sent is None else sent)
        ways = [np.linalg.norm(end - pvp["SRPPos"].astype(np.float64), axis=1) for end in ends]
        reference = (ways[0] + ways[1]) / 2.0
    return PhaseHistory(
        source=str(path),
        samples=np.ascontiguousarray(samples.T),
        frequency_start_hz=start,
        frequency_step_hz=step,
        position_m=arp,
        reference_range_m=reference,
        polarization=found,
        frame=stated.frame or LocalEarth(*ecef_to_geodetic(iarp).tolist()),
        transmitter_m=sent,
    )


def antennas(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], bool]:
    """Of the first channel: times (p,) [s], transmitter and receiver (p, 3), earth-centred [m], and whether they are
    two antennas. Raises InputError for a broken file."""
    with _opened(path) as (reader, blocks):
        tree = reader.metadata.xmltree
        channel = tree.findtext("{*}Data/{*}Channel/{*}Identifier")
        _check_arrays(path, tree, channel, blocks)
        pvp = reader.read_pvps(channel)
        time, sent, received = (pvp[name].astype(np.float64) for name in ("TxTime", "TxPos", "RcvPos"))
        return time, sent, received, tree.findtext("{*}CollectionID/{*}CollectType") == "BISTATIC"


@contextmanager
def _opened(path: Path) -> Iterator[tuple[sarkit_cphd.Reader, dict[str, int]]]:
    """The library's reader and the sizes of the file's blocks [bytes]; what it raises becomes one InputError."""
    EXTRA.require(f"{path}: CPHD")
    import sarkit.cphd as sarkit_cphd
    from lxml.etree import LxmlError

    with reading(path, "CPHD file", LxmlError), path.open("rb") as file:
        blocks = _blocks(path, sarkit_cphd.read_file_header(file)[1])
        file.seek(0)
        yield sarkit_cphd.Reader(file), blocks


def _blocks(path: Path, header: dict[str, str]) -> dict[str, int]:
    """Sizes of the file's blocks [bytes]. InputError for one that does not lie in the file: the library believes it."""
    size, found = path.stat().st_size, {}
    for name in ("XML", "SUPPORT", "PVP", "SIGNAL"):
        if name == "SUPPORT" and f"{name}_BLOCK_SIZE" not in header:
            continue
        length, start = int(header[f"{name}_BLOCK_SIZE"]), int(header[f"{name}_BLOCK_BYTE_OFFSET"])
        if length < 0 or start < 0 or start + length > size:
            raise InputError(
                f"{path}: the header places {name} at bytes {start} to {start + length}; the file has {size}: broken "
                "or truncated"
            )
        found[name] = length
    return found


def _check_arrays(path: Path, tree: ElementTree, channel: str, blocks: dict[str, int]) -> None:
    """Raise InputError where a channel's arrays do not fit into their blocks."""
    for node in tree.findall("{*}Data/{*}Channel"):
        if node.findtext("{*}Identifier") == channel:
            vectors, samples = (int(node.findtext(f"{{*}}{name}")) for name in ("NumVectors", "NumSamples"))
            size = int(tree.findtext("{*}Data/{*}NumBytesPVP"))
            packed = int(node.findtext("{*}CompressedSignalSize") or 0)
            fits = vectors * samples * 2 <= blocks["SIGNAL"] or packed > 0  # 2 bytes: the smallest kind of sample
            if (
                min(vectors, samples, size, packed) < 0
                or not fits
                or max(packed, vectors * size) > sum(blocks.values())
            ):
                raise InputError(
                    f"{path}: channel {channel} has {vectors} vectors of {samples} samples and {size} bytes of "
                    f"parameters; they do not fit into the file's blocks: broken"
                )


def _channel(path: Path, tree: ElementTree, wanted: str | None) -> tuple[str, str]:
    """Identifier and polarization (transmitted, received) of the channel asked for."""
    channels = {}
    for parameters in tree.findall("{*}Channel/{*}Parameters"):
        sent, received = (parameters.findtext(f"{{*}}Polarization/{{*}}{end}") for end in ("TxPol", "RcvPol"))
        channels[parameters.findtext("{*}Identifier")] = f"{sent}{received}"
    fitting = {name: pol for name, pol in channels.items() if wanted in (None, pol)}
    if len(fitting) != 1:
        listed = ", ".join(f"{name} ({pol})" for name, pol in channels.items()) or "none"
        raise InputError(
            f"{path}: {len(fitting)} channels"
            + (f" of polarization {wanted}" if wanted else "")
            + f"; the file has {listed}; choose one with --polarization"
        )
    ((name, pol),) = fitting.items()
    return name, pol


def _complex(signal: np.ndarray, amplitude: np.ndarray | None) -> np.ndarray:
    """Samples of any of the standard's types, times each vector's AmpSF, complex64 (vector, sample)."""
    if signal.dtype.names:
        signal = signal["real"].astype(np.float32) + 1j * signal["imag"].astype(np.float32)
    samples = signal.astype(np.complex64)
    return samples if amplitude is None else samples * amplitude.astype(np.float32)[:, None]


def _shared_band(pvp: np.ndarray, start: np.ndarray, step: np.ndarray, count: int) -> tuple[int, int]:
    """First sample, and the one after the last, of the band that all vectors share; all samples where it is empty."""
    low = np.ceil((pvp["FX1"] - start) / step - 0.5).max()
    high = np.floor((pvp["FX2"] - start) / step + 0.5).min()
    first, last = max(0, int(low)), min(count, int(high) + 1)
    return (first, last) if last - first > 1 else (0, count)


def _vector(tree: ElementTree, path: str) -> np.ndarray:
    return np.array([float(tree.findtext(f"{path}/{{*}}{axis}")) for axis in "XYZ"])


def write(path: Path, made: RecordedSignal) -> None:
    """The file, whole or not at all. Raises InputError where sarkit is missing."""
    EXTRA.require(f"{path}: CPHD")
    import lxml.etree
    import sarkit.cphd as sarkit_cphd

    root = lxml.etree.Element(f"{{{NAMESPACE}}}CPHD", nsmap={None: NAMESPACE})
    tables = sarkit_cphd.ElementWrapper(root)
    names = [str(number) for number in range(1, len(made.samples) + 1)]
    for name, table in (_head(made) | _channels(made, names)).items():
        tables[name] = table
    vectors = _vectors(made, sarkit_cphd.get_pvp_dtype(root.getroottree()))
    tables["ReferenceGeometry"] = sarkit_cphd.compute_reference_geometry(root.getroottree(), vectors)
    metadata = sarkit_cphd.Metadata(xmltree=root.getroottree())
    with replacing(path) as temporary, temporary.open("wb") as file, sarkit_cphd.Writer(file, metadata) as writer:
        for name, samples in zip(names, made.samples.values(), strict=True):
            writer.write_signal(name, np.ascontiguousarray(samples.T))
            writer.write_pvp(name, vectors)


def _head(made: RecordedSignal) -> dict[str, Any]:
    """What was collected, when, and where."""
    (low, high), times = made.taken.band_hz, made.taken.time_s
    return {
        "CollectionID": {
            "CollectorName": f"warpsar {__version__}",
            "CoreName": made.taken.view,
            "CollectType": made.taken.kind,
            "RadarMode": {"ModeType": made.taken.mode},
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
            "TOASwath": {"TOAMin": -made.toa_s, "TOAMax": made.toa_s},
        },
        "SceneCoordinates": _scene(made),
    }


def _channels(made: RecordedSignal, names: list[str]) -> dict[str, Any]:
    """A channel for each polarization, and how its vectors lie in the file."""
    (low, high), times = made.taken.band_hz, made.taken.time_s
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
                    "NumSamples": made.taken.frequencies,
                    "SignalArrayByteOffset": index * pulses * made.taken.frequencies * 8,
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
                    "RefVectorIndex": made.taken.middle,
                    **fixed,
                    "Polarization": {"TxPol": pol[0], "RcvPol": pol[1]},
                    "FxC": (low + high) / 2,
                    "FxBW": high - low,
                    "TOASaved": 2 * made.toa_s,
                    "DwellTimes": {"CODId": "1", "DwellId": "1"},
                }
                for name, pol in zip(names, made.samples, strict=True)
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


def _scene(made: RecordedSignal) -> dict[str, Any]:
    """The reference point, and the box about the mesh on the plane through it."""
    site, corners = made.taken.site, made.corners_m
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
            "IAXExtent": _extent("Line", low[0], high[0], made.cells_m[0]),
            "IAYExtent": _extent("Sample", low[1], high[1], made.cells_m[1]),
        },
    }


def _extent(name: str, low: float, high: float, step: float) -> dict[str, Any]:
    """Lines or samples of a grid, a cell apart, of which number 0 is the reference point."""
    first = int(np.ceil(low / step))
    return {f"{name}Spacing": step, f"First{name}": first, f"Num{name}s": int(np.floor(high / step)) - first + 1}


def _vectors(made: RecordedSignal, kind: np.dtype) -> np.ndarray:
    """Parameters of each pulse."""
    taken, site, track, times = made.taken, made.taken.site, made.taken.track, made.taken.time_s
    low, high = taken.band_hz
    received, sent = track.velocity_m_s()
    vectors = np.zeros(len(times), kind)
    vectors["TxTime"] = times
    vectors["RcvTime"] = times + 2.0 * track.reference_m() / SPEED_OF_LIGHT
    vectors["TxPos"], vectors["RcvPos"] = (site.to_ecef(one) for one in (track.transmitter_m, track.receiver_m))
    vectors["TxVel"], vectors["RcvVel"] = sent @ site.axes, received @ site.axes
    vectors["SRPPos"] = site.ecef
    toward = [place / np.linalg.norm(place, axis=1, keepdims=True) for place in (track.transmitter_m, track.receiver_m)]
    rate = (toward[0] * sent + toward[1] * received).sum(axis=1)  # of both ways [m/s]
    vectors["aFDOP"] = -rate / SPEED_OF_LIGHT
    # Of the shortest pulse that has the band: its sweep takes 1 / B, in which a sensor moves by v / B, 0.03 mm. Zeros
    # say an endless rate, by which readers divide.
    vectors["aFRR2"] = 2.0 / (SPEED_OF_LIGHT * (taken.frequencies * taken.step_hz) ** 2)
    vectors["aFRR1"] = 0.5 * (low + high) * vectors["aFRR2"]
    vectors["FX1"], vectors["FX2"] = low, high
    vectors["SC0"], vectors["SCSS"] = taken.start_hz, taken.step_hz
    vectors["TOA1"], vectors["TOA2"], vectors["SIGNAL"] = -made.toa_s, made.toa_s, 1
    return vectors


FORMAT = Format(
    "cphd",
    "CPHD",
    "`CPHD/`",
    "phase history: FX domain, one antenna or two; vectors with SIGNAL = 0 left out",
    read,
    detect=lambda path, head: head.startswith(MAGIC),
    write=write,
    extra=EXTRA,
)
