"""`warpsar.simulate`: from a scene to images, their variance and their layers."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_worlds import with_effect, working
from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, sigma0, view

import warpsar
from warpsar.errors import DeviceError
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import view_seed


def town(*views: Any, **options: Any) -> Scene:
    mesh = mesh_of(soil=ground(26, cells=3), brick=box((-4, -3, 0), (5, 2, 6)))
    options = {"materials": {"brick": BRICK}, **options}
    return scene_of(mesh, list(views) or view(25, 40), **options)


def test_image_of_a_view() -> None:
    """Shapes, axes and names; every view and polarization is there, in order."""
    scene = town(view(0, 30, name="north"), view(90, 50, name="east"), polarizations=("VV", "HV"), shape=(30, 44))
    north, east = warpsar.simulate(scene, device="cpu")
    assert (north.name, east.name) == ("north", "east")
    for image in (north, east):
        assert list(image.beta0) == ["VV", "HV"]
        for beta0 in image.beta0.values():
            assert (beta0.shape, beta0.dtype) == ((30, 44), np.float32)
        np.testing.assert_allclose(image.range_m, (np.arange(30) + 0.5 - 15) * 0.5)
        np.testing.assert_allclose(image.azimuth_m, (np.arange(44) + 0.5 - 22) * 0.5)
        assert image.rays > image.hits > 0
        assert not image.layers
        assert not image.sampling_variance


def test_a_view_does_not_depend_on_its_neighbours() -> None:
    """Nor does a polarization on the others; a view's own place sets its jitter."""
    north, east = view(0, 30, name="north"), view(90, 50, name="east")
    alone = warpsar.simulate(town(north), device="cpu")[0].beta0["HH"]
    first, _ = warpsar.simulate(town(north, east, polarizations=("HH", "VV")), device="cpu")
    np.testing.assert_array_equal(first.beta0["HH"], alone)


def test_seeds_of_views_differ() -> None:
    seeds = {view_seed(scene, index) for scene in range(20) for index in range(200)}
    assert len(seeds) == 20 * 200
    assert max(view_seed(2**31 - 1, index) for index in range(200)) < 2**31


def test_seed_of_the_scene() -> None:
    """`[sampling] seed` is the default, and the argument stands before it."""
    stated = town(sampling={"seed": 5})
    for scene, options in ((stated, {}), (town(), {"seed": 5})):
        image = warpsar.simulate(scene, device="cpu", **options)[0].beta0["HH"]
        np.testing.assert_array_equal(image, warpsar.simulate(stated, device="cpu")[0].beta0["HH"])
    assert (warpsar.simulate(town(), device="cpu")[0].beta0["HH"] != image).any()


def test_default_sampling_density() -> None:
    """64 rays to a pixel's area across the look direction; `rays_per_m2` says the same in other words."""
    per_area = town(rays_per_pixel=64.0)
    assert per_area.sampling.density_per_m2(per_area.grid) == 256
    assert town(sampling={"rays_per_m2": 256.0}, rays_per_pixel=None).sampling.density_per_m2(per_area.grid) == 256
    assert town(rays_per_pixel=None).sampling.density_per_m2(per_area.grid) == 256


@pytest.mark.parametrize("deposit", ["nearest", "footprint"])
def test_sampling_variance(deposit: str) -> None:
    """On average over the pixels it is the variance over many seeds; none inside of a facet with footprints."""
    scene = town(rays_per_pixel=16.0, sampling={"deposit": deposit})
    one = warpsar.simulate(scene, device="cpu", variance=True)[0]
    many = np.stack([warpsar.simulate(scene, device="cpu", seed=s)[0].beta0["HH"] for s in range(100, 130)])
    expected = many.var(axis=0, ddof=1)
    # a variance from two samples has the relative spread sqrt(2): over 1600 pixels, many of them alike, 10 %
    assert one.sampling_variance["HH"].mean() == pytest.approx(expected.mean(), rel=0.4)
    assert one.sampling_variance["HH"].shape == one.beta0["HH"].shape
    np.testing.assert_array_equal(one.beta0["HH"], warpsar.simulate(scene, device="cpu")[0].beta0["HH"])
    flat = scene_of(mesh_of(soil=ground(60)), view(0, 40), sampling={"deposit": deposit})
    image = warpsar.simulate(flat, device="cpu", variance=True)[0]
    relative = np.sqrt(image.sampling_variance["HH"].mean()) / image.beta0["HH"].mean()
    assert relative < 1e-5 if deposit == "footprint" else 0.005 < relative < 0.05


def test_layers_of_a_strip_map() -> None:
    """Incidence grows along range as the track's height over the slant range says."""
    scene = scene_of(mesh_of(soil=ground(60)), view(0, 40), slant_range_m=100.0)
    image = warpsar.simulate(scene, device="cpu", layers=True)[0]
    expected = np.rad2deg(np.arccos(100 * np.cos(np.deg2rad(40)) / (100 + image.range_m)))
    # a row is 0.4 degrees; its strata lie evenly in it to a fiftieth
    np.testing.assert_allclose(image.layers["incidence_deg"][2:-2, 20], expected[2:-2], atol=0.01)
    assert (image.layers["shadow"] == 0).all()
    np.testing.assert_allclose(image.layers["layover"], 1, rtol=1e-5)
    assert {layer.dtype for layer in image.layers.values()} == {np.dtype(np.float32)}


def test_shadow_is_only_where_something_is_hidden() -> None:
    """Beside the mesh there is nothing, and that is no shadow."""
    scene = scene_of(mesh_of(soil=ground(6)), view(0, 40))
    image = warpsar.simulate(scene, device="cpu", layers=True)[0]
    assert (image.beta0["HH"] == 0).any()
    assert not image.layers["shadow"].any()
    assert (image.layers["material"][image.beta0["HH"] == 0] == -1).all()


@pytest.mark.full
def test_layers_have_the_images_shape_with_effects() -> None:
    """Also where effects want finer or wider bins than the image's."""
    scene = town(view(25, 40, name="v0"), view(115, 40, name="v1"))
    plain = warpsar.simulate(scene, device="cpu", layers=True)[0]
    for name, table, radar in working():
        if radar:  # not in a plane wave
            continue
        image = warpsar.simulate(with_effect(scene, name, table), device="cpu", layers=True)[0]
        assert (image.beta0["HH"] != plain.beta0["HH"]).any(), name
        for key, layer in plain.layers.items():
            # the geometry's, whatever the effects do to the image
            np.testing.assert_array_equal(image.layers[key], layer, err_msg=f"{name}: {key}")


@pytest.mark.parametrize("variant", ["standard", "as_printed"])
def test_variant(variant: str) -> None:
    """The paper's own constants are 2 pi below the derived ones in HH."""
    theta = np.deg2rad(40)
    image = warpsar.simulate(scene_of(mesh_of(soil=ground(60)), view(0, 40), variant=variant), device="cpu")[0]
    expected = sigma0(theta) / np.sin(theta) / (1 if variant == "standard" else 2 * np.pi)
    np.testing.assert_allclose(image.beta0["HH"], expected, rtol=1e-4)


def test_every_material_has_its_own_spectrum_and_loss() -> None:
    """A lossy, exponential material beside a plain one: each half of a plate in closed form."""
    theta, k = np.deg2rad(40), 2 * np.pi * 9.6e9 / 299792458
    vertices, faces = ground(60, cells=2)
    west_half = vertices[faces].mean(axis=1)[:, 0] < 0
    mesh = mesh_of(soil=(vertices, faces[west_half]), mud=(vertices, faces[~west_half]))
    mud = {**SOIL, "eps_r": [15.0, -3.0], "spectrum": "exponential"}
    image = warpsar.simulate(scene_of(mesh, view(0, 40), materials={"mud": mud}), device="cpu")[0].beta0["HH"]
    np.testing.assert_allclose(image[:, :20], sigma0(theta) / np.sin(theta), rtol=1e-4)
    eps = 15 - 3j
    q = np.sqrt(eps - np.sin(theta) ** 2)
    a = (np.cos(theta) - q) / (np.cos(theta) + q)
    kh, kl = k * SOIL["rms_height_m"], k * SOIL["correlation_length_m"]
    expected = 8 * kh**2 * kl**2 * np.cos(theta) ** 4 * abs(a) ** 2 * (1 + 4 * kl**2 * np.sin(theta) ** 2) ** -1.5
    np.testing.assert_allclose(image[:, 20:], expected / np.sin(theta), rtol=1e-4)


def test_symmetric_world_gives_symmetric_images() -> None:
    """A mirrored world is a mirrored image, but for the jitter: nothing is preferred."""
    scene = scene_of(
        mesh_of(soil=ground(26), brick=box((-3, -3, 0), (3, 3, 4))),
        view(0, 40),
        materials={"brick": BRICK},
        rays_per_pixel=1024,
    )
    image = warpsar.simulate(scene, device="cpu")[0].beta0["HH"]
    scale = np.sqrt((image**2).mean())
    assert np.sqrt(((image - image[:, ::-1]) ** 2).mean()) < 0.01 * scale
    around = [
        warpsar.simulate(
            scene_of(scene.mesh, view(a, 40), materials={"brick": BRICK}, rays_per_pixel=1024), device="cpu"
        )[0]
        for a in (90, 180, 270)
    ]
    for other in around:
        assert np.sqrt(((other.beta0["HH"] - image) ** 2).mean()) < 0.01 * scale


def test_a_device_that_is_not_there() -> None:
    with pytest.raises(DeviceError, match="there is no such device here"):
        warpsar.simulate(town(), device="cuda:99")


def test_public_interface(tmp_path: Path) -> None:
    """As the package's own docstring shows it."""
    (tmp_path / "scene.obj").write_text("v -9 -9 0\nv 9 -9 0\nv 9 9 0\nv -9 9 0\nf 1 2 3 4\n")
    (tmp_path / "scene.toml").write_text(
        '[scene]\nmesh = "scene.obj"\n[radar]\nfrequency_hz = 9.6e9\npolarizations = ["HH"]\n'
        "[image]\nshape = [8, 8]\nspacing_m = [0.5, 0.5]\n"
        "[materials.default]\neps_r = 6.0\nrms_height_m = 0.0012\ncorrelation_length_m = 0.01\n"
        '[[views]]\nname = "only"\nazimuth_deg = 10.0\ndepression_deg = 50.0\n'
    )
    scene = warpsar.Scene.load(tmp_path / "scene.toml")
    (image,) = warpsar.simulate(scene, device="cpu")
    theta = np.deg2rad(40)
    np.testing.assert_allclose(image.beta0["HH"], sigma0(theta) / np.sin(theta), rtol=1e-4)
