"""Small scenes with measured images, for tests of what is learned from them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from worlds import box, ground, mesh_of, plate, scene_of, view

from warpsar.io.images import write_tiff
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Material, Sampling, View

TRUTH = {
    "ground": {"eps_r": 6.0, "rms_height_m": 0.0008, "correlation_length_m": 0.008},
    "cube": {"eps_r": 10.0, "rms_height_m": 0.0010, "correlation_length_m": 0.006},
}
START = {
    "ground": {"eps_r": 4.0, "rms_height_m": 0.0012, "correlation_length_m": 0.006},
    "cube": {"eps_r": 15.0, "rms_height_m": 0.0007, "correlation_length_m": 0.009},
}


def bumpy(size: float = 5.0, cells: int = 4, depth: float = 0.35) -> Mesh:
    """A square of fixed random tilts, one material `soil`, with UV and vertex scalars: every facet turned its own
    way, so that HV is not zero and every node of a field acts."""
    vertices, faces = plate((-size / 2, -size / 2, 0.0), (size, 0, 0), (0, size, 0), cells)
    random = np.random.default_rng(5)
    uv = (vertices[:, :2] / size + 0.5).astype(np.float32)
    vertices = vertices + [0.0, 0.0, 1.0] * random.uniform(-depth, depth, (len(vertices), 1))
    scalars = {
        "eps": random.uniform(4.0, 9.0, len(vertices)),
        "h": random.uniform(0.0015, 0.0025, len(vertices)),
        "l": random.uniform(0.006, 0.010, len(vertices)),
        "t": random.uniform(0.2, 0.5, len(vertices)),
    }
    mesh = mesh_of(soil=(vertices, faces))
    return replace(mesh, uv=uv, vertex_scalars=scalars)


def cube_on_a_plane(size: float = 16.0) -> Mesh:
    return mesh_of(ground=ground(size), cube=box((-2.5, -2.5, 0.0), (2.5, 2.5, 5.0)))


def views_at(*angles: tuple[float, float], **more: Any) -> list[View]:
    return [view(azimuth, incidence, name=f"v{i}", **more) for i, (azimuth, incidence) in enumerate(angles)]


def cube_scene(views: list[View], *, polarizations: tuple[str, ...] = ("HH", "VV"), shape: int = 36) -> Scene:
    """A cube on a plane, of the true materials; declared sampling, so that no time goes into choosing one."""
    return scene_of(
        cube_on_a_plane(),
        views,
        shape=(shape, shape),
        materials=TRUTH,
        polarizations=polarizations,
    )


def speckle(random: np.random.Generator, shape: tuple[int, ...], looks: float) -> np.ndarray:
    return random.gamma(looks, 1.0 / looks, shape)


def measured(
    truth: Scene,
    folder: Path,
    *,
    looks: float = 16.0,
    seed: int = 1,
    noise: Callable[[np.random.Generator, tuple[int, ...], float], np.ndarray] = speckle,
    images: list[dict[str, np.ndarray]] | None = None,
) -> Scene:
    """`truth` with an image of its own in every view and polarization, times speckle; float32 TIFF in `folder`.

    `images`: noise-free ones, by default drawn with other rays than a fit of this scene takes, and four times as
    many.
    """
    random = np.random.default_rng(seed)
    images = images if images is not None else noise_free(truth)
    views = []
    for one, clean in zip(truth.views, images, strict=True):
        paths = {}
        for polarization, image in clean.items():
            paths[polarization] = folder / f"{one.name}_{polarization}.tif"
            write_tiff(paths[polarization], image * noise(random, image.shape, looks))
        views.append(one.model_copy(update={"images": paths, "looks": looks}))
    return replace(truth, views=views)


def noise_free(truth: Scene) -> list[dict[str, np.ndarray]]:
    density = 4.0 * truth.sampling.density_per_m2(truth.grid)
    finer = replace(truth, sampling=Sampling(rays_per_m2=density, seed=truth.sampling.seed + 17))
    return [one.beta0 for one in simulate(finer, device="cpu")]


def starting(scene: Scene, materials: dict[str, dict[str, Any]] = START) -> Scene:
    """The scene with other materials."""
    return replace(scene, materials={name: Material(**materials[name]) for name in scene.mesh.materials})
