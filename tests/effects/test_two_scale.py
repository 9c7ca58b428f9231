"""The mean over tilts against a finer quadrature, and to first order in the variance."""

import numpy as np
import pytest
import warp as wp
import worlds
from effect_worlds import STRIP_MAP, Case, hits_of, plane, render_of, with_effect

from warpsar.kernels.effects import two_scale as kernels
from warpsar.kernels.lane_kernels import LANES, at_once

WORKING = [
    Case({"slope_variance": 0.02}),
    Case({"slope_variance": 0.02}, STRIP_MAP),
]


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


def test_many_hits_at_once_are_as_one_by_one() -> None:
    """Near grazing, where half of the tilts are hidden, and with a last block of hits that is not full."""
    scene = plane(views=[worlds.view(20.0, 80.0)])
    render = render_of(with_effect(scene, "two_scale", {"slope_variance": 0.2}))
    render.forward()
    step = next(step for step in render.program._steps if step.kernel is at_once(kernels.tilt_kernel(False)))
    found = step.outputs[0]
    assert found.shape[0] % LANES
    expected = wp.zeros_like(found)
    outputs = [expected, step.outputs[1]]
    wp.launch(kernels.tilt_kernel(False), found.shape[0], inputs=step.inputs, outputs=outputs, device="cpu")
    # sums of 25 float32 terms, and exp of another library
    assert found.numpy() == pytest.approx(expected.numpy(), rel=1e-5)
