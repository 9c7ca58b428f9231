"""The convolution and its hand-written adjoint against float64 NumPy, on images of every awkward shape."""

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from effect_worlds import ROUNDING, Case, plane, refusal, render_of, with_effect
from effect_worlds import pair as images_of
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import brentq
from scipy.signal.windows import taylor

from warpsar.effects.point_spread import EFFECT, WINDOWS
from warpsar.runtime import devices
from warpsar.runtime.program import Program

WORKING = [
    Case({"range_fwhm_m": 1.7, "azimuth_fwhm_m": 1.2, "window": "gaussian"}),
    Case({"range_fwhm_m": 1.7, "azimuth_fwhm_m": 1.2, "window": "sinc"}),
    Case({"range_fwhm_m": 1.7, "azimuth_fwhm_m": 1.2, "window": "taylor"}),
    Case({"range_fwhm_m": 1.7, "azimuth_fwhm_m": 1.2, "window": ["taylor", "sinc"]}),
]

SPACING = (0.5, 0.4)
# narrower than the CPU's stretches of pixels, as wide as one, no multiple of one, several and a line
SHAPES = [(9, 5), (16, 16), (40, 19), (21, 70), (1, 33)]
# of a hundredth of a pixel, of none at all, of pixels, wider than any image
WIDTHS = [(0.005, 0.004), (0.0, 0.9), (1.3, 0.0), (1.3, 2.1), (60.0, 90.0)]


class Spread:
    """The effect by itself: `image` in, `result` out."""

    def __init__(self, device: str, window: str, shape: tuple[int, int], widths: tuple[float, float]) -> None:
        self.program = Program(devices.resolve_device(device))
        self.p, self.image = self.program.array(2), self.program.array(shape[0] * shape[1])
        self.p.assign(np.array(widths, np.float32))
        self.shape = shape
        render: Any = SimpleNamespace(
            program=self.program, shape=shape, spacing_m=SPACING, settings={"point_spread": {"window": window}}
        )
        self.results = [EFFECT.image(render, self.p, self.image) for _ in range(2)]  # `image` has two readers

    def forward(self, image: np.ndarray) -> np.ndarray:
        self.image.assign(image.ravel())
        self.program.forward()
        return self.results[0].numpy().reshape(self.shape).astype(float)

    def backward(self, *seeds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gradients to the image and to the widths."""
        self.program.backward({r: s.ravel() for r, s in zip(self.results, seeds, strict=False)})
        return self.image.grad.numpy().reshape(self.shape).astype(float), self.p.grad.numpy().astype(float)


@cache
def half_width(window: str) -> float:
    return float(brentq(lambda x: amplitude(window, np.array([x]))[0] ** 2 - 0.5, 0.2, 1.2, xtol=1e-14))


@cache
def cosines() -> tuple[float, ...]:
    """Taylor's window as a sum of cosines of m turns over the aperture, m = 1 to 4, from SciPy's samples of it."""
    n = 1000
    window = taylor(n, nbar=5, sll=35, norm=False)
    t = (np.arange(n) + 0.5) / n - 0.5
    return tuple(float((window * np.cos(2 * np.pi * m * t)).mean() / window.mean()) for m in range(1, 5))


def amplitude(window: str, x: np.ndarray) -> np.ndarray:
    """Transform of an aperture of length 1, 1 at 0."""
    total = np.sinc(x)
    if window == "taylor":
        for m, share in enumerate(cosines(), start=1):
            total = total + share * (np.sinc(x - m) + np.sinc(x + m))
    return total


def weights(window: str, count: int, width: float) -> np.ndarray:
    """By distance in pixels; both sides add up to 1."""
    k = np.arange(count + 1)
    if width < 1e-5:
        w = (k == 0).astype(float)
    elif window == "gaussian":
        w = np.exp(-4 * np.log(2) * (k / width) ** 2)
    else:
        w = amplitude(window, 2 * half_width(window) * k / width) ** 2
    return w / (w[0] + 2 * w[1:].sum())


def reference(window: str, image: np.ndarray, widths: tuple[float, ...]) -> np.ndarray:
    blurred = image.astype(float)
    for axis, (width, spacing) in enumerate(zip(widths, SPACING, strict=True)):
        n = image.shape[axis]
        w = weights(window, n, width / spacing)[:n]
        blurred = np.apply_along_axis(
            lambda line, w=w, n=n: np.convolve(line, np.r_[w[:0:-1], w])[n - 1 : 2 * n - 1], axis, blurred
        )
    return blurred


def two_images(shape: tuple[int, int], *, low: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(7)
    first, second = (rng.uniform(low, 1.0, shape).astype(np.float32) for _ in range(2))
    return first, second


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("shape", SHAPES)
def test_is_the_convolution_and_the_adjoint_its_own(device: str, window: str, shape: tuple[int, int]) -> None:
    """Value, gradient to the image, gradients to the widths, for every pair of widths."""
    image, seed = two_images(shape)
    for widths in WIDTHS:
        spread = Spread(device, window, shape, widths)
        expected = reference(window, image, widths)
        # float32: up to 140 terms, none negative; beyond 3 widths the Gaussian's 1e-11 is left out
        assert spread.forward(image) == pytest.approx(expected, rel=3e-6, abs=1e-7), widths
        to_image, to_widths = spread.backward(seed)
        assert to_image == pytest.approx(reference(window, seed, widths), rel=3e-6, abs=1e-7), widths
        power = float((seed * expected).sum())
        for axis, width in enumerate(widths):
            if width == 0:
                assert np.isfinite(to_widths[axis])
                continue
            ends = []
            for factor in (1 + 1e-6, 1 - 1e-6):
                moved = list(widths)
                moved[axis] *= factor
                ends.append(float((seed * reference(window, image, tuple(moved))).sum()))
            # By ln(width). The weights' slopes, of both signs, cancel in the sum: 1e-5 of the image's power. Sidelobes
            # of a hundredth of a pixel turn through 280 rad a pixel: far out float32 knows their phase to 1e-3.
            numeric = (ends[0] - ends[1]) / 2e-6
            known = 1e-4 if width < 0.01 else 1e-5
            assert to_widths[axis] * width == pytest.approx(numeric, rel=2e-4, abs=known * power), (widths, axis)


@pytest.mark.parametrize("window", WINDOWS)
@pytest.mark.parametrize("shape", SHAPES)
def test_adjoint_identity(device: str, window: str, shape: tuple[int, int]) -> None:
    """<A x, y> = <x, A' y>, for x and y of both signs; and two readers of an image add their gradients up."""
    x, y = two_images(shape, low=-1.0)
    for widths in WIDTHS:
        spread = Spread(device, window, shape, widths)
        ax = spread.forward(x)
        aty, _ = spread.backward(y)
        size = float(np.linalg.norm(x) * np.linalg.norm(y))
        assert float((ax * y).sum()) == pytest.approx(float((x * aty).sum()), abs=1e-6 * size)
        twice, _ = spread.backward(y, 2 * y)
        assert twice == pytest.approx(3 * aty, rel=1e-5, abs=1e-5 * float(np.abs(aty).max()))


@pytest.mark.parametrize("window", WINDOWS)
def test_no_width_changes_no_bit(device: str, window: str) -> None:
    image, seed = two_images((21, 37))
    spread = Spread(device, window, image.shape, (0.0, 0.0))
    if window == "gaussian":
        assert np.array_equal(spread.forward(image), image)
        assert np.array_equal(spread.backward(seed)[0], seed)
    else:  # sidelobes of a kernel 1e-5 pixels wide
        assert spread.forward(image) == pytest.approx(image, rel=1e-6)
    assert np.isfinite(spread.backward(seed)[1]).all()


@pytest.mark.cuda
@pytest.mark.parametrize("window", WINDOWS)
def test_cuda_is_the_cpu(window: str) -> None:
    """Stretches of pixels on one, single pixels and sums over lanes on the other; float32 in another order."""
    image, seed = two_images((150, 130))
    one, other = (Spread(device, window, image.shape, (1.3, 2.1)) for device in ("cpu", "cuda"))
    assert one.forward(image) == pytest.approx(other.forward(image), rel=1e-5)
    for here, there in zip(one.backward(seed), other.backward(seed), strict=True):
        assert here == pytest.approx(there, rel=1e-4)


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
    without, with_it = images_of(plane(), "point_spread", {"range_fwhm_m": 1.1, "azimuth_fwhm_m": 0.7})
    deviation = [width / 0.5 / np.sqrt(8 * np.log(2)) for width in (1.1, 0.7)]
    expected = gaussian_filter1d(
        gaussian_filter1d(without, deviation[0], axis=0, mode="constant", truncate=9),
        deviation[1],
        axis=1,
        mode="constant",
        truncate=9,
    )
    assert with_it == pytest.approx(expected, rel=ROUNDING, abs=ROUNDING * without.max())


def test_a_pair_of_windows_is_that_of_range_and_that_of_azimuth(device: str) -> None:
    """Against each axis alone, held to the convolution by the tests above: the other's width is 0."""
    image, _ = two_images((40, 37))
    rows = Spread(device, "taylor", image.shape, (1.3, 0.0)).forward(image)
    expected = Spread(device, "gaussian", image.shape, (0.0, 2.1)).forward(rows)
    pair: Any = ["taylor", "gaussian"]
    found = Spread(device, pair, image.shape, (1.3, 2.1)).forward(image)
    # a Taylor kernel 1e-5 pixels wide has sidelobes of 1e-7 in azimuth
    assert found == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("window", ["hann", ["taylor"], ["taylor", "hann"], ["sinc", "sinc", "sinc"]])
def test_an_unknown_window_is_refused(window: Any) -> None:
    said = refusal("point_spread", {"window": window})
    assert f"found {window!r}; allowed is 'sinc' or 'taylor' or 'gaussian', or a pair of these" in said
