"""What an image says of itself: the view's geometry, its axes, and what its numbers are."""

from __future__ import annotations

from typing import Any

from warpsar.version import __version__
from warpsar.world.tables import View
from warpsar.world.world import World, geometry_of


def metadata(scene: World, view: View) -> dict[str, Any]:
    """The facts of a view's image, under the same names in EXR, GeoTIFF, NetCDF, Zarr and simulate.json.

    Numbers, texts, and lists of them. `range_axis`, `azimuth_axis` and `elevation_axis` are unit vectors (east, north,
    up); `spacing_m` is (range, azimuth). `slant_range_m` is there for a strip-map alone, else the wave is plane.
    """
    geometry = geometry_of(scene, view)
    facts: dict[str, Any] = {
        "view": view.name,
        "azimuth_deg": view.azimuth_deg,
        "incidence_deg": view.incidence_deg,
        "frequency_hz": view.frequency_hz or scene.radar.frequency_hz,
        "spacing_m": list(scene.grid.spacing_m),
        "reference_point_m": list(scene.reference_point_m),
        "range_axis": geometry.d.tolist(),
        "azimuth_axis": geometry.u.tolist(),
        "elevation_axis": geometry.v.tolist(),
        "axes": "rows: slant range, near range first; columns: azimuth; the reference point is in the middle",
        "quantity": "beta0",
        "units": "1",
        "scale": "linear power",
        "calibration": "beta0: sum of sigma0 dA over the lit surface, divided by the pixel's area in the slant plane",
        "polarizations": list(scene.radar.polarizations),
        "polarization_basis": scene.radar.polarization_basis,
        "software": f"warpsar {__version__}",
    }
    if scene.origin is not None:
        facts |= {f"origin_{name}": value for name, value in scene.origin.model_dump().items()}
    if geometry.slant_range_m is not None:
        facts["slant_range_m"] = geometry.slant_range_m
    return facts
