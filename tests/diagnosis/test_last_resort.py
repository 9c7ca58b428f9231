"""The last resort of diagnose: a law of backscatter learned from images, kept where views left out bear it."""

from base64 import b64decode
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from conftest import benchmark

from warpsar import Material, Scene, diagnose, simulate
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.refit import Fitted, refit_as
from warpsar.diagnosis.report.page import law_section
from warpsar.diagnosis.result import Diagnosed
from warpsar.diagnosis.search.confirmation import NOT_ELSEWHERE
from warpsar.diagnosis.search.loop import Search, learned_law
from warpsar.diagnosis.turn.addition import TOO_LITTLE
from warpsar.effects.learned_scattering import shape_db
from warpsar.errors import InputError, NothingLitError
from warpsar.runtime import devices
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.world.sigma0_table import Sigma0Table

ROOT = Path(__file__).resolve().parents[2]
LAW = {"hh_20": 2.0, "hh_40": -2.0, "hh_60": 2.0, "vv_20": -2.0, "vv_40": 2.0, "vv_60": -2.0}
PRICE = 4.0  # of 2 ln L, of a parameter: as diagnose has it where speckle is not correlated


def standing(effects: dict[str, dict[str, Any]]) -> tuple[FitSetup, Fitted]:
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
    one_bench, other = (FitSetup(device, Rays(Stage.of(scene, device), 700.0, seed), {}) for seed in (3, 4))
    setup = replace(one_bench, observations=frozen(one_bench, other, scene))
    return setup, refit_as(setup, scene)


def test_a_law_of_all_views_is_learned() -> None:
    setup, here = standing({"learned_scattering": LAW})
    found = learned_law(setup, here, PRICE)
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
    setup, here = standing({})
    found = learned_law(setup, here, PRICE)
    assert found is not None
    assert found[0].refused == TOO_LITTLE


@pytest.mark.full
def test_what_one_view_has_is_no_law() -> None:
    setup, here = standing({"view_gain": {"gain_db": {"v0": 4.0, "v1": -4.0, "v2": 4.0, "v3": -4.0}}})
    found = learned_law(setup, here, PRICE)
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


def diagnosed(truth: Callable[[Scene], Scene], folder: Path) -> Diagnosed:
    """Ground at five incidences, HH and VV, four looks, `ka_spm` declared; a sixth view tests."""
    references = benchmark("references")
    scene = Scene.load(ROOT / "data" / "in_domain" / "spm.toml")
    views = [
        scene.views[0].model_copy(update={"name": f"v{k}", "azimuth_deg": 75.0 * k, "incidence_deg": incidence})
        for k, incidence in enumerate((28.0, 34.0, 40.0, 46.0, 52.0, 45.0))
    ]
    scene = replace(scene, views=views)
    scene = references.measured(scene, references.clean_images(truth(scene)), folder, 4.0, 0)
    last = scene.views[-1].model_copy(update={"role": "test"})
    return diagnose(replace(scene, views=[*scene.views[:-1], last]), device="cpu")


@pytest.mark.slow
def test_it_is_accepted_where_no_window_raises_an_alarm(tmp_path: Path) -> None:
    """A table's images, HH bent up and VV down: the deviance tells, views left out and a test view bear it."""
    angles = np.arange(0.0, 91.0, 2.5)
    bend = 3.0 * np.exp(-(((angles - 40.0) / 10.0) ** 2) / 2)
    table = Sigma0Table(angles, {"HH": -8.0 - 0.25 * angles + bend, "VV": -7.0 - 0.22 * angles - bend})
    table.write(tmp_path / "surface.csv")
    soil = Material(model="facet", sigma0=tmp_path / "surface.csv")
    done = diagnosed(lambda scene: replace(scene, materials={"soil": soil}), tmp_path)
    assert not any(turn.alarms for turn in done.diagnosis.turns)
    assert done.diagnosis.verdict == ["learned_scattering"]
    for role in ("train", "test"):
        before, after = done.before[role], done.after[role]
        assert before is not None
        assert after is not None
        assert before["deviance"] > 1.25
        assert after["deviance"] < 1.08  # bumps 80 degrees wide leave something of a bend 20 degrees wide
    law = done.diagnosis.final.scene.effects["learned_scattering"]
    apart = shape_db(law, "HH", np.array([28.0, 40.0, 52.0])) - shape_db(law, "VV", np.array([28.0, 40.0, 52.0]))
    assert apart[1] > apart[[0, 2]].max() + 0.5  # HH over VV about 40 degrees, which no eps, h and l has


@pytest.mark.slow
def test_it_is_not_named_where_a_named_effect_explains_the_images(tmp_path: Path) -> None:
    done = diagnosed(lambda scene: replace(scene, effects={"saturation": {"exponent": 0.8}}), tmp_path)
    assert done.diagnosis.verdict == ["saturation"]


def test_no_lit_ground_ends_the_search_and_no_other_refusal_does() -> None:
    search = Search.__new__(Search)

    def judge(error: type[InputError]) -> Any:
        def call(*_: Any) -> None:
            raise error("v0: no")

        return call

    search._judge = judge(NothingLitError)
    assert not search._left(cast(Scene, None))
    search._judge = judge(InputError)
    with pytest.raises(InputError, match="v0: no"):
        search._left(cast(Scene, None))
