"""One view's simulated images."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.errors import InputError
from warpsar.simulation.strong_scatterers import StrongScatterers

if TYPE_CHECKING:
    import xarray

LAYERS = {
    "incidence_deg": ("degree", "local angle of incidence, averaged over the lit area; NaN where nothing is lit"),
    "layover": ("1", "separate stretches of lit surface in the pixel"),
    "shadow": ("1", "1 where only surfaces hidden from the radar lie"),
    "material": ("1", "index of the material with the largest lit area; -1 for none"),
}
"""Units and meaning of the layers."""


@dataclass
class SimulatedView:
    """One view's images.

    `beta0[pol]`: linear power, dimensionless, shape (rows, cols), float32, rows along slant range. `range_m` and
    `azimuth_m`: pixel centres about the reference point [m]. `sampling_variance[pol]`: variance of beta0 that the
    jitter of the rays leaves (two seeds). `layers`: see `warpsar.layers.layers`,
    and by name the shares of beta0 that effects tell apart (`beta0_2_bounces_HH`), before the image stage.
    `lit_fraction`: share of the pixels that single-bounce light reaches. `metadata`: geometry, axes and calibration, as
    the headers of its files have them. `looks`: of the speckle on `beta0`; None for an image without.
    `covered`: where a surface lies, lit or hidden (`warpsar.trace.layers.covered`); None where no picture is drawn.
    `scatterers`: the strongest, where they were asked for.
    """

    name: str
    beta0: dict[str, np.ndarray]
    range_m: np.ndarray
    azimuth_m: np.ndarray
    rays: int
    hits: int
    sampling_variance: dict[str, np.ndarray] = field(default_factory=dict)
    layers: dict[str, np.ndarray] = field(default_factory=dict)
    lit_fraction: float = 0.0
    metadata: dict[str, Any] = field(default_factory=dict)
    looks: float | None = None
    covered: np.ndarray | None = None
    scatterers: StrongScatterers | None = None

    def __repr__(self) -> str:
        rows, cols = len(self.range_m), len(self.azimuth_m)
        return f"<SimulatedView {self.name}: {', '.join(self.beta0)}, {rows} x {cols} pixels, {self.rays} rays>"

    def channels(self) -> dict[str, np.ndarray]:
        """What was asked for beyond the images, by name: layers, shares and sampling variances."""
        return dict(self.layers) | {f"sampling_variance_{p}": v for p, v in self.sampling_variance.items()}

    def to_xarray(self) -> xarray.Dataset:
        """The view as an `xarray.Dataset` (extra `xarray`).

        `beta0` and, where there is one, `sampling_variance` have the dimensions range, azimuth and polarization; layers
        have range and azimuth, as NumPy's arrays have. `range` and `azimuth` are coordinates [m] about the reference
        point; a strip-map has `slant_range`, too. The geometry stands in the attributes, under the names of `metadata`.

        Raises InputError where xarray is missing.
        """
        try:
            import xarray
        except ImportError as error:
            raise InputError('xarray is needed: pip install "warpsar[xarray]"') from error
        plane = ("range", "azimuth")
        variables: dict[str, Any] = {
            "beta0": ((*plane, "polarization"), np.stack(list(self.beta0.values()), axis=-1), _BETA0)
        }
        if self.sampling_variance:
            attributes = {"units": "1", "long_name": "variance of beta0 that the jitter of the rays leaves"}
            variables["sampling_variance"] = (
                (*plane, "polarization"),
                np.stack(list(self.sampling_variance.values()), axis=-1),
                attributes,
            )
        for name, layer in self.layers.items():
            units, meaning = LAYERS.get(name, ("1", "share of beta0, before the image stage"))
            variables[name] = (plane, layer, {"units": units, "long_name": meaning})
        coordinates: dict[str, Any] = {
            "azimuth": ("azimuth", self.azimuth_m, _axis("azimuth")),
            "range": ("range", self.range_m, _axis("slant range")),
            "polarization": ("polarization", list(self.beta0), {"long_name": "transmitted and received polarization"}),
        }
        facts = {name: value for name, value in self.metadata.items() if name not in _ELSEWHERE}
        if "slant_range_m" in facts:
            attributes = {"units": "m", "long_name": "distance from the track"}
            coordinates["slant_range"] = ("range", self.range_m + facts["slant_range_m"], attributes)
        title = "simulated SAR image" if self.looks is None else "simulated SAR image with speckle"
        return xarray.Dataset(variables, coordinates, {"Conventions": "CF-1.11", "title": title, **facts})


_ELSEWHERE = ("axes", "polarizations", "quantity", "units", "scale")  # by dimensions, coordinates, and beta0
_BETA0 = {"units": "1", "long_name": "radar brightness beta0, linear power"}


def _axis(name: str) -> dict[str, str]:
    return {"units": "m", "long_name": f"{name} of the pixel's centre about the reference point"}
