"""Scenes that the benchmarks make themselves: a town of any number of faces, and the example with one effect."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from warpsar.effects.registry import get, validate
from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Grid, Material, Radar, Sampling, View

EXAMPLE = Path(__file__).resolve().parent.parent / "data" / "example" / "scene.toml"
SIZE_M = (173.6, 178.8)
MATERIAL = {"eps_r": 5.0, "rms_height_m": 0.0004, "correlation_length_m": 0.005}
FREQUENCY_HZ = 15.2e9
INCIDENCE_DEG = 45.0
HIGHEST_M = 30.0
LOOKS = 16.0


def town_mesh(faces: int, *, scalars: bool = False, seed: int = 0) -> Mesh:
    """Rolling ground with 40 flat-roofed blocks as one heightfield of about `faces` triangles, centred.

    A block's wall is one row of triangles from the last ground node to the first roof node, so walls lean by one
    cell. With `scalars` every vertex has its own eps_r, rms height and correlation length.
    """
    n = max(2, round(np.sqrt(faces / 2)) + 1)
    rng = np.random.default_rng(seed)
    x, y = (np.linspace(-0.5, 0.5, n) * side for side in SIZE_M)
    z = (0.5 * np.sin(x / 17.0))[:, None] + (0.4 * np.cos(y / 23.0))[None, :]
    for _ in range(40):
        (cx, cy), (half_x, half_y) = rng.uniform(-75.0, 75.0, 2), rng.uniform(4.0, 15.0, 2)
        i, j = (slice(*np.searchsorted(axis, (c - h, c + h))) for axis, c, h in ((x, cx, half_x), (y, cy, half_y)))
        z[i, j] = np.maximum(z[i, j], rng.uniform(3.0, HIGHEST_M))
    vertices = np.empty((n * n, 3))
    vertices[:, 0], vertices[:, 1], vertices[:, 2] = np.repeat(x, n), np.tile(y, n), z.ravel()
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)[None, :]).ravel().astype(np.int32)
    triangles = np.concatenate(
        [np.stack([corner, corner + n, corner + n + 1], 1), np.stack([corner, corner + n + 1, corner + 1], 1)]
    )
    fields = {}
    if scalars:
        for key, value in MATERIAL.items():
            fields[key] = value * rng.uniform(0.8, 1.25, n * n)
    return Mesh(vertices, triangles, np.zeros(len(triangles), np.int32), ("town",), vertex_scalars=fields)


def town_scene(
    faces: int, shape: tuple[int, int], rays_per_pixel: float, *, layout: str = "uniform", polarization: str = "HH"
) -> Scene:
    """The town seen from the west at 45 degrees; the pixels cover it, whatever their number."""
    across = SIZE_M[1]
    along = SIZE_M[0] * np.sin(np.deg2rad(INCIDENCE_DEG)) + 2 * HIGHEST_M * np.cos(np.deg2rad(INCIDENCE_DEG))
    mesh = town_mesh(faces, scalars=layout == "vertex")
    material = {**MATERIAL, "specular_fraction": 0.3}
    if layout == "vertex":
        material |= {"layout": "vertex", **{key: key for key in MATERIAL}}
    return Scene(
        mesh=mesh,
        radar=Radar(frequency_hz=FREQUENCY_HZ, polarizations=(polarization,)),
        grid=Grid(shape=shape, spacing_m=(along / shape[0], across / shape[1])),
        materials={"town": Material(**material)},
        views=[View(name="west", azimuth_deg=270.0, incidence_deg=INCIDENCE_DEG)],
        sampling=Sampling(rays_per_pixel=rays_per_pixel),
    )


def around(scene: Scene, count: int, first_deg: float = 270.0) -> Scene:
    """The scene seen from so many sides, 360 / count degrees apart."""
    sides = [(f"v{k}", first_deg + 360.0 * k / count) for k in range(count)]
    views = [scene.views[0].model_copy(update={"name": name, "azimuth_deg": azimuth}) for name, azimuth in sides]
    return replace(scene, views=views)


def measuring(scene: Scene, images: Iterable[np.ndarray], *, speckled: bool = True) -> Scene:
    """The scene with the `images` of its views, in HH, as its measured ones: of 16 looks, under the same speckle each
    time, or without any."""
    random, views = np.random.default_rng(0), []
    for view, image in zip(scene.views, images, strict=True):
        seen = image * random.gamma(LOOKS, 1.0 / LOOKS, image.shape) if speckled else image
        views.append(view.model_copy(update={"images": {"HH": seen.astype(np.float32)}, "looks": LOOKS}))
    return replace(scene, views=views)


def example_with(effect: str | None, rays_per_pixel: float) -> Scene:
    """The committed example's first view, twice (`v0`, `v1`); with the values that an effect declares for it."""
    scene = Scene.load(EXAMPLE)
    return replace(
        scene,
        views=[scene.views[0].model_copy(update={"name": name}) for name in ("v0", "v1")],
        sampling=scene.sampling.model_copy(update={"rays_per_pixel": rays_per_pixel}),
        effects={} if effect is None else {effect: validate(effect, get(effect).example, f"effects.{effect}")},
    )
