"""HV of I2EM where a surface varies: the spline against the integral, its slopes, its ends, and images of fields."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scattering_reference as reference
import warp as wp
from test_crossed_table import SOIL
from test_scattering_models import values
from worlds import WAVENUMBER, ground, join, plate, scene_of, view

from warpsar import Mesh, Scene, renderer
from warpsar.kernels import crossed_spline
from warpsar.kernels.codes import Spectrum
from warpsar.kernels.lane_kernels import LANES, at_once
from warpsar.kernels.shade import HitSurfaces
from warpsar.render.ways import i2em
from warpsar.render.ways.i2em import spline, table
from warpsar.runtime import launches
from warpsar.runtime.structs import fill

SPECTRA = ["gaussian", "exponential"]
LOSS = {"gaussian": 0.3, "exponential": 2.0}


def surfaces(spectrum: str, n: int) -> dict[str, np.ndarray]:
    """Inside the domain: kh < 3, h / l < 0.4, and kl < 4 for a gaussian."""
    random = np.random.default_rng(3)
    kl = np.exp(random.uniform(math.log(0.15), math.log(4.0 if spectrum == "gaussian" else 60.0), n))
    return {
        "theta": np.radians(random.uniform(1.0, 80.0, n)),
        "eps": np.exp(random.uniform(math.log(2.0), math.log(80.0), n)) - 1j * LOSS[spectrum],
        "kh": np.minimum(kl * np.exp(random.uniform(math.log(0.02), math.log(0.4), n)), 3.0),
        "kl": kl,
    }


def coordinates(eps: np.ndarray, kh: np.ndarray, kl: np.ndarray) -> np.ndarray:
    logarithms = np.log(eps.real - 1), np.log(np.asarray(kh) / WAVENUMBER), np.log(np.asarray(kl) / WAVENUMBER)
    return np.stack([*np.broadcast_arrays(*logarithms), np.full(eps.shape, -50.0)], axis=1)


def read(
    spectrum: str, theta: np.ndarray, zeta: np.ndarray, cos_psi: float = 1.0, *, lanes: bool = True,
    device: str = "cpu", with_slopes: bool = True,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """sigma0 of HV and its slopes to the learned coordinates, (n,) and (n, 4), from the second row of a table."""
    n, code = len(theta), int(Spectrum[spectrum.upper()])

    def put(values: Any, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(values), dtype=dtype, device=device)

    coefficients = table(((1 - code, 1.0), (code, LOSS[spectrum])), wp.get_device(device))
    sigma, slopes = put(np.zeros(n, np.float32), float), put(np.zeros((n, 4), np.float32), wp.vec4)
    surfaces = fill(
        HitSurfaces,
        wavenumber=WAVENUMBER,
        face=put(np.zeros(n, np.int32), int),
        face_material=put(np.zeros(1, np.int32), int),
        cos_incidence=put(np.cos(theta).astype(np.float32), float),
        cos_twist=put(np.full(n, cos_psi, np.float32), float),
        spectrum=put(np.array([code], np.int32), int),
        eps_im=put(np.array([LOSS[spectrum]], np.float32), float),
    )
    inputs = [
        put(np.arange(n, dtype=np.int32), int),
        surfaces,
        put(zeta.astype(np.float32), wp.vec4),
        put(np.ones(1, np.int32), int),
        coefficients,
    ]
    out = [sigma, slopes if with_slopes else wp.empty(0, dtype=wp.vec4, device=device)]
    kernel = crossed_spline.scatter_kernel(with_slopes, beyond=lanes)
    kernel, block = (at_once(kernel), LANES) if lanes else (kernel, 1)
    wp.launch(kernel, -(-n // block), inputs=inputs, outputs=out, device=device)
    if not lanes:
        wp.launch(crossed_spline.beyond_kernel, n, inputs=inputs[:-2], outputs=out, device=device)
    return sigma.numpy().astype(float), slopes.numpy().astype(float)


def test_a_spline_has_its_values_and_is_exact_for_parabolas() -> None:
    random = np.random.default_rng(0).random((9, 3))
    found = spline(random)
    np.testing.assert_allclose((found[:-2] + 6 * found[1:-1] + found[2:]) / 8, random, rtol=1e-12)
    at = np.arange(-1.0, 10.0)  # of the coefficients; x^2 over a spline's piece is its middle's, and 1 / 4 off at both
    np.testing.assert_allclose(spline(np.arange(9.0) ** 2), at**2 - 0.25, atol=1e-12)


@pytest.mark.full
@pytest.mark.parametrize("spectrum", SPECTRA)
def test_level_ground_has_the_integral(spectrum: str) -> None:
    """The same sixteen rings and five spokes, in NumPy: what is left is the interpolation."""
    s = surfaces(spectrum, 400)
    for theta, most in ((s["theta"], 0.03), (np.radians(np.linspace(80.0, 89.0, 400)), 0.06)):
        found = read(spectrum, theta, coordinates(s["eps"], s["kh"], s["kl"]))[0]
        rows = zip(theta, s["eps"], s["kh"], s["kl"], strict=True)
        expected = [reference.i2em_hv(*row, spectrum, rings=16, spokes=5) for row in rows]
        np.testing.assert_allclose(10 * np.log10(found / expected), 0.0, atol=most)


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_a_turned_facet_has_the_models_values_and_slopes(spectrum: str) -> None:
    """Against `modelled`, whose series end at 1e-4 of their distributions: 0.03 dB, and 10 % in slopes."""
    s = surfaces(spectrum, 400)
    found, slopes = read(spectrum, s["theta"], coordinates(s["eps"], s["kh"], s["kl"]), 0.8)
    expected = values("i2em", "HV", spectrum, s["theta"], s["eps"], s["kh"], s["kl"], 0.8)
    np.testing.assert_allclose(10 * np.log10(found / expected[:, 0]), 0.0, atol=0.03)
    np.testing.assert_allclose(slopes / found[:, None], expected[:, 1:] / expected[:, :1], atol=0.1)


@pytest.mark.parametrize("cos_psi", [1.0, 0.8])
@pytest.mark.parametrize("spectrum", SPECTRA)
def test_slopes_are_those_of_differences(spectrum: str, cos_psi: float) -> None:
    """Of the spline's own values."""
    s, step = surfaces(spectrum, 200), 2e-3
    zeta = coordinates(s["eps"], s["kh"], s["kl"])
    found, slopes = read(spectrum, s["theta"], zeta, cos_psi)
    for k, unit in enumerate(np.eye(4)[:3]):
        more, less = (read(spectrum, s["theta"], zeta + sign * step * unit, cos_psi)[0] for sign in (1, -1))
        # float32 logarithms, 1e-6 over the step, and a spline's curvature jumps at its nodes
        np.testing.assert_allclose(slopes[:, k] / found, np.log(more / less) / (2 * step), atol=4e-3)
    assert not slopes[:, 3].any()


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_beyond_its_ends(spectrum: str) -> None:
    """Below the least kh double scattering grows with h^4; beyond every other end a hit has the integral itself."""
    theta = np.radians([20.0, 40.0, 60.0])
    eps = np.full(3, 9.0 - 1j * LOSS[spectrum])
    smooth, slopes = read(spectrum, theta, coordinates(eps, 1e-4, 1.0))
    expected = values("i2em", "HV", spectrum, theta, eps, 1e-4, 1.0)[:, 0]
    np.testing.assert_allclose(10 * np.log10(smooth / expected), 0.0, atol=0.02)
    np.testing.assert_allclose(slopes[:, 1] / smooth, 4.0, rtol=1e-5)
    far = 10.0 if spectrum == "gaussian" else 250.0
    for one, kh, kl in ((9.0, 6.0, 5.0), (9.0, 0.01, 0.02), (9.0, 3.0, far), (1.05, 0.5, 2.0), (200.0, 0.5, 2.0)):
        eps = np.full(3, one - 1j * LOSS[spectrum])
        found, slopes = read(spectrum, theta, coordinates(eps, kh, kl))
        expected = values("i2em", "HV", spectrum, theta, eps, kh, kl)
        np.testing.assert_allclose(found, expected[:, 0], rtol=2e-4)  # float32 beside float64
        np.testing.assert_allclose(slopes, expected[:, 1:], rtol=1e-3, atol=2e-4 * expected[:, 0].max())


def everywhere(spectrum: str) -> tuple[np.ndarray, np.ndarray]:
    """Incidences from 0 to 90 degrees, and coordinates in the table and beyond every end of it."""
    random = np.random.default_rng(1)
    zeta = random.uniform((-3.0, -7.0, -4.0, 0.0), (6.0, 2.0, 3.0, 0.0), (500, 4))
    return np.radians(np.linspace(0.0, 90.0, 500)), zeta - [0.0, math.log(WAVENUMBER), math.log(WAVENUMBER), 50.0]


@pytest.mark.parametrize("spectrum", SPECTRA)
def test_lanes_are_hits_one_by_one(spectrum: str) -> None:
    theta, zeta = everywhere(spectrum)
    (many, slopes), (one, expected) = (read(spectrum, theta, zeta, 0.8, lanes=lanes) for lanes in (True, False))
    assert np.isfinite(many).all()
    assert np.isfinite(slopes).all()
    # the lanes' exponential is within 2e-7; the integral's many terms add up
    some = one > 1e-30
    np.testing.assert_allclose(many, one, rtol=1e-4, atol=1e-30)
    np.testing.assert_allclose(slopes[some].T / many[some], expected[some].T / one[some], atol=1e-3)


@pytest.mark.parametrize("lanes", [False, True])
def test_values_without_slopes_are_the_same(lanes: bool) -> None:
    theta, zeta = everywhere("exponential")
    values, none = read("exponential", theta, zeta, 0.8, lanes=lanes, with_slopes=False)
    # the compiler may join products to sums in other places
    np.testing.assert_allclose(values, read("exponential", theta, zeta, 0.8, lanes=lanes)[0], rtol=2e-6)
    assert not none.any()


@pytest.mark.cuda
@pytest.mark.parametrize("spectrum", SPECTRA)
def test_cuda_is_the_cpu(spectrum: str) -> None:
    theta, zeta = everywhere(spectrum)
    one, other = (read(spectrum, theta, zeta, 0.8, lanes=False, device=device) for device in ("cpu", "cuda"))
    some = one[0] > 1e-30
    # single scattering is a difference of two amplitudes, which falls with sin^2: their last digits are most of it
    lost = 1e-4 + 1e-6 / np.maximum(np.sin(theta) ** 2, 1e-6)
    assert (np.abs(other[0] - one[0]) < lost * one[0] + 1e-30).all()
    alone = read(spectrum, theta, zeta, 0.8, lanes=False, device="cuda", with_slopes=False)[0]
    assert (np.abs(alone - other[0]) < lost * one[0] + 1e-30).all()
    apart = other[1][some].T / other[0][some] - one[1][some].T / one[0][some]
    assert (np.abs(apart) < 10 * lost[some]).all()


def field(effects: dict[str, Any] | None = None, **more: Any) -> Scene:
    """Level ground, 12 m wide, seen from the north: east is the image's azimuth."""
    vertices, faces = ground(12.0)
    rough = 0.003 * np.exp(vertices[:, 0] / 15)
    mesh = Mesh.of(vertices, faces, uv=vertices[:, :2] / 12 + 0.5, vertex_scalars={"rough": rough})
    scene = scene_of(
        mesh,
        view(0, 40),
        shape=(20, 20),
        spacing_m=(0.5, 0.5),
        polarizations=("HV",),
        materials={"default": {**SOIL, "model": "i2em", **more}},
    )
    return replace(scene, effects=effects or {})


FIELDS: dict[str, tuple[dict[str, Any], Any]] = {
    "vertex": ({"layout": "vertex", "rms_height_m": "rough"}, lambda x: (9.0, 0.003 * np.exp(x / 15), 0.03)),
    "texture": (
        {"layout": "texture", "correlation_length_m": np.array([[0.02, 0.04], [0.02, 0.04]])},
        lambda x: (9.0, 0.003, 0.02 * 2 ** ((x + 3) / 6)),
    ),
    "eps_gradient": (
        {"effects": {"eps_gradient": {"per_m_east": 0.1, "per_m_north": 0.0}}},
        lambda x: (1 + 8 * np.exp(0.1 * x), 0.003, 0.03),
    ),
}


@pytest.mark.parametrize("name", FIELDS)
def test_images_of_a_surface_that_varies(name: str) -> None:
    """Every column of the image has the integral of the eps, h and l that lie there."""
    given, surface_at = FIELDS[name]
    image = renderer(field(**given), device="cpu")()["view"]["HV"]
    x = (np.arange(20) - 9.5) * 0.5
    columns = np.flatnonzero(abs(x) < 2.9)  # between the middles of the texels
    found = image[8:12, columns].mean(axis=0) * math.sin(math.radians(40.0))
    expected = []
    for eps, h, length in (surface_at(each) for each in x[columns]):
        k = WAVENUMBER
        expected.append(reference.i2em_hv(math.radians(40.0), eps - 0.8j, k * h, k * length, rings=16, spokes=5))
    assert max(expected) > 1.1 * min(expected)
    # 0.02 dB of the spline, and the curve of sigma0 inside a pixel
    np.testing.assert_allclose(10 * np.log10(found / np.array(expected)), 0.0, atol=0.03)


@pytest.mark.parametrize("name", FIELDS)
def test_gradients_of_an_image_are_those_of_differences(name: str) -> None:
    render = renderer(field(**FIELDS[name][0]), device="cpu")
    random = np.random.default_rng(0)
    seeds = {"view": {p: random.random(image.shape) for p, image in render()["view"].items()}}
    gradient = render.vjp(render.values, seeds)
    assert len(gradient) >= 3
    for key, value in render.values.items():
        step = 1e-2 * np.asarray(value)

        def at(change: float, key: str = key, step: Any = step, value: Any = value) -> float:
            images = render({**render.values, key: value + change * step})["view"]
            return float(sum((seeds["view"][p] * images[p]).sum() for p in images))

        expected = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / 12
        assert float(np.sum(gradient[key] * step)) == pytest.approx(expected, rel=3e-3)  # float32 sums


def test_materials_have_rows_of_their_own() -> None:
    """Two spectra and two losses beside each other, as uniform materials and under an effect that moves nothing."""
    parts = [plate((x, -6.0, 0.0), (6.0, 0, 0), (0, 12.0, 0)) for x in (-6.0, 0.0)]
    vertices, faces = join(parts)
    mesh = Mesh(vertices, faces.astype(np.int32), np.array([0, 0, 1, 1], np.int32), ("wet", "dry"))
    dry = {**SOIL, "eps_r": (4.0, -0.1), "correlation_length_m": 0.01, "spectrum": "gaussian"}
    scene = scene_of(
        mesh,
        view(0, 40),
        shape=(20, 20),
        spacing_m=(0.5, 0.5),
        polarizations=("HV",),
        materials={name: {**own, "model": "i2em"} for name, own in (("wet", SOIL), ("dry", dry))},
    )
    still = replace(scene, effects={"eps_gradient": {"per_m_east": 1e-9, "per_m_north": 0.0}})
    even, uneven = (renderer(one, device="cpu")()["view"]["HV"] for one in (scene, still))
    assert even[10, 15] > 1.3 * even[10, 4]
    np.testing.assert_allclose(uneven[8:12, 1:-1], even[8:12, 1:-1], rtol=5e-3)  # 0.02 dB


def test_too_many_materials_have_the_integral(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = field(**FIELDS["vertex"][0])
    splined = renderer(scene, device="cpu")()["view"]["HV"]
    monkeypatch.setattr(i2em, "MOST_ROWS", 0)
    integrated = renderer(scene, device="cpu")()["view"]["HV"]
    assert not np.array_equal(integrated, splined)
    np.testing.assert_allclose(integrated[8:12, 1:-1], splined[8:12, 1:-1], rtol=7e-3)  # 0.03 dB


def test_threads_leave_every_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for count, least in (("1", 2**14), ("3", 64)):
        monkeypatch.setenv("WARPSAR_THREADS", count)
        monkeypatch.setattr(launches, "_LEAST", least)
        render = renderer(field(**FIELDS["texture"][0]), device="cpu")
        seeds = {"view": {"HV": np.ones((20, 20))}}
        found.append((render()["view"]["HV"], render.vjp(render.values, seeds)))
    np.testing.assert_array_equal(found[1][0], found[0][0])
    for key, gradient in found[0][1].items():
        np.testing.assert_array_equal(found[1][1][key], gradient)
