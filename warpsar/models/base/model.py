"""What a backscatter model says of itself."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import Literal

Ends = tuple[float, float]
ANY: Ends = (-inf, inf)


@dataclass(frozen=True)
class SurfaceParameter:
    """A number that sigma0 depends on, and that a fit may learn (SI).

    Those of base/parameters.py are of surfaces. Another one is a model's own: `Material`, the schema of scene.toml and
    the reference have its key from here. As those it may be a map, and known to a tolerance.
    """

    key: str
    """In scene.toml"""
    symbol: str
    """In sentences of reports"""
    coordinate: Literal["linear", "log", "contrast", "logit"]
    """What a fit moves, and what kernels get: the kind of `world.transform.Transform`"""
    low: float
    high: float
    """How far a fit may go"""
    limits: Ends
    """What scene.toml may state: above the first ("linear" and "logit": or equal to it), up to the second"""
    default: float = 1.0
    """Of a material that does not state it"""
    description: str = ""
    """For the reference and for editors"""
    example: float = 1.0
    """For the same"""

    @property
    def from_low(self) -> bool:
        """Whether the value may be the first of `limits` itself."""
        return self.coordinate in ("linear", "logit")


@dataclass(frozen=True)
class Domain:
    """Where a model has been found good: incidence [deg], kh, kl and moisture [m^3/m^3] from and up to, and h / l."""

    words: str
    """After "lies outside the domain of"."""
    incidence_deg: Ends = ANY
    kh: Ends = ANY
    kl: Ends = ANY
    moisture: Ends = ANY
    slope: float = inf
    crossed_gaussian_kl: Ends = ANY
    """In the place of `kl` where there are images of HV or VH, and the spectrum is gaussian."""


@dataclass(frozen=True)
class BackscatterModel:
    """A model, by what the scene file, fits and reports must know of it.

    Whatever its fields do not say is as a plain model of powers has it. The equations are `kernels/models/<name>.py`.
    """

    name: str
    """Of its file, and of `model` in scene.toml"""
    summary: str
    order: int
    """Among the models, where they are listed; the default is the first"""
    parameters: tuple[SurfaceParameter, ...]
    """What sigma0 depends on, and so what can be learned. A material states these, and may leave others out."""
    domain: Domain
    spectra: tuple[str, ...] = ("gaussian", "exponential", "separable")
    """Spectra of roughness that a material may have with it"""
    channels: tuple[str, ...] = ("HH", "VV", "HV", "VH")
    coherent_only: bool = False
    """Whether it knows conductors, slabs and smooth faces, which only products with phase have"""
    from_table: bool = False
    """Whether it takes sigma0 from a table (`sigma0` of a material), and so knows no surface"""

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(parameter.key for parameter in self.parameters)

    @property
    def of_surface(self) -> bool:
        """Whether it knows a permittivity and a roughness: what reflection and learned terms go by."""
        return {"eps_r", "rms_height_m"} <= set(self.keys)


DEFAULT = "ka_spm"
"""The model of a material that names none."""
