"""Which bodies are tried in a place, and when fewer numbers do."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from warpsar.diagnosis.proposals.places import BodyPlace
from warpsar.world.objects.table import Learnable, Object, Primitive

LONGER = 1.4  # length over width of a first box, whose width and length have the place's width as their mean
HEADINGS_DEG = (0.0, 45.0, 90.0, 135.0)
BODY: tuple[Learnable, ...] = ("position", "heading", "size")
VEHICLES: dict[Primitive, tuple[tuple[float, float], ...]] = {
    "car": ((2.5, 6.0), (1.0, 2.5), (0.8, 2.2)),
    "truck": ((4.0, 18.0), (1.7, 3.2), (1.8, 4.5)),
}
"""Least and largest length, width and height [m] of a box that may be one: a car slopes, so its box is narrower."""
BRIGHTNESS = ("rms_height_m",)  # all that is free of a point's material
POINT_PX = 1.0  # diameter of a point reflector, in pixels


@dataclass(frozen=True)
class TrialBody:
    """An object as it is tried. `numbers`: how many of its pose and size are free. `learn`: what is, of its material,
    where that is its own and its model has it."""

    table: Object
    numbers: int
    learn: tuple[str, ...] = ("eps_r", "rms_height_m", "correlation_length_m")


def boxes(place: BodyPlace, name: str) -> Iterator[TrialBody]:
    """Boxes of the place's width and height, under four headings."""
    size = (place.width_m * LONGER**0.5, place.width_m / LONGER**0.5, place.height_m)
    for heading in HEADINGS_DEG:
        yield TrialBody(_body("box", name, size, place.position_m, heading), 6)


def point(position_m: tuple[float, float, float], name: str, pixel_m: float) -> TrialBody:
    """A point reflector: a sphere of about a pixel, which is as bright from everywhere. Its height is free."""
    d = POINT_PX * pixel_m
    table = Object(
        name=name, primitive="sphere", size_m=(d, d, d), position_m=position_m, material=name, learn=("position",)
    )
    return TrialBody(table, 3, BRIGHTNESS)


def point_in(box: Object, name: str, pixel_m: float) -> TrialBody:
    """A point reflector in the middle of a fitted box."""
    assert box.size_m is not None
    east, north, foot = box.position_m
    return point((east, north, foot + (box.size_m[2] - POINT_PX * pixel_m) / 2.0), name, pixel_m)


def others(box: Object) -> Iterator[TrialBody]:
    """Other bodies in the place of a fitted box: a cylinder, and vehicles of a vehicle's size, front or back ahead."""
    assert box.size_m is not None
    assert box.name is not None
    yield TrialBody(_body("cylinder", box.name, box.size_m, box.position_m, box.heading_deg), 6)
    for primitive, limits in VEHICLES.items():
        if all(low <= size <= high for size, (low, high) in zip(box.size_m, limits, strict=True)):
            for turn in (0.0, 180.0):
                yield TrialBody(_body(primitive, box.name, box.size_m, box.position_m, box.heading_deg + turn), 6)


def round_one(shape: TrialBody) -> TrialBody | None:
    """The upright cylinder of a circle that is nearest to one of an ellipse; None for other bodies."""
    if shape.table.primitive != "cylinder" or shape.table.size_m is None:
        return None
    length, width, height = shape.table.size_m
    d = (length * width) ** 0.5
    table = shape.table.model_copy(update={"size_m": (d, d, height), "heading_deg": 0.0, "learn": ("position", "size")})
    return TrialBody(table, 4, shape.learn)


def tidy(table: Object) -> Object:
    """The same body with its length not below its width, where the two may be exchanged, and a heading from 0 to 360
    degrees, or to 180 where the body has no front."""
    assert table.size_m is not None
    length, width, height = table.size_m
    heading, size = table.heading_deg, table.size_m
    symmetric = table.primitive in ("box", "cylinder", "plate")
    if symmetric and width > length:
        heading, size = heading + 90.0, (width, length, height)
    return table.model_copy(update={"heading_deg": heading % (180.0 if symmetric else 360.0), "size_m": size})


def _body(
    primitive: Primitive, name: str, size: tuple[float, ...], position: tuple[float, ...], heading: float
) -> Object:
    table = Object(
        name=name,
        primitive=primitive,
        size_m=size,  # type: ignore[arg-type]
        position_m=position,  # type: ignore[arg-type]
        heading_deg=(heading + 180.0) % 360.0 - 180.0,
        material=name,
        learn=BODY,
    )
    return tidy(table)
