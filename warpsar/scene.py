"""What is looked at: a scene file, its mesh and its images, checked once, at the door."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    field_validator,
    model_validator,
)

from warpsar.errors import InputError
from warpsar.frame import SPEED_OF_LIGHT
from warpsar.images import LARGEST_IMAGE, read_channel, read_mask

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pydantic import ValidationInfo

    from warpsar.mesh import Mesh

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


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene with all its files checked; `dataclasses.replace` makes a changed one."""

    mesh: Mesh
    radar: Radar
    grid: Grid
    materials: dict[str, Material]
    """In the order of `mesh.materials`."""
    views: list[View]
    sampling: Sampling = dataclass_field(default_factory=Sampling)
    effects: dict[str, dict[str, Any]] = dataclass_field(default_factory=dict)
    """Parameters of the declared effects, as `warpsar.effects.validate` gives them."""
    reference_point_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where range and azimuth are zero [m], world."""
    path: Path | None = None
    """The scene file, absolute; None for a scene made in memory."""
    mesh_path: Path | None = None
    """The mesh file, absolute."""
    warnings: tuple[str, ...] = ()
    """What the user should be told about the input, one line each."""
    source: str = dataclass_field(default="", repr=False)
    """The scene file's text: `save` keeps its comments."""

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read and check a scene file, its mesh, images, masks and maps.

        Raises `InputError`, one message with everything that is wrong: first of the file itself, and, where
        that is sound, of all that it refers to.
        """
        from warpsar.scenefile import load

        return load(Path(path))

    def save(self, path: str | Path) -> None:
        """Write the scene file, atomically, with the comments of the one it was loaded from.

        Only what was stated or changed is written. File names are relative to the new place and the files
        stay where they are. Needs `mesh_path`.
        """
        from warpsar.scenefile import save

        save(self, Path(path))

    def wavenumber(self, view: View) -> float:
        """2 pi f / c [rad/m] of a view."""
        return 2.0 * math.pi * (view.frequency_hz or self.radar.frequency_hz) / SPEED_OF_LIGHT

    def slant_range_m(self, view: View) -> float | None:
        """Range from the track to the reference point [m]; None for a plane wave."""
        return view.slant_range_m or self.radar.slant_range_m

    def measured(self, view: View, polarization: str) -> NDArray[np.float32]:
        """The measured image: beta0, linear power, shape (rows, cols); NaN where it is not finite."""
        image = read_channel(view.images[polarization], polarization, shape=self.grid.shape)  # type: ignore[index]
        return np.where(np.isfinite(image), image, np.float32(np.nan))

    def mask(self, view: View) -> NDArray[np.bool_] | None:
        """The pixels that the view's mask lets through, shape (rows, cols); None without a mask."""
        return None if view.mask is None else read_mask(view.mask, shape=self.grid.shape)

    def field(self, material: str, key: str) -> NDArray[np.float32] | NDArray[np.float64]:
        """The values that a name stands for.

        A texture, shape (rows, cols), row 0 at v = 1, float32; or the scalar of all of the mesh's vertices,
        shape (n,), float64.
        """
        table = self.materials[material]
        name = getattr(table, key)
        if not isinstance(name, str):
            raise InputError(f"materials.{material}.{key} is the number {name}, not the name of a field")
        return read_channel(name, key) if table.layout == "texture" else self.mesh.vertex_scalars[name]

    def files(self) -> Iterator[Path]:
        """Every image, mask and map that the scene refers to, in a fixed order."""
        for material in self.materials.values():
            for key in SURFACE_KEYS:
                value = getattr(material, key)
                if isinstance(value, str) and material.layout == "texture":
                    yield Path(value)
        for view in self.views:
            yield from (view.images[key] for key in sorted(view.images))
            if view.mask is not None:
                yield view.mask

    @cached_property
    def input_hash(self) -> str:
        """SHA-256 of the scene file, the mesh as read and every file referred to, wherever they lie."""
        total = hashlib.sha256(self.source.encode())
        mesh = self.mesh
        scalars = dict(sorted(mesh.vertex_scalars.items()))
        total.update(repr((mesh.materials, mesh.vertices.shape, mesh.faces.shape, list(scalars))).encode())
        for array in (mesh.vertices, mesh.faces, mesh.face_material, mesh.uv, *scalars.values()):
            if array is not None:
                total.update(np.ascontiguousarray(array).data)
        for path in self.files():
            with path.open("rb") as stream:
                total.update(hashlib.file_digest(stream, "sha256").digest())
        return total.hexdigest()
