"""The mean power of complex images is the image of power, where surfaces mirror and scatter.

`benchmarks/engines_agree.py` holds ten scenes against each other, cell by cell; here are totals, and one closed form.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
from effect_worlds import with_effect
from worlds import box, ground, mesh_of, plate

import warpsar
from warpsar.world.collection import Collection
from warpsar.world.frame import view_geometry

METAL = {"eps_r": (1e6, -1e6), "rms_height_m": 1e-6, "correlation_length_m": 0.1}
BLUR = {"range_fwhm_m": 0.5, "azimuth_fwhm_m": 0.5, "window": "taylor"}


def scene(mesh: warpsar.Mesh, materials: dict[str, dict[str, Any]], azimuth_deg: float, **radar: Any) -> warpsar.Scene:
    """For complex images, from so far away that no power falls with the distance over the scene."""
    return warpsar.Scene(
        mesh=mesh,
        radar=warpsar.Radar(**{"frequency_hz": 2.4e9, "polarizations": ("HH", "HV", "VV"), **radar}),
        grid=warpsar.Grid(shape=(80, 80), spacing_m=(0.2, 0.2)),
        materials={name: warpsar.Material(**materials[name]) for name in mesh.materials},
        views=[warpsar.View(name="look", azimuth_deg=azimuth_deg, incidence_deg=45.0)],
        collection=Collection(focus="direct", slant_range_m=1e6, scatterers_per_cell=4.0),
        effects={},
    )


def both(made: warpsar.Scene, draws: int) -> tuple[dict[str, float], dict[str, float]]:
    """Sums over the image [m2]: of the mean power of complex images, and of the image of power."""
    made = with_effect(made, "point_spread", BLUR)
    pixel = float(np.prod(made.grid.spacing_m))
    power = replace(with_effect(made, "multibounce", {"strength": 1.0}), collection=None)
    expected = warpsar.simulate(power, device="cpu")[0].beta0
    images = [warpsar.slc(made, device="cpu", seed=seed)[0].images for seed in range(draws)]
    found = {
        name: pixel * float(np.mean([(np.abs(one[name].astype(complex)) ** 2).sum() for one in images]))
        for name in expected
    }
    return found, {name: pixel * float(image.astype(float).sum()) for name, image in expected.items()}


@pytest.mark.parametrize("azimuth_deg", [pytest.param(0.0, marks=pytest.mark.full), 25.0])
def test_totals_of_a_block_on_rough_ground(azimuth_deg: float) -> None:
    """In its flash, and far off it: within 0.5 dB, as 6 draws tell to 0.1 dB."""
    mesh = mesh_of(soil=ground(10.0), brick=box((-2.0, -1.5, 0.0), (2.0, 1.5, 2.0)))
    soil = {"eps_r": 6.0, "rms_height_m": 0.006, "correlation_length_m": 0.05}
    brick = {"eps_r": 8.0, "rms_height_m": 0.001, "correlation_length_m": 0.05}
    found, expected = both(scene(mesh, {"soil": soil, "brick": brick}, azimuth_deg), 6)
    for name, level in expected.items():
        if level > 0.01 * max(expected.values()):
            assert 10.0 * np.log10(found[name] / level) == pytest.approx(0.0, abs=0.5), name


@pytest.mark.full
def test_a_wall_mirrors_very_rough_ground() -> None:
    """Geometric optics: there and back add up as fields, 4 |R|^2 / 2 m^2 of L h tan(theta) of ground, in HH.

    In the wall's mirror direction the facets that answer lie level. A metal wall and metal ground: |R| is 1. The
    coherent share is exp(-4 k^2 h^2 cos^2), below 1e-12, and such slopes send nothing back at once. All power lies in
    the 19 cells of the wall's foot: 24 draws of them have a standard error of 0.2 dB.
    """
    length, height, h, l = 8.0, 0.8, 0.08, 0.6  # noqa: E741
    mesh = mesh_of(
        wall=plate((-4, 0, 0), (length, 0, 0), (0, 0, height)), floor=plate((-5, 0, 0), (10, 0, 0), (0, 1.2, 0))
    )
    rough = {**METAL, "rms_height_m": h, "correlation_length_m": l}
    made = scene(mesh, {"wall": METAL, "floor": rough}, 0.0, polarizations=("HH",))
    assert (4.0 * np.pi * made.radar.frequency_hz / 299792458.0 * h) ** 2 * 0.5 > 27.0
    area = length * height  # of ground that the wall shows, at 45 degrees
    expected = 4.0 * area / (2.0 * 2.0 * h**2 / l**2)
    found, _ = both(made, 24)
    assert 10.0 * np.log10(found["HH"] / expected) == pytest.approx(0.0, abs=0.5)


def test_what_scatters_a_bounce_belongs_to_places() -> None:
    """Two views nearly alike see nearly the same numbers; another seed sees others."""
    mesh = mesh_of(wall=plate((-4, 0, 0), (8, 0, 0), (0, 0, 2)), floor=plate((-5, 0, 0), (10, 0, 0), (0, 3, 0)))
    rough = {**METAL, "rms_height_m": 0.08, "correlation_length_m": 0.6}
    one, near = (
        with_effect(scene(mesh, {"wall": METAL, "floor": rough}, angle, polarizations=("HH",)), "point_spread", BLUR)
        for angle in (0.0, 0.02)
    )
    images = [
        warpsar.slc(made, device="cpu", seed=seed)[0].images["HH"].astype(complex)
        for made, seed in ((one, 1), (near, 1), (one, 2))
    ]
    lit = np.abs(images[0]) > 0.1 * np.abs(images[0]).max()

    def coherence(other: np.ndarray) -> float:
        a, b = images[0][lit], other[lit]
        return float(np.abs((a * b.conj()).sum()) / np.sqrt((np.abs(a) ** 2).sum() * (np.abs(b) ** 2).sum()))

    assert coherence(images[1]) > 0.95
    assert coherence(images[2]) < 0.6


@pytest.mark.full
def test_the_ends_of_a_corner_off_its_flash() -> None:
    """A dihedral of 2.4 m, 5 degrees off its flash: both engines have its two ends, with one total. Complex images have
    them at the foot's ends, to a pixel of 1/16 m; images of power to 0.1 m, where a cell is 0.5 m."""
    wall, floor = plate((-1.2, -1.0, 0.0), (2.4, 0.0, 0.0), (0.0, 0.0, 2.0)), plate((-4, -1, 0), (8, 0, 0), (0, 6, 0))
    mesh = mesh_of(metal=wall, floor=floor)
    made = scene(mesh, {"metal": METAL, "floor": METAL}, 5.0, frequency_hz=5.2e9, polarizations=("VV",))
    made = replace(made, grid=warpsar.Grid(shape=(192, 192), spacing_m=(0.0625, 0.0625)))
    made = replace(made, radar=made.radar.model_copy(update={"terms": ("multibounce",)}))
    made = with_effect(made, "point_spread", BLUR)
    field = warpsar.slc(made, device="cpu", seed=0)[0].images["VV"].astype(complex)
    power = replace(with_effect(made, "multibounce", {"strength": 1.0}), collection=None)
    geometry = view_geometry(5.0, 45.0, 5.2e9)
    feet = np.array([[-1.2, -1.0, 0.0], [1.2, -1.0, 0.0]])
    ends = sorted(feet @ geometry.u)
    totals, inward = [], []
    for image in (np.abs(field) ** 2, warpsar.simulate(power, device="cpu")[0].beta0["VV"].astype(float)):
        across = image.max(axis=0)
        peaks = [int(across[:96].argmax()), 96 + int(across[96:].argmax())]
        at = [(column + 0.5 - 96) * 0.0625 for column in peaks]
        inward.append([at[0] - ends[0], ends[1] - at[1]])
        totals.append(image.sum())
    print("farther in [m]:", np.round(inward, 2).tolist())
    assert 10.0 * np.log10(totals[0] / totals[1]) == pytest.approx(0.0, abs=0.3)
    assert inward[0] == pytest.approx([0.0, 0.0], abs=0.1)
    assert inward[1] == pytest.approx([0.0, 0.0], abs=0.1)


@pytest.mark.full
def test_two_rocks_and_the_way_between_them() -> None:
    """Two lumpy bodies of metal, 10 m apart, without ground: the one way over both has 15 dBsm in complex images, by
    the sweep, which cuts tubes until they are narrow, and in an image of power, which halves them. The sweep with 10
    and with 40 rays per wavelength differs by 0.02 dB; one view of an aperture by half a decibel, as the lobe bends
    over it. An image of power without spread tubes lacked 27 dB.
    """
    parts = []
    for number, x in ((3, 5.0), (4, -5.0)):
        ball = trimesh.creation.icosphere(subdivisions=5)
        lumps = np.prod(1.0 + 0.2 * np.sin(3.0 * ball.vertices + number), axis=1, keepdims=True)
        parts.append((ball.vertices * lumps * (1.5, 1.2, 1.0) + (x, 5.0, 0.6), ball.faces))
    made = scene(mesh_of(one=parts[0], other=parts[1]), {"one": METAL, "other": METAL}, 24.51, frequency_hz=3.078e9)
    made = replace(made, radar=made.radar.model_copy(update={"terms": ("multibounce",), "max_bounces": 2}))
    made = with_effect(made, "point_spread", BLUR | {"range_fwhm_m": 1.0, "azimuth_fwhm_m": 1.0})
    field = warpsar.slc(made, device="cpu")[0].images["VV"].astype(complex)
    image = (np.abs(field) ** 2).sum() * np.prod(made.grid.spacing_m)
    swept = warpsar.rcs(made, [24.51], [45.0], device="cpu", rays_per_wavelength=10.0).amplitude_m[..., -1]
    power = replace(with_effect(made, "multibounce", {"strength": 1.0}), collection=None)
    layer = warpsar.simulate(power, device="cpu", layers=True)[0].layers["beta0_2_bounces_VV"].astype(float)
    found, expected, spread = (
        10.0 * np.log10(one)
        for one in (image, 4.0 * np.pi * abs(swept.item()) ** 2, layer.sum() * np.prod(made.grid.spacing_m))
    )
    print(f"complex {found:.1f}, sweep {expected:.1f}, image of power {spread:.1f} dBsm")
    assert found == pytest.approx(expected, abs=1.0)
    assert spread == pytest.approx(expected, abs=1.0)


@pytest.mark.full
def test_rough_rocks_alone_have_their_level() -> None:
    """Rough faces of a lumpy body of stone, without bounces. Some cells of its highlight hold most of the power, so the
    mean of 40 draws is known to 0.2 dB."""
    ball = trimesh.creation.icosphere(subdivisions=5)
    lumps = np.prod(1.0 + 0.2 * np.sin(3.0 * ball.vertices + 3.0), axis=1, keepdims=True)
    stone = {"eps_r": 7.0, "rms_height_m": 0.002, "correlation_length_m": 0.016}
    mesh = mesh_of(rock=(3.0 * ball.vertices * lumps, ball.faces))
    made = scene(mesh, {"rock": stone}, 20.0, frequency_hz=9.6e9, terms=("rough",))
    made = replace(made, grid=warpsar.Grid(shape=(120, 120), spacing_m=(0.1, 0.1)))
    made = with_effect(made, "point_spread", BLUR | {"range_fwhm_m": 0.25, "azimuth_fwhm_m": 0.25})
    images = [warpsar.slc(made, device="cpu", seed=seed)[0].images["VV"].astype(complex) for seed in range(40)]
    found = np.array([(np.abs(image) ** 2).sum() for image in images])
    expected = warpsar.simulate(replace(made, collection=None), device="cpu")[0].beta0["VV"].astype(float).sum()
    ratio = 10.0 * np.log10(found.mean() / expected)
    print(f"{ratio:+.2f} dB, error {4.34 * found.std() / found.mean() / np.sqrt(len(found)):.2f} dB")
    assert ratio == pytest.approx(0.0, abs=0.4)
