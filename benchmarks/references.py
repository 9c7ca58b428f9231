"""Reference images of a scene whose parameters are the truth, and the scene a fit starts from."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from warpsar.io.images import write_exr
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.world.tables import Sampling

DATA = Path(__file__).parent.parent / "data"
KEYS = ("eps_r", "rms_height_m", "correlation_length_m")
RAY_FACTOR = 4.0  # the reference has so many times the fit's rays, from another seed
REFERENCE_SEED = 1000
NO_SPECKLE_LOOKS = 1e4  # what a noise-free image declares; its residual, not this, makes the intervals


def logs(values: Sequence[Any]) -> np.ndarray:
    """ln(eps_r - 1), ln h, ln l."""
    eps_r, h, length = values
    return np.log([eps_r - 1.0, h, length])


def with_rays(scene: Scene, factor: float) -> Scene:
    density = factor * scene.sampling.density_per_m2(scene.grid)
    sampling = Sampling(rays_per_m2=density, seed=scene.sampling.seed, deposit=scene.sampling.deposit)
    return replace(scene, sampling=sampling)


def clean_images(scene: Scene) -> dict[str, dict[str, np.ndarray]]:
    """beta0 by view and polarization, free of speckle, with more rays than the scene's and other ones."""
    views = simulate(with_rays(scene, RAY_FACTOR), seed=REFERENCE_SEED + scene.sampling.seed)
    return {view.name: view.beta0 for view in views}


def measured(
    scene: Scene, images: Mapping[str, Mapping[str, np.ndarray]], folder: Path, looks: float, seed: int | None = None
) -> Scene:
    """The scene with `images` as its measured ones, written into `folder`; gamma speckle of `looks` from `seed`, or
    none. Every view is one of `train`."""
    generator = None if seed is None else np.random.default_rng(seed)
    views = []
    for view in scene.views:
        path = folder / f"{view.name}.exr"
        channels = {}
        for polarization in scene.radar.polarizations:
            image = images[view.name][polarization]
            noise = 1.0 if generator is None else generator.gamma(looks, 1.0 / looks, image.shape)
            channels[polarization] = (image * noise).astype(np.float32)
        write_exr(path, channels)
        files = {polarization: path.resolve() for polarization in channels}
        views.append(view.model_copy(update={"images": files, "looks": looks, "role": "train"}))
    return replace(scene, views=views)


def changed(scene: Scene, material: str, **values: Any) -> Scene:
    """The scene with other values in one material."""
    materials = scene.materials | {material: scene.materials[material].model_copy(update=values)}
    return replace(scene, materials=materials)


def trained_on(scene: Scene, train: Collection[str], test: Collection[str] = ()) -> Scene:
    """The scene with the named views only, in these roles."""
    views = [
        view.model_copy(update={"role": "train" if view.name in train else "test"})
        for view in scene.views
        if view.name in train or view.name in test
    ]
    return replace(scene, views=views)
