"""`[[objects]]`: every key with its unit, its bounds, its default and its meaning."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from warpsar.world.tables import FileName, Number, Table

UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Metres in each unit of length that a mesh may have."""

Primitive = Literal["box", "cylinder", "sphere", "plate", "dihedral", "trihedral", "car", "truck"]
Direction = Literal["+X", "-X", "+Y", "-Y", "+Z", "-Z"]
Learnable = Literal["position", "heading", "pitch", "roll", "scale", "size", "cabin", "side_curvature"]
KEYS: dict[str, str] = {
    "position": "position_m",
    "heading": "heading_deg",
    "pitch": "pitch_deg",
    "roll": "roll_deg",
    "scale": "scale",
    "size": "size_m",
    "cabin": "cabin",
    "side_curvature": "side_curvature",
}
"""The key of the table that each word of `learn` frees."""
THREE = ("position_m", "size_m", "scale")
"""Keys whose elements may have a tolerance each."""
LIMITS = {"cabin": (0.1, 0.85), "side_curvature": (0.0, 0.5)}
"""Least and largest share that a fit may take."""
VEHICLES = ("car", "truck")
CABIN = {"car": 0.6, "truck": 0.25}
"""Default share of the length that the cabin takes."""

NAME = r"^\w[\w.+-]{0,49}$"
"""Of an object, and of a survey."""

_Angle = Annotated[Number, Field(ge=-360.0, le=360.0)]
_Place = Annotated[Number, Field(ge=-1e8, le=1e8)]
_Size = Annotated[Number, Field(ge=0.0, le=1e6)]
_Scale = Annotated[Number, Field(gt=0.0, le=1e6)]
_Share = Annotated[Number, Field(ge=0.1, le=0.85)]
_Bulge = Annotated[Number, Field(ge=0.0, le=0.5)]


class Object(Table):
    """`[[objects]]`: a body with a place of its own, beside the scene's mesh or in place of it.

    Exactly one of `mesh`, `primitive` and `group` is stated. The object's frame has its front to the north, up to +Z,
    and its origin in the middle of its foot. A group's frame is that of the world, and its values are relative to where
    the group stands in the mesh.
    """

    name: Annotated[str, Field(pattern=NAME)] | None = Field(
        default=None,
        description="Name of the object; else the group's, the primitive's, or that of the mesh file.",
        examples=["btr70"],
    )
    mesh: FileName | None = Field(
        default=None, description="Mesh file, of any format that [scene] takes.", examples=["BTR70.obj"]
    )
    primitive: Primitive | None = Field(default=None, description="A body that needs no file.", examples=["car"])
    group: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="A part of the scene's own mesh: the name of an OBJ's usemtl, o or g, or of a glTF's node.",
        examples=["tower"],
    )
    poses: FileName | None = Field(
        default=None,
        description="CSV file with a pose in each line (docs/objects.md): a body of this table stands at each of them.",
        examples=["vehicles.csv"],
    )
    size_m: tuple[_Size, _Size, _Size] | None = Field(
        default=None,
        description="Length (along the front), width and height of a primitive [m]; "
        "may be left out beside `poses` whose file has all three.",
        examples=[[4.5, 1.8, 1.5]],
    )
    cabin: _Share | None = Field(
        default=None,
        description="Share of a car's or truck's length that the cabin takes; 0.6 and 0.25 if not stated.",
        examples=[0.6],
    )
    side_curvature: _Bulge | None = Field(
        default=None,
        description="How far a car's or truck's sides bend in, above and below, as a share of half its width; 0.",
        examples=[0.1],
    )
    units: Literal["m", "cm", "mm", "in", "ft"] = Field(
        default="m", description="Unit of the mesh file.", examples=["in"]
    )
    up: Direction = Field(default="+Z", description="Axis of the mesh file that points up.", examples=["+Y"])
    front: Direction = Field(
        default="+Y", description="Axis of the mesh file that points to the object's front.", examples=["+X"]
    )
    position_m: tuple[_Place, _Place, _Place] = Field(
        default=(0.0, 0.0, 0.0),
        description="East, north and up of the middle of the object's foot [m].",
        examples=[[12.0, -3.5, 0.0]],
    )
    heading_deg: _Angle = Field(
        default=0.0, description="Where the front points, clockwise from north [deg].", examples=[35.0]
    )
    pitch_deg: _Angle = Field(default=0.0, description="Nose up positive [deg].", examples=[2.0])
    roll_deg: _Angle = Field(
        default=0.0,
        description="Right side down positive [deg]; the order is roll, pitch, heading.",
        examples=[-1.5],
    )
    scale: _Scale | tuple[_Scale, _Scale, _Scale] = Field(
        default=1.0, description="Factor on the size, or [along, across, up].", examples=[1.05, [1.0, 0.95, 1.0]]
    )
    material: Annotated[str, Field(min_length=1)] | None = Field(
        default=None, description="Material of the whole object; else the file's own names.", examples=["body"]
    )
    own_material: bool = Field(
        default=False,
        description="Whether the body has a material of its own, which begins as `material` and is called as the body "
        "is: bodies of one kind are unlike in brightness.",
        examples=[True],
    )
    materials: dict[str, Annotated[str, Field(min_length=1)]] | None = Field(
        default=None,
        description="Materials of the mesh file's parts: a material of the scene for each of the file's names.",
        examples=[{"hull": "steel", "wheels": "rubber"}],
    )
    glint: bool = Field(
        default=False,
        description="Whether `learn` may give the body a bright point beside what its shape returns, where the images "
        "pay for its three numbers.",
        examples=[True],
    )
    learn: tuple[Learnable, ...] = Field(
        default=(), description="Numbers that a fit may change.", examples=[["position", "heading"]]
    )
    tolerance: dict[str, Any] = Field(
        default_factory=dict,
        description='Standard deviation to which a key is known, in the key\'s unit, or relative, such as "5 %"; '
        "[a, b, c] for each element of position_m, size_m and scale, 0 for one that a fit holds; "
        "{ about = VALUE, sd = ... } where another value is known than the one stated.",
        examples=[{"position_m": 0.3, "heading_deg": 2.0}, {"position_m": [0.8, 0.8, 0.0]}],
    )

    survey: Annotated[str, Field(pattern=NAME)] | None = Field(
        default=None,
        description="Name of the survey that the pose is from; of `poses`, the file's name.",
        examples=["vehicles"],
    )
    survey_tolerance: dict[Literal["position_m", "heading_deg"], Annotated[Number, Field(gt=0.0, le=1e6)]] = Field(
        default_factory=dict,
        description="Standard deviation of an error that all bodies of one survey have in common [m] and [deg]; "
        "`tolerance` is for the own error of each body.",
        examples=[{"heading_deg": 4.0}],
    )
    accuracy_m: Annotated[Number, Field(gt=0.0, le=100.0)] | None = Field(
        default=None,
        description="Standard deviation of the body's outline about its true place along each axis [m], by which its "
        "edges are judged; else that of [scene].",
        examples=[0.1],
    )

    @field_validator("scale", mode="wrap")
    @classmethod
    def _one_scale(cls, value: Any, handler: Any) -> Any:
        """One message where both forms fail."""
        given = value if isinstance(value, list | tuple) else (value,)
        if len(given) not in (1, 3) or not all(_is_number(each) and 0 < each <= 1e6 for each in given):
            raise ValueError("must be a number above 0 to 1e+06, or three of them: [along, across, up]")
        return tuple(float(each) for each in given) if len(given) == 3 else float(given[0])

    @field_validator("learn")
    @classmethod
    def _once(cls, value: tuple[Learnable, ...]) -> tuple[Learnable, ...]:
        return tuple(dict.fromkeys(value))

    @field_validator("tolerance", mode="wrap")
    @classmethod
    def _known_keys(cls, value: Any, handler: Any) -> Any:
        for key, given in value.items() if isinstance(value, dict) else ():
            if key not in KEYS.values():
                raise ValueError(f"{key} has no tolerance; must be of {', '.join(KEYS.values())}")
            sd = _sd_of(given) if not isinstance(given, dict) or set(given) == {"about", "sd"} else given
            text = isinstance(sd, str) and re.fullmatch(r"\s*\d+(\.\d*)?\s*%\s*", sd)
            each_sd = _three(sd) if key in THREE and len(_three(sd)) == 3 else (sd,)
            numbers = all(_is_number(one) and 0 <= one < float("inf") for one in each_sd)
            if not text and not (numbers and (any(each_sd) if len(each_sd) == 3 else each_sd[0] > 0)):
                three = ", three of them with 0 for one that is held" if key in THREE else ""
                raise ValueError(
                    f'{key} must be a number above 0, in the key\'s own unit{three}, or text such as "5 %"'
                )
            about = _three(given["about"]) if isinstance(given, dict) else (0.0,)
            if not all(_is_number(each) and abs(each) <= 1e8 for each in about):
                raise ValueError(f"{key}.about: found {given['about']!r}; must be numbers as {key} itself takes")
        return handler(value)

    @model_validator(mode="after")
    def _sound(self) -> Object:
        kinds = [key for key in ("mesh", "primitive", "group") if getattr(self, key) is not None]
        if len(kinds) != 1:
            raise ValueError(f"found {' and '.join(kinds) or 'no body'}; must be exactly one of mesh, primitive, group")
        if self.up[1] == self.front[1]:
            raise ValueError(f'found up = "{self.up}" and front = "{self.front}"; must lie on two axes')
        for key in ("own_material", "glint"):
            if getattr(self, key) and self.material is None:
                raise ValueError(f"found {key} without material; must state the one that it begins as")
        if self.material is not None and self.materials is not None:
            raise ValueError("found material and materials; must be one of them")
        self._refuse_foreign_keys(kinds[0])
        self._refuse_half_a_survey()
        if self.primitive is not None:
            self._refuse_sizes()
        return self

    def _refuse_foreign_keys(self, kind: str) -> None:
        """Keys, and words of `learn`, that say nothing of this kind of object."""
        of_kind = {"size_m": kind == "primitive", **dict.fromkeys(("units", "up", "front"), kind == "mesh")}
        of_kind |= dict.fromkeys(("cabin", "side_curvature"), self.primitive in VEHICLES)
        of_kind |= {"material": kind != "group", "materials": kind == "mesh"}
        for key, fits in of_kind.items():
            word = key.removesuffix("_m")
            if not fits and (key in self.model_fields_set or word in self.learn or key in self.tolerance):
                what = f"a {self.primitive}" if self.primitive else f"a {kind}"
                raise ValueError(f"found {key} with {what}; must be left out there")

    def _refuse_half_a_survey(self) -> None:
        """A common error needs a survey, and an error that each body has of its own beside it."""
        if self.poses is not None and (self.group is not None or "position_m" in self.model_fields_set):
            what = "a group" if self.group is not None else "position_m"
            raise ValueError(f"found poses with {what}; must be left out there")
        for key in self.survey_tolerance:
            if self.survey is None and self.poses is None:
                raise ValueError("found survey_tolerance without survey; the bodies of one survey share its error")
            if isinstance(_sd_of(self.tolerance.get(key)), str | None):
                raise ValueError(f"found survey_tolerance of {key}; must have a tolerance of it, too, in its unit")
            if 0 in _three(_sd_of(self.tolerance[key])):
                raise ValueError(
                    f"found survey_tolerance of {key} with a tolerance of 0; must be above 0, as all moves"
                )

    def _refuse_sizes(self) -> None:
        if self.size_m is None and self.poses is not None:
            return  # the file's columns state it, and each body is judged for itself
        if self.size_m is None:
            raise ValueError(f"found a {self.primitive} without size_m; must be [length, width, height]")
        zeros = sum(size == 0 for size in self.size_m)
        if zeros > (self.primitive == "plate"):
            allowed = "one size may be 0" if self.primitive == "plate" else "all three must be above 0"
            raise ValueError(f"found size_m = {list(self.size_m)}; {allowed}")
        if self.round and (self.heading_deg or "heading" in self.learn):
            raise ValueError(f"found a heading of a {self.primitive}, which has no front; must be left out")

    @property
    def round(self) -> bool:
        """Whether the body looks the same under every heading."""
        if self.size_m is None or self.size_m[0] != self.size_m[1] or "size" in self.learn:
            return False
        upright = not (self.pitch_deg or self.roll_deg or {"pitch", "roll"} & set(self.learn))
        flat = self.primitive == "sphere" and self.size_m[2] == self.size_m[0]
        return flat or (self.primitive in ("sphere", "cylinder") and upright)

    @property
    def label(self) -> str:
        """What messages and results call it."""
        return self.name or self.group or self.primitive or (self.mesh.stem if self.mesh else "")

    @property
    def scales(self) -> tuple[float, float, float]:
        """Factors along the front, across it, and up."""
        return self.scale if isinstance(self.scale, tuple) else (self.scale,) * 3

    def known_of(self, key: str, values: tuple[float, ...]) -> tuple[tuple[float, float], ...]:
        """About which value each of a key's `values` is known, and its standard deviation: infinite without one."""
        stated = self.tolerance.get(key)
        about, sd = values, stated
        if isinstance(stated, dict):
            about, sd = _three(stated["about"]), stated["sd"]
            about = about * len(values) if len(about) == 1 else about
        if isinstance(sd, str):
            share = float(sd.strip().rstrip("%")) / 100.0
            return tuple((float(value), share * abs(value)) for value in about[: len(values)])
        sds = _three(float("inf") if sd is None else sd)
        sds = sds * len(values) if len(sds) == 1 else sds
        return tuple((float(value), float(one)) for value, one in zip(about[: len(values)], sds, strict=False))

    def pinned(self) -> Object:
        """The object with the values that its tolerances are about, which stay when a fit moves the keys' own."""
        known = {
            key: one if isinstance(one, dict) else {"about": getattr(self, key), "sd": one}
            for key, one in self.tolerance.items()
            if getattr(self, key) is not None
        }
        return self.model_copy(update={"tolerance": {**self.tolerance, **known}})


def _sd_of(tolerance: Any) -> Any:
    return tolerance["sd"] if isinstance(tolerance, dict) else tolerance


def _three(value: Any) -> tuple[Any, ...]:
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
