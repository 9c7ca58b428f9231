"""The learned term of sigma0: what it is far from its table, its gradients and its file."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from worlds import WAVENUMBER, ground, mesh_of, scene_of, view

from warpsar import InputError, Scene, renderer
from warpsar.world import scattering_term
from warpsar.world.scattering_term import ScatteringTerm, learned

pytestmark = pytest.mark.unit

SOIL = {"eps_r": (9.0, -0.8), "rms_height_m": 0.003, "correlation_length_m": 0.03, "spectrum": "exponential"}
HERE = np.array([np.cos(np.radians(40.0)), np.log(0.003 * WAVENUMBER), np.log(0.03 * WAVENUMBER), np.log(8.0)])


def law(at: np.ndarray) -> dict[str, np.ndarray]:
    """A smooth error of a model [dB]."""
    return {
        "HH": 1.5 * np.sin(at[:, 1]) - 0.4 * at[:, 3],
        "VV": 0.8 * at[:, 1] + 0.3 * at[:, 2],
        "HV": np.cos(at[:, 2]) - 2.0,
    }


@pytest.fixture(scope="module")
def term() -> ScatteringTerm:
    random = np.random.default_rng(0)
    places = HERE + random.uniform(-1, 1, (120, 4)) * (0.15, 1.0, 1.0, 1.0)
    return learned("i2em", places, law(places))


def test_it_says_what_its_table_says_and_nothing_elsewhere(term: ScatteringTerm) -> None:
    random = np.random.default_rng(1)
    inside = HERE + random.uniform(-0.5, 0.5, (30, 4)) * (0.15, 1.0, 1.0, 1.0)
    for name, truth in law(inside).items():
        np.testing.assert_allclose(term.db(name, inside), truth, atol=0.35)
        sd = term.sd_db(name, inside)
        assert (np.abs(term.db(name, inside) - truth) < 4 * sd).all()
    far = HERE + np.array([[0.0, 9.0, 0.0, 0.0], [0.0, 0.0, -9.0, 0.0], [0.0, 0.0, 0.0, 12.0]])
    step = 1e-3
    for name in ("HH", "VV", "HV"):
        assert np.abs(term.db(name, far)).max() < 1e-3
        for k in range(4):
            moved = far + step * np.eye(4)[k]
            assert np.abs((term.db(name, moved) - term.db(name, far)) / step).max() < 1e-2
        assert term.sd_db(name, far) == pytest.approx(np.hypot(3.0, 0.25), rel=1e-3)  # what nothing is known of
        assert (term.sd_db(name, far) > 5 * term.sd_db(name, HERE[None])).all()


def test_values_that_are_not_known_teach_nothing(term: ScatteringTerm) -> None:
    off = law(term.places)
    off["HV"][:] = np.nan
    found = learned("i2em", term.places, off)
    assert not found.db("HV", HERE[None]).any()
    assert found.sd_db("HV", HERE[None])[0] == 3.0
    np.testing.assert_array_equal(found.db("VH", term.places), found.db("HV", term.places))


def lawn(file: Path | None, **more: Any) -> Scene:
    material = {**SOIL, "model": "i2em", **more} | ({} if file is None else {"learned_term": file})
    return scene_of(
        mesh_of(lawn=ground(12.0)),
        view(30, 40),
        shape=(20, 22),
        spacing_m=(0.7, 0.6),
        polarizations=("HH", "VV", "HV"),
        materials={"lawn": material},
    )


@pytest.fixture
def file(term: ScatteringTerm, tmp_path: Path) -> Path:
    path = tmp_path / "soil.json"
    term.save(path)
    return path


def test_images_are_the_physics_times_it(file: Path, term: ScatteringTerm) -> None:
    plain, more = renderer(lawn(None), device="cpu")()["view"], renderer(lawn(file), device="cpu")()["view"]
    for name in ("HH", "VV", "HV"):
        ratio = 10 * np.log10(more[name][8:12, 8:14] / plain[name][8:12, 8:14])
        np.testing.assert_allclose(ratio, term.db(name, HERE[None])[0], atol=2e-3)  # float32 weights of both signs


def test_gradients_are_those_of_differences(file: Path) -> None:
    render = renderer(lawn(file), device="cpu")
    random = np.random.default_rng(0)
    seeds = {"view": {p: random.random(image.shape) for p, image in render()["view"].items()}}
    gradient = render.vjp(render.values, seeds)
    for name, value in render.values.items():
        step = 2e-2 * np.asarray(value)

        def at(change: float, name: str = name, step: Any = step, value: Any = value) -> float:
            images = render({**render.values, name: value + change * step})["view"]
            return float(sum((seeds["view"][p] * images[p]).sum() for p in images))

        expected = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / 12
        assert float(np.sum(gradient[name] * step)) == pytest.approx(expected, rel=5e-3)  # float32 weights


def test_a_scene_file_keeps_it(file: Path) -> None:
    path = file.parent / "scene.toml"
    lawn(file).save(path)
    assert 'learned_term = "soil.json"' in path.read_text()
    assert Scene.load(path).materials["lawn"].learned_term == file
    again = scattering_term.read(file)
    np.testing.assert_array_equal(again.db("VV", HERE[None]), scattering_term.read(file).db("VV", HERE[None]))


def test_a_term_of_another_model_is_refused(file: Path) -> None:
    with pytest.raises(InputError, match='found a term of "i2em"; must be of "ka_spm"'):
        lawn(file, model="ka_spm")


@pytest.mark.parametrize(
    "change",
    [
        {"places": []},
        {"places": [[1.0, 2.0, 3.0]]},
        {"width": [0.1, 1.0, 0.0, 1.0]},
        {"features": ["cos_incidence"]},
        {"weights": {"RR": [1.0]}},
        {"weights": {"HH": [1.0]}},
        {"spread_db": 0.0},
        {"weights": None},
    ],
)
def test_a_file_that_is_no_term_is_refused(change: dict[str, Any], file: Path) -> None:
    data = json.loads(file.read_text())
    file.write_text(json.dumps({**data, **change}))
    with pytest.raises(InputError, match=r"soil\.json"):
        lawn(file)
    file.write_text("{")
    with pytest.raises(InputError, match=r"soil\.json"):
        lawn(file)
