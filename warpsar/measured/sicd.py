"""SICD (Sensor Independent Complex Data, NGA.STND.0024), read with sarkit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from warpsar.errors import InputError
from warpsar.measured.data import Facts, ImageChip, Quantity, direction_deg, reading
from warpsar.measured.earth import EarthFrame, Origin, ecef_to_geodetic

_AMPLITUDE_LOOKUP = "AMP8I_PHS8I"


class _Window:
    """The pixel array, read from the file only where it is sliced."""

    def __init__(self, path: Path, shape: tuple[int, int], lookup: np.ndarray | None) -> None:
        self.path, self.shape, self.lookup, self.dtype = path, shape, lookup, np.dtype(np.complex64)

    def __getitem__(self, window: tuple[slice, slice]) -> np.ndarray:
        import sarkit.sicd as sarkit_sicd

        rows, cols = window
        with reading(self.path, "SICD image"), self.path.open("rb") as file:
            raw, _ = sarkit_sicd.NitfReader(file).read_sub_image(rows.start, cols.start, rows.stop, cols.stop)
            if raw.dtype.names and "amp" in raw.dtype.names:
                table = np.arange(256.0) if self.lookup is None else self.lookup
                return (table[raw["amp"]] * np.exp(2j * np.pi * raw["phase"] / 256.0)).astype(np.complex64)
            if raw.dtype.names:
                return (raw["real"].astype(np.float32) + 1j * raw["imag"].astype(np.float32)).astype(np.complex64)
            return raw.astype(np.complex64)


def read(path: Path, frame: EarthFrame | None) -> ImageChip:
    """The image, placed by the standard's own projection (range and range rate of each pixel) of world points.

    Without `frame` the world's origin is the scene centre point. Where the header has a beta0 scale factor the image is
    calibrated with it.
    """
    try:
        import sarkit.sicd as sarkit_sicd
        from sarkit.sicd import projection
    except ImportError as error:
        raise InputError(f'{path}: SICD needs sarkit: pip install "warpsar[sicd]"') from error
    with reading(path, "SICD file"), path.open("rb") as file:
        xml = sarkit_sicd.NitfReader(file).metadata.xmltree
    helper = sarkit_sicd.XmlHelper(xml)

    def load(name: str) -> Any:
        return helper.load("./" + "/".join(f"{{*}}{part}" for part in name.split("/")))

    with reading(path, "SICD header"):
        scp, shape = load("GeoData/SCP/ECF"), (load("ImageData/NumRows"), load("ImageData/NumCols"))
        world = frame or Origin(*ecef_to_geodetic(scp).tolist())
        spacing = (load("Grid/Row/SS"), load("Grid/Col/SS"))
        first = np.array([load("ImageData/FirstRow"), load("ImageData/FirstCol")])
        middle = load("ImageData/SCPPixel") - first
        arp = load("SCPCOA/ARPPos")
        pol = "".join(part[0] for part in load("ImageFormation/TxRcvPolarizationProc").split(":"))
        band = [load(f"ImageFormation/TxFrequencyProc/{end}") for end in ("MinProc", "MaxProc")]
        beta0 = load("Radiometric/BetaZeroSFPoly")
        pixel_type = load("ImageData/PixelType")
        lookup = load("ImageData/AmpTable") if pixel_type == _AMPLITUDE_LOOKUP else None
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
        return Facts(azimuth, incidence, sum(band) / 2.0, pol, float(np.linalg.norm(toward)))

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
