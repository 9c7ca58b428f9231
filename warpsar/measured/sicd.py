"""SICD (Sensor Independent Complex Data, NGA.STND.0024), read with sarkit."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from warpsar.errors import InputError
from warpsar.measured.data import Facts, ImageChip, Quantity, direction_deg, reading
from warpsar.measured.earth import EarthFrame, Origin, ecef_to_geodetic

_AMPLITUDE_LOOKUP = "AMP8I_PHS8I"
logging.getLogger("jbpy").addHandler(logging.NullHandler())  # what it says of a broken file is in our message


class _Guarded:
    """A NITF as jbpy reads it, field by field.

    Bands beyond 9 (NBANDS = 0, then XBANDS in five digits, up to 99,999) take it time by their square; SICD has two.
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
    """The pixel array, read from the file only where it is sliced."""

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


def _check_pixels(path: Path, reader: Any, kinds: Any) -> None:
    """The XML's shape against the NITF's image segments, and those against the file: the library believes the XML."""
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

    Without `frame` the world's origin is the scene centre point. Where the header has a beta0 scale factor the image is
    calibrated with it.
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

    def load(name: str) -> Any:
        return helper.load("./" + "/".join(f"{{*}}{part}" for part in name.split("/")))

    def numbers(shape: tuple[int, ...], *names: str) -> np.ndarray:
        found = np.array([load(name) for name in names], np.float64).reshape(shape)
        if not np.isfinite(found).all():
            raise InputError(f"{path}: the header's {', '.join(names)} must be finite numbers")
        return found

    with reading(path, "SICD header", LxmlError):
        scp, shape = numbers((3,), "GeoData/SCP/ECF"), (load("ImageData/NumRows"), load("ImageData/NumCols"))
        world = frame or Origin(*ecef_to_geodetic(scp).tolist())
        spacing = tuple(numbers((2,), "Grid/Row/SS", "Grid/Col/SS").tolist())
        middle = numbers((2,), "ImageData/SCPPixel") - numbers((2,), "ImageData/FirstRow", "ImageData/FirstCol")
        arp = numbers((3,), "SCPCOA/ARPPos")
        pol = "".join(part[0] for part in load("ImageFormation/TxRcvPolarizationProc").split(":"))
        band = numbers((2,), *(f"ImageFormation/TxFrequencyProc/{end}" for end in ("MinProc", "MaxProc")))
        beta0 = load("Radiometric/BetaZeroSFPoly")
        if beta0 is not None and (np.ndim(beta0) != 2 or not np.isfinite(beta0).all()):
            raise InputError(f"{path}: the header's BetaZeroSFPoly must be finite coefficients of two powers")
        pixel_type = load("ImageData/PixelType")
        lookup = load("ImageData/AmpTable") if pixel_type == _AMPLITUDE_LOOKUP else None
        if lookup is not None and (np.shape(lookup) != (256,) or not np.isfinite(lookup).all()):
            raise InputError(f"{path}: the header's AmpTable must be 256 finite numbers")
        parameters = projection.MetadataParams.from_xml(xml)

    def locate(points_m: np.ndarray) -> np.ndarray:
        with reading(path, "SICD projection"):
            grid, _, converged = projection.scene_to_image(parameters, world.to_ecef(points_m))
        if not converged:
            raise InputError(f"{path}: the header's geometry does not bring the view's points into the image")
        return grid / spacing + middle

    def gain(pixel: np.ndarray) -> np.ndarray:
        coordinates = (pixel - middle) * spacing
        return np.polynomial.polynomial.polyval2d(coordinates[..., 0], coordinates[..., 1], beta0)

    def facts(reference_point_m: np.ndarray) -> Facts:
        toward = arp - world.to_ecef(reference_point_m)
        azimuth, incidence = direction_deg(toward, world, reference_point_m)
        return Facts(azimuth, incidence, float(band.mean()), pol, float(np.linalg.norm(toward)))

    quantity: Quantity = "complex"
    return ImageChip(
        source=str(path),
        samples=_Window(path, shape, lookup),
        quantity=quantity,
        facts=facts,
        spacing_m=spacing,
        locate=locate,
        calibrated=beta0 is not None,
        gain=gain if beta0 is not None else None,
    )
