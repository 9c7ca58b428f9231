"""A hut on level ground, as a first scene often is, and a box that it may lack."""

from typing import Any

from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, view

from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material, View

SIDES = ((10, 40, "train"), (100, 45, "train"), (190, 50, "train"), (280, 40, "train"), (55, 44, "test"))
"""Azimuth, incidence and role of each view. By four incidences lit pixels tell a floor from a surface."""
BODY = Material(eps_r=20.0, rms_height_m=0.0012, correlation_length_m=0.005)
BOX = Object(
    name="it",
    primitive="box",
    size_m=(4.0, 2.5, 2.5),
    position_m=(2.0, -1.5, 0.0),
    heading_deg=35.0,
    material="it",
)


def views(sides: Any = SIDES, **more: Any) -> list[View]:
    return [view(a, i, name=f"v{k}", role=role, **more) for k, (a, i, role) in enumerate(sides)]


def town(seen: list[View] | None = None, soil: dict[str, Any] = SOIL, **more: Any) -> Scene:
    """Ground wider than the images, with a hut, whose shadow is six pixels long, and no floor declared."""
    mesh = mesh_of(ground=ground(30), hut=box((-7.0, 2.0, 0.0), (-4.0, 6.0, 3.0)))
    asked = {"shape": (44, 40), "spacing_m": (0.5, 0.5), **more}
    return scene_of(mesh, seen or views(), materials={"ground": soil, "hut": BRICK}, **asked)
