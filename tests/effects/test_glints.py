"""Points of known cross-section against their closed forms."""

import numpy as np
import pytest
from effect_worlds import Case, pair, plane, refusal, with_effect
from worlds import axes, view

from warpsar.simulation.command import simulate

pytestmark = pytest.mark.unit

WORKING = [
    Case({"strength": 1.0, "points": [[0.4, -0.3, 1.0, 0.0, 180.0, 3.0]]}),
    Case({"strength": 0.5, "points": [[0.4, -0.3, 1.0, 10.0, 20.0, 6.0]]}, {"slant_range_m": 300.0}),
]
# float32 sums beside the image's own power
SUMS = 1e-4
PIXEL_M2 = 0.25


def added(table: dict[str, object], azimuth_deg: float = 20.0, effects: dict[str, object] | None = None) -> np.ndarray:
    """What glints add to `plane`, seen at 40 degrees of incidence."""
    scene = plane(views=view(azimuth_deg, 40.0))
    for name, other in (effects or {}).items():
        scene = with_effect(scene, name, other)  # type: ignore[arg-type]
    without, with_it = pair(scene, "glints", table)
    return with_it - without


def test_power_is_the_cross_section() -> None:
    """beta0 is cross-section per area of a pixel: its sum over the image, times that area, is `strength` x 4 m2; with
    the declared response, too."""
    table = {"strength": 0.5, "points": [[1.1, 0.7, 1.5, 0.0, 180.0, 10.0 * np.log10(4.0)]]}
    assert added(table).sum() * PIXEL_M2 == pytest.approx(2.0, rel=SUMS)
    response = {"point_spread": {"range_fwhm_m": 0.8, "azimuth_fwhm_m": 0.9, "window": "taylor", "fixed": True}}
    # a Taylor window's sidelobes beyond the image's edge
    assert added(table, effects=response).sum() * PIXEL_M2 == pytest.approx(2.0, rel=2e-3)


def test_a_point_lies_at_its_range_and_azimuth() -> None:
    """The centroid of its power, about the image's middle, is its place along the axes of range and of azimuth."""
    place = np.array([1.13, 0.71, 1.52])
    power = added({"strength": 1.0, "points": [[*place, 0.0, 180.0, 6.0]]})
    d, u, _ = axes(20.0, 40.0)
    row, col = (np.arange(n) - (n - 1) / 2.0 for n in power.shape)
    found = [(power.sum(axis=1) @ row) * 0.5 / power.sum(), (power.sum(axis=0) @ col) * 0.5 / power.sum()]
    # a 2e-4th of the image's extent, by float32 sums
    assert found == pytest.approx([place @ d, place @ u], abs=2e-3)


@pytest.mark.parametrize(
    ("azimuth_deg", "share"), [(30.0, 1.0), (42.0, 0.5), (18.0, 0.5), (54.0, 0.0625), (210.0, 0.0)]
)
def test_the_lobe_is_a_gaussian_of_the_radars_azimuth(azimuth_deg: float, share: float) -> None:
    """Half is left at the half width, 12 degrees, and a sixteenth at twice as much, about 30 degrees."""
    power = added({"strength": 1.0, "points": [[0.0, 0.0, 1.0, 30.0, 12.0, 0.0]]}, azimuth_deg)
    assert power.sum() * PIXEL_M2 == pytest.approx(share, rel=SUMS, abs=1e-4)


def test_points_add_up_and_leave_the_image_at_its_edge() -> None:
    rows = [[0.0, 0.0, 1.0, 0.0, 180.0, 0.0], [2.0, 1.0, 0.5, 0.0, 180.0, 3.0]]
    each = [added({"strength": 1.0, "points": [row]}) for row in rows]
    both = added({"strength": 1.0, "points": rows})
    np.testing.assert_allclose(both, sum(each), atol=1e-5 * both.max())
    assert added({"strength": 1.0, "points": [[500.0, 0.0, 0.0, 0.0, 180.0, 30.0]]}).max() == 0.0


def test_the_cross_polarized_image_stays() -> None:
    scene = plane(polarizations=("HV",))
    table = {"strength": 1.0, "points": [[0.0, 0.0, 1.0, 0.0, 180.0, 10.0]]}
    images = [simulate(one, device="cpu")[0].beta0["HV"] for one in (scene, with_effect(scene, "glints", table))]
    assert np.array_equal(*images)


@pytest.mark.parametrize(
    "points",
    [[[0.0, 0.0, 1.0, 0.0, 180.0]], [[0.0, 0.0, 1.0, 0.0, 0.0, 3.0]], [[0.0, 0.0, "up", 0.0, 9.0, 3.0]], 3.0],
)
def test_a_row_that_is_no_point_is_refused(points: object) -> None:
    said = refusal("glints", {"strength": 1.0, "points": points})
    assert "effects.glints.points: found" in said
    assert "allowed is a list of [east, north, up, azimuth, half width, level]" in said


def test_a_strength_of_no_points_is_refused() -> None:
    assert "effects.glints.points: missing; allowed is a list of" in refusal("glints", {"strength": 1.0})
