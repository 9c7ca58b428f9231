"""Sixteen hits at once on the CPU (kernels/lane_kernels.py): against golden values, and against the functions one by
one in float64, which test_scattering.py holds against golden values, derivatives and differences.
"""

from itertools import product
from typing import Any

import numpy as np
import pytest
import warp as wp
from test_scattering import golden, relative_rounding  # noqa: F401 - a fixture

from warpsar.kernels.codes import FRACTION_LIMIT, Spectrum
from warpsar.kernels.lane_kernels import LANES, at_once
from warpsar.kernels.scatter import scatter_kernel
from warpsar.kernels.scattering import sigma0_and_slopes
from warpsar.kernels.shade import HitSurfaces
from warpsar.runtime.structs import fill

pytestmark = pytest.mark.unit

COUNT = 16 * 40 + 5  # the last block is not full
EPS_IM, ASPECT = (0.0, 0.6, 3.0), (1.0, 0.7, 1.6)  # of three materials, each with a spectrum of its own


@wp.kernel(enable_backward=False)
def one_by_one(
    polarization: int,
    variant: int,
    spectrum: wp.array(dtype=int),
    inputs: wp.array2d(dtype=wp.float64),
    zeta: wp.array2d(dtype=wp.float64),
    out: wp.array2d(dtype=wp.float64),
):
    i = wp.tid()
    one = wp.float64(1.0)
    length = wp.exp(zeta[i, 2])
    found = sigma0_and_slopes(
        polarization,
        spectrum[i],
        variant,
        inputs[i, 0],
        inputs[i, 1],
        inputs[i, 2],
        one + wp.exp(zeta[i, 0]),
        inputs[i, 4],
        wp.exp(zeta[i, 1]),
        length,
        inputs[i, 5] * length,
        inputs[i, 3],
        one / (one + wp.exp(-zeta[i, 3])),
    )
    for k in range(5):
        out[i, k] = found[k]


def hits(count: int = COUNT) -> dict[str, np.ndarray]:
    random = np.random.default_rng(1)
    zeta = [
        np.log(random.uniform(1.0, 20.0, count)),
        np.log(random.uniform(2e-4, 3e-3, count)),
        np.log(random.uniform(4e-3, 2e-2, count)),
        random.normal(0.0, 2.0, count),
    ]
    cosines = {name: random.uniform(0.2, 1.0, count) for name in ("incidence", "twist", "azimuth2")}
    found = cosines | {"zeta": np.stack(zeta, axis=1)}
    return {name: values.astype(np.float32) for name, values in found.items()} | {
        "material": random.integers(0, 3, count).astype(np.int32)
    }


def in_lanes(given: dict[str, Any], polarization: int, variant: int) -> tuple[np.ndarray, np.ndarray]:
    """sigma0, shape (n,), and its slopes, (n, 4)."""

    def put(values: Any, dtype: Any = float) -> Any:
        return wp.array(values, dtype=dtype, device="cpu")

    count = given["material"].size
    sigma = wp.zeros(count, dtype=float, device="cpu")
    slopes = wp.zeros(count, dtype=wp.vec4, device="cpu")
    surfaces = fill(
        HitSurfaces,
        polarization=polarization,
        variant=variant,
        wavenumber=given.get("wavenumber", 200.0),
        face=put(np.arange(count, dtype=np.int32), int),
        face_material=put(given["material"], int),
        cos_incidence=put(given["incidence"]),
        cos_twist=put(given["twist"]),
        cos2_azimuth=put(given["azimuth2"]),
        spectrum=put(given.get("spectrum", tuple(Spectrum)), int),
        eps_im=put(given.get("eps_im", EPS_IM)),
        aspect=put(given.get("aspect", ASPECT)),
    )
    inputs = [put(np.zeros(0, np.int32), int), surfaces, put(given["zeta"], wp.vec4)]
    blocks = -(-count // LANES)
    values, both = (at_once(scatter_kernel("ka_spm", kept, some=False)) for kept in (False, True))
    wp.launch(both, blocks, inputs=inputs, outputs=[sigma, slopes], device="cpu")
    alone = wp.zeros(count, dtype=float, device="cpu")
    none = wp.empty(0, dtype=wp.vec4, device="cpu")
    wp.launch(values, blocks, inputs=inputs, outputs=[alone, none], device="cpu")
    np.testing.assert_array_equal(alone.numpy(), sigma.numpy())
    return sigma.numpy(), slopes.numpy()


@pytest.mark.parametrize(("polarization", "variant"), list(product(range(4), range(2))))
def test_the_scattering_functions_in_float64(polarization: int, variant: int) -> None:
    given = hits()
    sigma, slopes = in_lanes(given, polarization, variant)
    material = given["material"]
    columns = [np.full(COUNT, 200.0), *(given[n].astype(float) for n in ("incidence", "twist", "azimuth2"))]
    columns += [np.array(EPS_IM)[material], np.array(ASPECT)[material]]
    out = wp.zeros((COUNT, 5), dtype=wp.float64, device="cpu")
    inputs = [
        polarization,
        variant,
        wp.array(material, dtype=int, device="cpu"),
        wp.array(np.stack(columns, axis=1), dtype=wp.float64, device="cpu"),
        wp.array(given["zeta"].astype(float), dtype=wp.float64, device="cpu"),
    ]
    wp.launch(one_by_one, COUNT, inputs=inputs, outputs=[out], device="cpu")
    expected = out.numpy()
    # Exponents reach -40 here, whose float32 rounding alone is 40 * 6e-8; HV and VH are the difference of two
    # amplitudes, which takes more digits: up to three where they nearly agree.
    seen = expected[:, 0] > 1e-15
    assert seen.sum() > 500
    assert np.quantile(np.abs(sigma / expected[:, 0] - 1.0)[seen], 0.95) < 2e-5
    assert np.abs(sigma / expected[:, 0] - 1.0)[seen].max() < (2e-2 if polarization > 1 else 2e-4)
    size = np.abs(expected).max(axis=1, keepdims=True)
    error = (np.abs(slopes - expected[:, 1:]) / size)[seen]
    assert np.quantile(error, 0.95) < 3e-5
    assert error.max() < (2e-2 if polarization > 1 else 5e-4)


def test_golden_values(golden: Any) -> None:  # noqa: F811
    """The file knows nothing of learned coordinates: u (32 + 4 C) as in test_scattering.py, and C once more for each
    coordinate's own rounding, whose size is up to |ln h| = 8 (u of it, and the exponential's 2e-7)."""
    inputs, sigma, derivatives = golden
    tau = inputs["tau"]
    logit = np.array([-FRACTION_LIMIT if t == 0 else FRACTION_LIMIT if t == 1 else np.log(t / (1 - t)) for t in tau])
    h, length = inputs["rms_height"], inputs["length_x"]
    zeta = np.stack([np.log(inputs["eps_re"] - 1), np.log(h), np.log(length), logit], axis=1)
    scaled = [
        derivatives["eps_re"] * (inputs["eps_re"] - 1),
        derivatives["rms_height"] * h,
        derivatives["length"] * length,
        np.where(tau == 0.3, derivatives["tau"] * tau * (1 - tau), 0.0),
    ]
    expected = np.stack(scaled, axis=1)
    rounding = relative_rounding(inputs, sigma, derivatives, np.float32)
    bound = rounding + (8.0 * 6e-8 + 2e-7) * np.abs(expected / sigma[:, None]).sum(axis=1)
    groups = np.stack([inputs["polarization"], inputs["variant"], inputs["wavenumber"]], axis=1)
    seen = 0
    for polarization, variant, wavenumber in np.unique(groups, axis=0):
        rows = np.flatnonzero((groups == (polarization, variant, wavenumber)).all(axis=1))
        given = {
            "wavenumber": wavenumber,
            "incidence": np.cos(inputs["theta"][rows]),
            "twist": inputs["cos_twist"][rows],
            "azimuth2": inputs["cos2_azimuth"][rows],
            "zeta": zeta[rows],
            "material": np.arange(rows.size, dtype=np.int32),
            "spectrum": inputs["spectrum"][rows].astype(np.int32),
            "eps_im": inputs["eps_im"][rows],
            "aspect": np.ones(rows.size),
        }
        found, slopes = in_lanes(given, int(polarization), int(variant))
        assert (np.abs(found / sigma[rows] - 1.0) <= bound[rows]).all()
        error = np.abs(slopes - expected[rows]) / sigma[rows, None]
        size = 1.0 + np.abs(expected[rows]) / sigma[rows, None]
        assert (error <= 4.0 * bound[rows, None] * size).all()
        seen += rows.size
    assert seen == 547
    assert np.median(bound) < 1e-5


def test_a_hit_is_the_same_wherever_it_lies_in_its_block() -> None:
    given = hits()
    sigma, slopes = in_lanes(given, 0, 0)
    for shift in (1, 7, 15):
        moved, moved_slopes = in_lanes({name: values[shift:] for name, values in given.items()}, 0, 0)
        np.testing.assert_array_equal(moved, sigma[shift:])
        np.testing.assert_array_equal(moved_slopes, slopes[shift:])


def test_nothing_is_lost_at_the_ends() -> None:
    """tau of exactly 0 and 1 from |logit| 40 on, a dead permittivity, grazing and vertical incidence: all finite, and
    the power of a surface that does not reflect is 0."""
    given = hits(32)
    given["zeta"][:8, 3], given["zeta"][8:16, 3] = 45.0, -45.0
    given["zeta"][16:20, 0] = -np.inf
    given["incidence"][20:24], given["incidence"][24:28] = 0.0, 1.0
    given["material"][16:20] = 0
    for polarization in range(4):
        sigma, slopes = in_lanes(given, polarization, 0)
        assert np.isfinite(sigma).all()
        assert np.isfinite(slopes).all()
        assert (sigma[16:20] == 0).all()
        assert (slopes[:16, 3] == 0).all()
    # all specular: no HV
    assert (in_lanes(given, 2, 0)[0][:8] == 0).all()
