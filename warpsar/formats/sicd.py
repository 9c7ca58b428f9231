"""SICD (Sensor Independent Complex Data, NGA.STND.0024), read and written with sarkit.

What is written is SICD 1.3.0 with a grid of the type PLANE: each pixel is a place of the image's plane, onto which the
phase history was backprojected. Its projection into the world is then the standard's own, whatever the track.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.errors import InputError
from warpsar.formats.base.acquisition import F64, START, Acquisition, FormedImage
from warpsar.formats.base.data import Facts, ImageChip, direction_deg, reading
from warpsar.formats.base.declared import Declared, cells_of, half_power_width
from warpsar.formats.base.format import Format, Stated
from warpsar.io.images import replacing
from warpsar.products.grid import LineGrid
from warpsar.products.orbit import Orbit
from warpsar.products.product import Product
from warpsar.runtime.extra import Extra
from warpsar.version import __version__
from warpsar.world.earth import LocalEarth, ecef_to_geodetic
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.taper import TAYLOR_NBAR, TAYLOR_SIDELOBE_DB

if TYPE_CHECKING:
    import sarkit.sicd as sarkit_sicd

EXTRA = Extra("sicd", ("sarkit",))
NAMESPACE = "urn:SICD:1.3.0"
"""The newest that sarpy 2.1 knows; nothing that is written here is of a newer one."""
_ORDER = 4
"""Of the polynomial of the track: a circle of a few degrees to a micrometre."""
WINDOWS: dict[str, dict[str, Any]] = {
    "none": {"WindowName": "UNIFORM"},
    "hann": {"WindowName": "HANNING"},
    "taylor": {"WindowName": "TAYLOR", "Parameter": [("NBAR", f"{TAYLOR_NBAR}"), ("SLL", f"-{TAYLOR_SIDELOBE_DB}")]},
    "unknown": {"WindowName": "UNKNOWN"},
}
"""What the standard calls them."""
_WEIGHTS = 512
"""Of an aperture, as the standard recommends."""
STRAIGHT = 0.01
"""Columns by which times of closest approach may leave equal steps."""
ORBIT_STEP_S = 0.5
"""Between state vectors that stand for the header's polynomial."""
WINDOW_MISFIT = 0.05
"""Of a window's weights over their mean: 5 % change the power of a point by under 0.02 dB."""
FAINT = 0.02
"""Share of the strongest weight under which pulses do not count for the width of the aperture."""
_AMPLITUDE_LOOKUP = "AMP8I_PHS8I"
logging.getLogger("jbpy").addHandler(logging.NullHandler())  # our message holds what it says of a broken file


def read(path: Path, stated: Stated) -> ImageChip:
    """The image, placed by the standard's own projection (range and range rate of each pixel) of world points.

    Without a frame the world's origin is the scene centre point. Where the header has a beta0 scale factor, the image
    is calibrated with it.
    """
    EXTRA.require(f"{path}: SICD")
    import sarkit.sicd as sarkit_sicd
    from lxml.etree import LxmlError
    from sarkit.sicd import projection

    with reading(path, "SICD file", LxmlError), path.open("rb") as file:
        reader = sarkit_sicd.NitfReader(_Guarded(file))
        xml = reader.metadata.xmltree
        _check_pixels(path, reader, sarkit_sicd.PIXEL_TYPES)
        helper = sarkit_sicd.XmlHelper(xml)
    with reading(path, "SICD header", LxmlError):
        header = _Header.read(path, helper)
        world = stated.frame or LocalEarth(*ecef_to_geodetic(header.centre).tolist())
        parameters = projection.MetadataParams.from_xml(xml)

    def locate(points_m: np.ndarray) -> np.ndarray:
        with reading(path, "SICD projection"):
            grid, _, converged = projection.scene_to_image(parameters, world.to_ecef(points_m))
        if not converged:
            raise InputError(f"{path}: the header's geometry does not bring the view's points into the image")
        return grid / header.spacing_m + header.middle

    def facts(reference_point_m: np.ndarray) -> Facts:
        toward = header.antenna - world.to_ecef(reference_point_m)
        azimuth, incidence = direction_deg(toward, world, reference_point_m)
        return Facts(azimuth, incidence, header.frequency_hz, header.polarization, float(np.linalg.norm(toward)))

    return ImageChip(
        source=str(path),
        samples=_Window(path, header.shape, header.lookup),
        quantity="complex",
        facts=facts,
        spacing_m=header.spacing_m,
        locate=locate,
        calibrated=header.beta0 is not None,
        gain=header.gain if header.beta0 is not None else None,
        response=header.response,
    )


def products(path: Path, polarization: str | None) -> tuple[Product, ...]:
    """The image of a grid of the type RGZERO: rows are slant range, columns are times of closest approach.

    Its orbit is the header's polynomial of the antenna's place. Raises InputError for other grids, which have no lines
    of zero Doppler.
    """
    import sarkit.sicd as sarkit_sicd
    from lxml.etree import LxmlError

    with reading(path, "SICD file", LxmlError), path.open("rb") as file:
        reader = sarkit_sicd.NitfReader(_Guarded(file))
        _check_pixels(path, reader, sarkit_sicd.PIXEL_TYPES)
        helper = sarkit_sicd.XmlHelper(reader.metadata.xmltree)
    with reading(path, "SICD header", LxmlError):
        header = _Header.read(path, helper)
        found = _zero_doppler(path, header, helper)
    if polarization not in (None, header.polarization):
        raise InputError(f"{path}: found the polarization {header.polarization}; {polarization} was asked for")
    return (found,)


def _zero_doppler(path: Path, header: _Header, helper: sarkit_sicd.XmlHelper) -> Product:
    def load(name: str) -> Any:
        return helper.load("./" + "/".join(f"{{*}}{part}" for part in name.split("/")))

    grid, plane = load("Grid/Type"), load("RMA/INCA/TimeCAPoly")
    if grid != "RGZERO" or plane is None:
        raise InputError(
            f"{path}: found SICD with a grid of the type {grid}; must be RGZERO with RMA/INCA, whose lines are of zero "
            "Doppler (`warpsar import` places the others; the mission's own product has the orbit)"
        )
    times, track = np.atleast_1d(np.asarray(plane, np.float64)), np.asarray(load("Position/ARPPoly"), np.float64)
    range_m, collect = load("RMA/INCA/R_CA_SCP"), np.datetime64(load("Timeline/CollectStart").replace(tzinfo=None))
    rows, columns = header.shape
    row_m, column_m = header.spacing_m
    along = (np.arange(columns) - header.middle[1]) * column_m
    at = np.polynomial.polynomial.polyval(along, times)
    straight = np.polynomial.polynomial.polyfit(np.arange(columns, dtype=np.float64), at, 1)
    bent = float(np.abs(at - np.polynomial.polynomial.polyval(np.arange(columns), straight)).max())
    if bent > STRAIGHT * abs(straight[1]):
        raise InputError(
            f"{path}: RMA/INCA/TimeCAPoly: found times that leave equal steps by {bent / abs(straight[1]):.2g} "
            f"columns; must be within {STRAIGHT:g}"
        )
    lasts = float(load("Timeline/CollectDuration"))
    ends = min(0.0, float(at.min())) - ORBIT_STEP_S, max(lasts, float(at.max())) + ORBIT_STEP_S
    when = np.linspace(*ends, max(int(np.ceil((ends[1] - ends[0]) / ORBIT_STEP_S)), 3) + 1)
    place = np.polynomial.polynomial.polyval(when, track).T
    speed = np.polynomial.polynomial.polyval(when, np.polynomial.polynomial.polyder(track, axis=0)).T
    bands = [load(f"Grid/{axis}/ImpRespBW") for axis in ("Row", "Col")]
    noise = load("Radiometric/NoiseLevel/NoisePoly")
    if load("Radiometric/NoiseLevel/NoiseLevelType") != "ABSOLUTE":
        noise = None

    def metres(line: ArrayLike, pixel: ArrayLike) -> tuple[F64, F64]:
        down, over = np.broadcast_arrays(np.asarray(pixel, np.float64), np.asarray(line, np.float64))
        return (down - header.middle[0]) * row_m, (over - header.middle[1]) * column_m

    def polynomial(of: Any) -> Callable[[ArrayLike, ArrayLike], F64]:
        return lambda line, pixel: np.asarray(np.polynomial.polynomial.polyval2d(*metres(line, pixel), np.asarray(of)))

    noise_db = None if noise is None else polynomial(noise)
    epoch = collect.astype("datetime64[us]")
    return Product(
        source=str(path),
        platform=str(load("CollectionInfo/CollectorName")),
        epoch=epoch,
        polarization=header.polarization,
        frequency_hz=header.frequency_hz,
        side="left" if load("SCPCOA/SideOfTrack") == "L" else "right",
        grid=LineGrid(
            columns, rows, float(straight[0]), float(straight[1]), float(range_m) - header.middle[0] * row_m, row_m
        ),
        orbit=Orbit.of(str(path), when, place, speed),
        samples=_Turned(_Window(path, header.shape, header.lookup)),
        quantity="complex",
        radiometry=None if header.beta0 is None else "beta0",
        gain=None if header.beta0 is None else polynomial(header.beta0),
        noise=None if noise_db is None else lambda line, pixel: 10.0 ** (noise_db(line, pixel) / 10.0),
        bandwidth_hz=(bands[0] * SPEED_OF_LIGHT / 2.0, bands[1] * column_m / abs(float(straight[1]))),
        hamming=(_hamming(path, load, "Row"), _hamming(path, load, "Col")),
        top=32767.0 if load("ImageData/PixelType") == "RE16I_IM16I" else None,
    )


def _hamming(path: Path, load: Callable[[str], Any], axis: str) -> float:
    """alpha of the window alpha - (1 - alpha) cos that is the axis's, by least squares. 1 where none is stated."""
    name, weights = load(f"Grid/{axis}/WgtType/WindowName"), load(f"Grid/{axis}/WgtFunct")
    if weights is None:
        known = {None: 1.0, "UNIFORM": 1.0, "HANNING": 0.5, "HAMMING": 0.54}
        if name not in known:
            raise InputError(f"{path}: Grid/{axis}: found the window {name} without WgtFunct; must have it")
        return known[name]
    values = np.asarray(weights, np.float64) / np.mean(weights)
    wave = np.cos(2.0 * np.pi * np.linspace(0.0, 1.0, values.size))
    share = float((wave - wave.mean()) @ (values - 1.0) / ((wave - wave.mean()) @ wave))
    off = float(np.std(values - share * (wave - wave.mean())))
    if off > WINDOW_MISFIT:
        raise InputError(
            f"{path}: Grid/{axis}/WgtFunct: found the window {name}, which is no alpha - (1 - alpha) cos (it leaves "
            f"{100 * off:.0f} %); must be within {100 * WINDOW_MISFIT:.0f} %"
        )
    # alpha - (1 - alpha) cos over its mean, alpha, has the share -(1 - alpha) / alpha of the cosine.
    return float(np.clip(1.0 / (1.0 - share), 0.5, 1.0))


class _Turned:
    """Pixels with lines of azimuth first: SICD's rows are range."""

    def __init__(self, window: _Window) -> None:
        self.window, self.shape, self.dtype = window, window.shape[::-1], window.dtype

    def __getitem__(self, window: tuple[slice, slice]) -> np.ndarray:
        lines, pixels = (slice(*each.indices(count)[:2]) for each, count in zip(window, self.shape, strict=True))
        return self.window[pixels, lines].T


class _Guarded:
    """A NITF that jbpy reads field by field; fields that would take it for ever raise ValueError.

    More than 9 bands (NBANDS = 0, then XBANDS in five digits, up to 99,999) take time by their square. SICD has two.
    """

    def __init__(self, file: BinaryIO) -> None:
        self.file, self.last = file, b""
        self.size = os.fstat(file.fileno()).st_size

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)

    def read(self, size: int = -1) -> bytes:
        if size > self.size:
            raise ValueError(f"a field of {size} bytes in a file of {self.size}")
        if size == 5 and self.last == b"0":
            raise ValueError("an image of more than 9 bands")
        data = self.file.read(size)
        self.last = data if size == 1 else b""
        return data


class _Window:
    """The pixels, read from the file only where they are sliced."""

    def __init__(self, path: Path, shape: tuple[int, int], lookup: np.ndarray | None) -> None:
        self.path, self.shape, self.lookup, self.dtype = path, shape, lookup, np.dtype(np.complex64)

    def __getitem__(self, window: tuple[slice, slice]) -> np.ndarray:
        import sarkit.sicd as sarkit_sicd

        rows, cols = window
        with reading(self.path, "SICD image"), self.path.open("rb") as file:
            reader = sarkit_sicd.NitfReader(_Guarded(file))
            raw, _ = reader.read_sub_image(rows.start, cols.start, rows.stop, cols.stop)
            if raw.dtype.names and "amp" in raw.dtype.names:
                table = np.arange(256.0) if self.lookup is None else self.lookup
                return (table[raw["amp"]] * np.exp(2j * np.pi * raw["phase"] / 256.0)).astype(np.complex64)
            if raw.dtype.names:
                return (raw["real"].astype(np.float32) + 1j * raw["imag"].astype(np.float32)).astype(np.complex64)
            return raw.astype(np.complex64)


def _check_pixels(path: Path, reader: sarkit_sicd.NitfReader, kinds: Mapping[str, Any]) -> None:
    """Raise InputError where XML, NITF and file differ in the number of pixels: the library believes the XML."""
    data = reader.metadata.xmltree.find("{*}ImageData")
    rows, cols = (int(data.findtext(f"{{*}}{name}")) for name in ("NumRows", "NumCols"))
    wanted = rows * cols * kinds[data.findtext("{*}PixelType")]["dtype"].itemsize
    segments = [s for s in reader.jbp["ImageSegments"] if s["subheader"]["IID1"].value.startswith("SICD")]
    shapes = [(s["subheader"]["NROWS"].value, s["subheader"]["NCOLS"].value) for s in segments]
    held, end = sum(s["Data"].size for s in segments), max(s["Data"].get_offset() + s["Data"].size for s in segments)
    if min(rows, cols) < 1 or sum(s[0] for s in shapes) != rows or any(s[1] != cols for s in shapes):
        raise InputError(f"{path}: the XML says {rows} x {cols} pixels, the NITF's image segments have {shapes}")
    if held != wanted or end > path.stat().st_size:
        raise InputError(
            f"{path}: {rows} x {cols} pixels of {data.findtext('{*}PixelType')} need {wanted} bytes; the NITF's image "
            f"segments hold {held}, up to byte {end} of {path.stat().st_size}: broken or truncated"
        )


@dataclass(frozen=True)
class _Header:
    """What the XML says of the image; vectors (3,) are earth-centred [m]."""

    centre: np.ndarray
    """Scene centre point."""
    shape: tuple[int, int]
    spacing_m: tuple[float, float]
    """Of rows and columns."""
    middle: np.ndarray
    """Row and column of the scene centre point, (2,)."""
    antenna: np.ndarray
    """Phase centre at the centre of the aperture."""
    polarization: str
    frequency_hz: float
    beta0: np.ndarray | None
    """Coefficients of the scale factor's polynomial in the metres along rows and columns, two powers."""
    lookup: np.ndarray | None
    """Amplitude of each of 256 codes, where pixels are codes."""
    response: Declared | None

    def gain(self, pixel: np.ndarray) -> np.ndarray:
        """The scale factor to beta0 at (row, column), (..., 2)."""
        along = (pixel - self.middle) * self.spacing_m
        coefficients = np.asarray(self.beta0)
        return np.asarray(np.polynomial.polynomial.polyval2d(along[..., 0], along[..., 1], coefficients))

    @classmethod
    def read(cls, path: Path, helper: sarkit_sicd.XmlHelper) -> _Header:
        def load(name: str) -> Any:
            return helper.load("./" + "/".join(f"{{*}}{part}" for part in name.split("/")))

        def numbers(shape: tuple[int, ...], *names: str) -> np.ndarray:
            found = np.array([load(name) for name in names], np.float64).reshape(shape)
            if not np.isfinite(found).all():
                raise InputError(f"{path}: the header's {', '.join(names)} must be finite numbers")
            return found

        centre, shape = numbers((3,), "GeoData/SCP/ECF"), (load("ImageData/NumRows"), load("ImageData/NumCols"))
        row_m, col_m = numbers((2,), "Grid/Row/SS", "Grid/Col/SS").tolist()
        middle = numbers((2,), "ImageData/SCPPixel") - numbers((2,), "ImageData/FirstRow", "ImageData/FirstCol")
        antenna = numbers((3,), "SCPCOA/ARPPos")
        polarization = "".join(part[0] for part in load("ImageFormation/TxRcvPolarizationProc").split(":"))
        band = numbers((2,), *(f"ImageFormation/TxFrequencyProc/{end}" for end in ("MinProc", "MaxProc")))
        beta0 = load("Radiometric/BetaZeroSFPoly")
        if beta0 is not None and (np.ndim(beta0) != 2 or not np.isfinite(beta0).all()):
            raise InputError(f"{path}: the header's BetaZeroSFPoly must be finite coefficients of two powers")
        lookup = load("ImageData/AmpTable") if load("ImageData/PixelType") == _AMPLITUDE_LOOKUP else None
        if lookup is not None and (np.shape(lookup) != (256,) or not np.isfinite(lookup).all()):
            raise InputError(f"{path}: the header's AmpTable must be 256 finite numbers")
        widths, bands, names, weights = (
            (load(f"Grid/Row/{name}"), load(f"Grid/Col/{name}"))
            for name in ("ImpRespWid", "ImpRespBW", "WgtType/WindowName", "WgtFunct")
        )
        usable = all(number is not None and 0.0 < number < np.inf for number in (*widths, *bands))
        cells = (cells_of(names[0], weights[0]), cells_of(names[1], weights[1]))
        response = Declared(widths, bands, cells) if usable else None
        middle_hz = float(band.mean())
        return cls(centre, shape, (row_m, col_m), middle, antenna, polarization, middle_hz, beta0, lookup, response)


def write(path: Path, made: FormedImage) -> None:
    """The file, whole or not at all. Raises InputError where sarkit is missing."""
    EXTRA.require(f"{path}: SICD")
    import lxml.etree
    import sarkit.sicd as sarkit_sicd

    root = lxml.etree.Element(f"{{{NAMESPACE}}}SICD", nsmap={None: NAMESPACE})
    tables = sarkit_sicd.ElementWrapper(root, _schema())
    for name, table in _tables(made).items():
        tables[name] = table
    tables["SCPCOA"] = sarkit_sicd.compute_scp_coa(root.getroottree())
    graze, slope = (float(root.findtext(f"{{*}}SCPCOA/{{*}}{name}")) for name in ("GrazeAng", "SlopeAng"))
    tables["Radiometric"] = {
        "RCSSFPoly": np.full((1, 1), made.response_m2),
        "SigmaZeroSFPoly": np.full((1, 1), np.cos(np.deg2rad(slope))),
        "BetaZeroSFPoly": np.ones((1, 1)),
        "GammaZeroSFPoly": np.full((1, 1), np.cos(np.deg2rad(slope)) / np.sin(np.deg2rad(graze))),
    }
    security: Any = {"security": {"clas": "U"}}
    made_by: Any = {"ostaid": "warpsar", **security}
    source: Any = {"isorce": "warpsar", **security}
    metadata = sarkit_sicd.NitfMetadata(
        xmltree=root.getroottree(),
        file_header_part=made_by,
        im_subheader_part=source,
        de_subheader_part=security,
    )
    with replacing(path) as temporary, temporary.open("wb") as file, sarkit_sicd.NitfWriter(file, metadata) as writer:
        writer.write_image(np.ascontiguousarray(made.pixels))


@cache
def _schema() -> Any:
    """What sarkit knows of the standard's elements, read once: by itself it reads it anew for every element."""
    import sarkit.sicd as sarkit_sicd

    found: Any = sarkit_sicd.XsdHelper(NAMESPACE)
    found.get_transcoder = cache(found.get_transcoder)
    return found


def _tables(made: FormedImage) -> dict[str, Any]:
    """What was collected, what the pixels are and where they lie."""
    taken, sent, received = made.taken, made.polarization[0], made.polarization[1]
    (low, high), lasts = taken.band_hz, float(taken.time_s[-1])
    label = f"{sent}:{received}"
    return {
        "CollectionInfo": {
            "CollectorName": f"warpsar {__version__}",
            "CoreName": taken.view,
            "CollectType": taken.kind,
            "RadarMode": {"ModeType": taken.mode},
            "Classification": "UNCLASSIFIED",
        },
        "ImageCreation": {"Application": f"warpsar {__version__}"},
        "ImageData": _image_data(made.pixels),
        "GeoData": {
            "EarthModel": "WGS_84",
            "SCP": {"ECF": _centre(made), "LLH": ecef_to_geodetic(_centre(made))},
            "ImageCorners": _corners(made),
        },
        "Grid": _grid(made, 0.5 * lasts),
        "Timeline": {"CollectStart": np.datetime64(START).astype(object), "CollectDuration": lasts},
        "Position": {"ARPPoly": _polynomial(taken)},
        "RadarCollection": {
            "TxFrequency": {"Min": low, "Max": high},
            "TxPolarization": sent,
            "RcvChannels": {"@size": 1, "ChanParameters": [{"@index": 1, "TxRcvPolarization": label}]},
        },
        "ImageFormation": {
            "RcvChanProc": {"NumChanProc": 1, "ChanIndex": [1]},
            "TxRcvPolarizationProc": label,
            "TStartProc": 0.0,
            "TEndProc": lasts,
            "TxFrequencyProc": {"MinProc": low, "MaxProc": high},
            "ImageFormAlgo": "OTHER",
            "STBeamComp": "NO",
            "ImageBeamComp": "NO",
            "AzAutofocus": "NO",
            "RgAutofocus": "NO",
        },
    }


def _image_data(pixels: NDArray[np.complex64]) -> dict[str, Any]:
    rows, columns = pixels.shape
    return {
        "PixelType": "RE32F_IM32F",
        "NumRows": rows,
        "NumCols": columns,
        "FirstRow": 0,
        "FirstCol": 0,
        "FullImage": {"NumRows": rows, "NumCols": columns},
        "SCPPixel": [rows // 2, columns // 2],
    }


def _place(made: FormedImage, row: int, column: int) -> F64:
    """A pixel about the reference point, (3,) [m]."""
    along, across = made.axes
    place: F64 = made.range_m[row] * along + made.azimuth_m[column] * across
    return place


def _centre(made: FormedImage) -> F64:
    """The scene centre point, earth-centred, (3,) [m]: a pixel's, half a pixel from the reference point where their
    number is even."""
    return made.taken.site.to_ecef(_place(made, len(made.range_m) // 2, len(made.azimuth_m) // 2))


def _corners(made: FormedImage) -> F64:
    """Latitude and longitude of the corners, (4, 2), cast along the slant plane's normal onto the level plane."""
    taken = made.taken
    normal = np.cross(taken.track.velocity_m_s()[0][taken.middle], taken.track.centre().towards()[0])
    found = []
    for row, column in ((0, 0), (0, -1), (-1, -1), (-1, 0)):
        place = _place(made, row, column)
        level = place - place[2] / normal[2] * normal
        found.append(ecef_to_geodetic(taken.site.to_ecef(level))[:2])
    return np.array(found)


def _grid(made: FormedImage, centre_s: float) -> dict[str, Any]:
    taken, (along, across), (of_band, of_pulses) = made.taken, made.axes, made.weights
    toward = taken.track.centre().mean_towards()[0] if taken.track.bistatic else made.look
    steep = float(-along @ toward)
    carrier = 2.0 * (taken.start_hz + 0.5 * (taken.frequencies - 1) * taken.step_hz) / SPEED_OF_LIGHT
    band: F64 = 2.0 * taken.step_hz / SPEED_OF_LIGHT * steep * np.arange(taken.frequencies, dtype=np.float64)
    aperture: F64 = carrier * (taken.track.mean_towards() @ across)
    used = of_pulses > FAINT * of_pulses.max()  # of a beam: its main lobe
    rows = _axis(band, of_band, made.range_m)
    columns = _axis(aperture[used], of_pulses[used], made.azimuth_m)
    for axis, vector, centre, window in (
        (rows, along, carrier * steep, made.windows[0]),
        (columns, across, 0.0, made.windows[1]),
    ):
        axis |= {"UVectECF": vector @ taken.site.axes, "KCtr": centre, "WgtType": WINDOWS[window]}
        if window == "none":
            del axis["WgtFunct"]
    coefficients = np.full((1, 1), centre_s)
    if taken.stripmap and taken.track.straight is not None:  # each column has its own centre of aperture
        rate = float(across @ taken.track.straight) / float(np.linalg.norm(taken.track.velocity_m_s()[0][taken.middle]))
        coefficients = np.array([[centre_s + rate * made.azimuth_m[len(made.azimuth_m) // 2], rate]])
    return {
        "ImagePlane": "GROUND" if made.ground else "SLANT",
        "Type": "PLANE",
        "TimeCOAPoly": coefficients,
        "Row": rows,
        "Col": columns,
    }


def _axis(at: F64, weight: F64, places_m: F64) -> dict[str, Any]:
    """One direction of the grid, with its samples at spatial frequencies `at` [1/m]."""
    step = float(places_m[1] - places_m[0])
    width = float(np.ptp(at)) * len(at) / (len(at) - 1)
    half = min(0.5 * width, 0.5 / step)
    order = np.argsort(at)
    middles = 0.5 * (at.min() + at.max()) + ((np.arange(_WEIGHTS) + 0.5) / _WEIGHTS - 0.5) * width
    return {
        "SS": step,
        "ImpRespWid": half_power_width(at, weight),
        "Sgn": -1,
        "ImpRespBW": 2.0 * half,
        "DeltaK1": -half,
        "DeltaK2": half,
        "DeltaKCOAPoly": np.zeros((1, 1)),
        "WgtFunct": np.interp(middles, at[order], weight[order]) / weight.max(),
    }


def _polynomial(taken: Acquisition) -> F64:
    """Coefficients of the track in time, (order, 3), earth-centred; halfway between two antennas."""
    times = taken.time_s
    place = taken.site.to_ecef(0.5 * (taken.track.receiver_m + taken.track.transmitter_m))
    order = 1 if taken.track.straight is not None else min(_ORDER, len(times) - 1)
    if order == 1:
        velocity = (place[-1] - place[0]) / (times[-1] - times[0])
        return np.stack([place[0], velocity])
    scale = times[-1]
    fitted = np.polynomial.polynomial.polyfit(times / scale, place - place[0], order)
    return fitted / scale ** np.arange(order + 1)[:, None] + np.eye(order + 1)[:, :1] * place[0]


FORMAT = Format(
    "sicd",
    "SICD",
    "`NITF`",
    "complex image, placed by the standard's own projection; beta0 where the header has BetaZeroSFPoly; its resolution "
    "becomes `[effects.point_spread]` with a tolerance",
    read,
    detect=lambda path, head: head.startswith(b"NITF"),
    write=write,
    products=products,
    extra=EXTRA,
)
