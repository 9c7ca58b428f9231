"""Two passes over a sloped field, and a mover: theory's phase, coherence and displacement."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from collected_scenes import FREQUENCY, ROUGH, field, scene
from test_slc import points

import warpsar
from warpsar.collection.bodies import Bodies
from warpsar.collection.history import phase_history as recorded
from warpsar.collection.plan import plan_of
from warpsar.collection.scatterers import ScattererPart, Scatterers, body_of, spacing_m
from warpsar.collection.slc import focused
from warpsar.runtime import devices
from warpsar.world.frame import SPEED_OF_LIGHT

INCIDENCE, SLOPE = np.deg2rad(40.0), np.deg2rad(8.0)
CELL = 0.5
SHAPE = (56, 116)
SEEDS = 12
DISTANCE = 1e6
"""[m]: far enough for one baseline to be one angle in all of the field."""


def passed(incidence: float, seed: int) -> np.ndarray:
    """The complex image of a field that rises by 8 degrees away from the radar, which is in the north.

    Rows are as far apart on the field for any incidence: the passes need no registration.
    """
    made = scene(
        field(64.0, 64.0, lambda x, y: -y * np.tan(SLOPE)),
        view={"azimuth_deg": 0.0, "incidence_deg": float(np.rad2deg(incidence))},
        shape=SHAPE,
        spacing=(CELL * np.sin(incidence - SLOPE) / np.sin(INCIDENCE - SLOPE), CELL),
        material=ROUGH,
        radar={"terms": ("rough",)},
        collection={
            "slant_range_m": DISTANCE,
            "speed_m_s": 7500.0,
            "window": "none",
            "focus": "direct",
            "resolution_m": None,
            "bandwidth_hz": SPEED_OF_LIGHT / 2 / CELL,
            "aperture_deg": float(np.rad2deg(SPEED_OF_LIGHT / FREQUENCY / 2 / CELL)),
            "scatterers_per_cell": 8.0,
        },
    )
    (image,) = warpsar.slc(made, device="cpu", seed=seed)
    return image.images["HH"].astype(complex)


def pair(share: float) -> tuple[complex, float, int]:
    """Complex coherence of two passes, a `share` of the critical baseline apart, after the slope's fringes are taken
    off; what theory expects; and the looks."""
    # Gatelli et al. (IEEE TGRS 32(4), 1994): the spectra are shifted by f db / tan(incidence - slope).
    turn = share * SPEED_OF_LIGHT / 2 / CELL / FREQUENCY * np.tan(INCIDENCE - SLOPE)
    other = INCIDENCE + turn
    ratio = np.sin(other - SLOPE) / np.sin(INCIDENCE - SLOPE)
    rows = (np.arange(SHAPE[0]) + 0.5 - SHAPE[0] / 2) * CELL
    fringe = np.exp(-4j * np.pi * FREQUENCY / SPEED_OF_LIGHT * rows * (1.0 - ratio))[:, None]
    total, powers, looks = 0.0j, np.zeros(2), 0
    for seed in range(SEEDS):
        one, two = passed(INCIDENCE, seed), passed(other, seed)
        total += (one * two.conj() * fringe.conj()).sum()
        powers += [(np.abs(one) ** 2).sum(), (np.abs(two) ** 2).sum()]
        looks += one.size  # a pixel is a cell
    # Both bands along the field: B and f times the sines. Their overlap over their widths is 1 - share to first order.
    band = SPEED_OF_LIGHT / 2 / CELL
    overlap = max(0.0, band * (1.0 + ratio) / 2.0 - FREQUENCY * (ratio - 1.0))
    return total / np.sqrt(powers.prod()), overlap / band / np.sqrt(ratio), looks


@pytest.mark.full
@pytest.mark.parametrize("share", [0.25, 0.5, 0.75, 1.0])
def test_two_passes_over_a_sloped_field(share: float) -> None:
    """Coherence falls linearly to zero at the critical baseline; the phase is the slope's to 0.01 rad at a coherence of
    0.5, with 78,000 looks."""
    coherence, expected, looks = pair(share)
    assert looks > 15_000
    assert expected == pytest.approx(1.0 - share, abs=0.025)
    error = (1 - expected**2) / np.sqrt(2 * looks)
    # A step of the image's frequencies is 1 % of the band: half of it at either end.
    assert np.abs(coherence) == pytest.approx(expected, abs=4 * error + 0.005)
    if share <= 0.5:
        assert np.angle(coherence) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("side", ["right", "left"])
@pytest.mark.parametrize("speed", [0.2, -0.3])
def test_a_mover_is_displaced(side: str, speed: float) -> None:
    """By -R v_r / v along the flight, v_r away from the radar: it recedes, so it looks as if it were behind."""
    flown = {"speed_m_s": 100.0, "side": side, "resolution_m": (0.5, 0.5)}
    made = scene(field(8.0, 8.0), shape=(64, 320), spacing=(0.25, 0.25), collection=flown)
    cpu = devices.resolve_device("cpu")
    plan = plan_of(made, made.views[0], cpu)
    away = speed * plan.geometry.d
    still = points(plan, np.zeros((1, 3)), np.ones(1)).parts[0]
    moving = Scatterers((replace(still, velocity=away[None]),), 0.0)
    image = np.abs(focused(recorded(plan, moving, ("HH",), cpu), made.grid, cpu).images["HH"])
    at = np.unravel_index(image.argmax(), image.shape)
    flight = 1.0 if side == "right" else -1.0  # along columns
    expected = -plan.slant_range_m * speed / 100.0 * flight
    assert (at[1] + 0.5 - 160) * 0.25 == pytest.approx(expected, abs=0.3)
    assert isinstance(still, ScattererPart)


def test_an_object_moves_by_its_name(tmp_path: object) -> None:
    """`velocity_m_s` names an object: its faces alone have the velocity."""
    text = """
[scene]
[radar]
frequency_hz = 9.6e9
polarizations = ["HH"]
terms = ["single", "multibounce"]
[image]
shape = [64, 160]
spacing_m = [0.25, 0.25]
[materials.body]
conductor = true
[[objects]]
name = "still"
primitive = "trihedral"
size_m = [0.4, 0.4, 0.4]
material = "body"
position_m = [0.0, 0.0, 0.0]
heading_deg = 30.0
[[objects]]
name = "mover"
primitive = "trihedral"
size_m = [0.4, 0.4, 0.4]
material = "body"
position_m = [3.0, 0.0, 0.0]
heading_deg = 30.0
[collection]
resolution_m = [0.5, 0.5]
slant_range_m = 10e3
speed_m_s = 100.0
velocity_m_s = { mover = [0.0, 0.0, -0.05] }
[[views]]
name = "one"
azimuth_deg = 30.0
incidence_deg = 50.0
"""
    from pathlib import Path

    path = Path(str(tmp_path)) / "scene.toml"
    path.write_text(text, encoding="utf-8")
    (image,) = warpsar.slc(warpsar.Scene.load(path), device="cpu")
    power = np.abs(image.images["HH"]) ** 2
    strongest = image.azimuth_m[np.argsort(power.max(axis=0))[::-1]]
    # It sinks: v_r = 0.05 cos(50 deg) away, 3.2 m behind; it stands at 3 m cos(30 deg) ahead.
    expected = 3.0 * np.cos(np.deg2rad(30.0)) - 10e3 * 0.05 * np.cos(np.deg2rad(50.0)) / 100.0
    assert np.abs(strongest[:8] - 0.0).min() < 0.4
    assert np.abs(strongest[:8] - expected).min() < 0.5


def test_views_of_much_the_same_cells_share_a_surface() -> None:
    """A view's cells differ a little from those of others, and with them the number of scatterers of each face."""
    cpu = devices.resolve_device("cpu")
    made = scene(field(24.0, 24.0), radar={"terms": ("rough",)})
    first = plan_of(made, made.views[0], cpu)
    plans = [replace(first, step_hz=factor * first.step_hz) for factor in (1.0, 1.02, 0.5)]
    assert spacing_m(plans[0]) > spacing_m(plans[1])
    bodies = Bodies(made, plans, cpu, 0)
    shared = bodies.of(plans[0])
    assert bodies.of(plans[1]) is shared
    assert bodies.of(plans[2]) is not shared
    assert shared.scatterer_points.numpy() == pytest.approx(
        body_of(made, spacing_m(plans[1]), cpu, 0).scatterer_points.numpy()
    )
