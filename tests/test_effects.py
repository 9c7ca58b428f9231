"""What every effect of the registry must do: start from nothing, have the derivatives it says, refuse nonsense."""

import dataclasses
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import BRICK, SOIL, box, ground, mesh_of, scene_of, view

import warpsar.effects
from warpsar.effects import registry
from warpsar.effects.base.trial import Context
from warpsar.effects.registry import check, declared, get, names, validate
from warpsar.errors import InputError
from warpsar.render.render import ViewRender
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.simulation.rays import trace_view
from warpsar.surface.stage import Stage

STRIP_MAP: dict[str, Any] = {"slant_range_m": 300.0}

# An effect at work, away from the kinks of piecewise linear interpolation; every continuous parameter appears.
WORKING: list[tuple[str, dict[str, Any], dict[str, Any]]] = [
    ("eps_gradient", {"per_m_east": 0.03, "per_m_north": -0.02}, {}),
    ("exponential_spectrum", {"weight": 0.4}, {}),
    ("two_scale", {"slope_variance": 0.02}, {}),
    ("two_scale", {"slope_variance": 0.02}, STRIP_MAP),
    ("vegetation", {"optical_depth": 0.2, "albedo": 0.1}, {}),
    ("antenna_pattern", {"beamwidth_m": 20.0, "boresight_m": 2.0}, {}),
    ("antenna_pattern", {"beamwidth_deg": 3.0, "boresight_deg": 0.4}, STRIP_MAP),
    ("range_loss", {"per_m": 0.03}, {}),
    ("range_loss", {"exponent": 3.0}, STRIP_MAP),
    ("view_gain", {"gain_db": {"view": 2.0, "other": -2.0}}, {}),
    ("registration", {"range_m": 0.31, "azimuth_m": -0.23}, {}),
    ("registration", {"range_m": 0.1, "east_m": 0.37, "north_m": 0.2, "up_m": -0.3}, STRIP_MAP),
    ("multibounce", {"strength": 0.8}, {}),
    ("multibounce", {"strength": 0.8, "max_bounces": 4}, STRIP_MAP),
    ("edge_diffraction", {"strength": 0.7}, {}),
    ("point_spread", {"range_fwhm_m": 1.7, "azimuth_fwhm_m": 1.2, "window": "gaussian"}, {}),
    ("point_spread", {"range_fwhm_m": 1.7, "azimuth_fwhm_m": 1.2, "window": "sinc"}, {}),
    ("point_spread", {"range_fwhm_m": 1.7, "azimuth_fwhm_m": 1.2, "window": "taylor"}, {}),
    ("azimuth_ambiguity", {"level": 0.05, "offset_m": 2.9}, {}),
    ("noise_floor", {"level": 0.003}, {}),
    ("interference", {"level": {"view": 0.01}, "rows": {"view": [[3, 5], [9, 10]]}}, {}),
    ("saturation", {"exponent": 0.8}, {}),
    ("saturation", {"exponent": 0.8, "pivot": 0.02}, {}),
]
IDS = [f"{name}-{'-'.join(map(str, table.values()))}"[:60] for name, table, _ in WORKING]


def street(**radar: Any) -> Scene:
    """A block on a plane, turned so that its walls mirror the radar's rays into the ground; 16 x 16 pixels."""
    mesh = mesh_of(soil=ground(18.0), brick=box((-2.0, -2.5, 0.0), (3.0, 1.0, 3.0)))
    return scene_of(
        mesh,
        [view(2.0, 42.0), view(80.0, 50.0, name="other")],
        shape=(16, 16),
        spacing_m=(0.75, 0.75),
        rays_per_pixel=16.0,
        materials={"soil": SOIL, "brick": BRICK},
        polarizations=("HH", "VV"),
        **radar,
    )


def with_effect(scene: Scene, name: str, table: dict[str, Any]) -> Scene:
    return dataclasses.replace(scene, effects={**scene.effects, name: validate(name, table, f"effects.{name}")})


def render_of(scene: Scene, *, neutral: bool = False) -> ViewRender:
    """The first view with its effects; those at neutral too where asked."""
    stage = Stage.of(scene, devices.resolve_device("cpu"))
    effects = declared(scene, scene.views[0], neutral=neutral)
    hits = trace_view(scene, stage, scene.views[0], seed=3, effects=effects)
    return ViewRender(stage, scene.views[0], hits, scene.grid.shape, scene.radar.polarizations, effects)


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


def test_every_parameter_is_at_work() -> None:
    stated = {(name, key) for name, table, _ in WORKING for key in table}
    assert {(name, p.name) for name in names() for p in get(name).parameters} <= stated


@pytest.mark.parametrize(("name", "table", "radar"), WORKING, ids=IDS)
def test_changes_the_image(name: str, table: dict[str, Any], radar: dict[str, Any]) -> None:
    scene = street(**radar)
    (plain, _), (changed, _) = simulate(scene, device="cpu"), simulate(with_effect(scene, name, table), device="cpu")
    assert not np.array_equal(plain.beta0["HH"], changed.beta0["HH"])
    assert np.isfinite(changed.beta0["HH"]).all()
    assert (changed.beta0["VV"] >= 0).all()


@pytest.mark.parametrize("name", names())
def test_neutral_changes_no_bit(name: str) -> None:
    scene = street()
    neutral = {p.name: {} if p.per_view else p.neutral for p in get(name).parameters if not math.isnan(p.neutral)}
    neutral = {key: value for key, value in neutral.items() if not key.endswith("_deg") and key != "exponent"}
    declared_scene = with_effect(scene, name, neutral if neutral else {})
    for before, after in zip(simulate(scene, device="cpu"), simulate(declared_scene, device="cpu"), strict=True):
        for polarization, image in before.beta0.items():
            assert np.array_equal(image, after.beta0[polarization])


@pytest.mark.parametrize(("name", "table", "radar"), WORKING, ids=IDS)
def test_program_at_neutral_is_the_image_without(name: str, table: dict[str, Any], radar: dict[str, Any]) -> None:
    """On the same hits, with the effect in the program: a fit may start there, a template is taken there."""
    render = render_of(with_effect(street(**radar), name, table))
    bare = ViewRender(render.stage, render.view, render.hits, render.shape, ("HH", "VV"), [])
    parameters = get(name).parameters
    at = [0.0 if math.isnan(p.neutral) and p.name.startswith("bore") else p.default for p in parameters]
    render.set_parameters(render.stage.surface.nodes, {name: np.array(at)})
    for polarization, image in bare.forward().items():
        # float32: a sum in another order, or a product with 1 - 1e-7
        assert render.forward()[polarization] == pytest.approx(image, rel=2e-5, abs=2e-6 * float(image.max()))
    gradients = gradients_of(render, np.ones(render.shape))
    assert all(np.isfinite(g).all() for g in gradients.values())


def gradients_of(render: ViewRender, seed: np.ndarray) -> dict[str, np.ndarray]:
    """d (sum of seed * images) to the nodes and to every effect's parameters."""
    render.program.forward()
    render.program.backward({image: seed.ravel().astype(np.float32) for image in render.images.values()})
    effects = {name: values.grad.numpy().astype(float) for name, values in render.effect_values.items()}
    return {"nodes": render.nodes.grad.numpy().astype(float), **effects}


@pytest.mark.parametrize(("name", "table", "radar"), WORKING, ids=IDS)
def test_derivatives_are_those_of_finite_differences(name: str, table: dict[str, Any], radar: dict[str, Any]) -> None:
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


@pytest.mark.parametrize(("name", "table"), [(name, table) for name, table, _ in WORKING if get(name).stage == "image"])
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
    assert trials
    parameters = {p.name for p in get(name).parameters}
    for trial in (trials[0], trials[-1]):
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


def test_trials_speak_of_the_kind_of_scene() -> None:
    context = Context(street(**STRIP_MAP), 0.01)
    assert "beamwidth_deg" in get("antenna_pattern").trials(context)[0].steps[0].plus
    assert "exponent" in get("range_loss").trials(context)[0].steps[0].plus
    assert get("view_gain").trials(Context(dataclasses.replace(street(), views=street().views[:1]), 0.01)) == []


def test_linear_and_square_step_of_the_antenna_are_that() -> None:
    """(I+ - I-) / (2 size I) is x for the linear step, (I+ - I0) / (size I0) is -x^2 for the square one."""
    scene = street()
    linear, square = get("antenna_pattern").trials(Context(scene, 0.01))[0].steps
    render = render_of(scene)
    x = render.hits.point.numpy() @ render.geometry.v

    def gain(table: Any) -> np.ndarray:
        return np.exp(-8 * math.log(2) * ((x - table["boresight_m"]) / table["beamwidth_m"]) ** 2)

    # second order in the step: 0.04 at the edge
    assert (gain(linear.plus) - gain(linear.minus)) / (2 * linear.size) == pytest.approx(x, rel=0.06, abs=1e-9)
    assert (gain(square.plus) - 1) / square.size == pytest.approx(-(x**2), rel=0.03, abs=1e-9)


REFUSED = [
    ("noise_floor", {"level": -1.0}, "effects.noise_floor.level: found -1.0; allowed is 0 to 1e+09 beta0"),
    ("noise_floor", {"level": True}, "allowed is a number"),
    ("noise_floor", {"level": math.inf}, "allowed is a number"),
    ("noise_floor", {"level": math.nan}, "allowed is a number"),
    ("noise_floor", {"height": 1.0}, "height: unknown key; allowed are level"),
    ("point_spread", {"window": "hann"}, "found 'hann'; allowed is 'sinc' or 'taylor' or 'gaussian'"),
    ("multibounce", {"max_bounces": 9}, "allowed is 2 or 3 or 4"),
    ("multibounce", {"max_bounces": True}, "allowed is 2 or 3 or 4"),
    ("view_gain", {"gain_db": 3.0}, "allowed is a table of view names"),
    ("view_gain", {"gain_db": {"nobody": 3.0}}, "found 'nobody'; allowed are the views view, other"),
    ("view_gain", {"gain_db": {"view": "loud"}}, "gain_db.view: found 'loud'"),
    ("interference", {"level": {"view": 0.1}}, "rows.view: missing"),
    ("interference", {"level": {"view": 0.1}, "rows": {"view": [[3, 3]]}}, "first < end"),
    ("interference", {"level": {"view": 0.1}, "rows": {"view": [[3, 99]]}}, "allowed are rows of the image, to 16"),
    ("antenna_pattern", {"beamwidth_deg": 20.0}, "allowed there are beamwidth_m and boresight_m"),
    ("range_loss", {"exponent": 3.0}, "allowed there is per_m"),
    ("saturation", {"pivot": 0.0}, 'a positive beta0 or "median"'),
    ("glitter", {}, "found 'glitter'; allowed are eps_gradient"),
]


@pytest.mark.parametrize(("name", "table", "message"), REFUSED)
def test_refuses(name: str, table: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refusal:
        check(with_effect(street(), name, table))
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_infinite_width_may_be_written() -> None:
    scene = with_effect(street(), "antenna_pattern", {"beamwidth_m": math.inf, "boresight_m": 1.0})
    assert declared(scene, scene.views[0]) == []


def test_discrete_choices_are_not_learned() -> None:
    with pytest.raises(InputError, match="window: is discrete and cannot be learned; allowed are range_fwhm_m"):
        get("point_spread").parameter("window")
    with pytest.raises(InputError, match="max_bounces: is discrete"):
        get("multibounce").parameter("max_bounces")
    assert get("point_spread").parameter("range_fwhm_m").unit == "m"


def test_view_gains_have_no_mean() -> None:
    scene = with_effect(street(), "view_gain", {"gain_db": {"view": 3.0}})
    assert [declared(scene, v)[0].values[0] for v in scene.views] == [1.5, -1.5]


DOUBLING = '''
from typing import Any

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import Parameter
from warpsar.effects.base.recorder import Recorder
from warpsar.kernels.effects import view_gain as kernels


class Doubling(Effect):
    """As much again of everything."""

    name = "doubling"
    stage = "gain"
    order = 99
    summary = "as much again"
    parameters = (Parameter("gain_db", "dB", 0.0, -10.0, 10.0, 1.0),)

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


def test_refinements_of_interference_move_one_end_or_add_one_band() -> None:
    """Bands stay inside the image, apart from one another, and a band that scored joins only where there is room."""
    scene = street()
    rows = scene.grid.shape[0]
    table = {"level": {"v0": 0.1}, "rows": {"v0": [[0, 2], [6, 8]]}}
    others = [
        {"level": {"v0": 0.2}, "rows": {"v0": [[7, 9]]}},  # overlaps
        {"level": {"v1": 0.3}, "rows": {"v1": [[4, 5]]}},
    ]
    found = get("interference").refinements(scene, table, others)
    moved = [one["rows"] for one, chosen in found if chosen == 0]
    assert {"v0": [[0, 3], [6, 8]]} in moved
    assert {"v0": [[0, 2], [5, 8]]} in moved
    for bands in (rows_of["v0"] for rows_of in moved):
        assert len(bands) == 2
        assert all(0 <= first < end <= rows for first, end in bands)
        assert bands[0][1] < bands[1][0]
        assert np.count_nonzero(np.array(bands) != np.array(table["rows"]["v0"])) == 1
    added = [one for one, chosen in found if chosen == 1]
    assert added == [{"level": {"v1": 0.3, "v0": 0.1}, "rows": {"v0": [[0, 2], [6, 8]], "v1": [[4, 5]]}}]
