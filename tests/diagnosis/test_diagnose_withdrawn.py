"""What test views take back: the one addition that makes them worse, and no other; numbers that a view holds."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from comparisons import comparison
from learning_scenes import cube_scene, measured
from worlds import view

from warpsar.diagnosis import result
from warpsar.diagnosis.found import DiagnoseOptions, Diagnosis
from warpsar.diagnosis.models.judge import Judge
from warpsar.diagnosis.models.refit import fit_model
from warpsar.diagnosis.result import _test_gain, judged
from warpsar.diagnosis.scores.templates import with_effect
from warpsar.diagnosis.search.procedure import diagnose_scene
from warpsar.runtime import devices
from warpsar.scene.scene import Scene

CPU = devices.resolve_device("cpu")
FLOOR = {"level": 0.01}
ANGLES = ((15.0, 35.0, "train"), (135.0, 48.0, "train"), (250.0, 42.0, "train"), (330.0, 40.0, "test"))


def scene_of(effects: dict[str, Any], folder: Path) -> Scene:
    views = [view(a, i, name=f"v{k}", role=role) for k, (a, i, role) in enumerate(ANGLES)]
    truth = replace(cube_scene(views, polarizations=("HH",), shape=44), effects=effects)
    return replace(measured(truth, folder), effects={})


@pytest.fixture(scope="module")
def floored(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """A floor, found."""
    found = diagnose_scene(
        scene_of({"noise_floor": FLOOR}, tmp_path_factory.mktemp("floored")), CPU, DiagnoseOptions(draws=400, starts=0)
    )
    assert found.verdict == ["noise_floor"]
    return found


@pytest.mark.full
def test_what_hurts_is_withdrawn_and_the_rest_stays(floored: Diagnosis) -> None:
    """A loss along range that the images do not have, held fixed in the final model: it goes, and the floor stays."""
    both = with_effect(floored.final.scene, "range_loss", {"per_m": 0.05, "fixed": True})
    hurt = replace(floored, final=fit_model(floored.setup, both, 0, 0))
    done = judged(hurt)
    assert done.diagnosis.withdrawn == ["range_loss"]
    assert set(done.diagnosis.final.scene.effects) == {"noise_floor"}
    assert done.verdict == ["noise_floor"]
    assert done.unexplained
    assert any("test views speak against" in one for one in done.reasons)
    after, before = done.after["test"], done.before["test"]
    assert after is not None
    assert before is not None
    assert after["deviance"] < before["deviance"]


@pytest.mark.full
def test_nothing_is_withdrawn_where_nothing_hurts(floored: Diagnosis) -> None:
    done = judged(floored)
    assert done.diagnosis.withdrawn == []
    assert (done.verdict, done.unexplained) == (["noise_floor"], False)


@pytest.mark.full
def test_a_name_that_is_not_earned_leaves_something_unexplained(
    floored: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where every test of the whole images is quiet, too: without the name this would be an all-clear."""
    monkeypatch.setattr(result, "not_established", lambda *_: {"noise_floor": "it may be another thing"})
    done = judged(floored)
    assert done.verdict == []
    assert done.reasons == ["noise_floor: it may be another thing"]
    assert done.unexplained


def test_numbers_of_single_views_are_fitted_to_test_views(tmp_path: Path) -> None:
    """A gain of its own in every view: no other view tells that of the test view, so the judgement fits it there."""
    gains = {"v0": 1.5, "v1": -1.0, "v2": 0.5, "v3": 3.0}
    scene = scene_of({"view_gain": {"gain_db": gains}}, tmp_path)
    train = {name: gains[name] for name in ("v0", "v1", "v2")}
    known = with_effect(scene, "view_gain", {"gain_db": train})
    judge = Judge(CPU)
    (plain,) = judge(known, "test")
    (own,) = judge.with_own_numbers(known)
    assert plain.metrics["deviance"] > 2.0  # 3 dB off, at 16 looks
    assert own.metrics["deviance"] == pytest.approx(1.0, abs=0.15)  # 1,300 pixels of deviance: 0.06 of their mean
    assert judge.with_own_numbers(scene)[0] is judge(scene, "test")[0]


def test_numbers_that_do_not_pay_stay_where_they_began(tmp_path: Path) -> None:
    """The test view lies where it should. Fitted to its speckle, a shift would be a centimetre or two of chance, which
    edges see."""
    shifts = {"range_m": {"v0": 0.4}, "azimuth_m": {"v0": -0.3}}
    scene = scene_of({"aim_point": shifts}, tmp_path)
    known = with_effect(scene, "aim_point", shifts)
    judge = Judge(CPU)
    (plain,), (own,) = judge(known, "test"), judge.with_own_numbers(known)
    assert own is not plain
    np.testing.assert_array_equal(own.simulated, plain.simulated)


@pytest.mark.full
def test_a_gain_of_every_view_pays_on_test_views_with_their_own(tmp_path: Path) -> None:
    """The test view is 3 dB brighter. With the gains of the others, which are not its own, it is as far off as before:
    that is no reason against the name. With its own it is right, and nothing is left."""
    gains = {"v0": 1.5, "v1": -1.0, "v2": 0.5, "v3": 3.0}
    found = diagnose_scene(
        scene_of({"view_gain": {"gain_db": gains}}, tmp_path), CPU, DiagnoseOptions(draws=400, starts=0)
    )
    done = judged(found)
    assert done.own_numbers
    assert done.reasons == []
    assert (done.verdict, done.unexplained) == (["view_gain"], False)
    for of in (done.before["test"], done.after["test"]):
        assert of is not None
        assert of["deviance"] > 2.0  # without a gain of its own: 3 dB off, at 16 looks


def refuted(true_share: float, change: float, looks: float, draws: int = 100) -> float:
    """Share of draws in which a test view speaks against a body that darkens a place: to `change` of the power there,
    while the images hold `true_share` of that, in dB."""
    shape, random = (48, 48), np.random.default_rng([int(100 * true_share), int(100 * change), int(looks)])
    plain = np.full(shape, 0.05)
    inside = np.zeros(shape, bool)
    inside[20:26, 15:20] = True
    darker, there = (np.where(inside, plain * change**share, plain) for share in (1.0, true_share))
    interior = np.pad(np.ones((42, 42), bool), 3)
    found = []
    for _ in range(draws):
        image = there * random.gamma(looks, 1.0 / looks, shape)
        pair = [comparison(image, mu, looks, name="v0", interior=interior) for mu in (plain, darker)]
        found.append(_test_gain([pair[0]], [pair[1]]).refuted)
    return float(np.mean(found))


@pytest.mark.full
@pytest.mark.parametrize("looks", [1.0, 4.0])
@pytest.mark.parametrize("change", [0.01, 0.7, 0.999])
def test_a_true_change_is_hardly_ever_refuted(change: float, looks: float) -> None:
    """A shadow, a weak one, and a change by which nothing in a test view is another: at 1 %, 6 of 100 or more come by
    chance in 0.06 % of all cases."""
    assert refuted(1.0, change, looks) <= 0.05


def test_a_false_change_is_refuted_where_a_view_can_tell() -> None:
    assert refuted(0.0, 0.1, 1.0, draws=20) > 0.9
    assert refuted(0.0, 0.999, 4.0, draws=20) <= 0.1  # a view that cannot tell refutes nothing
