"""SICD (Sensor Independent Complex Data, NGA.STND.0024), read with sarkit."""

from __future__ import annotations

import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from warpsar.errors import InputError
from warpsar.measured.data import Facts, ImageChip, direction_deg, reading
from warpsar.measured.declared import Declared, cells_of
from warpsar.measured.earth import EarthFrame, Origin, ecef_to_geodetic

if TYPE_CHECKING:
    import sarkit.sicd as sarkit_sicd

_AMPLITUDE_LOOKUP = "AMP8I_PHS8I"
logging.getLogger("jbpy").addHandler(logging.NullHandler())  # our message holds what it says of a broken file


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


def read(path: Path, frame: EarthFrame | None) -> ImageChip:
    """The image, placed by the standard's own projection (range and range rate of each pixel) of world points.

    Without `frame` the world's origin is the scene centre point. Where the header has a beta0 scale factor, the image
    is calibrated with it.
    """
    try:
        import sarkit.sicd as sarkit_sicd
        from lxml.etree import LxmlError
        from sarkit.sicd import projection
    except ImportError as error:
        raise InputError(f'{path}: SICD needs sarkit: pip install "warpsar[sicd]"') from error
    with reading(path, "SICD file", LxmlError), path.open("rb") as file:
        reader = sarkit_sicd.NitfReader(_Guarded(file))
        xml = reader.metadata.xmltree
        _check_pixels(path, reader, sarkit_sicd.PIXEL_TYPES)
        helper = sarkit_sicd.XmlHelper(xml)
    with reading(path, "SICD header", LxmlError):
        header = _Header.read(path, helper)
        world = frame or Origin(*ecef_to_geodetic(header.centre).tolist())
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
