"""Fits of the diagnosis: where they begin, which are given up, what is dropped, and what views left out say."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from learning_scenes import cube_scene, measured, views_at
from scipy.ndimage import maximum_filter

from warpsar.diagnosis.dark.evidence import Dark, worth_a_refit
from warpsar.diagnosis.found import Candidate, Turn
from warpsar.diagnosis.models import refit
from warpsar.diagnosis.models.carried import Carried, carried_over
from warpsar.diagnosis.models.fit_setup import FitSetup, image_of
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.left_out import ViewsLeftOut, leave_one_view_out
from warpsar.diagnosis.models.refit import BOUND, Fitted, descend, fit_model, narrow, on_bounded_ground, refit_as
from warpsar.diagnosis.scores.templates import with_effect
from warpsar.diagnosis.search.confirmation import confirm
from warpsar.diagnosis.turn import pruning
from warpsar.diagnosis.turn.addition import TOO_LITTLE
from warpsar.diagnosis.turn.geometry_trial import with_edges
from warpsar.diagnosis.turn.pruning import prune, resettled, with_smaller
from warpsar.diagnosis.turn.screening import GLANCE, Screening
from warpsar.diagnosis.turn.shortlist import by_rank, surveyed
from warpsar.effects.base.trial import Context
from warpsar.effects.registry import get
from warpsar.learning.optimise import FitState
from warpsar.learning.results import learned_scene
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.speckle.scan import Spot
from warpsar.surface.stage import Stage

SHIFT = {"range_m": 0.33, "azimuth_m": -0.41}  # of pixels of 0.5 m
FLOOR = {"level": 0.01}
BLUR = {"range_fwhm_m": 0.9, "azimuth_fwhm_m": 0.8, "window": "gaussian"}
GHOST = {"level": 0.1, "offset_m": 6.0}
NEAR = ((20.0, 40.0), (21.0, 40.0))
# no view has an incidence angle to itself, which others could not tell of
ANGLES = ((20.0, 35.0), (140.0, 36.0), (250.0, 50.0), (310.0, 49.0))


def bench_of(
    effects: Mapping[str, Mapping[str, Any]], folder: Path, angles: Sequence[tuple[float, float]] = ANGLES
) -> tuple[FitSetup, Scene]:
    """A cube on a plane whose images hold `effects`; the scene declares none."""
    truth = replace(
        cube_scene(views_at(*angles), polarizations=("HH",), shape=44),
        effects={name: dict(table) for name, table in effects.items()},
    )
    scene = replace(measured(truth, folder), effects={})
    device = devices.resolve_device("cpu")
    rays, other = (Rays(Stage.of(scene, device), 256.0, seed) for seed in (3, 4))
    return FitSetup(device, rays, frozen(FitSetup(device, rays, {}), FitSetup(device, other, {}), scene)), scene


@pytest.fixture(scope="module")
def shifted(tmp_path_factory: pytest.TempPathFactory) -> tuple[FitSetup, Scene]:
    """Lines of double bounce 20 dB above the ground, and all of it moved by less than a pixel."""
    effects = {"multibounce": {"strength": 1.0}, "registration": SHIFT}
    setup, scene = bench_of(effects, tmp_path_factory.mktemp("shifted"))
    return setup, with_effect(scene, "multibounce", {"strength": 1.0})


@pytest.fixture(scope="module")
def blurred(tmp_path_factory: pytest.TempPathFactory) -> tuple[FitSetup, Scene]:
    return bench_of({"point_spread": BLUR}, tmp_path_factory.mktemp("blurred"))


@pytest.fixture(scope="module")
def floor(tmp_path_factory: pytest.TempPathFactory) -> tuple[FitSetup, Scene]:
    return bench_of({"noise_floor": FLOOR}, tmp_path_factory.mktemp("floor"))


def likelihood(setup: FitSetup, scene: Scene) -> float:
    problem = setup.problem(scene)
    return -problem.value(problem.modelled_as_declared())


def fitted_to(setup: FitSetup, scene: Scene, effects: Mapping[str, Mapping[str, Any]]) -> Fitted:
    return fit_model(setup, replace(scene, effects={n: dict(t) for n, t in effects.items()}), 0, 0)


# Where fits begin


@pytest.mark.full
@pytest.mark.full
def test_pixels_that_rays_do_not_know_are_left_out_once_bounces_are_in_the_model(
    shifted: tuple[FitSetup, Scene],
) -> None:
    """They and those beside them: power may fall into either. Without bounces, no pixel is left out."""
    setup, scene = shifted
    other = replace(setup, rays=Rays(setup.rays.stage, setup.rays.rays_per_m2, 4))
    fitted = refit_as(setup, scene)
    narrowed, again = narrow(setup, other, fitted)
    problems = [replace(one, observations=setup.observations).problem(again.scene) for one in (setup, other)]
    for problem in problems:
        problem.modelled_as_declared()
    left_out = 0
    for number, (name, before) in enumerate(setup.observations.items()):
        one, two = (image_of(problem.views[number], "HH") for problem in problems)
        relative = 2.0 * np.abs(one - two) / np.maximum(one + two, 1e-30)
        limit = np.sqrt(0.2 / before[0].looks)  # half of its square, the variance of one set, is a tenth of speckle's
        gone = before[0].interior & ~narrowed.observations[name][0].interior
        assert gone[before[0].interior & (relative > 1.001 * limit)].all()
        assert (maximum_filter(relative, 3)[gone] > 0.999 * limit).all()
        left_out += int(gone.sum())
    assert 0 < left_out < 0.05 * sum(found[0].count for found in setup.observations.values())
    assert again.problem.scene.effects.keys() == scene.effects.keys()
    bare = refit_as(setup, replace(scene, effects={}))
    assert narrow(setup, other, bare)[0] is setup


def test_a_shift_of_bright_lines_is_searched_for(shifted: tuple[FitSetup, Scene]) -> None:
    """The search ends at the shift to what its last step, an eighth of a pixel, can tell; of the world's shifts, which
    cannot be this one in all views, it finds the best of a grid about it."""
    setup, scene = shifted
    alike, world = get("registration").trials(Context(scene, 0.01))
    (table,) = surveyed(setup, scene, "registration", alike)
    for key, value in SHIFT.items():
        assert table[key] == pytest.approx(value, abs=0.5 / 8)
    (anywhere,) = surveyed(setup, scene, "registration", world)
    assert likelihood(setup, with_effect(scene, "registration", anywhere)) < likelihood(
        setup, with_effect(scene, "registration", table)
    )


@pytest.mark.full
def test_a_shift_that_aim_points_contain_is_not_searched_for(shifted: tuple[FitSetup, Scene]) -> None:
    """A model with free aim points moves no number of registration, so a search has none to begin at."""
    setup, scene = shifted
    aimed = with_effect(scene, "aim_point", {"range_m": {"v0": 0.2}, "azimuth_m": {"v0": 0.0}})
    for trial in get("registration").trials(Context(scene, 0.01)):
        assert surveyed(setup, aimed, "registration", trial) == list(trial.starts)


@pytest.mark.full
def test_the_search_leads_the_fit_where_the_slope_at_zero_does_not(shifted: tuple[FitSetup, Scene]) -> None:
    setup, scene = shifted
    base = fit_model(setup, scene, 0, 0)
    zero = dict.fromkeys(SHIFT, 0.0)
    found = {}
    for start in ("zero", "searched"):
        trial = get("registration").trials(Context(scene, 0.01))[0]
        tables = [zero] if start == "zero" else surveyed(setup, base.scene, "registration", trial)
        found[start], _ = Screening(setup, base, scene, "registration", tables).finish(-np.inf)
    # of the scenes that came out: a fit that begins without a shift has no hits beyond the image's border to move in
    searched, zero_led = (likelihood(setup, found[start].scene) for start in ("searched", "zero"))
    assert searched > zero_led - 1.0
    for key, value in SHIFT.items():  # 16 looks, some 2,000 pixels with lines among them: a hundredth of a pixel
        assert found["searched"].scene.effects["registration"][key] == pytest.approx(value, abs=0.02)


def test_a_pixel_without_a_ray_counts_as_a_part_of_a_rays_share(floor: tuple[FitSetup, Scene]) -> None:
    """L (I / m - 1 - ln(I / m)) with m a quarter of one ray's share of what the pixel was declared to have, in the
    kernel as on the host, and no slope there; dark pixels keep their own darkness."""
    setup, scene = floor
    seen = setup.observations["v0"][0]
    assert seen.least is not None
    declared = setup.problem(scene).modelled_as_declared()[0]
    np.testing.assert_allclose(seen.least[seen.interior], declared / (4.0 * 256.0 / 4.0), rtol=1e-6)  # 64 a pixel
    interior = np.zeros_like(seen.interior)
    interior[tuple(np.argwhere(seen.dark)[0])] = True  # where no model of this scene puts light
    one = replace(seen, interior=interior, dark=np.zeros_like(seen.dark), least=np.full(seen.interior.shape, 1e-4))
    problem = replace(setup, observations={"v0": [one]}).problem(scene, ["v0"], dark=False)
    ratio = float(one.values[0]) / 1e-4
    expected = one.looks * (ratio - 1.0 - np.log(ratio))
    loss, gradient = problem.gradient(problem.x0)
    assert loss == pytest.approx(expected, rel=1e-5)  # float32
    assert problem.value(problem.modelled(problem.x0)) == pytest.approx(expected, rel=1e-6)
    assert (gradient == 0.0).all()
    assert replace(one, dark=interior).darkest[0] < 1e-15


# Which fits are given up


def test_a_fit_far_behind_is_given_up_and_no_other(floor: tuple[FitSetup, Scene]) -> None:
    setup, scene = floor
    far = replace(scene, materials={n: m.model_copy(update={"eps_r": 40.0}) for n, m in scene.materials.items()})
    base = fit_model(setup, scene, 0, 0)
    tables = [{"range_fwhm_m": 3.0, "azimuth_fwhm_m": 3.0}]
    screening = Screening(setup, replace(base, scene=far, log_likelihood=-np.inf), far, "point_spread", tables)
    assert screening.glanced.state.iteration <= GLANCE
    behind, given_up = screening.finish(base.log_likelihood + 1e5)
    assert given_up
    whole, finished = screening.finish(-np.inf)
    assert not finished
    assert whole.iterations > behind.iterations
    assert whole.log_likelihood >= behind.log_likelihood
    # nested in the base with widths of nothing: a fit that is let go on arrives no lower, but for speckle's ripples
    assert whole.log_likelihood > base.log_likelihood - 5.0


def test_a_surface_that_was_dragged_away_comes_back_from_the_declared_one(floor: tuple[FitSetup, Scene]) -> None:
    """A body in the wrong place drags its surface to where no descent leads back, once it stands where it should."""
    setup, scene = floor
    dragged = {"eps_r": 1.1, "rms_height_m": 2.0, "correlation_length_m": 2e-5}
    there = replace(scene, materials={**scene.materials, "cube": scene.materials["cube"].model_copy(update=dragged)})
    onward, anew = (refit_as(setup, there, declared) for declared in (None, scene))
    best = refit_as(setup, scene)
    # the declared surface is the true one here; the dragged one ends 5 of ln L below
    assert anew.log_likelihood == pytest.approx(best.log_likelihood, abs=1.0)
    assert onward.log_likelihood < best.log_likelihood - 3.0


def test_a_fit_that_cannot_reach_what_stands_is_given_up(floor: tuple[FitSetup, Scene]) -> None:
    """A fit far from its end is given up too, by its pace alone: those that get a limit start from a fitted model."""
    setup, scene = floor

    def started(**surface: float) -> Scene:
        cube = scene.materials["cube"].model_copy(update=surface)
        return replace(scene, materials={**scene.materials, "cube": cube})

    far, near = (
        started(eps_r=40.0, rms_height_m=2e-4),
        started(rms_height_m=1.02 * scene.materials["cube"].rms_height_m),
    )
    whole = refit_as(setup, far)
    given_up = refit_as(setup, far, limit=whole.log_likelihood + 1e5)
    assert given_up.iterations == GLANCE < whole.iterations
    whole = refit_as(setup, near)
    within_reach = refit_as(setup, near, limit=whole.log_likelihood)
    assert (within_reach.log_likelihood, within_reach.iterations) == (whole.log_likelihood, whole.iterations)


# What is dropped


@pytest.mark.full
def test_what_the_newest_effect_makes_needless_is_dropped(
    shifted: tuple[FitSetup, Scene], tmp_path_factory: pytest.TempPathFactory
) -> None:
    turn = Turn([], "registration", Spot(0.0, 0, 0, 0, (3, 3)), 0.0, 1.0, 7.0, fit_model(*shifted, 0, 0))
    setup, scene = shifted
    narrow = {**BLUR, "range_fwhm_m": 0.2, "azimuth_fwhm_m": 0.2}
    turn.fitted = fitted_to(setup, scene, {**scene.effects, "point_spread": narrow, "registration": SHIFT})
    prune(setup, turn, ["point_spread"], np.log(1e4))
    assert turn.dropped == ["point_spread"]
    assert set(turn.fitted.scene.effects) == {"multibounce", "registration"}

    setup, scene = bench_of({"point_spread": BLUR, "registration": SHIFT}, tmp_path_factory.mktemp("both"))
    turn.dropped = []
    turn.fitted = fitted_to(setup, scene, {"point_spread": BLUR, "registration": SHIFT})
    prune(setup, turn, ["point_spread"], np.log(1e4))
    assert turn.dropped == []


@pytest.mark.full
def test_a_reading_that_was_taken_while_others_were_missing_is_asked_again(tmp_path: Path) -> None:
    """A blur hides how bounces end; beside it the images tell. The right reading stays."""
    lobe = {"strength": 1.0, "reflection": "lobe"}
    setup, scene = bench_of({"multibounce": lobe, "point_spread": BLUR}, tmp_path)
    wrong, right = ({"multibounce": {**lobe, "reflection": one}, "point_spread": BLUR} for one in ("roughness", "lobe"))
    for begun in (wrong, right):
        found = resettled(setup, fitted_to(setup, scene, begun), ["multibounce"], scene).scene.effects["multibounce"]
        assert found["reflection"] == "lobe"
        assert found["strength"] == pytest.approx(1.0, rel=0.3)


@pytest.mark.full
def test_a_reading_that_has_lost_hopelessly_is_fitted_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the same effects it is not fitted again; beside others it is."""
    fits: list[Scene] = []

    def counted(setup: FitSetup, scene: Scene, *rest: Any) -> Fitted:
        fits.append(scene)
        return refit_as(setup, scene, *rest)

    monkeypatch.setattr(pruning, "refit_as", counted)
    lobe = {"multibounce": {"strength": 1.0, "reflection": "lobe"}, "point_spread": BLUR}
    setup, scene = bench_of(lobe, tmp_path)
    fitted, lost = fitted_to(setup, scene, lobe), set[Hashable]()
    for _ in range(2):
        assert resettled(setup, fitted, ["multibounce"], scene, lost) is fitted
    assert [one.effects["multibounce"]["reflection"] for one in fits] == ["roughness"]
    other = fitted_to(setup, scene, {**lobe, "noise_floor": {"level": 1e-4}})
    resettled(setup, other, ["multibounce"], scene, lost)
    assert len(fits) == 2


@pytest.mark.full
def test_a_reading_is_asked_again_from_the_declared_surface(tmp_path: Path) -> None:
    """The wrong reading has dragged the surface to where the right one fits worse than it; from the surface of the
    file the right one fits better."""
    lobe = {"strength": 1.0, "reflection": "lobe"}
    setup, scene = bench_of({"multibounce": lobe, "point_spread": BLUR}, tmp_path)
    dragged = {"eps_r": 1.1, "rms_height_m": 2.0, "correlation_length_m": 2e-5}
    there = replace(scene, materials={**scene.materials, "cube": scene.materials["cube"].model_copy(update=dragged)})
    begun = {"multibounce": {"strength": 13.0, "reflection": "roughness"}, "point_spread": BLUR}
    fitted = fitted_to(setup, there, begun)
    assert resettled(setup, fitted, ["multibounce"], there).scene.effects["multibounce"]["reflection"] == "roughness"
    found = resettled(setup, fitted, ["multibounce"], scene).scene.effects["multibounce"]
    assert found["reflection"] == "lobe"
    assert found["strength"] == pytest.approx(1.0, rel=0.3)


def test_power_that_another_effect_adds_as_well_is_dropped(tmp_path_factory: pytest.TempPathFactory) -> None:
    """A copy in the dark beside the floor that made it; alone, it is what the dark pixels have."""
    floor, copy = {"level": 0.01}, {"level": 1e-4, "offset_m": 12.0}
    setup, scene = bench_of({"noise_floor": floor}, tmp_path_factory.mktemp("added"))
    turn = Turn([], "noise_floor", Spot(0.0, 0, 0, 0, (3, 3)), 0.0, 1.0, 7.0, fit_model(setup, scene, 0, 0))
    turn.fitted = fitted_to(setup, scene, {"azimuth_ambiguity": copy, "noise_floor": floor})
    prune(setup, turn, ["azimuth_ambiguity"], np.log(1e4))
    assert turn.dropped == ["azimuth_ambiguity"]
    turn.fitted = fitted_to(setup, scene, {"azimuth_ambiguity": copy})
    turn.dropped = []
    prune(setup, turn, ["azimuth_ambiguity"], np.log(1e4))
    assert turn.dropped == []


@pytest.mark.full
def test_shifts_of_views_that_are_all_alike_become_one(
    shifted: tuple[FitSetup, Scene], tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The same shift in every view is `registration`; another shift in each stays `aim_point`."""
    setup, scene = shifted
    views = [view.name for view in scene.views]
    aimed = {key: dict.fromkeys(views, value) for key, value in SHIFT.items()}
    price = float(np.log(1e4))
    found = with_smaller(setup, fitted_to(setup, scene, {**scene.effects, "aim_point": aimed}), ["aim_point"], price)
    assert set(found.scene.effects) == {"multibounce", "registration"}
    for key, value in SHIFT.items():  # as in the test of the search
        assert found.scene.effects["registration"][key] == pytest.approx(value, abs=0.02)

    apart = {key: {name: value * (-1) ** k for k, name in enumerate(views)} for key, value in SHIFT.items()}
    setup, scene = bench_of({"aim_point": apart}, tmp_path_factory.mktemp("apart"))
    found = with_smaller(setup, fitted_to(setup, scene, {"aim_point": apart}), ["aim_point"], price)
    assert set(found.scene.effects) == {"aim_point"}


# Views left out


def test_left_out_passes_beyond_two_errors_or_as_a_weak_effect_would() -> None:
    assert ViewsLeftOut(10.1, 5.0, 3).passed
    assert not ViewsLeftOut(9.9, 5.0, 3).passed
    # a weak one: true, it would gain 8 +- 5, so that 2 errors are no fair question; 0 or 8 less 10 are
    assert ViewsLeftOut(0.1, 5.0, 3, expected=8.0, quiet=True).passed
    assert not ViewsLeftOut(-0.1, 5.0, 3, expected=8.0, quiet=True).passed
    assert not ViewsLeftOut(0.1, 5.0, 3, expected=8.0).passed  # something else is missing
    assert ViewsLeftOut(5.1, 5.0, 3, expected=15.0, quiet=True).passed
    assert not ViewsLeftOut(4.9, 5.0, 3, expected=15.0, quiet=True).passed
    assert ViewsLeftOut(0.0, 0.0, 1).passed
    # numbers of single views: one and a half errors where all columns have them alike
    assert ViewsLeftOut(7.6, 5.0, 3, uneven=0.1).passed
    assert not ViewsLeftOut(7.4, 5.0, 3, uneven=0.1).passed
    assert not ViewsLeftOut(7.6, 5.0, 3, uneven=0.3).passed
    assert not ViewsLeftOut(9.0, 5.0, 3, uneven=0.3).varies
    assert ViewsLeftOut(9.0, 5.0, 3, uneven=0.6).varies


def test_what_is_carried_is_judged_by_what_the_effect_leads_to_expect() -> None:
    assert Carried(0.51).by_surface("azimuth_ambiguity")
    assert not Carried(0.51, expected=0.5).by_surface("azimuth_ambiguity")  # as expected; the surface would give 1
    assert Carried(0.76, expected=0.5).by_surface("azimuth_ambiguity")
    assert Carried(0.9, expected=0.9).by_surface("azimuth_ambiguity")  # views too much alike to tell
    assert Carried(0.3).by_surface("interference")
    assert not Carried(0.3).by_surface("azimuth_ambiguity")


def test_views_left_out_tell_what_helps(blurred: tuple[FitSetup, Scene], floor: tuple[FitSetup, Scene]) -> None:
    """A blur that is there helps in views it was not fitted to; one that is not gains what speckle gains by chance,
    some units of ln L."""
    gains = {}
    for case, (setup, scene) in {"blurred": blurred, "sharp": floor}.items():
        base = fit_model(setup, scene, 0, 0)
        left = leave_one_view_out(setup, base, fitted_to(setup, scene, {"point_spread": BLUR}), "point_spread")
        assert left.views == 4
        gains[case] = left.gain
        assert (left.gain > 2.0 * left.error) == (case == "blurred")
    assert gains["blurred"] > 15.0
    assert abs(gains["sharp"]) < 10.0


def test_what_one_view_has_is_not_carried_to_the_others(
    blurred: tuple[FitSetup, Scene], floor: tuple[FitSetup, Scene]
) -> None:
    """One view is blurred, three are sharp: the three say so, and the one alone cannot say otherwise."""
    setup, scene = floor
    views = [blurred[1].views[0], *scene.views[1:]]
    scene = replace(scene, views=views)
    one = FitSetup(setup.device, setup.rays, {})
    other = FitSetup(setup.device, Rays(setup.rays.stage, 256.0, 4), {})
    setup = replace(one, observations=frozen(one, other, scene))
    base = fit_model(setup, scene, 0, 0)
    fitted = fitted_to(setup, scene, {"point_spread": BLUR})
    assert fitted.log_likelihood > base.log_likelihood + 4.0  # two numbers gain 1 by chance
    assert not leave_one_view_out(setup, base, fitted, "point_spread").passed


# What holds beside all the others


def never(model: Fitted, name: str) -> bool:
    """No dark pixels ask for anything."""
    return False


@pytest.mark.full
def test_what_is_not_there_is_taken_back_and_what_is_there_holds(shifted: tuple[FitSetup, Scene]) -> None:
    """A shift that is there holds beside a blur that is not, though the blur was added too."""
    setup, scene = shifted
    narrow = {**BLUR, "range_fwhm_m": 0.2, "azimuth_fwhm_m": 0.2}
    fitted = fitted_to(setup, scene, {**scene.effects, "point_spread": narrow, "registration": SHIFT})
    found = confirm(setup, fitted, ["point_spread", "registration"], never, np.log(1e4))
    blur, shift = found.asked
    assert (blur.effect, blur.size, blur.refused) == ("point_spread", 2, TOO_LITTLE)
    assert (shift.effect, shift.size, shift.refused) == ("registration", 2, "")
    assert blur.gain < 2 * np.log(1e4) < shift.gain
    assert shift.left_out is not None
    assert shift.left_out.gain > 2.0 * shift.left_out.error
    assert set(found.fitted.scene.effects) == {"multibounce", "registration"}


def test_what_the_dark_pixels_need_stays_whatever_it_gains(
    floor: tuple[FitSetup, Scene], blurred: tuple[FitSetup, Scene]
) -> None:
    """Unless its own test speaks against it: where the dark is dark, no floor was asked for."""
    asked = {}
    for case, (setup, scene) in {"floor": floor, "blurred": blurred}.items():
        fitted = fitted_to(setup, scene, {"noise_floor": FLOOR})
        for asks in (True, False):
            found = confirm(setup, fitted, ["noise_floor"], lambda model, name, asks=asks: asks, price=1e12)
            (asked[case, asks],) = found.asked
    assert asked["floor", True].refused == ""
    assert asked["floor", False].refused == asked["blurred", False].refused == TOO_LITTLE
    assert asked["blurred", True].refused.startswith("its own test speaks against it")


def test_copies_on_a_part_of_the_dark_stay_whatever_they_gain_in_the_light(
    blurred: tuple[FitSetup, Scene], tmp_path: Path
) -> None:
    """Copies of a ground that ends: less than half of the dark measures power, and all of that is theirs. Where the
    dark is dark, copies pay in the light or go."""
    setup, scene = ghostly = bench_of({"azimuth_ambiguity": GHOST}, tmp_path)
    declared = Dark.of(fitted_to(setup, scene, {}))
    assert setup.has_dark
    assert not declared.everywhere
    asked = []
    for setup, scene in (ghostly, blurred):
        fitted = fitted_to(setup, scene, {"azimuth_ambiguity": GHOST})
        asked += confirm(setup, fitted, ["azimuth_ambiguity"], never, price=1e12).asked
    assert [one.refused for one in asked] == ["", TOO_LITTLE]


# Where single pixels cannot decide


def test_a_bounded_loss_is_the_kernels_and_its_slope_is_right(floor: tuple[FitSetup, Scene]) -> None:
    """b ln(1 + t / b) of every pixel, by the kernel as on the host, against central differences of the images; few
    pixels a thousand times too bright hardly move the fit."""
    setup, scene = floor
    spoilt = {
        name: [replace(one, measured=one.measured.copy()) for one in seen] for name, seen in setup.observations.items()
    }
    for seen in spoilt.values():
        places = np.argwhere(seen[0].interior)[:: max(1, seen[0].count // 10)]
        seen[0].measured[tuple(places.T)] *= 1e3
    plain, bounded = (replace(setup, observations=spoilt, bound=b) for b in (0.0, BOUND))
    problem = bounded.problem(scene)
    loss, gradient = problem.gradient(problem.x0)
    terms = plain.problem(scene).terms(problem.modelled(problem.x0))
    assert loss == pytest.approx(sum((BOUND * np.log1p(t / BOUND)).sum() for t in terms), rel=1e-5)  # float32 pixels
    for k, slope in enumerate(gradient):
        step = 0.01 * (np.arange(gradient.size) == k)
        above, below = (problem.value(problem.modelled(problem.x0 + s)) for s in (step, -step))
        assert slope == pytest.approx((above - below) / 0.02, rel=2e-3, abs=1e-3 * np.abs(gradient).max())
    clean = fit_model(setup, scene, 0, 0)
    ground, there = on_bounded_ground(plain, fit_model(plain, scene, 0, 0), scene)
    assert ground.bound == BOUND
    free = setup.problem(scene)
    lost = [clean.log_likelihood + free.value(free.modelled(x)) for x in (there.x, fit_model(plain, scene, 0, 0).x)]
    assert lost[0] < 0.05 * lost[1]
    assert on_bounded_ground(setup, clean, scene) == (setup, clean)  # nothing stands out: nothing is bounded


# What the surface could be


@pytest.mark.parametrize(
    ("angles", "effect", "table", "told"),
    [
        (ANGLES, "point_spread", BLUR, True),
        (ANGLES, "azimuth_ambiguity", GHOST, True),
        (NEAR, "point_spread", BLUR, False),
        (NEAR, "azimuth_ambiguity", GHOST, False),
        # one strip of the world, which both views show in the same rows
        (
            NEAR,
            "interference",
            {"level": {"v0": 0.02, "v1": 0.02}, "rows": {v: [[30, 34]] for v in ("v0", "v1")}},
            False,
        ),
        # a transmitter that one of the two has heard, or both in other rows
        (NEAR, "interference", {"level": {"v0": 0.02}, "rows": {"v0": [[30, 34]]}}, True),
        (NEAR, "interference", {"level": {"v0": 0.02, "v1": 0.02}, "rows": {"v0": [[30, 34]], "v1": [[8, 12]]}}, True),
    ],
    ids=["blur", "ghost", "blur, near", "ghost, near", "strip, near", "one view, near", "other rows, near"],
)
def test_what_the_surface_could_be_is_told_by_views_from_elsewhere(
    angles: Sequence[tuple[float, float]], effect: str, table: dict[str, Any], told: bool, tmp_path: Path
) -> None:
    """What lies in the image comes over with the surface to a view from nearly the same direction, and to no other;
    what one view alone has comes over to none."""
    setup, scene = bench_of({effect: table}, tmp_path, angles)
    carried = carried_over(setup, fitted_to(setup, scene, {effect: table}), effect)
    assert (carried.share < 0.3) if told else (carried.share > 0.7)
    assert carried.by_surface(effect) is not told


def test_copies_come_over_in_part_to_a_view_from_the_other_side(tmp_path: Path) -> None:
    """They lie on both sides of what they are copies of; but their light is that of the side seen, so that an
    ambiguity is still told."""
    setup, scene = bench_of({"azimuth_ambiguity": GHOST}, tmp_path, ((20.0, 40.0), (200.0, 40.0), (110.0, 45.0)))
    table = {"azimuth_ambiguity": GHOST}
    carried = carried_over(setup, fitted_to(setup, scene, table), "azimuth_ambiguity")
    assert not carried.by_surface("azimuth_ambiguity")


def test_a_single_view_tells_nothing_of_the_surface(tmp_path: Path) -> None:
    setup, scene = bench_of({"point_spread": BLUR}, tmp_path, ((20.0, 40.0),))
    base, fitted = (fitted_to(setup, scene, effects) for effects in ({}, {"point_spread": BLUR}))
    assert leave_one_view_out(setup, base, fitted, "point_spread") == ViewsLeftOut(0.0, 0.0, 1)
    assert carried_over(setup, fitted, "point_spread") == Carried(1.0, 1.0)


def test_one_start_alone_follows_a_flat_valley(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of six starts the best goes on, and those that still gain on it; not those that are hopeless, or crawl beside it.

    Losses by iteration: the best one; one that will pass it; one in the same valley; one without hope that falls; one
    that stands; one that has arrived.
    """
    losses = [
        lambda k: 100.0 - 0.01 * k,
        lambda k: 130.0 - k,
        lambda k: 100.5 - 0.02 * k,
        lambda k: 900.0 - 2.0 * k,
        lambda k: 150.0,
        lambda k: 100.0,
    ]
    steps = [0] * len(losses)

    def step(problem: Any, state: FitState, *_: Any, **__: Any) -> FitState:
        which, k = int(state.x[0]), state.since_start + 1
        steps[which] += 1
        loss = losses[which](k)
        state = replace(state, loss=loss, best_loss=min(loss, state.best_loss))
        return replace(state, iteration=k, since_start=k, arrived=which == 5)

    monkeypatch.setattr(refit, "levenberg_marquardt", step)
    problem: Any = SimpleNamespace(bounds=(np.zeros(1), np.full(1, 9.0)))
    x, loss, iterations = descend(problem, [np.full(1, float(k)) for k in range(len(losses))])
    assert steps == [40, 40, 12, 12, 12, 1]
    assert (x[0], loss, iterations) == (1.0, 90.0, sum(steps))


def test_edges_tell_a_shift_and_a_blur(tmp_path: Path) -> None:
    """The last fit has edges, too: what is left of all four numbers' errors is less than half of what it was. The model
    that it gives has these numbers, and a surface on its own pixels again."""
    truth = {"registration": SHIFT, "point_spread": BLUR}
    setup, scene = bench_of(truth, tmp_path)
    inside = refit_as(setup, replace(scene, effects=truth))
    there, found = with_edges(setup, inside, scene)
    assert found is not None
    assert there.scene.effects == learned_scene(there.problem, there.x).effects == found.scene.effects

    def off(fitted: Fitted) -> float:
        keys = [(name, key) for name, table in truth.items() for key in table if key.endswith("_m")]
        return float(np.linalg.norm([fitted.scene.effects[name][key] - truth[name][key] for name, key in keys]))

    assert off(there) < 0.5 * off(inside)
    assert there.log_likelihood > likelihood(setup, found.scene)


def test_candidates_far_below_the_best_wait() -> None:
    """A score of 4.9 beside one of 100 is fitted only where nothing else is added; one of 5 is not kept waiting."""
    found = [Candidate(name, "testable", minus_log_p=p) for name, p in (("a", 100.0), ("b", 5.0), ("c", 4.9))]
    assert [[one.effect for one in some] for some in by_rank(found)] == [["a", "b"], ["c"]]
    assert by_rank(found[:1]) == [found[:1]]
    assert by_rank([]) == [[]]


def test_dark_pixels_test_a_floor_that_the_surface_can_imitate() -> None:
    """Lit pixels cannot tell a floor from the surface here. Power in most dark pixels can; zeros there rule it out."""

    def offered(positive: int) -> list[str]:
        floor, ghost = Candidate("noise_floor", "not_testable"), Candidate("azimuth_ambiguity", "testable")
        found = worth_a_refit([floor, ghost], 7.0, Dark(100, positive, unexplained=80))
        assert all(one.testability == "testable" and one.statistic == one.statistic for one in found if one is floor)
        return [one.effect for one in found]

    assert offered(100) == ["noise_floor", "azimuth_ambiguity"]
    assert offered(90) == ["azimuth_ambiguity"]
    quiet = Candidate("noise_floor", "not_testable")
    assert worth_a_refit([quiet], 7.0, Dark(100, 100)) == []
    assert quiet.testability == "not_testable"
