"""The tables of scene.toml: keys, units, what each may be, and defaults."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from warpsar.io.images import LARGEST_IMAGE

DEFAULT_RAYS_PER_PIXEL = 64.0


Polarization = Literal["HH", "HV", "VH", "VV"]


SurfaceKey = Literal["eps_r", "rms_height_m", "correlation_length_m", "specular_fraction"]


SURFACE_KEYS: tuple[SurfaceKey, ...] = ("eps_r", "rms_height_m", "correlation_length_m", "specular_fraction")


LIMITS: dict[str, tuple[float, float]] = {
    "eps_r": (1.0, 1e9),
    "rms_height_m": (0.0, 100.0),
    "correlation_length_m": (0.0, 1e4),
    "specular_fraction": (0.0, 1.0),
}
"""What a surface value may be: above the first number (specular_fraction: or equal), not above the second."""


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]


_Whole = Annotated[int, Field(strict=True)]


_Positive = Annotated[Number, Field(gt=0.0)]


_Angle = Annotated[Number, Field(gt=0.0, lt=90.0)]


_Frequency = Annotated[Number, Field(ge=1e6, le=1e13)]


_Count = Annotated[_Whole, Field(gt=0)]


_Spacing = Annotated[Number, Field(ge=1e-5, le=1e5)]


_Range = Annotated[Number, Field(gt=0.0, le=1e9)]


def _file_name(value: object) -> object:
    if isinstance(value, str) and (not value or any(ord(letter) < 32 for letter in value)):
        raise ValueError("must be a file name, without control characters")
    return value


FileName = Annotated[Path, BeforeValidator(_file_name)]


class Table(BaseModel):
    """A table of scene.toml: no unknown keys, never changed in place (`model_copy` makes a new one)."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Radar(Table):
    """`[radar]`: carrier frequency [Hz], polarizations, and how they meet the surface.

    `slant_range_m` [m] makes it a strip-map, else the wave is plane. `variant = "as_printed"` takes the
    paper's own constants (prefactor 8, its a_vv) instead of the corrected ones.
    """

    frequency_hz: _Frequency
    polarizations: Annotated[tuple[Polarization, ...], Field(min_length=1)]
    slant_range_m: _Range | None = None
    polarization_basis: Literal["radar", "local"] = "radar"
    variant: Literal["standard", "as_printed"] = "standard"

    @field_validator("polarizations")
    @classmethod
    def _unique(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        if len(set(value)) < len(value):
            raise ValueError("must not name a polarization twice")
        return value


class Origin(Table):
    """`[scene] origin`: where the world's origin lies on WGS 84, in degrees, and metres above the ellipsoid."""

    latitude_deg: Annotated[Number, Field(ge=-90.0, le=90.0)]
    longitude_deg: Annotated[Number, Field(ge=-360.0, le=360.0)]
    height_m: Annotated[Number, Field(gt=-1e5, lt=1e5)] = 0.0


class Grid(Table):
    """`[image]`: pixels (rows in range, columns in azimuth) and their spacing [m] (range, azimuth)."""

    shape: tuple[_Count, _Count]
    spacing_m: tuple[_Spacing, _Spacing]
    calibrated: Annotated[bool, Field(strict=True)] = True

    @field_validator("shape")
    @classmethod
    def _not_too_many(cls, value: tuple[int, int]) -> tuple[int, int]:
        if value[0] * value[1] > LARGEST_IMAGE:
            raise ValueError(f"must have at most {LARGEST_IMAGE} (2^28) pixels")
        return value

    @property
    def pixel_area_m2(self) -> float:
        """Area of a slant-plane pixel [m^2]."""
        return self.spacing_m[0] * self.spacing_m[1]


class Sampling(Table):
    """`[sampling]`: rays over the plane across the look direction, their seed, how they fall into pixels."""

    rays_per_pixel: Annotated[_Positive, Field(le=1e7)] | None = None
    rays_per_m2: Annotated[_Positive, Field(le=1e12)] | None = None
    seed: Annotated[_Whole, Field(ge=0, lt=2**31)] = 0
    deposit: Literal["footprint", "nearest", "linear"] = "footprint"

    @model_validator(mode="after")
    def _one_density(self) -> Sampling:
        if self.rays_per_pixel is not None and self.rays_per_m2 is not None:
            raise ValueError("found both rays_per_pixel and rays_per_m2; must be one of them")
        return self

    @property
    def stated(self) -> bool:
        """Whether the user chose a density."""
        return self.rays_per_pixel is not None or self.rays_per_m2 is not None

    def density_per_m2(self, grid: Grid) -> float:
        """Rays per square metre across the look direction; 64 per pixel area where nothing is stated."""
        if self.rays_per_m2 is not None:
            return self.rays_per_m2
        return (self.rays_per_pixel or DEFAULT_RAYS_PER_PIXEL) / grid.pixel_area_m2


class Material(Table):
    """`[materials.NAME]`: relative permittivity, roughness and the specular share of a surface.

    Each of the four values is a number, or a name: of an image (`layout = "texture"`; absolute in memory)
    or of a scalar of the PLY's vertices (`layout = "vertex"`). `eps_r` may be (eps', -eps'') of a lossy
    surface, `correlation_length_m` (lx, ly) with `spectrum = "separable"`. `learn` names what a fit may
    change.
    """

    # First, because the values' validators look at them.
    layout: Literal["uniform", "vertex", "texture"] = "uniform"
    spectrum: Literal["gaussian", "exponential", "separable"] = "gaussian"
    eps_r: float | tuple[float, float] | str
    rms_height_m: float | str
    correlation_length_m: float | tuple[float, float] | str
    specular_fraction: float | str = 0.0
    learn: tuple[SurfaceKey, ...] = ("eps_r", "rms_height_m", "correlation_length_m")

    @field_validator(*SURFACE_KEYS, mode="plain")
    @classmethod
    def _value(cls, value: Any, info: ValidationInfo) -> float | tuple[float, float] | str:
        key = str(info.field_name)
        if isinstance(value, str):
            if info.data.get("layout") == "uniform":
                raise ValueError('a name needs layout = "texture" (of a file) or "vertex" (of a PLY\'s scalar)')
            _file_name(value)
            return value
        if _is_number(value) and within(key, value):
            return float(value)
        allowed = allowed_values(key)
        pair = value if isinstance(value, list | tuple) and len(value) == 2 else ()
        pair = pair if all(map(_is_number, pair)) else ()
        if key == "eps_r":
            if pair and within(key, pair[0]) and -LIMITS[key][1] <= pair[1] <= 0:
                return float(pair[0]), float(pair[1])
            allowed += ", or [eps', -eps''] with the second not above 0"
        elif key == "correlation_length_m":
            if pair and info.data.get("spectrum") == "separable" and all(within(key, each) for each in pair):
                return float(pair[0]), float(pair[1])
            allowed += ', or [lx, ly] with spectrum = "separable"'
        raise ValueError(f"must be {allowed}")

    @field_validator("learn")
    @classmethod
    def _unique(cls, value: tuple[SurfaceKey, ...]) -> tuple[SurfaceKey, ...]:
        return tuple(dict.fromkeys(value))


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def within(key: str, value: Any) -> Any:
    """Whether a number, or each of an array's, may stand for the surface value."""
    low, high = LIMITS[key]
    return ((value >= low) if key == "specular_fraction" else (value > low)) & (value <= high)


def allowed_values(key: str) -> str:
    low, high = LIMITS[key]
    allowed = f"a number {'from' if key == 'specular_fraction' else 'above'} {low:g} to {high:g}"
    if key == "eps_r":
        allowed += " (at 1 nothing reflects and every derivative is 0: a dead point that no fit can leave)"
    return allowed


class View(Table):
    """`[[views]]`: from where the radar looks, and what it measured. Paths are absolute in memory."""

    name: Annotated[str, Field(pattern=r"^\w[\w.+-]{0,49}$")]
    azimuth_deg: Annotated[Number, Field(ge=-360.0, le=360.0)]
    stated_incidence_deg: _Angle | None = Field(default=None, alias="incidence_deg")
    depression_deg: _Angle | None = None
    grazing_deg: _Angle | None = None
    frequency_hz: _Frequency | None = None
    slant_range_m: _Range | None = None
    images: dict[Polarization, FileName] = Field(default_factory=dict)
    mask: FileName | None = None
    looks: Annotated[_Positive, Field(le=1e9)] | None = None
    role: Literal["train", "test"] = "train"

    @model_validator(mode="after")
    def _one_angle(self) -> View:
        angles = (self.stated_incidence_deg, self.depression_deg, self.grazing_deg)
        stated = [
            name
            for name, angle in zip(("incidence_deg", "depression_deg", "grazing_deg"), angles, strict=True)
            if angle is not None
        ]
        if len(stated) != 1:
            raise ValueError(
                f"found {' and '.join(stated) or 'no angle'}; must be exactly one of "
                "incidence_deg, depression_deg, grazing_deg"
            )
        return self

    @property
    def incidence_deg(self) -> float:
        """Angle between up and the direction to the radar at the reference point [deg], in (0, 90)."""
        if self.stated_incidence_deg is not None:
            return self.stated_incidence_deg
        return 90.0 - (self.depression_deg if self.depression_deg is not None else self.grazing_deg or 0.0)
