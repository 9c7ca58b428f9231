"""Sentinel-1 SAFE: SLC and GRD, placed by the annotation's orbit and timing, with its calibration and noise."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.errors import InputError
from warpsar.formats.base.data import ImageChip, reading
from warpsar.formats.base.format import Format, Stated
from warpsar.formats.base.located import chip_of
from warpsar.io import input_file
from warpsar.products.grid import LineGrid
from warpsar.products.ground_range import GroundRange
from warpsar.products.lookup import LineTable
from warpsar.products.orbit import Orbit
from warpsar.products.product import Product
from warpsar.products.tops import Tops
from warpsar.runtime.extra import Extra
from warpsar.world.frame import SPEED_OF_LIGHT

EXTRA = Extra("geo", ("rasterio",))
LARGEST_XML = 2**28
"""Bytes of an annotation; those of IW products have some 2 MB."""
F64 = NDArray[np.float64]


class _Raster:
    """The measurement file, read only where it is sliced."""

    def __init__(self, path: Path, shape: tuple[int, int]) -> None:
        self.path, self.shape = path, shape
        self.dtype = np.dtype(np.float32)

    @contextmanager
    def _opened(self) -> Iterator[Any]:
        import rasterio

        with reading(self.path, "GeoTIFF", rasterio.errors.RasterioError), warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)  # placed by the annotation
            with rasterio.open(self.path) as file:
                yield file

    @cached_property
    def _checked(self) -> bool:
        EXTRA.require(f"{self.path}: Sentinel-1")
        with self._opened() as file:
            found = (file.height, file.width)
        if found != self.shape:
            raise InputError(f"{self.path}: found {found} pixels; its annotation says {self.shape}")
        return True

    def __getitem__(self, window: tuple[slice, slice]) -> np.ndarray:
        assert self._checked
        from rasterio.windows import Window

        (top, bottom, _), (left, right, _) = (s.indices(n) for s, n in zip(window, self.shape, strict=True))
        with self._opened() as file:
            found = file.read(1, window=Window(left, top, right - left, bottom - top))
        return np.asarray(found, np.complex64 if np.iscomplexobj(found) else np.float32)


def is_one(path: Path, head: bytes) -> bool:
    """manifest.safe of Sentinel-1, or an annotation file of it."""
    text = head[:4096]
    annotation = b"<product>" in text and b"<missionId>S1" in text
    return annotation or (b"xfdu:XFDU" in text and (path.parent / "annotation").is_dir())


def annotation_files(path: Path, polarization: str | None) -> list[Path]:
    """The annotation files of a SAFE folder, of its manifest.safe, or the one that `path` is."""
    if path.is_file() and path.name != "manifest.safe":
        return [path]
    folder = path if path.is_dir() else path.parent
    found = sorted((folder / "annotation").glob("s1*.xml"))
    if not found:
        raise InputError(f"{folder}: found no annotation/s1*.xml; must be a SAFE folder of Sentinel-1 SLC or GRD")
    wanted = [one for one in found if polarization is None or f"-{polarization.lower()}-" in one.name]
    if not wanted:
        known = sorted({one.name.split("-")[3].upper() for one in found})
        raise InputError(f"{folder}: found the polarizations {', '.join(known)}; {polarization} is none of them")
    return wanted


def products(path: Path, polarization: str | None) -> tuple[Product, ...]:
    """One product of each annotation file. Raises InputError for a file that is none."""
    return tuple(_Annotation(one).product() for one in annotation_files(path, polarization))


def read(path: Path, stated: Stated) -> ImageChip:
    """The image, placed by its orbit. Raises InputError where several images are there, or no frame is known."""
    found = products(path, stated.polarization)
    if len(found) > 1:
        names = ", ".join(Path(one.source).name for one in found)
        raise InputError(f"{path}: found several images ({names}); name one annotation file, or --polarization")
    return chip_of(found[0], path, stated)


class _Annotation:
    """An annotation file, and the tables of calibration and noise that lie beside it."""

    def __init__(self, path: Path) -> None:
        self.path, self.root = path, _parse(path, "product")
        self.epoch = _time(path, self.text("adsHeader/startTime")).astype("datetime64[D]").astype("datetime64[us]")

    def text(self, name: str) -> str:
        return _text(self.path, self.root, name)

    def number(self, name: str) -> float:
        return _number(self.path, self.root, name)

    def seconds(self, text: str) -> float:
        return _seconds(self.path, text, self.epoch)

    def product(self) -> Product:
        information = "imageAnnotation/imageInformation"
        orbit, grid = self.orbit(), self.grid()
        slc = self.text("adsHeader/productType") == "SLC"
        first = next(self.root.iterfind("imageAnnotation/processingInformation/swathProcParamsList/swathProcParams"))
        band = {axis: _number(self.path, first, f"{axis}Processing/lookBandwidth") for axis in ("range", "azimuth")}
        weights = {
            axis: _number(self.path, first, f"{axis}Processing/windowCoefficient") for axis in ("range", "azimuth")
        }
        whole = {
            axis: _number(self.path, first, f"{axis}Processing/processingBandwidth") for axis in ("range", "azimuth")
        }
        looks = {axis: whole[axis] / band[axis] if band[axis] > 0.0 else 1.0 for axis in band}  # Product refuses 0
        raster = self._measurement()
        lines, pixels = (
            int(self.number(f"{information}/numberOfLines")),
            int(self.number(f"{information}/numberOfSamples")),
        )
        calibration = self._table("calibration", "calibration", "calibrationVectorList/calibrationVector", "betaNought")
        return Product(
            source=str(self.path),
            platform=f"{self.text('adsHeader/missionId')} {self.text('adsHeader/swath')}",
            epoch=self.epoch,
            polarization=self.text("adsHeader/polarisation"),
            frequency_hz=self.number("generalAnnotation/productInformation/radarFrequency"),
            side="right",
            grid=grid,
            orbit=orbit,
            samples=None if raster is None else _Raster(raster, (lines, pixels)),
            quantity="complex" if slc else "amplitude",
            radiometry=None if calibration is None else "beta0",
            gain=None if calibration is None else _inverse_square(calibration),
            noise=self._noise(),
            demodulate=self._tops(grid) if grid.burst_start_s else None,
            bandwidth_hz=(band["range"], band["azimuth"]),
            hamming=(weights["range"], weights["azimuth"]),
            looks=(looks["range"], looks["azimuth"]),
            top=32767.0 if slc else 65535.0,
        )

    def orbit(self) -> Orbit | None:
        vectors = list(self.root.iterfind("generalAnnotation/orbitList/orbit"))
        if not vectors:
            return None
        times = [self.seconds(_text(self.path, one, "time")) for one in vectors]
        place, speed = (
            [[_number(self.path, one, f"{what}/{axis}") for axis in "xyz"] for one in vectors]
            for what in ("position", "velocity")
        )
        return Orbit.of(str(self.path), times, place, speed)

    def grid(self) -> LineGrid:
        information = "imageAnnotation/imageInformation"
        projection = self.text("generalAnnotation/productInformation/projection")
        lines, pixels = (int(self.number(f"{information}/numberOf{what}")) for what in ("Lines", "Samples"))
        interval = self.number(f"{information}/azimuthTimeInterval")
        start = self.seconds(self.text(f"{information}/productFirstLineUtcTime"))
        near = self.number(f"{information}/slantRangeTime") * SPEED_OF_LIGHT / 2.0
        ground = self._ground() if projection == "Ground Range" else None
        if ground is None:
            step = SPEED_OF_LIGHT / 2.0 / self.number("generalAnnotation/productInformation/rangeSamplingRate")
        else:
            step = self.number(f"{information}/rangePixelSpacing")
        bursts = tuple(
            self.seconds(_text(self.path, one, "azimuthTime"))
            for one in self.root.iterfind("swathTiming/burstList/burst")
        )
        plain = LineGrid(lines, pixels, start, interval, near, step, ground, bursts)
        return LineGrid(lines, pixels, start, interval, near, step, ground, bursts, self._bulk_range_m(plain))

    def _bulk_range_m(self, plain: LineGrid) -> float | None:
        """The range that the processor took for all, from the geolocation grid's times beside its lines' times."""
        points = list(self.root.iterfind("geolocationGrid/geolocationGridPointList/geolocationGridPoint"))
        if not points:
            return None
        line, slant_s = (
            np.array([_number(self.path, one, name) for one in points]) for name in ("line", "slantRangeTime")
        )
        time = np.array([self.seconds(_text(self.path, one, "azimuthTime")) for one in points])
        if plain.burst_start_s:  # the grid's lines at the end of a burst may have the next one's times
            per_burst = plain.lines // len(plain.burst_start_s)
            inside = (line % per_burst == 0) & (line < plain.lines)
            line, slant_s, time = line[inside], slant_s[inside], time[inside]
        late = time - plain.time_s(line, np.zeros_like(line))
        return float(np.median(slant_s - 2.0 * late)) * SPEED_OF_LIGHT / 2.0

    def _ground(self) -> GroundRange:
        sets = list(self.root.iterfind("coordinateConversion/coordinateConversionList/coordinateConversion"))
        if not sets:
            raise InputError(f"{self.path}: found no coordinateConversion; must be there in ground range")
        time = np.array([self.seconds(_text(self.path, one, "azimuthTime")) for one in sets])
        origin, slant = (np.array([_number(self.path, one, name) for one in sets]) for name in ("gr0", "sr0"))
        to_slant, to_ground = (
            np.array([_numbers(self.path, one, name) for one in sets])
            for name in ("grsrCoefficients", "srgrCoefficients")
        )
        return GroundRange(time, origin, to_slant, slant, to_ground)

    def _measurement(self) -> Path | None:
        """The TIFF of the same name; None where it is not there."""
        found = self.path.parent.parent / "measurement" / f"{self.path.stem}.tiff"
        return found if found.is_file() else None

    def _beside(self, kind: str) -> Path | None:
        found = self.path.parent / "calibration" / f"{kind}-{self.path.name}"
        return found if found.is_file() else None

    def _table(self, kind: str, root: str, vectors: str, values: str) -> LineTable | None:
        path = self._beside(kind)
        if path is None:
            return None
        found = list(_parse(path, root).iterfind(vectors))
        if not found:
            return None
        lines = np.array([_number(path, one, "line") for one in found])
        order = np.argsort(lines, kind="stable")
        pixels, numbers = ([_numbers(path, found[i], name) for i in order] for name in ("pixel", values))
        if any(p.size != v.size or p.size < 2 for p, v in zip(pixels, numbers, strict=True)):
            raise InputError(f"{path}: found vectors whose numbers of pixels and of {values} differ")
        if kind == "calibration" and (lowest := min(v.min() for v in numbers)) <= 0.0:
            raise InputError(f"{path}: {values}: found {lowest:g}; must be above 0")
        return LineTable(lines[order], tuple(pixels), tuple(numbers))

    def _noise(self) -> Callable[[ArrayLike, ArrayLike], F64] | None:
        """Power of thermal noise [DN^2]: range vectors, times azimuth vectors where the file has them (IPF 2.9 on)."""
        path = self._beside("noise")
        if path is None:
            return None
        name, values = "noiseRangeVectorList/noiseRangeVector", "noiseRangeLut"
        if not _parse(path, "noise").findall(name):
            name, values = "noiseVectorList/noiseVector", "noiseLut"  # older products
        table = self._table("noise", "noise", name, values)
        if table is None:
            return None
        blocks = []
        for one in _parse(path, "noise").iterfind("noiseAzimuthVectorList/noiseAzimuthVector"):
            sides = [one.find(f"{edge}{what}") for edge in ("first", "last") for what in ("AzimuthLine", "RangeSample")]
            if all(side is not None for side in sides):
                box = [
                    _number(path, one, f"{edge}{what}")
                    for what in ("AzimuthLine", "RangeSample")
                    for edge in ("first", "last")
                ]
            else:
                box = [-np.inf, np.inf, -np.inf, np.inf]  # SLC: the whole image
            blocks.append((box, _numbers(path, one, "line"), _numbers(path, one, "noiseAzimuthLut")))

        def power(line: ArrayLike, pixel: ArrayLike) -> F64:
            line, pixel = np.asarray(line, np.float64), np.asarray(pixel, np.float64)
            found = np.asarray(table.at(line, pixel))
            for (first, last, left, right), lines, factors in blocks:
                down = (line >= first - 0.5) & (line <= last + 0.5)
                along = (pixel >= left - 0.5) & (pixel <= right + 0.5)
                if down.any() and along.any():
                    np.multiply(found, np.interp(line, lines, factors), out=found, where=down & along)
            return found

        return power

    def _tops(self, grid: LineGrid) -> Tops:
        centroids = list(self.root.iterfind("dopplerCentroid/dcEstimateList/dcEstimate"))
        rates = list(self.root.iterfind("generalAnnotation/azimuthFmRateList/azimuthFmRate"))
        orbit = self.orbit()
        if not centroids or not rates or orbit is None:
            raise InputError(f"{self.path}: found no dcEstimate, azimuthFmRate or orbit; must be there for bursts")
        steering = np.deg2rad(self.number("generalAnnotation/productInformation/azimuthSteeringRate"))
        frequency = self.number("generalAnnotation/productInformation/radarFrequency")

        def table(found: list[ElementTree.Element], name: str, old: tuple[str, ...] = ()) -> tuple[F64, F64, F64]:
            rows = [
                _numbers(self.path, one, name)
                if one.find(name) is not None
                else np.array([_number(self.path, one, each) for each in old])
                for one in found
            ]
            times = np.array([self.seconds(_text(self.path, one, "azimuthTime")) for one in found])
            starts = np.array([_number(self.path, one, "t0") for one in found])
            return times, starts, np.array(rows)

        return Tops.of(
            grid, orbit, frequency, steering, table(centroids, "dataDcPolynomial"),
            table(rates, "azimuthFmRatePolynomial", ("c0", "c1", "c2")),
        )  # fmt: skip


def _inverse_square(table: LineTable) -> Callable[[ArrayLike, ArrayLike], F64]:
    return lambda line, pixel: 1.0 / np.square(table.at(line, pixel))


def _parse(path: Path, root: str) -> ElementTree.Element:
    """The root element of an XML file. Raises InputError for one that is none, or that declares entities."""
    text = input_file.read_bytes(path, "an annotation", LARGEST_XML)
    if re.search(rb"<!(DOCTYPE|ENTITY)", text):
        raise InputError(f"{path}: found a DOCTYPE or an ENTITY; must be plain XML")
    try:
        found = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: not readable as XML ({error})") from error
    if found.tag != root:
        raise InputError(f"{path}: found <{found.tag[:60]}>; must be <{root}>")
    return found


def _text(path: Path, element: ElementTree.Element, name: str) -> str:
    found = element.findtext(name)
    if not found or not found.strip():
        raise InputError(f"{path}: found no {name}; must be there")
    return found.strip()


def _numbers(path: Path, element: ElementTree.Element, name: str) -> F64:
    text = _text(path, element, name)
    try:
        found = np.array(text.split(), np.float64)
    except ValueError:
        raise InputError(f"{path}: {name}: found {text[:60]!r}; must be numbers") from None
    if not np.isfinite(found).all():
        raise InputError(f"{path}: {name}: found NaN or infinite values")
    return found


def _number(path: Path, element: ElementTree.Element, name: str) -> float:
    found = _numbers(path, element, name)
    if found.size != 1:
        raise InputError(f"{path}: {name}: found {found.size} numbers; must be one")
    return float(found[0])


def _time(path: Path, text: str) -> np.datetime64:
    try:
        return np.datetime64(text, "ns")
    except ValueError:
        raise InputError(f"{path}: found the time {text[:60]!r}; must be like 2021-12-23T05:11:22.594441") from None


def _seconds(path: Path, text: str, epoch: np.datetime64) -> float:
    return float((_time(path, text) - epoch) / np.timedelta64(1, "s"))


FORMAT = Format(
    "sentinel1",
    "Sentinel-1 SAFE",
    "`manifest.safe`, or an annotation file",
    "SLC or GRD image, placed by orbit and zero Doppler; beta0 by its calibration annotation",
    read,
    detect=is_one,
    extra=EXTRA,
    products=products,
    folder=("annotation", "a SAFE folder"),
)
