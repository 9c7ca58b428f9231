"""The last resort of diagnose: a law of backscatter learned from images, kept where views left out bear it."""

from base64 import b64decode
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from warpsar import Scene, simulate
from warpsar.diagnosis.models.bench import Bench
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.refit import Fitted, refit_as
from warpsar.diagnosis.report.law import law_section
from warpsar.diagnosis.search.confirmation import NOT_ELSEWHERE
from warpsar.diagnosis.search.last_resort import learned_law
from warpsar.diagnosis.turn.addition import TOO_LITTLE
from warpsar.effects.learned_scattering import shape_db
from warpsar.runtime import devices
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage

ROOT = Path(__file__).resolve().parent.parent
LAW = {"hh_20": 2.0, "hh_40": -2.0, "hh_60": 2.0, "vv_20": -2.0, "vv_40": 2.0, "vv_60": -2.0}
PRICE = 4.0  # of 2 ln L, of a parameter: as diagnose has it where speckle is not correlated


def standing(effects: dict[str, dict[str, Any]]) -> tuple[Bench, Fitted]:
    """Rolling ground from four sides, HH and VV, four looks; the images have the effects, the model has not."""
    scene = Scene.load(ROOT / "data" / "in_domain" / "spm.toml")
    first = scene.views[0]
    views = [
        first.model_copy(update={"name": f"v{k}", "azimuth_deg": 90.0 * k, "stated_incidence_deg": 28.0 + 9.0 * k})
        for k in range(4)
    ]
    scene = replace(scene, views=views)
    random = np.random.default_rng(0)
    seen = []
    for one, view in zip(simulate(replace(scene, effects=effects), device="cpu"), views, strict=True):
        images = {p: (b * random.gamma(4.0, 0.25, b.shape)).astype(np.float32) for p, b in one.beta0.items()}
        seen.append(view.model_copy(update={"images": images, "looks": 4.0}))
    scene = replace(scene, views=seen)
    device = devices.resolve_device("cpu")
    one_bench, other = (Bench(device, Rays(Stage.of(scene, device), 700.0, seed), {}) for seed in (3, 4))
    bench = replace(one_bench, observations=frozen(one_bench, other, scene))
    return bench, refit_as(bench, scene)


def test_a_law_of_all_views_is_learned() -> None:
    bench, here = standing({"learned_scattering": LAW})
    found = learned_law(bench, here, PRICE)
    assert found is not None
    candidate, fitted = found
    assert not candidate.refused
    assert candidate.left_out is not None
    assert candidate.left_out.gain > 2 * candidate.left_out.error
    angles = np.linspace(20.0, 60.0, 9)
    table = fitted.scene.effects["learned_scattering"]
    # the surface's own eps, h and l share each shape's level and slope: what is left is the bend, which they have not
    for channel in ("HH", "VV"):
        bends = [np.polyfit(angles, shape_db(one, channel, angles), 2)[0] for one in (table, LAW)]
        assert bends[0] * bends[1] > 0
        assert abs(bends[0]) > 0.25 * abs(bends[1])


def test_nothing_is_learned_where_nothing_is_missing() -> None:
    bench, here = standing({})
    found = learned_law(bench, here, PRICE)
    assert found is not None
    assert found[0].refused == TOO_LITTLE


def test_what_one_view_has_is_no_law() -> None:
    bench, here = standing({"view_gain": {"gain_db": {"v0": 4.0, "v1": -4.0, "v2": 4.0, "v3": -4.0}}})
    found = learned_law(bench, here, PRICE)
    assert found is not None
    assert found[0].refused in (NOT_ELSEWHERE, TOO_LITTLE)


def test_its_shape_is_drawn_in_the_report() -> None:
    def done(effects: dict[str, dict[str, Any]]) -> Any:
        scene = SimpleNamespace(effects=effects)
        return SimpleNamespace(diagnosis=SimpleNamespace(final=SimpleNamespace(scene=scene)))

    assert law_section(done({"vegetation": {}})) == []
    (section,) = law_section(done({"learned_scattering": LAW}))
    encoded = section.split("data:image/svg+xml;base64,")[1].split('"')[0]
    drawn = b64decode(encoded).decode()
    assert drawn.count('id="line2d_') > 10  # ticks, the zero line, and one for each channel
    assert "learned factor on sigma0" in section
