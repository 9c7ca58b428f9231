"""What every effect of the registry must do: start from nothing, have the derivatives it says, refuse nonsense."""

import dataclasses
import math
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_worlds import cases_of, gradients_of, module_of_tests, refusal, render_of, street, with_effect, working
from worlds import box, ground, mesh_of, scene_of, view

import warpsar.effects
from warpsar.effects import registry
from warpsar.effects.base.product import PRODUCTS
from warpsar.effects.base.trial import Context
from warpsar.effects.registry import check, declared, get, names, validate
from warpsar.errors import InputError
from warpsar.render.render import ViewRender
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate

ROOT = Path(__file__).resolve().parents[2]
WORKING = working()
IDS = [f"{name}-{'-'.join(map(str, table.values()))}"[:60] for name, table, _ in WORKING]
IMAGE = [(name, table) for name, table, _ in WORKING if get(name).stage == "image"]


@pytest.mark.parametrize("name", names())
def test_says_what_it_is(name: str) -> None:
    effect = get(name)
    assert effect.name == name
    assert effect.summary
    assert effect.parameters
    for p in effect.parameters:
        assert p.low <= p.default <= p.high
        low, high = p.fit_bounds
        assert p.low <= low < high <= p.high
        assert np.isfinite(p.to_coordinate([low, high])).all()
        middle = math.sqrt(low * high) if p.scale == "log" else (low + high) / 2
        assert p.from_coordinate(p.to_coordinate(middle)) == pytest.approx(middle, rel=1e-12)
        x, h = p.to_coordinate(middle), 1e-3
        difference = (p.from_coordinate(x + h) - p.from_coordinate(x - h)) / (2 * h)
        assert p.slope(x) == pytest.approx(difference, rel=1e-6)


@pytest.mark.parametrize("name", names())
def test_has_a_file_of_tests(name: str) -> None:
    """tests/effects/test_<name>.py, with cases in which every continuous parameter acts, and a test of its physics."""
    tests = module_of_tests(name)
    assert tests, f"effect {name} has no tests/effects/test_{name}.py"
    stated = {key for case in cases_of(name) for key in case.table}
    missing = {p.name for p in get(name).parameters} - stated
    assert not missing, f"tests/effects/test_{name}.py: WORKING has no case of {', '.join(sorted(missing))}"
    found = [key for key in tests if key.startswith("test_")]
    assert found, f"tests/effects/test_{name}.py holds no test"


@pytest.mark.parametrize("name", names())
def test_has_its_tables(name: str) -> None:
    """`example` for pictures, `rate_case` for the rates of the diagnosis: scene.toml would take both."""
    for key, views in (("example", ("v0", "v1")), ("rate_case", ("v0", "v1", "v2", "v3"))):
        assert hasattr(get(name), key), f"effect {name} has no {key}"
        table = getattr(get(name), key)
        assert validate(name, table, f"{name}.{key}", views)
        scene = Scene.load(ROOT / "data" / "example" / "scene.toml")
        seen = [view.model_copy(update={"name": one}) for one, view in zip(views, scene.views * 2, strict=False)]
        scene = dataclasses.replace(scene, views=seen, effects={name: validate(name, table, name)})
        assert any(declared(scene, view) for view in scene.views), f"{name}.{key} changes no view"


def unstated(name: str) -> list[str]:
    """Parameters with a value of their own where the table stands without them."""
    return [p.name for p in get(name).parameters if p.unstated is not None]


@pytest.mark.parametrize("name", names())
def test_a_table_that_states_nothing_acts_or_is_refused(name: str) -> None:
    """Without a value that brings the effect its table would do nothing, and nobody would say so."""
    effect, scene = get(name), street()
    bring = [p.name for p in effect.parameters if p.brings_it]
    others = {key: value for key, value in effect.example.items() if key not in bring}
    for table in ({}, others, {"fixed": True}):
        if unstated(name):
            of_view = declared(with_effect(scene, name, table), scene.views[0])
            assert [one.effect.name for one in of_view] == [name]
            continue
        with pytest.raises(InputError, match=rf"effects\.{name}: found .*{'.*'.join(bring)}.*has no effect"):
            validate(name, table, f"effects.{name}")


@pytest.mark.parametrize("name", [name for name in names() if unstated(name)])
def test_the_values_of_an_empty_table_are_those_that_it_could_state(name: str) -> None:
    stated = {p.name: p.unstated for p in get(name).parameters if p.unstated is not None}
    both = [simulate(with_effect(street(), name, table), device="cpu")[0].beta0["HH"] for table in ({}, stated)]
    assert np.array_equal(*both)
    assert not np.array_equal(both[0], simulate(street(), device="cpu")[0].beta0["HH"])


def test_the_page_of_effects_has_a_section_for_each() -> None:
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    sections = re.findall(r"^### (\w+)$", page, re.MULTILINE)
    missing, unknown = set(names()) - set(sections), set(sections) - set(names())
    assert not missing, f"docs/effects.md has no section {', '.join(sorted(missing))}"
    assert not unknown, f"docs/effects.md: no effect is called {', '.join(sorted(unknown))}"
    assert len(sections) == len(set(sections))


def test_the_page_of_effects_says_which_acts_on_what() -> None:
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    section = page.split("\n## On complex images, phase histories and curves\n")[1].split("\nHow they act")[0]
    found = [
        [cell.strip() for cell in row[1:-1].split("|")] for row in re.findall(r"^\| \[.*\|$", section, re.MULTILINE)
    ]
    assert found == [
        [f"[{name}](#{name})", *("yes" * (one in get(name).acts_on) for one in PRODUCTS), get(name).in_place]
        for name in names()
    ]


@pytest.mark.parametrize(("name", "table", "radar"), WORKING, ids=IDS)
def test_changes_the_image(name: str, table: dict[str, Any], radar: Mapping[str, Any]) -> None:
    scene = street(**radar)
    (plain, _), (changed, _) = simulate(scene, device="cpu"), simulate(with_effect(scene, name, table), device="cpu")
    assert not np.array_equal(plain.beta0["HH"], changed.beta0["HH"])
    assert np.isfinite(changed.beta0["HH"]).all()
    assert (changed.beta0["VV"] >= 0).all()


@pytest.mark.parametrize("name", names())
def test_neutral_changes_no_bit(name: str) -> None:
    scene = street()
    effect = get(name)
    neutral = {p.name: {} if p.keyed_by else p.neutral for p in effect.parameters if not math.isnan(p.neutral)}
    # without the parameters of another kind of scene
    neutral = {key: value for key, value in neutral.items() if effect.check(scene, {key: value}) is None}
    assert neutral
    declared_scene = with_effect(scene, name, neutral)
    for before, after in zip(simulate(scene, device="cpu"), simulate(declared_scene, device="cpu"), strict=True):
        for polarization, image in before.beta0.items():
            assert np.array_equal(image, after.beta0[polarization])


@pytest.mark.parametrize(("name", "table", "radar"), WORKING, ids=IDS)
def test_program_at_neutral_is_the_image_without(name: str, table: dict[str, Any], radar: Mapping[str, Any]) -> None:
    """On the same hits, with the effect in the program: a fit may start there, a template is taken there."""
    render = render_of(with_effect(street(**radar), name, table))
    bare = ViewRender(render.stage, render.view, render.hits, render.shape, ("HH", "VV"), [])
    at = [p.start if math.isnan(p.neutral) else p.neutral for p in get(name).parameters]
    render.set_parameters(render.stage.surface.nodes, {name: np.array(at)})
    for polarization, image in bare.forward().items():
        # float32: a sum in another order, or a product with 1 - 1e-7
        assert render.forward()[polarization] == pytest.approx(image, rel=2e-5, abs=2e-6 * float(image.max()))
    gradients = gradients_of(render, np.ones(render.shape))
    assert all(np.isfinite(g).all() for g in gradients.values())


@pytest.mark.parametrize(("name", "table", "radar"), WORKING, ids=IDS)
def test_derivatives_are_finite_differences(name: str, table: dict[str, Any], radar: Mapping[str, Any]) -> None:
    """Of the stated parameters, and of every surface node seen through the effect.

    float32 images: a sum of 500 terms is good to 1e-7 and better, over a step of 3e-3 that is 2e-5 of a derivative of
    order 1; truncation is as much again.
    """
    render = render_of(with_effect(street(**radar), name, table))
    seed = np.random.default_rng(5).uniform(0.5, 1.5, render.shape)
    nodes = render.stage.surface.nodes.copy()
    effect = declared(with_effect(street(**radar), name, table), render.view)[0]
    values = effect.values.copy()
    gradients = gradients_of(render, seed)

    def loss() -> float:
        return sum(float((seed * image.astype(float)).sum()) for image in render.forward().values())

    scale = loss()
    for index, parameter in enumerate(effect.effect.parameters):
        if parameter.name not in table:
            continue
        step = 0.003 * abs(values[index])
        ends = []
        for sign in (1, -1):
            moved = values.copy()
            moved[index] += sign * step
            render.set_parameters(nodes, {name: moved})
            ends.append(loss())
        difference = (ends[0] - ends[1]) / (2 * step)
        assert gradients[name][index] == pytest.approx(difference, rel=5e-3, abs=2e-6 * scale / step)
    for index in range(nodes.size):
        if nodes[index] < -30:  # tau = 0: no derivative
            continue
        ends = []
        for sign in (1, -1):
            moved_nodes = nodes.copy()
            moved_nodes[index] += sign * 0.01
            render.set_parameters(moved_nodes, {name: values})
            ends.append(loss())
        difference = (ends[0] - ends[1]) / 0.02
        assert gradients["nodes"][index] == pytest.approx(difference, rel=5e-3, abs=1e-4 * scale)


@pytest.mark.parametrize(("name", "table"), IMAGE)
def test_an_image_effect_alone_is_the_same(name: str, table: dict[str, Any]) -> None:
    render, bare = render_of(with_effect(street(), name, table)), render_of(street())
    effect = declared(with_effect(street(), name, table), render.view)[0]
    alone = bare.image_with(effect, bare.forward()["VV"])
    # to the bit, but for a sum whose terms may come in another order
    assert alone == pytest.approx(render.forward()["VV"], rel=1e-6)
    assert set(bare.settings) == set()


@pytest.mark.parametrize("name", names())
def test_trials_can_be_declared(name: str) -> None:
    """Steps from neutral are tables that scene.toml would take, and change the images they say they change."""
    scene = street()
    trials = get(name).trials(Context(scene, 0.01))
    assert bool(trials) != (get(name).of_phase or get(name).of_left_out)
    parameters = {p.name for p in get(name).parameters}
    for trial in (*trials[:1], *trials[-1:]):
        assert all(set(start) & parameters for start in trial.starts)
        for start in trial.starts:
            check(with_effect(scene, name, dict(start)))
        for step in trial.steps:
            assert step.size > 0
            assert step.one_sided == (step.minus is None)
            plus = simulate(with_effect(scene, name, dict(step.plus)), device="cpu")
            for before, after in zip(simulate(scene, device="cpu"), plus, strict=True):
                if step.views is not None and before.name not in step.views:
                    assert np.array_equal(before.beta0["HH"], after.beta0["HH"])


REFUSED = [
    (
        "point_spread",
        {"range_fwhm_m": 1.0, "cells": [1.0, 2.0]},
        "effects.point_spread.cells: found [1.0, 2.0]; allowed",
    ),
    ("point_spread", {"range_fwhm_m": 1.0, "cells": [[0.8, "sinc"], [0.7, "none"]]}, "allowed is a pair for range"),
    ("noise_floor", {"level": -1.0}, "effects.noise_floor.level: found -1.0; allowed is 0 to 1e+09 beta0"),
    ("multibounce", {"strength": -1.0}, "allowed is 0 to 1e+06\n"),
    ("multibounce", {"strength": True}, "allowed is a number\n"),
    ("noise_floor", {"level": True}, "allowed is a number [beta0]\n"),
    ("noise_floor", {"level": math.inf}, "allowed is a number"),
    ("noise_floor", {"level": math.nan}, "allowed is a number"),
    ("noise_floor", {"height": 1.0}, "height: unknown key; allowed are level"),
    ("view_gain", {"gain_db": 3.0}, "allowed is a table of view names"),
    ("view_gain", {"gain_db": {"nobody": 3.0}}, "found 'nobody'; allowed are the views v0, v1"),
    ("view_gain", {"gain_db": {"v0": "loud"}}, "gain_db.v0: found 'loud'"),
    ("glitter", {}, "found 'glitter'; allowed are eps_gradient"),
    ("noise_flor", {}, "saturation; did you mean noise_floor?"),
    ("noise_floor", {"levl": 1.0}, "; did you mean level?"),
]


@pytest.mark.parametrize(("name", "table", "message"), REFUSED)
def test_refuses(name: str, table: dict[str, Any], message: str) -> None:
    assert message in f"{refusal(name, table)}\n"


@pytest.mark.parametrize("name", names())
def test_discrete_choices_are_not_learned(name: str) -> None:
    effect = get(name)
    known = ", ".join(p.name for p in effect.parameters)
    for setting in effect.settings:
        with pytest.raises(InputError, match=f"{setting.name}: is discrete and cannot be learned; allowed are {known}"):
            effect.parameter(setting.name)
    for parameter in effect.parameters:
        assert effect.parameter(parameter.name) is parameter


DOUBLING = '''
from typing import Any

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import EffectParameter
from warpsar.effects.base.recorder import Recorder
from warpsar.kernels.effects import view_gain as kernels


class Doubling(Effect):
    """As much again of everything."""

    name = "doubling"
    stage = "gain"
    order = 99
    summary = "as much again"
    parameters = (EffectParameter("gain_db", "dB", 0.0, -10.0, 10.0, 1.0, description="Gain."),)

    def gain(self, render: Recorder, p: Any, sigma: Any, points: Any) -> Any:
        result = render.program.array(sigma.shape[0])
        render.program.launch(kernels.gain_kernel, sigma.shape[0], [p, sigma], [result])
        return result


EFFECT = Doubling()
'''


@pytest.fixture
def forgetful() -> Iterator[None]:
    """The registry looks at its folder anew, before and after."""
    for look in (registry._files, registry.names):
        look.cache_clear()
    yield
    for look in (registry._files, registry.names):
        look.cache_clear()


@pytest.mark.usefixtures("forgetful")
def test_a_new_effect_is_a_file_in_the_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        validate("doubling", {}, "effects.doubling")
    registry._files.cache_clear()
    registry.names.cache_clear()
    (tmp_path / "doubling.py").write_text(DOUBLING)
    monkeypatch.setattr(warpsar.effects, "__path__", [*warpsar.effects.__path__, str(tmp_path)])
    assert names().index("doubling") == names().index("view_gain") + 1
    scene = street()
    (plain, _) = simulate(scene, device="cpu")
    (loud, _) = simulate(with_effect(scene, "doubling", {"gain_db": 10 * math.log10(2)}), device="cpu")
    assert loud.beta0["HH"] == pytest.approx(2 * plain.beta0["HH"], rel=1e-6)
    monkeypatch.delitem(sys.modules, "warpsar.effects.doubling")


def test_effects_work_together() -> None:
    """Gains and shifts act on further paths too; what the system does comes last."""
    mesh = mesh_of(soil=ground(18.0), wall=box((-3, -3, 0), (3, 1, 4)))
    scene = scene_of(mesh, view(0.0, 45.0), shape=(40, 40), rays_per_pixel=16.0)
    scene = with_effect(scene, "multibounce", {"strength": 1.0})
    scene = with_effect(scene, "edge_diffraction", {"strength": 1.0})
    plain = render_of(dataclasses.replace(scene, effects={**scene.effects}))
    plain.forward()
    everything = with_effect(with_effect(scene, "range_loss", {"per_m": 0.1}), "noise_floor", {"level": 0.01})
    render = render_of(everything)
    image = render.forward()["HH"].astype(float)
    rows = (np.arange(40) - 19.5) * 0.5
    for name in ("beta0_2_bounces_HH", "beta0_edges_HH"):
        before, after = (one.layers[name].numpy().astype(float).reshape(40, 40) for one in (plain, render))
        assert before.sum() > 0
        # a pixel's power lies within half a pixel of its middle: exp(0.1 * 0.25)
        expected = before * np.exp(-0.1 * rows)[:, None]
        assert after == pytest.approx(expected, rel=0.03, abs=1e-9)
    assert image.min() == pytest.approx(0.01)
