"""CPHD (Compensated Phase History Data, NGA.STND.0068), FX domain; read with sarkit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from warpsar.errors import InputError
from warpsar.measured.data import PhaseHistory, reading
from warpsar.measured.earth import EarthFrame, Origin, ecef_to_geodetic

if TYPE_CHECKING:
    from lxml.etree import _ElementTree as ElementTree

MAGIC = b"CPHD/"


def read(path: Path, polarization: str | None, frame: EarthFrame | None) -> PhaseHistory:
    """The channel of `polarization`, or the only one. Without `frame` the world's origin is the scene's IARP.

    A point's echo has the phase SGN 2 pi f dTOA (standard, section 2); samples of SGN = +1 are conjugated. Left out are
    vectors that the file marks as bad (SIGNAL = 0), and frequencies outside the band FX1 to FX2 of any vector.
    """
    try:
        import sarkit.cphd as sarkit_cphd
        from lxml.etree import LxmlError
    except ImportError as error:
        raise InputError(f'{path}: CPHD needs sarkit: pip install "warpsar[sicd]"') from error
    with reading(path, "CPHD file", LxmlError), path.open("rb") as file:
        blocks = _blocks(path, sarkit_cphd.read_file_header(file)[1])
        file.seek(0)
        reader = sarkit_cphd.Reader(file)
        tree = reader.metadata.xmltree
        domain, kind = tree.findtext("{*}Global/{*}DomainType"), tree.findtext("{*}CollectionID/{*}CollectType")
        if domain != "FX":
            raise InputError(f"{path}: found {kind}, domain {domain}; data in the FX domain can be focused")
        channel, found = _channel(path, tree, polarization)
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
        frame=frame or Origin(*ecef_to_geodetic(iarp).tolist()),
        transmitter_m=sent,
    )


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
