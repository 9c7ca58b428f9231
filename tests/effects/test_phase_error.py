"""A phase error over slow time: Fresnel's integrals in complex images, the shift by its slope in images of power."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from effect_worlds import ROUNDING, Case, pair, plane, refusal, with_effect
from scipy.special import fresnel

import warpsar
from warpsar.collection.direct import direct, refuse_direct
from warpsar.collection.history import phase_history as recorded
from warpsar.collection.plan import Plan, plan_of
from warpsar.collection.scatterers import ScattererPart, Scatterers
from warpsar.collection.slc import Slc, focused
from warpsar.effects import registry
from warpsar.measured.gridding import Gridding, on_grid
from warpsar.runtime import devices
from warpsar.world.collection import Collection
from warpsar.world.taper import taper

KNOTS = [0.0, 1.0, -0.5, 0.3, 0.0]
WORKING = [
    Case({"quadratic_rad": {"v0": 3.0, "v1": 2.0}, "cubic_rad": {"v0": 1.5}, "quartic_rad": {"v0": -1.0}}),
    Case({"spline_rad": {"v0": 2.0}, "spline_shape": {"v0": KNOTS}}),
]
CELL_M = 0.5
WIDTH_M = 0.443
"""Half-power width of that cell without a taper."""
ROWS, COLS = 32, 128
PLACE = 1.125, 2.125
"""Range and azimuth of a point, in the middle of a pixel [m]."""
CPU = devices.resolve_device("cpu")


def test_power_is_shifted_by_the_slope_of_the_phase() -> None:
    """The sum over 64 places of the aperture, done in NumPy with images shifted by linear interpolation."""
    q, c = 4.0, 2.5
    blur = {"range_fwhm_m": 0.0, "azimuth_fwhm_m": 0.886 * 0.9, "window": "sinc"}
    scene = with_effect(plane(), "point_spread", blur)
    view = scene.views[0].name
    without, with_it = pair(scene, "phase_error", {"quadratic_rad": {view: q}, "cubic_rad": {view: c}})
    x = (np.arange(64) + 0.5) / 32 - 1.0
    cell = blur["azimuth_fwhm_m"] * 1.1288
    shift = cell / (np.pi * scene.grid.spacing_m[1]) * (2 * q * x + 3 * c * x**2)
    columns = np.arange(without.shape[1])
    expected = np.mean([[np.interp(columns - s, columns, row, left=0, right=0) for row in without] for s in shift], 0)
    inside = slice(12, -12)  # the interpolation of NumPy ends at the last pixel's centre
    assert with_it[:, inside] == pytest.approx(expected[:, inside], rel=10 * ROUNDING, abs=1e-7)


def test_the_shift_has_the_second_moment_of_the_response() -> None:
    """Of |h|^2, the transform of w(x) exp(j phi(x)): it grows by the mean of w^2 phi'^2, to the accuracy of sums.

    The weight is Hann's, which has second moments at all; `phase_at` gives phi.
    """
    effect = registry.get("phase_error")
    values, n = np.array([2.0, -1.0, 0.7, 1.0]), 4096
    x = (np.arange(n) + 0.5) / n * 2.0 - 1.0
    phi = effect.phase(values, {"spline_shape": KNOTS}, x)
    weight = taper("hann", 0.5 * x)

    def moments(field: Any) -> tuple[float, float]:
        power = np.abs(np.fft.fft(field, 64 * n)) ** 2
        place = -np.fft.fftfreq(64 * n, x[1] - x[0]) * 2.0 * np.pi  # in radians per unit of x
        mean = (power * place).sum() / power.sum()
        return float(mean), float((power * place**2).sum() / power.sum())

    (plain, spread), (mean, moment) = moments(weight), moments(weight * np.exp(-1j * phi))
    slope, share = np.gradient(phi, x), weight**2 / (weight**2).sum()
    assert plain == pytest.approx(0.0, abs=1e-6)
    assert mean == pytest.approx((share * slope).sum(), abs=2e-3)
    assert moment - spread == pytest.approx((share * slope**2).sum(), rel=2e-3)


def street(effects: dict[str, Any], **collection: Any) -> tuple[warpsar.Scene, Plan]:
    """A radar of a cell of half a metre, and its plan; what lies in the scene are `speck`s."""
    made = plane(shape=(ROWS, COLS), views=warpsar.View(name="one", azimuth_deg=30.0, incidence_deg=40.0))
    made = replace(
        made,
        grid=warpsar.Grid(shape=(ROWS, COLS), spacing_m=(0.25, 0.25)),
        radar=warpsar.Radar(frequency_hz=9.6e9, polarizations=("HH",), terms=("rough",)),
        collection=Collection(**({"mode": "spotlight", "slant_range_m": 10e3} | collection)),
        effects={},
    )
    made = with_effect(made, "point_spread", {"range_fwhm_m": WIDTH_M, "azimuth_fwhm_m": WIDTH_M, "window": "sinc"})
    for name, table in effects.items():
        made = with_effect(made, name, table)
    return made, plan_of(made, made.views[0], CPU)


def speck(plan: Plan) -> Scatterers:
    """A point in the middle of a pixel."""
    place = PLACE[0] * plan.geometry.d + PLACE[1] * plan.geometry.u
    part = ScattererPart(place[None], np.ones((1, 1), np.complex64), np.ones(len(plan.track), np.float32))
    return Scatterers((part,), 0.0)


def image(effects: dict[str, Any], focus: str, **collection: Any) -> Slc:
    made, plan = street(effects, focus=focus, **collection)
    if focus == "direct":
        return direct(plan, speck(plan), ("HH",), made.grid, CPU)
    return focused(recorded(plan, speck(plan), ("HH",), CPU), made.grid, CPU)


def response(q: float, u_m: np.ndarray) -> np.ndarray:
    """The mean of exp(j (q x^2 - pi x u / cell)) over -1 to 1, by Fresnel's integrals."""
    k = np.pi * u_m / CELL_M
    ends = [np.sqrt(2.0 * q / np.pi) * (sign - k / (2.0 * q)) for sign in (-1.0, 1.0)]
    (s0, c0), (s1, c1) = (fresnel(end) for end in ends)
    return np.exp(-1j * k**2 / (4.0 * q)) * np.sqrt(np.pi / (2.0 * q)) * ((c1 - c0) + 1j * (s1 - s0)) / 2.0


@pytest.mark.parametrize("focus", ["direct", "backprojection"])
def test_a_quadratic_error_gives_fresnels_integrals(focus: str) -> None:
    """A point under 2 pi at the aperture's ends, beside the point without an error: amplitude and phase."""
    q = 2.0 * np.pi
    plain, blurred = (image(one, focus) for one in ({}, {"phase_error": {"quadratic_rad": {"one": q}}}))
    row, column = np.unravel_index(np.abs(plain.images["HH"]).argmax(), (ROWS, COLS))
    expected = response(q, blurred.azimuth_m - PLACE[1])
    found = blurred.images["HH"][row] / plain.images["HH"][row, column]
    near = np.abs(blurred.azimuth_m - PLACE[1]) < 20.0 * CELL_M  # a direct response fades out from 24 cells on
    found, expected = found[near], expected[near]
    # 1 %: the aperture is cut into pulses, and the angle of a pulse from the point is not quite that from the middle.
    assert np.abs(found - expected).max() < 0.01 * np.abs(expected).max()


def test_direct_and_backprojected_images_have_the_same_odd_errors() -> None:
    """A cubic error and a spline without symmetry: a wrong sign of the place would mirror them."""
    table = {"cubic_rad": {"one": 5.0}, "spline_rad": {"one": 1.5}, "spline_shape": {"one": KNOTS}}
    ways = (("direct", "right"), ("backprojection", "right"), ("backprojection", "left"))
    first, *others = (image({"phase_error": table}, focus, side=side).images["HH"] for focus, side in ways)
    sharp = np.abs(image({}, "direct").images["HH"]).max()
    for other in others:  # 3 %: images without an error agree to 2 %, and the spline bends the phase between pulses
        assert np.abs(other - first).max() < 0.03 * sharp
    middle = COLS // 2 + round(PLACE[1] / 0.25 - 0.5)
    there = np.abs(first[:, middle - 20 : middle + 21])
    assert np.abs(there - there[:, ::-1]).max() > 0.3 * there.max()


@pytest.mark.parametrize("side", ["right", "left"])
def test_pulses_are_turned(side: str) -> None:
    """x rises along azimuth, whatever way the track is flown."""
    error = {"phase_error": {"quadratic_rad": {"one": 2.0}, "cubic_rad": {"one": 3.0}}}
    plans = [street(one, side=side)[1] for one in ({}, error)]
    plain, turned = (recorded(plan, speck(plan), ("HH",), CPU).samples for plan in plans)
    along = plans[0].track.receiver_m @ plans[0].geometry.u
    x = along / np.abs(along).max() * (len(along) - 1) / len(along)
    expected = np.exp(1j * (2.0 * x**2 + 3.0 * x**3))
    # A straight track's angle is its place to 1e-4 here; float32 keeps 1e-6 of a sample.
    assert turned / plain == pytest.approx(np.broadcast_to(expected, plain.shape), abs=1e-3)


def test_direct_is_refused_where_it_has_no_one_response() -> None:
    made, plan = street({"phase_error": {"quadratic_rad": {"one": 2.0}}}, mode="stripmap")
    with pytest.raises(warpsar.InputError, match='found "direct" with a phase error along a stripmap'):
        refuse_direct(plan, made.name)
    made, plan = street({"phase_error": {"quadratic_rad": {"one": 200.0}}})
    with pytest.raises(warpsar.InputError, match=r"with a phase error that moves power by 1[0-9][0-9] cells"):
        refuse_direct(plan, made.name)


def test_what_cannot_be() -> None:
    assert "spline_rad.v0: found without spline_shape.v0" in refusal("phase_error", {"spline_rad": {"v0": 1.0}})
    with pytest.raises(warpsar.InputError, match="at least 4 numbers within 1000"):
        with_effect(replace(plane()), "phase_error", {"spline_rad": {"v0": 1.0}, "spline_shape": {"v0": [1.0, 2.0]}})


def test_a_phase_history_keeps_its_phase_on_the_grid_of_a_view() -> None:
    """What `import` makes of our own phase history is our own complex image of it, phase and all."""
    made, plan = street({"phase_error": {"cubic_rad": {"one": 4.0}}})
    collected = recorded(plan, speck(plan), ("HH",), CPU)
    how = Gridding(window_range="none", window_azimuth="none", samples=(1, 1), device="cpu")
    found = on_grid(collected.history("HH"), made, made.views[0], how)
    own = focused(collected, made.grid, CPU)
    assert found.slc is not None
    scale = np.sqrt(plan.response_m2)
    # The point lies off the level that `import` takes its pixels from by nothing; both focus in their own way.
    assert np.abs(found.slc - scale * own.images["HH"]).max() < 0.02 * np.abs(found.slc).max()
    assert on_grid(collected.history("HH"), made, made.views[0], replace(how, subapertures=2)).slc is None
