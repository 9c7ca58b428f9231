"""Views that are traced again in bands give what views whose hits are kept give; and who decides which are which."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from effect_worlds import cases_of, with_effect
from learning_scenes import bumpy, measured, views_at
from worlds import SOIL, scene_of

from warpsar.effects.registry import get, names, validate
from warpsar.errors import InputError
from warpsar.learning.command import LearnOptions, learn
from warpsar.learning.problem import FitProblem
from warpsar.render.bands import stretches
from warpsar.runtime import devices, memory
from warpsar.scene.scene import Scene
from warpsar.trace.hits import BinGrid
from warpsar.world.tables import Material

WHOLE = [name for name in names() if get(name).needs_all_hits]
"""Effects that start from all hits of a view."""

EFFECTS: dict[str, dict[str, dict[str, Any]]] = {"none": {}}
"""By stage: all its effects that can be rendered in bands. Those of the image mix pixels of several bands."""

for name in (name for name in names() if name not in WHOLE):
    for case in cases_of(name)[:1]:
        if not case.radar:
            EFFECTS.setdefault(get(name).stage, {})[name] = case.table


def bumpy_scene(folder: Path, effects: str = "none", layout: str = "uniform") -> Scene:
    scene = scene_of(
        bumpy(), views_at((0.0, 40.0), (70.0, 50.0)), shape=(16, 22), spacing_m=(0.4, 0.4), polarizations=("HH", "VV")
    )
    seen = measured(scene, folder)
    material = dict(SOIL, rms_height_m=0.0010)
    if layout == "vertex":
        material |= {"layout": "vertex", "eps_r": "eps", "rms_height_m": "h"}
    tables = {name: validate(name, table, name) for name, table in EFFECTS[effects].items()}
    return replace(seen, materials={"soil": Material(**material)}, effects=tables)


def problems(scene: Scene, device: str, **more: Any) -> tuple[FitProblem, FitProblem]:
    """The same fit with all hits kept, and with none."""
    where = devices.resolve_device(device)
    kept, banded = (FitProblem(scene, where, max_memory_gib=gib, **more) for gib in (None, 1e-6))
    assert kept.keeps_hits
    assert not kept.bands
    assert set(banded.bands) == {"v0", "v1"}
    assert min(banded.bands.values()) > 3
    return kept, banded


@pytest.mark.full
@pytest.mark.parametrize("effects", EFFECTS)
def test_banded_images_and_gradients_are_the_kept_ones(effects: str, device: str, tmp_path: Path) -> None:
    scene = bumpy_scene(tmp_path, effects)
    kept, banded = problems(scene, device)
    x = kept.x0 + 0.03
    for one, other in zip(kept.modelled(x), banded.modelled(x), strict=True):
        np.testing.assert_allclose(other, one, rtol=2e-6)  # float32 sums of the same terms
    for one, other in zip(kept.observations, banded.observations, strict=True):
        np.testing.assert_array_equal(other.interior, one.interior)
    loss, gradient = kept.gradient(x)
    banded_loss, banded_gradient = banded.gradient(x)
    assert banded_loss == pytest.approx(loss, rel=1e-5)
    # each element is a sum over pixels of float32 terms of both signs, taken in two orders
    np.testing.assert_allclose(banded_gradient, gradient, rtol=1e-4, atol=2e-6 * np.abs(gradient).max())
    again = banded.gradient(x)[1]  # nothing is left over from the time before
    np.testing.assert_allclose(again, banded_gradient, rtol=1e-5, atol=1e-6 * np.abs(gradient).max())


def test_a_field_in_bands(device: str, tmp_path: Path) -> None:
    kept, banded = problems(bumpy_scene(tmp_path, layout="vertex"), device, total_variation={"rms_height_m": 2.0})
    gradient, banded_gradient = (problem.gradient(problem.x0 + 0.02)[1] for problem in (kept, banded))
    assert gradient.size > 20
    np.testing.assert_allclose(banded_gradient, gradient, rtol=1e-4, atol=2e-6 * np.abs(gradient).max())


@pytest.mark.full
def test_learn_in_bands_ends_where_learn_does(tmp_path: Path) -> None:
    scene = bumpy_scene(tmp_path)
    found = [learn(scene, device="cpu", options=LearnOptions(starts=1, max_memory_gib=gib)) for gib in (None, 1e-6)]
    # two minima of one function to float32, measured in standard deviations
    assert found[0].identified is not None
    np.testing.assert_allclose((found[1].x - found[0].x) / found[0].identified.sd, 0.0, atol=0.02)
    assert found[1].loss == pytest.approx(found[0].loss, rel=1e-5)
    assert found[1].domains["soil"] == pytest.approx(found[0].domains["soil"])


def test_some_kept_and_some_not(tmp_path: Path) -> None:
    scene = bumpy_scene(tmp_path)
    where = devices.resolve_device("cpu")
    sizes = {v.view.name: v.render.whole.hits.count for v in FitProblem(scene, where).views}
    bytes_of = {name: memory.kept_bytes(hits, 2, 0) for name, hits in sizes.items()}
    # room for one of them, with what the estimate may be off by
    problem = FitProblem(scene, where, max_memory_gib=1.5 * max(bytes_of.values()) / 2**30)
    assert len(problem.bands) == 1


def test_hits_are_estimated_from_a_few_columns(tmp_path: Path) -> None:
    scene = bumpy_scene(tmp_path)
    finer = replace(scene, grid=scene.grid.model_copy(update={"shape": (64, 128), "spacing_m": (0.1, 0.07)}))
    from warpsar.simulation.rays import Rays
    from warpsar.surface.stage import Stage

    rays = Rays(Stage.of(finer, devices.resolve_device("cpu")))
    for view in finer.views:
        count = rays.hits(finer, view, []).count
        # 16 of 128 columns: a smooth number per column
        assert rays.expected_hits(finer, view, []) == pytest.approx(count, rel=0.1)
        assert rays.most_hits(finer, view, []) > count


@pytest.mark.parametrize("name", WHOLE)
def test_effects_that_need_all_hits_are_refused(name: str, tmp_path: Path) -> None:
    scene = with_effect(bumpy_scene(tmp_path), name, cases_of(name)[0].table)
    with pytest.raises(InputError, match=f"effects.{name}: starts from all hits of view v0 at once"):
        FitProblem(scene, devices.resolve_device("cpu"), max_memory_gib=1e-6)


def test_out_of_memory_in_a_fit_turns_to_bands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A device that has no memory for one view's hits at once, as Warp says it."""
    from warpsar.simulation import rays as simulation

    scene, where = bumpy_scene(tmp_path), devices.resolve_device("cpu")
    kept = FitProblem(scene, where)
    limit = min(view.render.whole.hits.count for view in kept.views) // 6
    real = simulation.trace

    def trace(*arguments: Any, **more: Any) -> Any:
        hits = real(*arguments, **more)
        if hits.count > limit:
            raise RuntimeError(f"Failed to allocate {hits.count * 64} bytes on device 'cuda:0'")
        return hits

    monkeypatch.setattr(simulation, "trace", trace)
    banded = FitProblem(scene, where)
    assert not banded.keeps_hits
    x = kept.x0 + 0.03
    gradient = kept.gradient(x)[1]
    np.testing.assert_allclose(banded.gradient(x)[1], gradient, rtol=1e-4, atol=2e-6 * np.abs(gradient).max())


def test_stretches_cover_once() -> None:
    for pixels, count, fine in ((10, 3, 1), (10, 10, 1), (10, 64, 4), (1, 2, 2), (4096, 7, 1)):
        found = stretches(BinGrid((4, pixels * fine), (1.0, 1.0), fine), count)
        assert [a for a, _ in found[1:]] == [b for _, b in found[:-1]]
        assert (found[0][0], found[-1][1], len(found)) == (0, pixels * fine, min(count, pixels))
        assert all(a % fine == 0 for a, _ in found)
