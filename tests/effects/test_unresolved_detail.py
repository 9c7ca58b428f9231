"""Power of unresolved detail: how much, on what, and over which width."""

import numpy as np
import pytest
from effect_worlds import Case, pair, plane, refusal, render_of, street, with_effect
from worlds import view

pytestmark = pytest.mark.unit

WORKING = [
    Case({"level": 0.02, "spread_m": 1.3}),
    Case({"level": 0.05, "spread_m": 2.0, "materials": ["brick"]}, {"slant_range_m": 300.0}),
    Case({"level": 0.05, "spread_m": 1.0, "share": {"brick": 2.0, "soil": 0.5}}),
    Case({"level": 0.05, "spread_m": 1.0, "flash": 2.0, "flash_deg": 20.0, "axis_deg": 10.0}),
]


def test_power_is_the_outlines_area() -> None:
    """A square of 14 m, seen at 40 degrees from the zenith: its outline has 14^2 cos 40 m2. A pixel has 0.25 m2."""
    without, with_it = pair(plane(), "unresolved_detail", {"level": 0.3, "spread_m": 0.6})
    added = (with_it - without).sum() * 0.25
    # rays of 1 / 16 pixel's area at the border of 28 x 21 pixels
    assert added == pytest.approx(0.3 * 14.0**2 * np.cos(np.radians(40.0)), rel=5e-3)


def test_spread_is_that_of_a_gaussian() -> None:
    """Variances along both axes grow by (width / 2.3548)^2; the tails beyond 8 widths and the image's edge are lost."""
    moments = []
    for width in (0.01, 2.0):
        without, with_it = pair(plane(), "unresolved_detail", {"level": 0.3, "spread_m": width})
        added = with_it - without
        for axis, pixels in ((0, 40), (1, 48)):
            x = (np.arange(pixels) + 0.5 - pixels / 2) * 0.5
            line = added.sum(axis=1 - axis) / added.sum()
            moments.append((line * x**2).sum() - (line * x).sum() ** 2)
    grown = np.array(moments[2:]) - moments[:2]
    assert grown == pytest.approx((2.0 / 2.3548) ** 2, rel=0.01)


def test_it_lies_on_its_material_alone() -> None:
    scene = with_effect(street(), "unresolved_detail", {"level": 1.0, "spread_m": 1e-3, "materials": ["brick"]})
    render = render_of(scene)
    render.forward()
    share = render.layers["beta0_detail_HH"].numpy()
    faces = render.hits.face.numpy()
    brick = scene.mesh.face_material[faces] == scene.mesh.materials.index("brick")
    pixels = np.unique(render.hits.pixel.numpy()[brick])
    assert share[pixels].min() > 0.0
    assert np.delete(share, pixels).max() < 1e-6 * share.max()


def test_a_share_is_a_factor_of_its_material() -> None:
    """Power is linear in the level, material by material: what each alone returns, times its share, is the whole."""
    whole, share = {}, {"brick": 3.0, "soil": 0.25}
    for name in share:
        without, with_it = pair(street(), "unresolved_detail", {"level": 0.4, "spread_m": 1.0, "materials": [name]})
        whole[name] = with_it - without
    table = {"level": 0.4, "spread_m": 1.0, "share": share, "materials": list(share)}
    without, with_it = pair(street(), "unresolved_detail", table)
    expected = sum(share[name] * power for name, power in whole.items())
    # float32 sums beside the image's own power
    assert with_it - without == pytest.approx(expected, rel=1e-4, abs=1e-6 * with_it.max())


def test_a_share_of_no_material_is_refused() -> None:
    said = refusal("unresolved_detail", {"level": 0.1, "share": {"glass": 2.0}})
    assert ".share: found glass; allowed are the materials" in said
    assert "allowed is a table of material names" in refusal("unresolved_detail", {"level": 0.1, "share": 2.0})


def test_the_cross_polarized_image_stays() -> None:
    scene = street()
    scene = scene.__class__(**{**vars(scene), "radar": scene.radar.model_copy(update={"polarizations": ("HV",)})})
    without, with_it = pair(scene, "unresolved_detail", {"level": 0.3, "spread_m": 1.0}, "HV")
    assert np.array_equal(without, with_it)


def test_a_material_that_is_not_there_is_refused() -> None:
    said = refusal("unresolved_detail", {"level": 0.1, "materials": ["glass"]})
    assert ".materials: found glass; allowed are" in said


@pytest.mark.parametrize(
    ("azimuth_deg", "axis_deg", "factor"),
    [
        (30.0, 30.0, 1.0 + 8.0),  # along the axis
        (300.0, 30.0, 1.0 + 8.0),  # across it
        (33.0, 30.0, 1.0 + 8.0 / 2.0),  # at the half width, on either side
        (207.0, 30.0, 1.0 + 8.0 / 2.0),
        (75.0, 30.0, 1.0 + 8.0 / (1.0 + 15.0**2)),  # half way between two axes
    ],
)
def test_it_flashes_along_the_axes_of_the_body(azimuth_deg: float, axis_deg: float, factor: float) -> None:
    """Lorentz's curve of the angle from the nearest axis, times the level. A round look at the same plane from any
    azimuth holds the same outline, to the rays at its border."""
    table = {"level": 0.3, "spread_m": 0.6}
    flash = {**table, "flash": 8.0, "flash_deg": 3.0, "axis_deg": axis_deg}
    scene = plane(views=view(azimuth_deg, 40.0))
    without, plain = pair(scene, "unresolved_detail", table)
    _, with_it = pair(scene, "unresolved_detail", flash)
    # float32 sums beside the image's own power
    assert (with_it - without).sum() / (plain - without).sum() == pytest.approx(factor, rel=1e-4)
