"""Ground of other models: the mean of many complex images is the intensity renderer's, in every polarization."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from collected_scenes import SPOT, scene
from scipy.ndimage import binary_erosion
from test_rough_ground import SHAPE, SPACING, blurred, yard

import warpsar
from warpsar.collection.command import load_kernels
from warpsar.collection.direct import direct
from warpsar.collection.plan import plan_of
from warpsar.collection.scatterers import body_of, scatterers_of, spacing_m
from warpsar.runtime import devices

IMAGES = 60
CHANNELS = ("HH", "HV", "VV")
GROUND = {"eps_r": (9.0, -1.5), "rms_height_m": 0.003, "correlation_length_m": 0.02, "spectrum": "exponential"}
MATERIALS = {
    "grass": {**GROUND, "model": "i2em"},
    "road": {**GROUND, "model": "oh"},
    "block": {**GROUND, "model": "i2em", "spectrum": "gaussian", "rms_height_m": 0.004},
}


LAWN = """[scene]
mesh = "lawn.obj"

[radar]
frequency_hz = 9.6e9
polarizations = ["HH", "HV", "VH", "VV"]
slant_range_m = 10e3
terms = ["rough"]

[image]
shape = [64, 64]
spacing_m = [0.15, 0.15]

[collection]
mode = "spotlight"
resolution_m = [0.3, 0.3]

[materials.grass]
library = "grass"

[[views]]
name = "one"
azimuth_deg = 25.0
incidence_deg = 42.0
"""


@pytest.mark.full
def test_the_mean_is_the_intensity_renderers() -> None:
    """Region by region, to 4 standard errors and 1 %, as in test_rough_ground.py."""
    base = scene(
        yard(),
        view={"azimuth_deg": 0.0, "incidence_deg": 45.0},
        shape=SHAPE,
        spacing=SPACING,
        radar={"terms": ("rough",), "polarizations": CHANNELS, "slant_range_m": SPOT["slant_range_m"]},
        collection={"focus": "direct"},
    )
    made = replace(base, materials={name: warpsar.Material(**table) for name, table in MATERIALS.items()})
    cpu = devices.resolve_device("cpu")
    load_kernels(cpu)
    plan = plan_of(made, made.views[0], cpu)
    images = []
    for seed in range(IMAGES):
        found = scatterers_of(made, plan, body_of(made, spacing_m(plan), cpu, seed), once=True)
        images.append([direct(plan, found, CHANNELS, made.grid, cpu).images[name] for name in CHANNELS])
    mean = (np.abs(np.array(images, complex)) ** 2).mean(axis=0)
    image = warpsar.simulate(replace(made, sampling=warpsar.Sampling(rays_per_pixel=256)), device="cpu", layers=True)[0]
    cells = np.prod(plan.cells_m) / np.prod(SPACING)  # pixels in a cell
    for channel, found in zip(CHANNELS, mean, strict=True):
        expected = blurred(plan, image.beta0[channel].astype(float))
        for number, name in enumerate(MATERIALS):
            inside = binary_erosion(image.layers["material"] == number, iterations=4)
            looks = IMAGES * inside.sum() / cells
            ratio = found[inside].mean() / expected[inside].mean()
            assert looks > 300
            assert ratio == pytest.approx(1.0, abs=4.0 / np.sqrt(looks) + 0.01), (name, channel)


def test_a_scene_of_library_grass_has_a_complex_image(tmp_path: Path) -> None:
    """`library = "grass"` and nothing else: its model is i2em. HH and HV are different speckles, HV and VH are one."""
    (tmp_path / "lawn.obj").write_text("v -8 -8 0\nv 8 -8 0\nv 8 8 0\nv -8 8 0\nusemtl grass\nf 1 2 3\nf 1 3 4\n")
    (tmp_path / "scene.toml").write_text(LAWN)
    made = warpsar.Scene.load(tmp_path / "scene.toml")
    assert made.materials["grass"].model == "i2em"
    image = warpsar.slc(made, device="cpu")[0].images
    assert np.array_equal(image["HV"], image["VH"])
    middle = {name: one[16:48, 16:48].ravel() for name, one in image.items()}

    def coherence(one: str, other: str) -> float:
        norms = [np.linalg.norm(middle[name]) for name in (one, other)]
        return float(np.abs(np.vdot(middle[one], middle[other])) / np.prod(norms))

    assert coherence("HH", "VV") > 0.8
    assert coherence("HH", "HV") < 0.3  # some 256 cells: 4 / 16
