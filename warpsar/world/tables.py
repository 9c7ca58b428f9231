"""The tables of scene.toml: every key with its unit, its bounds, its default and its meaning."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    ValidationInfo,
    WrapValidator,
    create_model,
    field_validator,
    model_validator,
)

from warpsar.errors import InputError, listed
from warpsar.io.images import LARGEST_IMAGE
from warpsar.models import registry
from warpsar.models.base.model import DEFAULT
from warpsar.models.base.parameters import OF_SURFACES
from warpsar.world import models, pixels
from warpsar.world.problems import keys_of, problem
from warpsar.world.tolerance import refusal

DEFAULT_RAYS_PER_PIXEL = 64.0
"""Where neither density is stated."""
LARGEST_OF_LAYER = 1e6
"""Of a layer's permittivity or permeability: a film of carbon has some thousands."""
MOST_LAYERS = 8
LOSS = "_loss"
LAYER_KEYS = ("eps_r", f"eps_r{LOSS}", "mu_r", f"mu_r{LOSS}", "thickness_m")
"""What a layer is: real parts, losses eps'' and mu'', and thickness."""
OF_STACKS = ("thickness_m", *(f"layers.{k}.{key}" for k in range(MOST_LAYERS) for key in LAYER_KEYS))
"""What a fit to curves of RCS may learn of a stack; a power image does not depend on it."""

Polarization = Literal["HH", "HV", "VH", "VV"]
Term = Literal["single", "edges", "multibounce", "rough", "transmission", "edge_waves"]
OF_RAYS: frozenset[str] = frozenset({"single", "multibounce"})
"""Terms whose fields rays carry from face to face; a rough face reflects them as a half-space, with the loss of its
roughness."""
ViewKey = Literal["azimuth_deg", "incidence_deg"]
SpacingKey = Literal["range_spacing_m", "azimuth_spacing_m"]

_OWN = registry.own_parameters()
_VALUES = {one.key: one for one in OF_SURFACES} | _OWN
SURFACE_KEYS = tuple(_VALUES)
"""The values of a material that may be maps, and that a fit may learn: those of surfaces, and models' own."""

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


# Names that stand in a folder: to a type checker any text.
if TYPE_CHECKING:
    ModelName: TypeAlias = str
    SurfaceKey: TypeAlias = str
    LearnedKey: TypeAlias = str
else:
    ModelName = Literal[registry.names()]
    SurfaceKey = Literal[SURFACE_KEYS]
    LearnedKey = Literal[(*SURFACE_KEYS, models.TERM, models.TABLE, *OF_STACKS)]

FileName = Annotated[Path, BeforeValidator(_file_name)]


# A file's name, or in memory an array, which becomes `Pixels`. To a type checker whatever NumPy can make an array of.
if TYPE_CHECKING:
    MeasuredImage: TypeAlias = Any
    Mask: TypeAlias = Any
    Texture: TypeAlias = Any
else:
    MeasuredImage = Annotated[FileName, WrapValidator(pixels.measured)]
    Mask = Annotated[FileName, WrapValidator(pixels.mask)]
    Texture = str


class Table(BaseModel):
    """A table of scene.toml. It refuses unknown keys, and is never changed in place: `model_copy` makes a new one."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    def __init__(self, **keys: Any) -> None:
        """Raises InputError, one message with everything that is wrong."""
        try:
            super().__init__(**keys)
        except ValidationError as error:
            known = keys_of(type(self))
            wrong = [
                problem(".".join(str(part) for part in details["loc"] if part != "[key]"), details, known)
                for details in error.errors(include_url=False)
            ]
            raise InputError(listed(type(self).__name__, wrong)) from None

    # pydantic then checks tables inside others by itself, and collects all that is wrong in a file
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]

    def __repr_args__(self) -> Iterable[tuple[str | None, Any]]:
        """What is not as by default, under the keys of the scene file: in `repr` the rest is noise."""
        fields = type(self).model_fields
        default = {name: field.get_default(call_default_factory=True) for name, field in fields.items()}
        shown = [(str(name), value) for name, value in super().__repr_args__() if value != default.get(str(name))]
        return [((fields[name].alias if name in fields else None) or name, value) for name, value in shown]

    def __str__(self) -> str:
        return repr(self)


def bounces(terms: Collection[str], most: int) -> int:
    """Reflections of a ray of which these terms have something, at most `most`."""
    return most if "multibounce" in terms else 1


class Radar(Table):
    """`[radar]`: the radar's frequency and polarizations, and how they meet the surface."""

    frequency_hz: _Frequency = Field(description="Carrier frequency [Hz].", examples=[9.6e9])
    polarizations: Annotated[tuple[Polarization, ...], Field(min_length=1)] = Field(
        description="Polarizations of the images, transmitted and received, such as HH.", examples=[["HH", "VV"]]
    )
    slant_range_m: _Range | None = Field(
        default=None,
        description="Range from the straight track to the reference point [m]; plane wave without it.",
        examples=[850e3],
    )
    polarization_basis: Literal["radar", "local"] = Field(
        default="radar",
        description="Basis of the polarizations: the radar's, or every facet's own.",
        examples=["local"],
    )
    terms: Annotated[tuple[Term, ...], Field(min_length=1)] = Field(
        default=("single", "edges", "multibounce", "rough"),
        description="Terms of a coherent product; transmission goes into solid dielectrics, edge_waves from edge to "
        "edge of thin plates (docs/coherent.md).",
        examples=[["single", "edges"]],
    )
    max_bounces: Annotated[_Whole, Field(ge=1, le=1000)] = Field(
        default=30, description="Most reflections of a ray in a coherent product.", examples=[50]
    )
    learn: tuple[ViewKey, ...] = Field(
        default=(),
        description="The angles that a fit may turn by one number, common to all views.",
        examples=[["azimuth_deg"]],
    )
    tolerance: dict[ViewKey, Any] = Field(
        default_factory=dict,
        description="How well that common turn is known to be 0: one standard deviation each, in degrees.",
        examples=[{"azimuth_deg": 0.5}],
    )
    variant: Literal["standard", "as_printed"] = Field(
        default="standard",
        description="as_printed takes the paper's own constants (prefactor 8, its a_vv), not the corrected ones.",
        examples=["as_printed"],
    )

    @model_validator(mode="after")
    def _known(self) -> Radar:
        _refuse_tolerances(self, dict.fromkeys(self.tolerance, 0.0))
        return self

    @property
    def bounces(self) -> int:
        """Most reflections of a ray that the terms ask for."""
        return bounces(self.terms, self.max_bounces)

    @field_validator("polarizations", "terms")
    @classmethod
    def _unique(cls, value: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
        if len(set(value)) < len(value):
            raise ValueError(f"must not name a {str(info.field_name).removesuffix('s')} twice")
        return value


class Origin(Table):
    """`[scene] origin`: where the world's origin lies on WGS 84, in degrees, and metres above the ellipsoid."""

    latitude_deg: Annotated[Number, Field(ge=-90.0, le=90.0)] = Field(
        description="Geodetic latitude, north positive [deg].", examples=[48.137]
    )
    longitude_deg: Annotated[Number, Field(ge=-360.0, le=360.0)] = Field(
        description="Longitude, east positive [deg].", examples=[11.575]
    )
    height_m: Annotated[Number, Field(gt=-1e5, lt=1e5)] = Field(
        default=0.0, description="Height above the ellipsoid [m].", examples=[565.0]
    )


class Grid(Table):
    """`[image]`: the slant-plane pixels, rows in range and columns in azimuth."""

    shape: tuple[_Count, _Count] = Field(
        description="Pixels in range (rows) and in azimuth (columns).", examples=[[160, 200]]
    )
    spacing_m: tuple[_Spacing, _Spacing] = Field(
        description="Pixel spacing in slant range and in azimuth [m].", examples=[[0.45, 0.5]]
    )
    calibrated: Annotated[bool, Field(strict=True)] = Field(
        default=True,
        description="Whether measured images are beta0; false where their gain is unknown.",
        examples=[False],
    )

    learn: tuple[SpacingKey, ...] = Field(
        default=(), description="The spacings that a fit may change.", examples=[["azimuth_spacing_m"]]
    )
    tolerance: dict[SpacingKey, Any] = Field(
        default_factory=dict,
        description="How well the spacings are known: one standard deviation each, in metres or in percent.",
        examples=[{"azimuth_spacing_m": "2 %"}],
    )

    @property
    def range_spacing_m(self) -> float:
        """Pixel spacing in slant range [m]."""
        return self.spacing_m[0]

    @property
    def azimuth_spacing_m(self) -> float:
        """Pixel spacing in azimuth [m]."""
        return self.spacing_m[1]

    @model_validator(mode="after")
    def _known(self) -> Grid:
        _refuse_tolerances(self, {key: getattr(self, key) for key in self.tolerance})
        return self

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
    """`[sampling]`: how many rays are sent, their seed, and how they fall into pixels."""

    rays_per_pixel: Annotated[_Positive, Field(le=1e7)] | None = Field(
        default=None,
        description="Rays per pixel area, over the plane across the look direction; 64 if none is stated.",
        examples=[256.0],
    )
    rays_per_m2: Annotated[_Positive, Field(le=1e12)] | None = Field(
        default=None,
        description="The same density per square metre [1/m^2], in place of rays_per_pixel.",
        examples=[1000.0],
    )
    seed: Annotated[_Whole, Field(ge=0, lt=2**31)] = Field(
        default=0, description="Seed of the rays' jitter.", examples=[7]
    )
    deposit: Literal["footprint", "nearest", "linear"] = Field(
        default="footprint",
        description="Range bins that get a ray's power: those its footprint covers, the nearest, or the nearest two.",
        examples=["nearest"],
    )

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


class _OfModel(Table):
    """The keys of a material that say which model it has, and which files this reads."""

    library: str | None = Field(
        default=None,
        description="A surface of the library; it gives the keys that are left out (docs/materials.md).",
        examples=["asphalt"],
    )
    # What the values' validators look at comes before them.
    model: ModelName = Field(
        default=DEFAULT,
        description="Model that gives sigma0; facet takes it from a table (sigma0).",
        examples=["i2em"],
    )
    sigma0: FileName | None = Field(
        default=None,
        description='CSV of sigma0 [dB]: incidence_deg, and HH, VV, HV (model = "facet" alone).',
        examples=["asphalt.csv"],
    )
    learned_term: FileName | None = Field(
        default=None,
        description="JSON of a learned term: sigma0 is the model's times the exponential of it.",
        examples=["soil.json"],
    )
    layout: Literal["uniform", "vertex", "texture"] = Field(
        default="uniform",
        description="Kind of a name among the values: a scalar of the vertices, or an image.",
        examples=["texture"],
    )


# The keys that models have of their own: to a type checker any name.
if TYPE_CHECKING:

    class _WithOwn(_OfModel):
        def __getattr__(self, key: str) -> float | str | Texture: ...
else:
    _WithOwn = create_model(
        "_WithOwn",
        __base__=_OfModel,
        **{
            key: (
                float | str | Texture,
                Field(default=one.default, description=one.description, examples=[one.example]),
            )
            for key, one in _OWN.items()
        },
    )


class MaterialLayer(Table):
    """One of `layers` of a material: relative permittivity and permeability, and thickness."""

    eps_r: float | tuple[float, float] = Field(
        default=1.0,
        validate_default=True,
        description="Relative permittivity; [eps', -eps''] of a lossy layer.",
        examples=[3.2, [12.0, -1.5]],
    )
    mu_r: float | tuple[float, float] = Field(
        default=1.0,
        validate_default=True,
        description="Relative permeability; [mu', -mu''] of a lossy magnetic layer.",
        examples=[1.0, [1.6, -0.9]],
    )
    thickness_m: Annotated[_Positive, Field(le=100.0)] = Field(
        description="Thickness of the layer [m].", examples=[0.002]
    )

    def number(self, key: str) -> float:
        """The value of one of `LAYER_KEYS`; a loss that is not stated is 0."""
        name = key.removesuffix(LOSS)
        stated = getattr(self, name)
        real, imaginary = stated if isinstance(stated, tuple) else (stated, 0.0)
        return float(real if key == name else -imaginary)

    def with_number(self, key: str, new: float) -> MaterialLayer:
        """With another value of one of `LAYER_KEYS` that it states. A real part keeps its loss, and a loss its part."""
        name = key.removesuffix(LOSS)
        real, loss = (new, self.number(name + LOSS)) if key == name else (self.number(name), new)
        return self.model_copy(update={name: (real, -loss) if isinstance(getattr(self, name), tuple) else real})

    @field_validator("eps_r", "mu_r", mode="plain")
    @classmethod
    def _value(cls, value: Any) -> float | tuple[float, float]:
        parts = tuple(value) if isinstance(value, list | tuple) and len(value) == 2 else (value, 0.0)
        if all(map(_is_number, parts)) and 0.0 < parts[0] <= LARGEST_OF_LAYER >= -parts[1] >= 0.0:
            return float(value) if _is_number(value) else (float(parts[0]), float(parts[1]))
        raise ValueError(
            f"must be a number above 0 to {LARGEST_OF_LAYER:g}, or that and one from -{LARGEST_OF_LAYER:g} to 0"
        )


def layer_of(key: str) -> tuple[int, str]:
    """The number of the layer and its key, of a parameter's key `layers.NUMBER.KEY`."""
    _, number, name = key.split(".")
    return int(number), name


class Material(_WithOwn):
    """`[materials.NAME]`: relative permittivity, roughness and specular fraction of a surface.

    Each of the four values is a number, or a name: that of an image (`layout = "texture"`; an absolute path in memory)
    or of a scalar of the mesh's vertices (`layout = "vertex"`). In memory a texture may be an array of shape (rows,
    cols), row 0 at v = 1, which becomes `Pixels`. A backscatter model may have more values, each under its key.
    """

    spectrum: Literal["gaussian", "exponential", "separable"] = Field(
        default="gaussian",
        description="Spectrum of the roughness; separable takes two correlation lengths.",
        examples=["exponential"],
    )
    conductor: Annotated[bool, Field(strict=True)] = Field(
        default=False,
        description="A perfect conductor (coherent products alone); eps_r and rms_height_m may be left out.",
        examples=[True],
    )
    thickness_m: Annotated[_Positive, Field(le=100.0)] | None = Field(
        default=None,
        description="Thickness of a slab of eps_r [m]: in air, or on a conductor (coherent products alone).",
        examples=[0.0015],
    )
    layers: Annotated[tuple[MaterialLayer, ...], Field(max_length=MOST_LAYERS)] = Field(
        default=(),
        description="Layers from the outermost one inward, in air or on a conductor, in place of eps_r and thickness_m "
        "(coherent products alone). In air they must read the same from both ends.",
        examples=[[{"eps_r": [3.0, -0.1], "mu_r": [1.6, -0.9], "thickness_m": 0.002}]],
    )
    eps_r: float | tuple[float, float] | str | Texture | None = Field(
        default=None,
        validate_default=True,
        description="Relative permittivity; [eps', -eps''] of a lossy surface. Required but for a conductor.",
        examples=[6.0, [80.0, -20.0], "eps_r.exr"],
    )
    rms_height_m: float | str | Texture = Field(
        default=None,
        validate_default=True,
        description="RMS height h of the roughness [m]; 0 is smooth (coherent products). Required but for a conductor.",
        examples=[0.0012, "h.exr"],
    )
    correlation_length_m: float | tuple[float, float] | str | Texture | None = Field(
        default=None,
        validate_default=True,
        description='Correlation length l [m]; [lx, ly] if spectrum = "separable". Required if rough.',
        examples=[0.006, [0.02, 0.005]],
    )
    specular_fraction: float | str | Texture = Field(
        default=0.0, description="Share tau of the power that the surface reflects specularly.", examples=[0.1]
    )
    learn: tuple[LearnedKey, ...] = Field(
        default=("eps_r", "rms_height_m", "correlation_length_m"),
        description="The values that a fit may change; by default the first three, as far as the model has them. "
        '["learned_term"] trains the term, and holds the others; ["sigma0"] does so with a table\'s values. '
        "From curves of RCS alone also thickness_m, and values of layers, as layers.0.mu_r and layers.0.mu_r_loss.",
        examples=[["eps_r"]],
    )
    tolerance: dict[SurfaceKey, Any] = Field(
        default_factory=dict,
        description="How well learned values are known: one standard deviation each, in the key's unit or in percent.",
        examples=[{"eps_r": 0.5}, {"rms_height_m": "20 %"}, {"eps_r": {"about": 6.0, "sd": 0.5}}],
    )

    @field_validator(*SURFACE_KEYS, mode="plain")
    @classmethod
    def _value(cls, value: Any, info: ValidationInfo) -> float | tuple[float, float] | str | Texture | None:
        key = str(info.field_name)
        if value is None:
            return _left_out(key, info.data)
        if key == "rms_height_m" and _is_number(value) and value == 0:
            return 0.0
        if pixels.in_memory(value):
            return _texture(key, value, info.data.get("layout"))
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
            if pair and within(key, pair[0]) and -_VALUES[key].limits[1] <= pair[1] <= 0:
                return float(pair[0]), float(pair[1])
            allowed += ", or [eps', -eps''] with the second not above 0"
        elif key == "correlation_length_m":
            if pair and info.data.get("spectrum") == "separable" and all(within(key, each) for each in pair):
                return float(pair[0]), float(pair[1])
            allowed += ', or [lx, ly] with spectrum = "separable"'
        raise ValueError(f"must be {allowed}")

    @field_validator("learn")
    @classmethod
    def _unique(cls, value: tuple[LearnedKey, ...]) -> tuple[LearnedKey, ...]:
        return tuple(dict.fromkeys(value))

    @model_validator(mode="after")
    def _of_the_model(self) -> Material:
        if found := models.refusals(self, self.model_fields_set):
            raise ValueError("; ".join(found))
        if "learn" not in self.model_fields_set and self.model != DEFAULT:
            self.__dict__["learn"] = models.keys_of(self.model, self.learn)  # the default, as far as the model has it
        return self

    @model_validator(mode="after")
    def _stacked(self) -> Material:
        if not self.layers:
            return self
        if self.eps_r is not None or self.thickness_m is not None:
            raise ValueError("layers: found eps_r or thickness_m beside them; must be in the layers")
        if self.rms_height_m != 0.0:
            raise ValueError("layers: found rms_height_m; must be 0 or left out")
        if not self.conductor and self.layers != self.layers[::-1]:
            raise ValueError("layers: found other ones from behind; in air they must read the same from both ends")
        return self

    @model_validator(mode="after")
    def _of_its_stack(self) -> Material:
        for key in OF_STACKS:
            if key in self.learn and key not in self.stacked:
                allowed = (
                    f"allowed are {', '.join(self.stacked)}" if self.stacked else "it has no thickness_m or layers"
                )
                raise ValueError(f"learn: found {key}, which the material does not state; {allowed}")
        return self

    @property
    def stack(self) -> tuple[MaterialLayer, ...]:
        """The layers from the outermost one inward; of a half-space and of a bare conductor none."""
        if self.thickness_m is None:
            return self.layers
        eps: Any = self.eps_r
        return (MaterialLayer(eps_r=eps, thickness_m=self.thickness_m),)

    @property
    def stacked(self) -> list[str]:
        """The keys of `OF_STACKS` that it states: a loss where it is above 0."""
        if self.thickness_m is not None:
            return ["thickness_m"]
        return [
            f"layers.{number}.{key}"
            for number, layer in enumerate(self.layers)
            for key in LAYER_KEYS
            if layer.number(key) or not key.endswith(LOSS)
        ]

    def alike(self, number: int) -> set[int]:
        """The numbers in `layers` of those that are one layer with this one: in air its mirror image, too."""
        return {number} if self.conductor else {number, len(self.layers) - 1 - number}

    @property
    def solid(self) -> bool:
        """Whether its faces bound a half-space, as of a solid dielectric."""
        return not self.conductor and not self.layers and self.thickness_m is None

    @property
    def bare(self) -> bool:
        """Whether it is a conductor without a layer."""
        return self.conductor and not self.layers and self.thickness_m is None

    @property
    def fields(self) -> list[str]:
        """The keys whose values are maps, or scalars of the mesh's vertices."""
        return [key for key in SURFACE_KEYS if isinstance(getattr(self, key), str | pixels.Pixels)]

    @field_validator("tolerance")
    @classmethod
    def _known(cls, value: dict[SurfaceKey, Any], info: ValidationInfo) -> dict[SurfaceKey, Any]:
        for key, known in value.items():
            stated = info.data.get(key)
            if stated is None or "learn" not in info.data:
                continue  # that is wrong too, and said
            if key not in info.data["learn"]:
                raise ValueError(f"found {key}; allowed are values that `learn` names ({_listed(info.data['learn'])})")
            if isinstance(stated, str | pixels.Pixels):
                raise ValueError(f"found {key}, which is a field; allowed are values that are one number")
            stated = stated[0] if isinstance(stated, tuple) else stated
            if (problem := refusal(known, stated)) is not None:
                raise ValueError(f"{key}{problem}")
            if isinstance(known, dict) and not within(key, known["about"]):
                raise ValueError(f"{key}.about: found {known['about']}; must be {allowed_values(key)}")
        return value


def _refuse_tolerances(table: Any, stated: dict[Any, float]) -> None:
    """Raise ValueError for a tolerance of a `stated` value that `learn` does not free, or for one that is none."""
    for key, value in stated.items():
        if key not in table.learn:
            raise ValueError(f"tolerance: found {key}; allowed are values that `learn` names ({_listed(table.learn)})")
        if (problem := refusal(table.tolerance[key], value)) is not None:
            raise ValueError(f"tolerance.{key}{problem}")


def _listed(names: tuple[str, ...]) -> str:
    return ", ".join(names) or "it names none"


def _left_out(key: str, others: dict[str, Any]) -> float | None:
    """The value that stands for one which may be left out: of a conductor, of a smooth surface."""
    if models.needless(others.get("model", DEFAULT), key):
        return None
    if key == "rms_height_m" and (others.get("conductor") or others.get("layers")):
        return 0.0
    if key == "eps_r" and others.get("layers"):
        return None
    if key == "eps_r" and others.get("conductor") and others.get("thickness_m") is None:
        return None
    if key == "correlation_length_m" and others.get("rms_height_m") == 0.0:
        return None
    raise ValueError("missing")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _texture(key: str, value: Any, layout: Any) -> pixels.Pixels:
    if layout != "texture":
        raise InputError(f'{key}: found an array in memory and layout = "{layout}"; an array needs layout = "texture"')
    texture = value if isinstance(value, pixels.Pixels) else pixels.Pixels(value)
    if (bad := ~within(key, texture.values)).any():  # NaN is within nothing
        raise InputError(
            f"{key}: {int(bad.sum())} of {bad.size} values are out of range (one is {texture.values[bad][0]:g}); "
            f"each must be {allowed_values(key)}"
        )
    return texture


def within(key: str, value: Any) -> Any:
    """Whether a number may be the surface value `key`; of an array an array of answers."""
    one = _VALUES[key]
    return ((value >= one.limits[0]) if one.from_low else (value > one.limits[0])) & (value <= one.limits[1])


def allowed_values(key: str) -> str:
    """What the surface value `key` may be, in words."""
    one = _VALUES[key]
    allowed = f"a number {'from' if one.from_low else 'above'} {one.limits[0]:g} to {one.limits[1]:g}"
    if key == "rms_height_m":
        allowed += ", or 0 (smooth: coherent products alone)"
    if key == "eps_r":
        allowed += " (at 1 nothing reflects and every derivative is 0: a dead point that no fit can leave)"
    return allowed


class View(Table):
    """`[[views]]`: where the radar stands, and what it measured. Paths are absolute in memory.

    In memory an image (linear power) and the mask (nonzero where pixels are used) may be arrays of shape (rows, cols).
    They become `Pixels`. Raises InputError for an array that is no such image.

    Exactly one of `incidence_deg`, `depression_deg` and `grazing_deg` is stated.
    """

    name: Annotated[str, Field(pattern=r"^\w[\w.+-]{0,49}$")] = Field(
        description="Name of the view and of its files: up to 50 letters, digits, _, -, + and .", examples=["north"]
    )
    azimuth_deg: Annotated[Number, Field(ge=-360.0, le=360.0)] = Field(
        description="Direction to the radar, clockwise from north (+Y) [deg].", examples=[25.0]
    )
    stated_incidence_deg: _Angle | None = Field(
        default=None, alias="incidence_deg", description="Angle from the zenith to the radar [deg].", examples=[42.0]
    )
    depression_deg: _Angle | None = Field(default=None, description="90 - incidence_deg [deg].", examples=[48.0])
    grazing_deg: _Angle | None = Field(default=None, description="90 - incidence_deg [deg].", examples=[48.0])
    frequency_hz: _Frequency | None = Field(
        default=None, description="Carrier frequency [Hz]; else that of [radar].", examples=[5.4e9]
    )
    slant_range_m: _Range | None = Field(
        default=None,
        description="Range from the track to the reference point [m]; else that of [radar].",
        examples=[850e3],
    )
    images: dict[Polarization, MeasuredImage] = Field(
        default_factory=dict,
        description="Measured image of each polarization: a file of linear power (beta0).",
        examples=[{"HH": "north.tif"}],
    )
    slc: dict[Polarization, FileName] = Field(
        default_factory=dict,
        description="Complex samples of each polarization, whose power `images` has: an NPZ of `warpsar import`.",
        examples=[{"HH": "north_HH.npz"}],
    )
    mask: Mask | None = Field(
        default=None, description="Image that is not zero where pixels are used.", examples=["north_mask.png"]
    )
    looks: Annotated[_Positive, Field(le=1e9)] | None = Field(
        default=None, description="Equivalent number of looks of the images' speckle.", examples=[4.0]
    )
    looks_estimated: bool = Field(
        default=False,
        description="Whether `looks` were estimated from the images themselves, as `import` does: no test of speckle "
        "can then speak against them.",
        examples=[True],
    )
    texture: Annotated[_Positive, Field(ge=0.05, le=1e6)] | None = Field(
        default=None,
        description="Shape of the gamma law by which the power itself varies from pixel to pixel beside speckle; none "
        "if not stated.",
        examples=[6.0],
    )
    clipped_at: Annotated[_Positive, Field(le=1e30)] | None = Field(
        default=None,
        description="Power from which pixels of the images were clipped: those measured at least this.",
        examples=[65025.0],
    )
    learn: tuple[ViewKey, ...] = Field(
        default=(), description="The angles that a fit may change.", examples=[["azimuth_deg"]]
    )
    tolerance: dict[ViewKey, Any] = Field(
        default_factory=dict,
        description="How well the angles are known: one standard deviation each, in degrees or in percent.",
        examples=[{"azimuth_deg": 0.5, "incidence_deg": 0.2}],
    )
    role: Literal["train", "test"] = Field(
        default="train",
        description="train views are fitted; test views only measure how good the fit is.",
        examples=["test"],
    )

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
        _refuse_tolerances(self, {key: getattr(self, key) for key in self.tolerance})
        return self

    @property
    def incidence_deg(self) -> float:
        """Incidence angle at the reference point, from the zenith [deg], in (0, 90)."""
        if self.stated_incidence_deg is not None:
            return self.stated_incidence_deg
        return 90.0 - (self.depression_deg if self.depression_deg is not None else self.grazing_deg or 0.0)
