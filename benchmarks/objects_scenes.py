"""Scenes of benchmarks/objects.py: a plain with one object on it, and measured images of a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from warpsar.differentiable.geometry import exact_images
from warpsar.runtime import devices
from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh
from warpsar.world.objects.table import Object
from warpsar.world.tables import Grid, Material, Radar, View

CPU = devices.resolve_device("cpu")
GROUND = Material(eps_r=6.0, rms_height_m=0.0012, correlation_length_m=0.010)
BODY = Material(eps_r=12.0, rms_height_m=0.001, correlation_length_m=0.008)
DARK = Material(eps_r=6.0, rms_height_m=1e-7, correlation_length_m=0.010)
SIDES = ((10.0, 40.0), (100.0, 45.0), (190.0, 50.0), (280.0, 40.0))
PLACE = {"position_m": (1.3, -0.8, 0.0), "heading_deg": 35.0, "material": "body"}
BOX = {"primitive": "box", "size_m": (7.0, 4.0, 5.0), **PLACE}
CAR = {"primitive": "car", "size_m": (4.6, 1.8, 1.5), **PLACE}
SHEET = {"primitive": "plate", "size_m": (0.0, 4.0, 4.0), **PLACE, "position_m": (1.3, -0.8, 3.0)}


def plain(sides: Any = SIDES, pixels: int = 64, spacing_m: float = 0.5) -> Scene:
    """A plain of 40 m, seen from some sides."""
    corners = 20.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    views = [View(name=f"v{k}", azimuth_deg=a, incidence_deg=i) for k, (a, i) in enumerate(sides)]
    return Scene(
        Mesh(corners, faces, np.zeros(2, np.int32), ("ground",)),
        Radar(frequency_hz=9.6e9, polarizations=("HH",)),
        Grid(shape=(pixels, pixels), spacing_m=(spacing_m, spacing_m)),
        {"ground": GROUND},
        views,
    )


def with_one(scene: Scene, table: Mapping[str, Any], material: Material = BODY) -> Scene:
    return with_objects(scene, [Object(**table)], {"body": material})


def measured(scene: Scene, seed: int, looks: float = 16.0) -> Scene:
    """The scene with its own images, times speckle."""
    random = np.random.default_rng(seed)
    images = exact_images(scene, CPU)

    def seen(view: View) -> View:
        speckle = random.gamma(looks, 1.0 / looks, scene.grid.shape)
        return view.model_copy(
            update={"images": {"HH": (images[view.name]["HH"] * speckle).astype(np.float32)}, "looks": looks}
        )

    return replace(scene, views=[seen(view) for view in scene.views])
