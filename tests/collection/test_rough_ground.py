"""Rough ground: the mean of many complex images is the intensity renderer's, and their statistics are speckle's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from collected_scenes import ROUGH, SPOT, scene
from scipy.ndimage import binary_erosion, convolve1d

import warpsar
from warpsar.coherent.body import CoherentBody
from warpsar.collection.command import load_kernels
from warpsar.collection.direct import direct
from warpsar.collection.plan import Plan, plan_of
from warpsar.collection.response import band_weights
from warpsar.collection.scatterers import body_of, scatterers_of, spacing_m
from warpsar.runtime import devices

IMAGES = 200
SHAPE, SPACING = (104, 120), (0.2, 0.2)
MATERIALS = {"grass": ROUGH, "road": {**ROUGH, "rms_height_m": 0.0006}, "block": {**ROUGH, "eps_r": 9.0}}


def yard() -> warpsar.Mesh:
    """Ground of two materials, 20 x 16 m, with a block 4 x 4 x 2.5 m on it that throws a shadow."""
    x, y = 10.0, 8.0
    quads = [
        [[-x, -y, 0], [0, -y, 0], [0, y, 0], [-x, y, 0]],
        [[0, -y, 0], [x, -y, 0], [x, y, 0], [0, y, 0]],
    ]
    a, b, h = (-7.0, -3.0), (-2.0, 2.0), 2.5
    low = [[a[0], b[0], 0], [a[1], b[0], 0], [a[1], b[1], 0], [a[0], b[1], 0]]
    top = [[p, q, h] for p, q, _ in low]
    quads += [top, *([low[i], low[(i + 1) % 4], top[(i + 1) % 4], top[i]] for i in range(4))]
    faces = np.concatenate([[[4 * i, 4 * i + 1, 4 * i + 2], [4 * i, 4 * i + 2, 4 * i + 3]] for i in range(len(quads))])
    material = np.repeat([0, 1, *[2] * 5], 2).astype(np.int32)
    return warpsar.Mesh(np.concatenate(quads).astype(float), faces.astype(np.int32), material, tuple(MATERIALS))


@pytest.fixture(scope="module")
def ground() -> tuple[warpsar.Scene, Plan, np.ndarray]:
    """The scene, its plan, and complex images of many draws of its surface, (images, rows, columns)."""
    mesh = yard()
    base = scene(
        mesh,
        view={"azimuth_deg": 0.0, "incidence_deg": 45.0},
        shape=SHAPE,
        spacing=SPACING,
        radar={"terms": ("rough",), "slant_range_m": SPOT["slant_range_m"]},
        collection={"focus": "direct"},
    )
    made = replace(base, materials={name: warpsar.Material(**table) for name, table in MATERIALS.items()})
    cpu = devices.resolve_device("cpu")
    load_kernels(cpu)
    plan = plan_of(made, made.views[0], cpu)
    images = []
    for seed in range(IMAGES):
        found = scatterers_of(made, plan, body_of(made, spacing_m(plan), cpu, seed), once=True)
        images.append(direct(plan, found, ("HH",), made.grid, cpu).images["HH"])
    return made, plan, np.array(images)


def blurred(plan: Plan, beta0: np.ndarray) -> np.ndarray:
    """beta0 convolved with the power of the system's response, by quadrature over each pixel."""
    weights = (band_weights(plan.windows[0], plan.frequencies), plan.azimuth_weights)
    for axis, (weight, cell, step) in enumerate(zip(weights, plan.cells_m, SPACING, strict=True)):
        place = (np.arange(len(weight)) + 0.5) / len(weight) - 0.5
        fine = np.arange(-40 * 8 - 4, 40 * 8 + 4) + 0.5  # an eighth of a pixel
        power = np.abs(np.exp(2j * np.pi * fine[:, None] / 8 * step / cell * place) @ weight) ** 2
        kernel = power.reshape(-1, 8).sum(axis=1)
        beta0 = convolve1d(beta0, kernel / kernel.sum(), axis=axis, mode="constant")
    return beta0


@pytest.mark.full
def test_the_mean_is_the_intensity_renderers(ground: tuple[warpsar.Scene, Plan, np.ndarray]) -> None:
    """Region by region, to 4 standard errors and 1 % (of the renderer's sampling, and of 0.2 m pixels over 0.5 m)."""
    made, plan, images = ground
    beta0 = warpsar.simulate(replace(made, sampling=warpsar.Sampling(rays_per_pixel=256)), device="cpu")[0]
    expected = blurred(plan, beta0.beta0["HH"].astype(float))
    mean = (np.abs(images.astype(complex)) ** 2).mean(axis=0)
    layers = warpsar.simulate(made, device="cpu", layers=True)[0].layers
    cells = np.prod(plan.cells_m) / np.prod(SPACING)  # pixels in a cell
    checked = {}
    for number, name in enumerate(made.mesh.materials):
        inside = binary_erosion(layers["material"] == number, iterations=4)
        looks = IMAGES * inside.sum() / cells
        checked[name] = looks
        ratio = mean[inside].mean() / expected[inside].mean()
        assert ratio == pytest.approx(1.0, abs=4.0 / np.sqrt(looks) + 0.01), name
    assert min(checked.values()) > 1000, checked


def test_shadow_and_border_radiate_nothing(ground: tuple[warpsar.Scene, Plan, np.ndarray]) -> None:
    """Over rows across the shadow's edge and the field's border the mean is nowhere above the blurred beta0, and
    beyond them it falls to the taper's sidelobes."""
    made, plan, images = ground
    expected = blurred(plan, warpsar.simulate(made, device="cpu")[0].beta0["HH"].astype(float))
    mean = (np.abs(images.astype(complex)) ** 2).mean(axis=0)
    level = np.median(expected[expected > 0.5 * np.median(expected[expected > 0])])
    dark = binary_erosion(expected < 3e-3 * level, iterations=3)
    assert dark.sum() > 500
    assert mean[dark].mean() < 5e-3 * level
    # Pixels of 200 looks scatter by 7 %; where the ground ends they must not stand out.
    lit = expected > 0.1 * level
    edge = lit & ~binary_erosion(lit, iterations=4)
    excess = mean[edge].mean() / expected[edge].mean()
    looks = IMAGES * edge.sum() * np.prod(SPACING) / np.prod(plan.cells_m)
    assert excess == pytest.approx(1.0, abs=4.0 / np.sqrt(looks) + 0.03)  # half a pixel of the edge's place: 3 %


def test_statistics_are_speckles(ground: tuple[warpsar.Scene, Plan, np.ndarray]) -> None:
    """Power is exponential, E[P^2] = 2 E[P]^2 and E[P^3] = 6 E[P]^3; phase is circular; draws are independent."""
    made, _, images = ground
    layers = warpsar.simulate(made, device="cpu", layers=True)[0].layers
    inside = binary_erosion(layers["material"] == 1, iterations=5)
    some = images[:, inside][:, ::9].astype(complex)
    power = np.abs(some) ** 2 / (np.abs(some) ** 2).mean()
    n = power.size
    assert (power**2).mean() == pytest.approx(2.0, abs=4 * np.sqrt(20.0 / n) * 3)  # var(P^2) = 20; pixels 1/3 free
    assert (power**3).mean() == pytest.approx(6.0, abs=4 * np.sqrt(684.0 / n) * 3)
    assert np.abs((some**2).mean()) / (np.abs(some) ** 2).mean() < 4 * np.sqrt(2.0 / n) * 3
    phase = np.angle(some)
    assert np.abs(np.exp(1j * phase).mean()) < 4 / np.sqrt(n) * 3
    assert np.abs((some[0] * some[1].conj()).sum()) / np.sqrt((np.abs(some[:2]) ** 2).sum(axis=1).prod()) < 0.5


def test_a_trihedral_does_not_speckle() -> None:
    """On it power and phase hardly change from surface to surface."""
    from collected_scenes import square_trihedral

    corner, side = square_trihedral(0.4), 6.0
    flat = np.array([[-side, -side, 0], [side, -side, 0], [side, side, 0], [-side, side, 0]]) - [0, 0, 0.01]
    mesh = warpsar.Mesh(
        np.concatenate([corner.vertices, flat]),
        np.concatenate([corner.faces, [[12, 13, 14], [12, 14, 15]]]).astype(np.int32),
        np.repeat([0, 1], [6, 2]).astype(np.int32),
        ("corner", "ground"),
    )
    base = scene(
        warpsar.Mesh.of(corner.vertices, corner.faces),
        view={"azimuth_deg": 45.0, "incidence_deg": 55.0},
        shape=(33, 33),
        spacing=(0.2, 0.2),
        collection={"focus": "direct"},
    )
    materials = {"corner": warpsar.Material(conductor=True), "ground": warpsar.Material(**ROUGH)}
    made = replace(base, mesh=mesh, materials=materials)
    values = []
    for seed in range(6):
        image = warpsar.slc(made, device="cpu", seed=seed)[0].images["HH"]
        values.append(image[np.unravel_index(np.abs(image).argmax(), image.shape)])
    power = np.abs(values) ** 2
    assert power.std() / power.mean() < 0.1
    assert np.ptp(np.angle(np.array(values) / values[0])) < 0.1


def test_a_body_for_rough_terms_alone_sends_back_the_same(ground: tuple[warpsar.Scene, Plan, np.ndarray]) -> None:
    """Surfaces, regions and wedges, which it does not work out, have no part in what rough faces send back."""
    made, plan, _ = ground
    cpu = devices.resolve_device("cpu")
    assert made.radar.terms == ("rough",)
    whole = CoherentBody.of(made, cpu, spacing_m=spacing_m(plan), seed=0)
    assert whole.shape.wedges.start.size > 0
    bodies = (body_of(made, spacing_m(plan), cpu, 0), whole)
    (one,), (other,) = (scatterers_of(made, plan, body, once=True).parts for body in bodies)
    assert np.array_equal(one.point, other.point)
    assert np.array_equal(one.amplitude, other.amplitude)
