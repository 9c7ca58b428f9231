"""Each effect against its closed form, in NumPy float64, on scenes where that is known."""

import dataclasses
from typing import Any

import numpy as np
import pytest
import worlds
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from test_effects import render_of, with_effect
from worlds import box, ground, mesh_of, scene_of, view

from warpsar.effects.edge_diffraction import sharp_edges
from warpsar.render.render import ViewRender
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate

# float32 through a handful of operations
ROUNDING = 1e-5


def plane(**more: Any) -> Scene:
    """Flat soil that ends well inside an image of 40 x 48 pixels of 0.5 m."""
    more = {"shape": (40, 48), "rays_per_pixel": 16.0} | more
    return scene_of(mesh_of(soil=ground(14.0)), more.pop("views", view(20.0, 40.0)), **more)


def pair(scene: Scene, name: str, table: dict[str, Any], polarization: str = "HH") -> tuple[np.ndarray, np.ndarray]:
    """beta0 of the first view without and with an effect, float64."""
    without = simulate(scene, device="cpu")[0].beta0[polarization]
    return without.astype(float), simulate(with_effect(scene, name, table), device="cpu")[0].beta0[polarization].astype(
        float
    )


def hits_of(scene: Scene, name: str, table: dict[str, Any]) -> tuple[ViewRender, np.ndarray, np.ndarray]:
    """A render with one gain or surface effect, sigma0 of its hits without and with it."""
    render, bare = render_of(with_effect(scene, name, table)), render_of(scene)
    render.forward(), bare.forward()
    return render, bare.sigma["HH"].numpy().astype(float), render.sigma["HH"].numpy().astype(float)


# ---- image ----


def test_noise_floor_is_everywhere() -> None:
    without, with_it = pair(plane(), "noise_floor", {"level": 0.004})
    assert (without == 0).any()
    assert with_it - without == pytest.approx(0.004, rel=1e-4)


@pytest.mark.parametrize("window", ["sinc", "taylor", "gaussian"])
def test_point_spread_has_the_width_it_is_given_and_keeps_power(window: str) -> None:
    scene = plane(shape=(64, 64))
    widths = (2.6, 3.7)
    render = render_of(
        with_effect(
            scene,
            "point_spread",
            dict(zip(("range_fwhm_m", "azimuth_fwhm_m"), widths, strict=True)) | {"window": window},
        )
    )
    render.hits.weight.zero_()
    one = int(np.argmin(np.abs(render.hits.pixel.numpy() - (32 * 64 + 32))))
    weight = render.hits.weight.numpy()
    weight[one] = 1.0
    render.hits.weight.assign(weight)
    image = render.forward()["HH"].astype(float)
    row, col = divmod(int(render.hits.pixel.numpy()[one]), 64)
    power = float(render.sigma["HH"].numpy()[one])
    # Normalised over 64 pixels to each side; what lies beyond the 32 of the image is lost. Of sinc^2 that is
    # 1 / (pi^2 x) less as much at 2 x, x in units of the sidelobes.
    lost = sum(0.5 / (np.pi**2 * 32 * 0.5 * 0.8859 / width) for width in widths) if window == "sinc" else 0.0
    assert image.sum() == pytest.approx(power * (1 - lost), rel=3e-3)
    for line, width, at in ((image[:, col], widths[0], row), (image[row], widths[1], col)):
        fine = np.linspace(0, 8, 8001)
        # five samples and more over the width: a spline finds the half to 1e-3
        peak = CubicSpline(np.arange(-8, 9), line[at - 8 : at + 9])(fine)
        assert 2 * fine[np.argmax(peak < peak[0] / 2)] * 0.5 == pytest.approx(width, rel=5e-3)


def test_gaussian_point_spread_is_scipys() -> None:
    without, with_it = pair(plane(), "point_spread", {"range_fwhm_m": 1.1, "azimuth_fwhm_m": 0.7})
    deviation = [width / 0.5 / np.sqrt(8 * np.log(2)) for width in (1.1, 0.7)]
    expected = gaussian_filter1d(
        gaussian_filter1d(without, deviation[0], axis=0, mode="constant", truncate=9),
        deviation[1],
        axis=1,
        mode="constant",
        truncate=9,
    )
    assert with_it == pytest.approx(expected, rel=ROUNDING, abs=ROUNDING * without.max())


def test_azimuth_ambiguity_is_two_shifted_copies() -> None:
    without, with_it = pair(plane(), "azimuth_ambiguity", {"level": 0.1, "offset_m": 4.75})
    expected = without.copy()
    for pixels, share in ((9, 0.5), (10, 0.5)):  # 4.75 m are 9.5 pixels
        expected[:, pixels:] += 0.1 * share * without[:, :-pixels]
        expected[:, :-pixels] += 0.1 * share * without[:, pixels:]
    assert with_it == pytest.approx(expected, rel=ROUNDING, abs=1e-9)


def test_interference_is_in_its_rows_and_its_view() -> None:
    views = [view(20.0, 40.0), view(110.0, 40.0, name="other")]
    scene = with_effect(
        plane(views=views), "interference", {"level": {"other": 0.01}, "rows": {"other": [[3, 5], [7, 8]]}}
    )
    plain = simulate(plane(views=views), device="cpu")
    first, second = simulate(scene, device="cpu")
    assert np.array_equal(first.beta0["HH"], plain[0].beta0["HH"])
    added = second.beta0["HH"].astype(float) - plain[1].beta0["HH"]
    assert added[[3, 4, 7]] == pytest.approx(0.01, rel=1e-4)
    assert np.delete(added, [3, 4, 7], axis=0).max() == 0


@pytest.mark.parametrize("pivot", ["median", 0.02])
@pytest.mark.parametrize("exponent", [0.7, 1.3])
def test_saturation_about_its_pivot(exponent: float, pivot: Any) -> None:
    mesh = mesh_of(soil=ground(14.0), wall=box((-2, -2, 0), (2, 2, 3)))
    scene = scene_of(mesh, view(20.0, 40.0), shape=(41, 47), rays_per_pixel=16.0)
    without, with_it = pair(scene, "saturation", {"exponent": exponent, "pivot": pivot})
    p = np.median(without[without > 0]) if pivot == "median" else pivot
    assert with_it == pytest.approx(p * (without / p) ** exponent, rel=ROUNDING)


# ---- gain ----


def gains(scene: Scene, name: str, table: dict[str, Any]) -> tuple[np.ndarray, ViewRender]:
    """What happens to the power of each hit, from images in which one hit in ten is left."""
    render, bare = render_of(with_effect(scene, name, table)), render_of(scene)
    found = []
    for one in (render, bare):
        pixel = np.zeros(one.hits.count, np.int32)
        pixel[:] = np.arange(one.hits.count) % (one.shape[0] * one.shape[1])
        one.hits.pixel.assign(pixel)
        again = ViewRender(one.stage, one.view, one.hits, one.shape, tuple(one.images), one._effects)
        found.append(again.forward()["HH"].astype(float).ravel()[: one.hits.count])
    assert render.hits.count <= render.shape[0] * render.shape[1]
    return found[0] / found[1], render


def test_antenna_in_a_plane_wave() -> None:
    gain, render = gains(plane(), "antenna_pattern", {"beamwidth_m": 15.0, "boresight_m": 2.0})
    x = render.hits.point.numpy().astype(float) @ render.geometry.v
    assert gain == pytest.approx(np.exp(-4 * np.log(2) * (x - 2.0) ** 2 / 15.0**2) ** 2, rel=ROUNDING)
    # one way the power is half at half the width
    assert np.exp(-4 * np.log(2) * 7.5**2 / 15.0**2) == pytest.approx(0.5)


def test_antenna_in_a_strip_map() -> None:
    gain, render = gains(plane(slant_range_m=200.0), "antenna_pattern", {"beamwidth_deg": 4.0, "boresight_deg": -0.5})
    x = render.hits.point.numpy().astype(float)
    track = x - (x @ render.geometry.u)[:, None] * render.geometry.u + 200.0 * render.geometry.d
    phi = np.rad2deg(np.arctan2(track @ render.geometry.v, track @ render.geometry.d))
    assert gain == pytest.approx(np.exp(-4 * np.log(2) * (phi + 0.5) ** 2 / 16.0) ** 2, rel=ROUNDING)
    # steeper is nearer to the track's foot: larger phi at shorter horizontal distance
    assert np.corrcoef(phi, x @ render.geometry.s)[0, 1] > 0.9


def test_range_loss_in_both_kinds_of_scene() -> None:
    gain, render = gains(plane(slant_range_m=200.0), "range_loss", {"exponent": 3.0})
    x = render.hits.point.numpy().astype(float)
    across = x - (x @ render.geometry.u)[:, None] * render.geometry.u
    distance = np.linalg.norm(across + 200.0 * render.geometry.d, axis=1)
    assert gain == pytest.approx((distance / 200.0) ** -3.0, rel=ROUNDING)
    gain, render = gains(plane(), "range_loss", {"per_m": 0.05})
    assert gain == pytest.approx(
        np.exp(-0.05 * render.hits.point.numpy().astype(float) @ render.geometry.d), rel=ROUNDING
    )


def test_view_gain_in_decibels() -> None:
    scene = plane(views=[view(20.0, 40.0), view(110.0, 40.0, name="other")])
    without, with_it = pair(scene, "view_gain", {"gain_db": {"view": 3.0, "other": -3.0}})
    assert with_it == pytest.approx(10**0.3 * without, rel=ROUNDING)


# ---- position ----


def shifted(image: np.ndarray, rows: int, cols: int) -> np.ndarray:
    result = np.zeros_like(image)
    source = image[max(0, -rows) : image.shape[0] - max(0, rows), max(0, -cols) : image.shape[1] - max(0, cols)]
    result[max(0, rows) :, max(0, cols) :][: source.shape[0], : source.shape[1]] = source
    return result


def unmoved(scene: Scene, table: dict[str, Any]) -> tuple[ViewRender, np.ndarray]:
    """A render with registration, and its own hits' image at no shift."""
    render = render_of(with_effect(scene, "registration", table))
    bare = ViewRender(render.stage, render.view, render.hits, render.shape, ("HH",), [])
    return render, bare.forward()["HH"].astype(float)


def test_registration_by_whole_pixels_is_a_shift_of_the_image() -> None:
    render, before = unmoved(plane(), {"range_m": 1.5, "azimuth_m": -1.0})
    assert render.forward()["HH"] == pytest.approx(shifted(before, 3, -2), rel=ROUNDING, abs=1e-7 * before.max())


def test_registration_by_whole_fine_bins_is_exact() -> None:
    """A quarter of a pixel is one fine bin: the same as hits binned one bin farther."""
    render, _ = unmoved(plane(), {"range_m": 0.125})
    moved = render.forward()["HH"]
    grid = render.hits.grid
    render.hits.pixel.assign(render.hits.pixel.numpy() + grid.shape[1])
    render.set_parameters(render.stage.surface.nodes, {"registration": np.zeros(5)})
    assert moved == pytest.approx(render.forward()["HH"], rel=ROUNDING, abs=1e-9)


def test_registration_keeps_power_and_moves_its_centre() -> None:
    render, before = unmoved(plane(), {"range_m": 0.83, "azimuth_m": -0.61})
    after = render.forward()["HH"].astype(float)
    assert after.sum() == pytest.approx(before.sum(), rel=ROUNDING)
    for axis, metres in ((0, 0.83), (1, -0.61)):
        centres = [(np.arange(i.shape[axis]) * i.sum(axis=1 - axis)).sum() / i.sum() * 0.5 for i in (before, after)]
        # spreading over a pixel what lay in a fine bin of it leaves its mean to a small part of the bin
        assert centres[1] - centres[0] == pytest.approx(metres, abs=0.01)


def test_registration_of_the_world_is_seen_along_the_axes() -> None:
    east, up = 0.75, -0.5
    render, _ = unmoved(plane(), {"east_m": east, "up_m": up})
    world = render.forward()["HH"]
    d, u, _ = worlds.axes(20.0, 40.0)
    step = np.array([east, 0.0, up])
    render.set_parameters(render.stage.surface.nodes, {"registration": np.array([d @ step, u @ step, 0, 0, 0])})
    assert world == pytest.approx(render.forward()["HH"], rel=1e-4, abs=1e-6)


def test_registration_brings_in_what_lay_beside_the_image() -> None:
    """Flat soil larger than the image: it stays lit to the edge."""
    scene = scene_of(mesh_of(soil=ground(60.0)), view(20.0, 40.0), shape=(16, 16), rays_per_pixel=16.0)
    _, image = pair(scene, "registration", {"range_m": 2.0, "azimuth_m": 2.0})
    assert image.min() > 0.8 * image.max()


# ---- surface ----


def test_eps_gradient_is_zero_at_the_reference_point() -> None:
    scene = plane()
    render, _, with_it = hits_of(scene, "eps_gradient", {"per_m_east": 0.05, "per_m_north": -0.03})
    x = render.hits.point.numpy().astype(float)
    eps = 1 + 5.0 * np.exp(0.05 * x[:, 0] - 0.03 * x[:, 1])
    assert with_it == pytest.approx(worlds.sigma0(np.deg2rad(40.0), eps_r=eps), rel=ROUNDING)


def test_exponential_spectrum_is_a_mixture() -> None:
    _, without, with_it = hits_of(plane(), "exponential_spectrum", {"weight": 0.3})
    kl2 = (2 * worlds.WAVENUMBER * 0.010 * np.sin(np.deg2rad(40.0))) ** 2
    ratio = (2 * (1 + kl2) ** -1.5) / np.exp(-kl2 / 4)  # W_exp / W_gauss, physics.md section 0
    assert with_it / without == pytest.approx(0.7 + 0.3 * ratio, rel=ROUNDING)


def test_vegetation_is_a_water_cloud() -> None:
    _, without, with_it = hits_of(plane(), "vegetation", {"optical_depth": 0.2, "albedo": 0.1})
    cos = np.cos(np.deg2rad(40.0))
    t = np.exp(-0.4 / cos)
    assert with_it == pytest.approx(0.1 * cos * (1 - t) + t * without, rel=ROUNDING)


@pytest.mark.parametrize("polarization", ["HH", "VV", "HV"])
def test_two_scale_is_the_mean_over_tilts(polarization: str) -> None:
    """Against 40 x 40 Gauss-Hermite points; the surface's own five are good to 1e-3 at this slope."""
    scene = plane(polarizations=(polarization,))
    render = render_of(with_effect(scene, "two_scale", {"slope_variance": 0.01}))
    render.forward()
    d, u, _ = worlds.axes(20.0, 40.0)
    x, w = np.polynomial.hermite_e.hermegauss(40)
    w = w / w.sum()
    normal = np.stack(np.broadcast_arrays(0.1 * x[:, None], 0.1 * x[None, :], 1.0), axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    cosine = -normal @ d
    sigma = worlds.sigma0(
        np.arccos(np.clip(cosine, 0, 1)), polarization=polarization, cos_psi=worlds.cos_twist(normal, d, u)
    )
    expected = (w[:, None] * w[None, :] * sigma * (cosine > 0)).sum()
    assert render.sigma[polarization].numpy() == pytest.approx(expected, rel=2e-3)


def test_two_scale_to_first_order_in_the_variance() -> None:
    """(s^2 / 2) (sigma'' + cot(theta) sigma') of physics.md, in the facet's own basis, where no tilt turns it."""
    variance = 1e-3
    scene = plane(polarization_basis="local")
    _, without, with_it = hits_of(scene, "two_scale", {"slope_variance": variance})
    theta, h = np.deg2rad(40.0), 1e-3
    below, at, above = (worlds.sigma0(theta + k * h) for k in (-1, 0, 1))
    first, second = (above - below) / (2 * h), (above - 2 * at + below) / h**2
    expected = variance / 2 * (second + first / np.tan(theta))
    # next order: another factor of s^2 times a few; and float32 differences of sigma0
    assert with_it - without == pytest.approx(expected, rel=0.02)


# ---- edges ----


def test_edges_of_a_box_are_lines_where_they_lie() -> None:
    mesh = mesh_of(soil=ground(20.0), wall=box((-3, -2, 0), (3, 2, 4)))
    scene = scene_of(mesh, view(20.0, 40.0), shape=(48, 48), rays_per_pixel=16.0)
    render = render_of(with_effect(scene, "edge_diffraction", {"strength": 1.0}))
    edges = sharp_edges(render.stage.target)
    assert len(edges.start) == 12
    render.forward()
    share = render.layers["beta0_edges_HH"].numpy().astype(float).reshape(48, 48)
    # from 20 degrees east of north the radar sees the roof's four edges and the three upright ones about the north
    # and the east wall
    d, u, _ = worlds.axes(20.0, 40.0)
    roof = [((-3, -2, 4), (3, -2, 4)), ((-3, 2, 4), (3, 2, 4)), ((-3, -2, 4), (-3, 2, 4)), ((3, -2, 4), (3, 2, 4))]
    upright = [((x, y, 0), (x, y, 4)) for x, y in ((3, 2), (-3, 2), (3, -2))]
    total = 0.0
    for start, end in roof + upright:
        a, b = np.array(start, float), np.array(end, float)
        sin2 = 1 - (((b - a) @ d) / np.linalg.norm(b - a)) ** 2
        total += 1.0 / worlds.WAVENUMBER * sin2 * np.linalg.norm(b - a)
        middle = (a + b) / 2
        row, col = int(np.floor(middle @ d / 0.5)) + 24, int(np.floor(middle @ u / 0.5)) + 24
        assert share[row - 1 : row + 2, col - 1 : col + 2].max() > 0
    # pieces of a quarter of a pixel whose start is just off the ground or the roof
    assert share.sum() * 0.25 == pytest.approx(total, rel=0.02)


def test_edges_do_not_shine_through() -> None:
    """A box under a roof larger than it: only the roof is seen from above."""
    plate = worlds.plate((-6, -6, 6.0), (12, 0, 0), (0, 12, 0))
    mesh = mesh_of(soil=ground(20.0), wall=box((-1, -1, 0), (1, 1, 2)), roof=plate)
    scene = scene_of(mesh, view(20.0, 20.0), shape=(48, 48), rays_per_pixel=16.0)
    render = render_of(with_effect(scene, "edge_diffraction", {"strength": 1.0}))
    render.forward()
    assert render.layers["beta0_edges_HH"].numpy().max() == 0


def test_level_ground_has_no_edges() -> None:
    mesh = mesh_of(soil=ground(20.0, cells=4))
    render = render_of(scene_of(mesh, view(0.0, 40.0), shape=(8, 8), rays_per_pixel=4.0))
    assert len(sharp_edges(render.stage.target).start) == 0


def test_effects_work_together() -> None:
    """Gains and shifts act on further paths too; what the system does comes last."""
    mesh = mesh_of(soil=ground(18.0), wall=box((-3, -3, 0), (3, 1, 4)))
    scene = scene_of(mesh, view(0.0, 45.0), shape=(40, 40), rays_per_pixel=16.0)
    scene = with_effect(scene, "multibounce", {"strength": 1.0})
    scene = with_effect(scene, "edge_diffraction", {"strength": 1.0})
    plain = render_of(dataclasses.replace(scene, effects={**scene.effects}))
    plain.forward()
    everything = with_effect(with_effect(scene, "range_loss", {"per_m": 0.1}), "noise_floor", {"level": 0.01})
    render = render_of(everything)
    image = render.forward()["HH"].astype(float)
    rows = (np.arange(40) - 19.5) * 0.5
    for name in ("beta0_2_bounces_HH", "beta0_edges_HH"):
        before, after = (one.layers[name].numpy().astype(float).reshape(40, 40) for one in (plain, render))
        assert before.sum() > 0
        # a pixel's power lies within half a pixel of its middle: exp(0.1 * 0.25)
        expected = before * np.exp(-0.1 * rows)[:, None]
        assert after == pytest.approx(expected, rel=0.03, abs=1e-9)
    assert image.min() == pytest.approx(0.01)
