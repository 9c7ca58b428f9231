"""Scattering functions: golden values and derivatives, and identities that the golden file does not know of.

golden_scattering.csv holds 40-digit values and derivatives, cross-checked against SMRT 1.7.
"""

import csv
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp

from warpsar.kernels import scattering
from warpsar.kernels.codes import Polarization, Spectrum, Variant

pytestmark = pytest.mark.unit

GOLDEN = Path(__file__).parents[1] / "data" / "golden_scattering.csv"
POLARIZATIONS, SPECTRA, VARIANTS = tuple(Polarization), tuple(Spectrum), tuple(Variant)
(HH, VV, HV, VH), (GAUSSIAN, EXPONENTIAL, SEPARABLE), (STANDARD, AS_PRINTED) = POLARIZATIONS, SPECTRA, VARIANTS
CODES = {"polarization": HH, "spectrum": GAUSSIAN, "variant": STANDARD}
# Lossy, rough and oblique on purpose: no term of the model vanishes or dominates.
SURFACE = {
    "wavenumber": 201.2,
    "theta": 0.7,
    "cos_twist": 1.0,
    "eps_re": 6.885,
    "eps_im": 0.9,
    "rms_height": 0.002,
    "length_x": 0.008,
    "length_y": 0.012,
    "cos2_azimuth": 0.3,
    "tau": 0.0,
}
DEVICES = [
    "cpu",
    pytest.param(
        "cuda:0",
        marks=[pytest.mark.cuda, pytest.mark.skipif(not wp.is_cuda_available(), reason="no CUDA device")],
    ),
]


@wp.kernel
def sigma0_kernel(
    polarization: wp.array(dtype=wp.int32),
    spectrum: wp.array(dtype=wp.int32),
    variant: wp.array(dtype=wp.int32),
    wavenumber: wp.array(dtype=Any),
    theta: wp.array(dtype=Any),
    cos_twist: wp.array(dtype=Any),
    eps_re: wp.array(dtype=Any),
    eps_im: wp.array(dtype=Any),
    rms_height: wp.array(dtype=Any),
    length_x: wp.array(dtype=Any),
    length_y: wp.array(dtype=Any),
    cos2_azimuth: wp.array(dtype=Any),
    tau: wp.array(dtype=Any),
    out: wp.array(dtype=Any),
):
    i = wp.tid()
    out[i] = scattering.sigma0(
        polarization[i],
        spectrum[i],
        variant[i],
        wavenumber[i],
        wp.cos(theta[i]),
        cos_twist[i],
        eps_re[i],
        eps_im[i],
        rms_height[i],
        length_x[i],
        length_y[i],
        cos2_azimuth[i],
        tau[i],
    )


@wp.kernel
def fresnel_kernel(
    cos_theta: wp.array(dtype=Any),
    eps_re: wp.array(dtype=Any),
    eps_im: wp.array(dtype=Any),
    out_h: wp.array(dtype=Any),
    out_v: wp.array(dtype=Any),
):
    i = wp.tid()
    out_h[i] = scattering.fresnel_h(cos_theta[i], eps_re[i], eps_im[i])
    out_v[i] = scattering.fresnel_v(cos_theta[i], eps_re[i], eps_im[i])


@wp.kernel
def bistatic_kernel(
    polarization: wp.array(dtype=wp.int32),
    cos_half_angle: wp.array(dtype=Any),
    cos_tilt: wp.array(dtype=Any),
    eps_re: wp.array(dtype=Any),
    eps_im: wp.array(dtype=Any),
    slope_variance: wp.array(dtype=Any),
    out: wp.array(dtype=Any),
):
    i = wp.tid()
    out[i] = scattering.bistatic_geometric_optics(
        polarization[i], cos_half_angle[i], cos_tilt[i], eps_re[i], eps_im[i], slope_variance[i]
    )


@wp.kernel
def spectrum_kernel(
    spectrum: wp.array(dtype=wp.int32),
    wavenumber_squared: wp.array(dtype=Any),
    cos2_azimuth: wp.array(dtype=Any),
    rms_height: wp.array(dtype=Any),
    length_x: wp.array(dtype=Any),
    length_y: wp.array(dtype=Any),
    out: wp.array(dtype=Any),
):
    i = wp.tid()
    out[i] = scattering.roughness_spectrum(
        spectrum[i], wavenumber_squared[i], cos2_azimuth[i], rms_height[i], length_x[i], length_y[i]
    )


@wp.kernel(enable_backward=False)
def slopes_kernel(
    polarization: wp.array(dtype=wp.int32),
    spectrum: wp.array(dtype=wp.int32),
    variant: wp.array(dtype=wp.int32),
    wavenumber: wp.array(dtype=Any),
    theta: wp.array(dtype=Any),
    cos_twist: wp.array(dtype=Any),
    eps_re: wp.array(dtype=Any),
    eps_im: wp.array(dtype=Any),
    rms_height: wp.array(dtype=Any),
    length_x: wp.array(dtype=Any),
    length_y: wp.array(dtype=Any),
    cos2_azimuth: wp.array(dtype=Any),
    tau: wp.array(dtype=Any),
    out: wp.array2d(dtype=Any),
):
    i = wp.tid()
    found = scattering.sigma0_and_slopes(
        polarization[i],
        spectrum[i],
        variant[i],
        wavenumber[i],
        wp.cos(theta[i]),
        cos_twist[i],
        eps_re[i],
        eps_im[i],
        rms_height[i],
        length_x[i],
        length_y[i],
        cos2_azimuth[i],
        tau[i],
    )
    for k in range(5):
        out[i, k] = found[k]


KERNELS = (sigma0_kernel, fresnel_kernel, bistatic_kernel, spectrum_kernel, slopes_kernel)
# Declared before the first launch, the instances compile as one module, once.
for _kernel, _scalar in itertools.product(KERNELS, (wp.float32, wp.float64)):
    wp.overload(
        _kernel,
        {
            a.label: wp.array(dtype=_scalar, ndim=a.type.ndim)
            for a in _kernel.adj.args
            if isinstance(a.type, wp.array) and a.type.dtype is Any
        },
    )


def launch(kernel, columns, outputs=1, dtype=np.float64, device="cpu"):
    """Outputs of one launch over the columns, broadcast, and the gradient of their sum to each real one."""
    names = list(columns)
    values = np.broadcast_arrays(*(np.atleast_1d(columns[n]) for n in names))
    arrays = {}
    for name, value in zip(names, values, strict=True):
        integer = name in CODES
        arrays[name] = wp.array(
            value.ravel().astype(np.int32 if integer else dtype),
            requires_grad=not integer,
            device=device,
        )
    shape, size = values[0].shape, values[0].size
    out = [wp.zeros(size, dtype=wp.dtype_from_numpy(dtype), requires_grad=True, device=device) for _ in range(outputs)]
    tape = wp.Tape()
    with tape:
        wp.launch(kernel, dim=size, inputs=list(arrays.values()), outputs=out, device=device)
    tape.backward(grads={o: wp.ones_like(o, requires_grad=False) for o in out})
    gradients = {n: a.grad.numpy().reshape(shape) for n, a in arrays.items() if n not in CODES}
    results = [o.numpy().reshape(shape) for o in out]
    return (results[0] if outputs == 1 else results), gradients


def sigma0(dtype=np.float64, device="cpu", **columns):
    unknown = columns.keys() - CODES.keys() - SURFACE.keys()
    assert not unknown, unknown
    return launch(sigma0_kernel, CODES | SURFACE | columns, dtype=dtype, device=device)


def sigma0_and_slopes(dtype=np.float64, device="cpu", **columns):
    """sigma0, shape (n,), and its slopes to ln(eps_re - 1), ln h, ln l, logit tau, shape (n, 4)."""
    columns = CODES | SURFACE | columns
    values = np.broadcast_arrays(*(np.atleast_1d(value) for value in columns.values()))
    inputs = [
        wp.array(value.ravel().astype(np.int32 if name in CODES else dtype), device=device)
        for name, value in zip(columns, values, strict=True)
    ]
    out = wp.zeros((values[0].size, 5), dtype=wp.dtype_from_numpy(dtype), device=device)
    wp.launch(slopes_kernel, dim=values[0].size, inputs=inputs, outputs=[out], device=device)
    return out.numpy()[:, 0], out.numpy()[:, 1:]


def spectrum(code, wavenumber, rms_height, length_x, length_y, cos2_azimuth=1.0):
    columns = {
        "spectrum": code,
        "wavenumber_squared": np.square(wavenumber),
        "cos2_azimuth": cos2_azimuth,
        "rms_height": rms_height,
        "length_x": length_x,
        "length_y": length_y,
    }
    return launch(spectrum_kernel, columns)[0]


def fresnel(cos_theta, eps_re, eps_im):
    (h, v), _ = launch(fresnel_kernel, {"cos_theta": cos_theta, "eps_re": eps_re, "eps_im": eps_im}, outputs=2)
    return h, v


@pytest.fixture(scope="module")
def golden():
    with GOLDEN.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 547

    def column(name):
        return np.array([float(r[name]) for r in rows])

    inputs = {
        # "pp": the geometric-optics term, the same in HH and VV.
        "polarization": np.array([{"hh": HH, "vv": VV, "pp": VV}[r["pol"]] for r in rows]),
        "spectrum": np.array(
            [
                {"gauss": GAUSSIAN, "exp": EXPONENTIAL, "sep0": SEPARABLE, "sep45": SEPARABLE}[r["spectrum"]]
                for r in rows
            ]
        ),
        "variant": np.array([AS_PRINTED if "asprinted" in r["model"] else STANDARD for r in rows]),
        "wavenumber": 2.0 * np.pi * column("freq_GHz") * 1e9 / 299792458.0,
        "theta": np.radians(column("theta_deg")),
        "cos_twist": np.ones(len(rows)),
        "eps_re": column("eps_re"),
        "eps_im": -column("eps_im"),  # the file's sign is that of Im eps
        "rms_height": column("h_m"),
        "length_x": column("l_m"),
        "length_y": column("l_m"),
        "cos2_azimuth": np.array([0.5 if r["spectrum"] == "sep45" else 1.0 for r in rows]),
        "tau": column("tau"),
    }
    derivatives = {
        "eps_re": column("dsig_deps_re"),
        "rms_height": column("dsig_dh"),
        "length": column("dsig_dl"),
        "tau": column("dsig_dtau"),
        "theta": column("dsig_dtheta_rad"),
    }
    return inputs, column("sigma0_linear"), derivatives


def relative_rounding(inputs, sigma, derivatives, dtype):
    """First-order bound of sigma0's relative error per row, from the golden derivatives: no tuned number.

    u (32 + 4 C): about 30 roundings of factors whose product sigma0 is, and C, the sum over the inputs of
    |d ln sigma0 / d ln x|, for at most four roundings of each input and of the products it enters as (kl,
    its square, the exponent). The cosine is such an input: near nadir its last bit is what is left of
    sin^2 theta. k scales as h and l together, sigma0 being dimensionless.
    """
    condition = np.zeros_like(sigma)
    for name in ("eps_re", "rms_height", "length", "tau"):
        x = inputs["length_x" if name == "length" else name]
        condition += np.abs(x * derivatives[name] / sigma)
    condition += np.abs(
        (inputs["rms_height"] * derivatives["rms_height"] + inputs["length_x"] * derivatives["length"]) / sigma
    )
    condition += np.abs(derivatives["theta"] / np.tan(inputs["theta"]) / sigma)
    return np.finfo(dtype).eps / 2.0 * (32.0 + 4.0 * condition)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_golden_values(golden, dtype, device):
    inputs, sigma, derivatives = golden
    got, _ = sigma0(dtype, device, **inputs)
    tolerance = relative_rounding(inputs, sigma, derivatives, dtype)
    error = np.abs(got.astype(np.float64) / sigma - 1.0)
    print(
        f"largest error {error.max():.1e} relative, {(error / tolerance).max():.2f} of its bound; "
        f"bound: median {np.median(tolerance):.1e}, largest {tolerance.max():.1e}"
    )
    assert np.all(error <= tolerance), np.argmax(error / tolerance)
    # The bound is tight on the common row: 6e-6 in float32. It reaches 3e-3 at 0.5 degrees with kl = 40.
    assert np.median(tolerance) < 50.0 * np.finfo(dtype).eps


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("name", ["eps_re", "rms_height", "length", "tau", "theta"])
def test_golden_derivatives(golden, name, dtype, device):
    """In log coordinates, against 1 + |derivative|: some golden derivatives are exact cancellations (1e-40).

    The terms that cancel are of the order of sigma0 itself, each as exact as sigma0 (`relative_rounding`); 4
    for the product rule's few terms.
    """
    inputs, sigma, derivatives = golden
    _, gradients = sigma0(dtype, device, **inputs)
    got = (gradients["length_x"] + gradients["length_y"]) if name == "length" else gradients[name]
    unit = 1.0 if name in ("theta", "tau") else inputs["length_x" if name == "length" else name]
    expected = derivatives[name] * unit / sigma
    error = np.abs(got.astype(np.float64) * unit / sigma - expected)
    tolerance = 4.0 * relative_rounding(inputs, sigma, derivatives, dtype) * (1.0 + np.abs(expected))
    # The file differentiates to tau in its mixtures only.
    rows = (inputs["tau"] == 0.3) if name == "tau" else np.ones(sigma.size, bool)
    assert rows.sum() >= 102
    error, tolerance, expected = error[rows], tolerance[rows], expected[rows]
    print(
        f"largest error {(error / (1.0 + np.abs(expected))).max():.1e} of 1 + |derivative|, "
        f"{(error / tolerance).max():.2f} of its bound"
    )
    assert np.all(error <= tolerance), np.argmax(error / tolerance)


def test_derivatives_outside_the_golden_file():
    """Five-point central differences: truncation O(step^4), rounding 1e-16 / step, both under 1e-9."""
    rows = np.array(list(itertools.product(POLARIZATIONS, SPECTRA, VARIANTS)))
    codes = dict(zip(CODES, rows.T, strict=True))
    point = SURFACE | {"cos_twist": 0.8, "tau": 0.4}
    value, gradients = sigma0(**codes, **point)
    for name, x in point.items():
        step = 1e-3 * x
        f = {n: sigma0(**codes, **point | {name: x + n * step})[0] for n in (-2, -1, 1, 2)}
        difference = (f[-2] - 8.0 * f[-1] + 8.0 * f[1] - f[2]) / (12.0 * step)
        # The scale is value / x: a column that is not read has the derivative 0.
        np.testing.assert_allclose(gradients[name], difference, rtol=1e-8, atol=1e-9 * np.max(value / x), err_msg=name)
    not_separable = codes["spectrum"] != SEPARABLE
    for name in ("length_y", "cos2_azimuth"):
        assert np.all(gradients[name][not_separable] == 0.0)
        # Where it is separable both count in every channel: the Bragg wave is along neither axis.
        assert np.all(gradients[name][~not_separable] != 0.0)


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_everything_is_finite_at_the_edges(dtype, device):
    """Values and gradients where a root, a quotient or an exponential could give NaN or overflow."""
    edges = {
        "polarization": POLARIZATIONS,
        "spectrum": SPECTRA,
        "variant": VARIANTS,
        "theta": (0.0, 1e-4, 1.5707, np.pi / 2),
        "cos_twist": (0.0, 1.0),
        "eps_re": (1.0, 6.885),
        "eps_im": (0.0, 1e6),
        # m from 1e-6 to 1e4: geometric optics underflows, or its lobe is as wide as the sky; kl up to 2e4.
        "rms_height": (1e-6, 1e-1),
        "length_x": (1e-5, 1.0),
        "tau": (0.0, 1.0),
    }
    grid = dict(zip(edges, (np.array(c) for c in zip(*itertools.product(*edges.values()), strict=True)), strict=True))
    value, gradients = sigma0(dtype, device, **grid, wavenumber=2e4, length_y=grid["length_x"])
    assert np.all(np.isfinite(value))
    assert np.all(value >= 0.0)
    for name, gradient in gradients.items():
        assert np.all(np.isfinite(gradient)), name
    _, slopes = sigma0_and_slopes(dtype, device, **grid, wavenumber=2e4, length_y=grid["length_x"])
    assert np.all(np.isfinite(slopes))


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_slopes_in_closed_form_are_those_of_reverse_mode(dtype, device):
    """The chain rule from SI units to the learned coordinates; both lengths grow together."""
    rng = np.random.default_rng(0)
    codes = np.array(list(itertools.product(POLARIZATIONS, SPECTRA, VARIANTS))).repeat(40, axis=0)
    n = len(codes)
    surface = {
        "wavenumber": np.exp(rng.uniform(3, 6, n)),
        "theta": rng.uniform(0.01, 1.5, n),
        "cos_twist": rng.uniform(0, 1, n),
        "eps_re": 1 + np.exp(rng.uniform(-2, 4, n)),
        "eps_im": rng.choice([0.0, 0.5, 7.0], n),
        "rms_height": np.exp(rng.uniform(-8, -4, n)),
        "length_x": np.exp(rng.uniform(-5, -1, n)),
        "length_y": np.exp(rng.uniform(-5, -1, n)),
        "cos2_azimuth": rng.uniform(0, 1, n),
        "tau": rng.uniform(0.05, 0.95, n),
    }
    columns = dict(zip(CODES, codes.T, strict=True)) | surface
    value, gradients = sigma0(device=device, **columns)
    tau = surface["tau"]
    expected = np.stack(
        [
            gradients["eps_re"] * (surface["eps_re"] - 1),
            gradients["rms_height"] * surface["rms_height"],
            gradients["length_x"] * surface["length_x"] + gradients["length_y"] * surface["length_y"],
            gradients["tau"] * tau * (1 - tau),
        ],
        axis=1,
    )
    again, found = sigma0_and_slopes(dtype, device, **columns)
    # the same terms in the same order: a compiler may only fuse other products into sums
    np.testing.assert_allclose(again, sigma0(dtype, device, **columns)[0], rtol=50 * np.finfo(dtype).eps)
    # The terms that cancel are sigma0's own, times an exponential's argument of up to some hundred; HV also takes the
    # difference of two amplitudes.
    scale = np.maximum(np.abs(expected), value[:, None])
    error = np.abs(found - expected) / np.where(scale > 1e-30, scale, np.inf)
    if dtype == np.float64:
        assert error.max() < 1e-10
    else:
        assert np.median(error) < 1e-6
        assert np.quantile(error, 0.99) < 1e-3


def test_specular_fraction_selects_the_terms():
    """A term with weight 0 leaves no trace, though it underflow; d/dtau is their difference."""
    for height, length in ((1e-4, 0.2), (2e-3, 8e-3)):
        surface = {"polarization": [HH, VV], "rms_height": height, "length_x": length}
        ends = {tau: sigma0(**surface, tau=tau) for tau in (0.0, 0.25, 1.0)}
        small, mixed, specular = (ends[t][0] for t in (0.0, 0.25, 1.0))
        np.testing.assert_allclose(mixed, 0.75 * small + 0.25 * specular, rtol=1e-14)
        for tau in ends:
            np.testing.assert_allclose(ends[tau][1]["tau"], specular - small, rtol=1e-14)
    assert np.all(sigma0(polarization=[HV, VH], cos_twist=0.6, tau=1.0)[0] == 0.0)


def test_slopes_of_a_separable_surface():
    """Geometric optics of lengths lx, ly is that of their geometric mean; the Bragg direction does not matter."""
    lx, ly = SURFACE["length_x"], SURFACE["length_y"]
    separable = sigma0(spectrum=SEPARABLE, cos2_azimuth=[0.0, 0.3, 1.0], tau=1.0)[0]
    isotropic = sigma0(spectrum=GAUSSIAN, length_x=np.sqrt(lx * ly), tau=1.0)[0][0]
    np.testing.assert_allclose(separable, isotropic, rtol=1e-13)


def test_sigma0_has_no_unit_of_length():
    """Wavelength, height and length scaled together by a power of two: the very same bits."""
    codes = dict(zip(CODES, np.array(list(itertools.product(POLARIZATIONS, SPECTRA, VARIANTS))).T, strict=True))
    scaled = {"wavenumber": SURFACE["wavenumber"] / 4.0} | {
        n: SURFACE[n] * 4.0 for n in ("rms_height", "length_x", "length_y")
    }
    common = codes | {"cos_twist": 0.8, "tau": 0.4}
    np.testing.assert_array_equal(sigma0(**common)[0], sigma0(**common | scaled)[0])


def test_the_printed_constant_is_low_by_two_pi():
    spectra = np.array(SPECTRA)
    standard = sigma0(spectrum=spectra, variant=STANDARD)[0]
    printed = sigma0(spectrum=spectra, variant=AS_PRINTED)[0]
    np.testing.assert_allclose(standard / printed, 2.0 * np.pi, rtol=1e-14)


# --- polarization


def test_rotation_of_the_radar_basis():
    psi = np.linspace(0.0, np.pi / 2.0, 7)
    channels = {p: sigma0(polarization=p, cos_twist=np.cos(psi))[0] for p in POLARIZATIONS}
    np.testing.assert_array_equal(channels[HV], channels[VH])  # reciprocity
    # 90 degrees swap the channels: cos(pi / 2) is 6e-17, not 0.
    np.testing.assert_allclose(channels[HH], channels[VV][::-1], rtol=1e-14)
    assert channels[HV][0] == 0.0
    assert channels[HV][-1] < 1e-30
    # A rotation keeps the span |S_HH|^2 + |S_VV|^2 + 2 |S_HV|^2.
    span = channels[HH] + channels[VV] + 2.0 * channels[HV]
    np.testing.assert_allclose(span, span[0], rtol=1e-14)
    # At 45 degrees S_HH = S_VV = (a_hh + a_vv) / 2.
    np.testing.assert_allclose(channels[HH][3], channels[VV][3], rtol=1e-14)
    # Geometric optics does not turn.
    specular = sigma0(polarization=[[HH], [VV]], cos_twist=np.cos(psi), tau=1.0)[0]
    assert np.all(specular == specular[0, 0])


def local_amplitudes(theta, eps):
    """a_hh, a_vv by the textbook's own arithmetic, in complex double."""
    c, s2 = np.cos(theta), np.sin(theta) ** 2
    q = np.sqrt(eps - s2 + 0j)
    a_vv = (eps - 1.0) * (s2 - eps * (1.0 + s2)) / (eps * c + q) ** 2
    return (c - q) / (c + q), a_vv


def test_channels_share_one_phase():
    """Complex amplitudes, lossy: HH : VV : HV of a turned facet, which magnitudes alone would not give."""
    theta, psi, eps = np.radians([5.0, 30.0, 60.0, 85.0]), 0.6, 15.0 - 6.0j
    a_hh, a_vv = local_amplitudes(theta, eps)
    c2, s2 = np.cos(psi) ** 2, np.sin(psi) ** 2
    expected = np.abs([a_hh * c2 + a_vv * s2, a_hh * s2 + a_vv * c2, (a_vv - a_hh) * np.sqrt(s2 * c2)]) ** 2
    got = sigma0(polarization=[[HH], [VV], [HV]], theta=theta, cos_twist=np.cos(psi), eps_re=15.0, eps_im=6.0)[0]
    np.testing.assert_allclose(got / got[0], expected / expected[0], rtol=1e-12)


def test_depolarisation_in_closed_form():
    """a_vv - a_hh = -2 (eps - 1)^2 sin^2 q / ((eps cos + q)^2 (cos + q)), which is 0 at nadir."""
    theta, eps = np.radians([0.0, 1.0, 20.0, 45.0, 80.0]), 9.0 - 2.0j
    c, s2 = np.cos(theta), np.sin(theta) ** 2
    q = np.sqrt(eps - s2)
    difference = 2.0 * (eps - 1.0) ** 2 * s2 * q / ((eps * c + q) ** 2 * (c + q))
    hh, hv = (
        sigma0(polarization=p, theta=theta, cos_twist=w, eps_re=9.0, eps_im=2.0)[0]
        for p, w in ((HH, 1.0), (HV, np.sqrt(0.5)))
    )
    # Subtracting two amplitudes of order 1 leaves 1e-16 / sin^2; at 1 degree 3e-4.
    np.testing.assert_allclose(
        hv / hh, np.abs(difference) ** 2 / 4.0 / np.abs((c - q) / (c + q)) ** 2, rtol=1e-11, atol=1e-30
    )


def test_perfect_conductor():
    """|eps| -> inf: a_hh -> -1, a_vv -> -(1 + sin^2) / cos^2 of the same sign, to O(1 / sqrt|eps|) = 1e-6."""
    theta = np.radians([0.0, 20.0, 45.0, 70.0])
    metal = {"theta": theta, "eps_re": 1.0, "eps_im": 1e14}
    hh, vv = (sigma0(polarization=p, **metal)[0] for p in (HH, VV))
    hv = sigma0(polarization=HV, cos_twist=np.sqrt(0.5), **metal)[0]
    s2, c2 = np.sin(theta) ** 2, np.cos(theta) ** 2
    np.testing.assert_allclose(vv / hh, ((1.0 + s2) / c2) ** 2, rtol=1e-5)
    np.testing.assert_allclose(hv / hh, (s2 / c2) ** 2, rtol=1e-5, atol=1e-12)
    printed = sigma0(polarization=[[HH], [VV]], variant=AS_PRINTED, **metal)[0]
    np.testing.assert_allclose(printed[1], printed[0], rtol=1e-5)


# --- reflectivities


def test_fresnel_reflectivities():
    theta = np.radians([0.0, 30.0, 60.0, 89.0])
    for eps in (1.0, 6.885, 75.0, 15.0 - 3.0j, 1.5 - 1e4j):
        eps = complex(eps)
        h, v = fresnel(np.cos(theta), eps.real, -eps.imag)
        c = np.cos(theta)
        q = np.sqrt(eps - np.sin(theta) ** 2)
        # What is not reflected is transmitted (Poynting): 4 c Re q / |c + q|^2, and with q / eps for V.
        np.testing.assert_allclose(h, 1.0 - 4.0 * c * q.real / np.abs(c + q) ** 2, rtol=1e-12, atol=1e-15)
        y = q / eps
        np.testing.assert_allclose(v, 1.0 - 4.0 * c * y.real / np.abs(c + y) ** 2, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(h[0], v[0], rtol=1e-14)
        assert np.all(h[1:] >= v[1:])
    # Brewster: tan theta = n. The residue is the rounding of the cosine, squared.
    assert fresnel(1.0 / np.sqrt(1.0 + 6.885), 6.885, 0.0)[1][0] < 1e-30


def test_bistatic_coefficient():
    """Backscatter at half angle 0; elsewhere the reflectivity at the half angle replaces |R0|^2."""
    theta, half, eps = np.radians([0.0, 10.0, 40.0]), np.radians(55.0), (6.885, 0.9)
    m2 = 2.0 * (SURFACE["rms_height"] / SURFACE["length_x"]) ** 2

    def bistatic(polarization, cos_half_angle):
        columns = {
            "polarization": polarization,
            "cos_half_angle": cos_half_angle,
            "cos_tilt": np.cos(theta),
            "eps_re": eps[0],
            "eps_im": eps[1],
            "slope_variance": m2,
        }
        return launch(bistatic_kernel, columns)[0]

    for polarization, r in zip((HH, VV), fresnel(np.cos(half), *eps), strict=True):
        backscatter = sigma0(polarization=polarization, theta=theta, tau=1.0)[0]
        np.testing.assert_allclose(bistatic(polarization, 1.0), backscatter, rtol=1e-13)
        t2 = np.tan(theta) ** 2
        expected = r * np.exp(-t2 / (2.0 * m2)) / (2.0 * m2 * np.cos(theta) ** 4)
        np.testing.assert_allclose(bistatic(polarization, np.cos(half)), expected, rtol=1e-12)
    assert np.all(bistatic(HV, np.cos(half)) == 0.0)


# --- statistics of the surface

# Gauss-Legendre on (0, 1) and the map x / (1 - x) to (0, inf).
NODES, WEIGHTS = np.polynomial.legendre.leggauss(200)
X, DX = 0.5 * (NODES + 1.0), 0.5 * WEIGHTS
RADIUS, DRADIUS = X / (1.0 - X), DX / (1.0 - X) ** 2


def test_geometric_optics_counts_every_slope_once():
    """pi |R0|^2 sec^4 p(slopes) with p normalised and of variance 2 h^2 / l^2 per axis."""
    slope = RADIUS
    r0 = fresnel(1.0, SURFACE["eps_re"], SURFACE["eps_im"])[0][0]
    specular = sigma0(theta=np.arctan(slope), tau=1.0, rms_height=0.004)[0]
    density = specular / (np.pi * r0 * (1.0 + slope**2) ** 2)
    measure = 2.0 * np.pi * slope * DRADIUS * density
    np.testing.assert_allclose(np.sum(measure), 1.0, rtol=1e-10)
    variance = 2.0 * (0.004 / SURFACE["length_x"]) ** 2
    np.testing.assert_allclose(np.sum(measure * slope**2) / 2.0, variance, rtol=1e-10)


def test_height_and_length_cannot_be_told_apart_by_geometric_optics():
    """d/dln h = -d/dln l exactly: the two gradients are the same products in another order (32 roundings)."""
    _, g = sigma0(theta=np.radians([0.0, 10.0, 30.0, 45.0, 70.0]), tau=1.0)
    dh, dl = g["rms_height"] * SURFACE["rms_height"], g["length_x"] * SURFACE["length_x"]
    np.testing.assert_allclose(dh, -dl, rtol=32 * 1.2e-16)
    assert np.all(np.abs(dh) > 0.0)


@pytest.mark.parametrize("code", [GAUSSIAN, EXPONENTIAL])
def test_isotropic_spectrum_is_normalised(code):
    h, length = 0.002, 0.008
    k, dk = RADIUS / length, DRADIUS / length
    w = spectrum(code, k, h, length, np.nan)
    # The exponential's x^-2 tail is smooth in the mapped variable: quadrature is exact to rounding.
    np.testing.assert_allclose(np.sum(2.0 * np.pi * k * w * dk), h * h, rtol=1e-10)
    if code == GAUSSIAN:  # the slope variance per axis, which geometric optics takes for granted
        np.testing.assert_allclose(np.sum(np.pi * k**3 * w * dk), 2.0 * (h / length) ** 2, rtol=1e-10)


def test_separable_spectrum_is_normalised():
    h, lx, ly = 0.002, 0.008, 0.003
    angle, weight = X * np.pi / 2.0, DX * np.pi / 2.0
    kx, ky = np.meshgrid(np.tan(angle) / lx, np.tan(angle) / ly, indexing="ij")
    measure = np.outer(weight / np.cos(angle) ** 2 / lx, weight / np.cos(angle) ** 2 / ly)
    k2 = kx**2 + ky**2
    w = spectrum(SEPARABLE, np.sqrt(k2).ravel(), h, lx, ly, (kx**2 / k2).ravel()).reshape(kx.shape)
    # Four quadrants. K of 1e7 / l against 1e2 / l: the square's rounding costs digits at the corners.
    np.testing.assert_allclose(4.0 * np.sum(w * measure), h * h, rtol=1e-8)


@pytest.mark.parametrize("code", [GAUSSIAN, EXPONENTIAL])
def test_spectrum_transforms_the_correlation(code):
    """W(K) = h^2 / (2 pi) int C(r) J0(K r) r dr with C = exp(-r^2 / l^2) or exp(-r / l): what `l` means."""
    from scipy.special import j0

    h, length = 0.002, 0.008
    kl = np.array([0.0, 0.5, 1.0, 3.0])
    nodes, weights = np.polynomial.legendre.leggauss(400)
    reach = 45.0  # exp(-45) = 3e-20
    r, dr = reach * (nodes + 1.0) / 2.0, reach * weights / 2.0
    correlation = np.exp(-(r**2)) if code == GAUSSIAN else np.exp(-r)
    transform = (correlation * r * dr) @ j0(np.outer(r, kl)) * (h * length) ** 2 / (2.0 * np.pi)
    np.testing.assert_allclose(spectrum(code, kl / length, h, length, np.nan), transform, rtol=1e-11)


def test_separable_spectrum_is_a_product():
    """Transform of exp(-|x| / lx - |y| / ly): a Lorentzian per axis, not the isotropic exponential's."""
    h, lx, ly, k, phi = 0.002, 0.008, 0.003, 150.0, 0.4

    def axis(component, length):
        return length / (np.pi * (1.0 + (component * length) ** 2))

    expected = h**2 * axis(k * np.cos(phi), lx) * axis(k * np.sin(phi), ly)
    np.testing.assert_allclose(spectrum(SEPARABLE, k, h, lx, ly, np.cos(phi) ** 2), expected, rtol=1e-14)
