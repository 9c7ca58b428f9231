"""Rough faces of every model: their mean power is the intensity renderer's sigma0, channel by channel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from bodies import ALL, FREQUENCY, K, rectangles, scene

import warpsar
from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions
from warpsar.coherent.sweep import Worker
from warpsar.collection import places
from warpsar.errors import InputError
from warpsar.models import registry
from warpsar.world import scattering_term

SOIL = {"eps_r": (9.0, -1.5), "rms_height_m": 0.0025, "correlation_length_m": 0.02, "spectrum": "exponential"}
KA_SPM = {"eps_r": (7.0, -0.9), "rms_height_m": 0.0012, "correlation_length_m": 0.01, "specular_fraction": 0.1}
TABLE = "incidence_deg,HH,VV,HV\n0,-2,-1,-15\n30,-9,-8,-19\n60,-14,-12,-22\n90,-20,-18,-30\n"
LEVEL, TURNED = (0.0, 0.0), (0.35, -0.2)
"""How steep the ground rises to the east, and to the north."""
FLOAT32 = 1e-5
"""Of the renderer, whose incidence and whose sigma0 are float32. Found are 1.6e-6."""


def ground(slopes: tuple[float, float] = LEVEL, side: float = 0.6) -> warpsar.Mesh:
    h = side / 2
    corners = np.array([[-h, -h], [h, -h], [h, h], [-h, h]])
    return rectangles(np.column_stack([corners, corners @ np.array(slopes)]))


@pytest.fixture(scope="module")
def tables(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a table of sigma0, and a learned term for each of two models."""
    folder = tmp_path_factory.mktemp("tables")
    (folder / "ground.csv").write_text(TABLE)
    random = np.random.default_rng(0)
    for model in ("i2em", "ka_spm"):
        at = np.column_stack([random.uniform(0.5, 1.0, 12), *random.normal([[-0.7], [1.4], [2.1]], 0.3, (3, 12))])
        off = {name: random.normal(0.0, 2.0, 12) for name in ("HH", "VV", "HV")}
        scattering_term.learned(model, at, off).save(folder / f"{model}.json")
    return folder


def material(name: str, folder: Path) -> dict[str, Any]:
    """The table of a material, by its model's name; `with a term`, `gaussian` are further words of it."""
    model = name.split()[0]
    own: dict[str, Any] = {
        key: one.example for key, one in registry.own_parameters().items() if key in registry.get(model).keys
    }
    if not registry.get(model).of_surface:
        own |= {key: value for key, value in SOIL.items() if key in registry.get(model).keys}
        return {"model": model, **own, **({"sigma0": folder / "ground.csv"} if registry.get(model).from_table else {})}
    given: dict[str, Any] = {**(KA_SPM if model == "ka_spm" else SOIL), **own, "model": model}
    if "gaussian" in name:
        given["spectrum"] = "gaussian"
    if "term" in name:
        given["learned_term"] = folder / f"{model}.json"
    return given


OTHERS = [name for name in registry.names() if name != "ka_spm"]
MODELS = (*OTHERS, "i2em gaussian", "i2em with a term", "ka_spm with a term")


def faces(mesh: warpsar.Mesh, given: dict[str, Any]) -> warpsar.Scene:
    """A scene of this material, in the polarizations that its model has."""
    channels = tuple(one for one in ALL if one in registry.get(given.get("model", "ka_spm")).channels)
    return scene(mesh, material=given, terms=("rough",), polarizations=channels)


def intensity(made: warpsar.Scene) -> np.ndarray:
    """Power of the renderer's image in the scene's polarizations [m2]."""
    seen = replace(
        made,
        grid=warpsar.Grid(shape=(40, 40), spacing_m=(0.03, 0.03)),
        views=[warpsar.View(name="one", azimuth_deg=20.0, incidence_deg=40.0)],
    )
    image = warpsar.simulate(seen, device="cpu")[0]
    return np.array([one.sum(dtype=np.float64) for one in image.beta0.values()]) * seen.grid.pixel_area_m2


def parts(made: warpsar.Scene, device: str = "cpu") -> np.ndarray:
    """Amplitudes of every scatterer by each of the three numbers alone, set to one: (3, n, 4), complex."""
    body = CoherentBody.of(made, wp.get_device(device))
    worker = Worker(body, np.array([K]), 1.0, ("rough",), 1, 0, 1.0)
    sensor = Directions.of(np.array([20.0]), np.array([40.0])).s[0]
    radar = places.sight(body, 1e7 * sensor)[1]
    found = []
    for one in range(3):
        numbers = body.scatterers.numpy()
        for i, name in enumerate(("diffuse", "specular")):
            numbers[name] = (float(one == i), 0.0)
        body.scatterers.assign(numbers)
        for group in body.scatterer_groups:
            if group.crossed is not None:
                group.crossed.fill_(wp.vec2d(float(one == 2), 0.0))
        found.append(places.complex_of(places.rough_amplitudes(worker, radar, body.placed)).astype(complex))
    return np.array(found)


def powers(made: warpsar.Scene) -> np.ndarray:
    """Mean of 4 pi |A|^2 of all scatterers in the scene's polarizations [m2]."""
    each = 4.0 * np.pi * (np.abs(parts(made)) ** 2).sum(axis=(0, 1))
    return each[[ALL.index(name) for name in made.radar.polarizations]]


@pytest.mark.parametrize("slopes", [LEVEL, TURNED])
@pytest.mark.parametrize("name", MODELS)
def test_mean_power_is_the_renderers_sigma0(name: str, slopes: tuple[float, float], tables: Path) -> None:
    """Over that of a `ka_spm` face in HH: the rays, and the number of scatterers, fall out of the ratio."""
    mesh = ground(slopes)
    known, other = faces(mesh, KA_SPM), faces(mesh, material(name, tables))
    expected = intensity(other) / intensity(known)[0]
    found = powers(other) / powers(known)[0]
    np.testing.assert_allclose(found, expected, rtol=FLOAT32, atol=1e-12)
    if name == MODELS[0]:  # and by itself, to what the image's rays and the number of scatterers leave open
        assert powers(other)[0] == pytest.approx(intensity(other)[0], rel=0.02)


def test_channels_have_the_covariance_of_small_perturbation() -> None:
    """A nearly smooth face: HH over VV is Bragg's complex ratio (Rice 1951), both are one number, and HV is another."""
    smooth = {**SOIL, "rms_height_m": 2e-5, "correlation_length_m": 0.005}
    found = parts(faces(ground(), {**smooth, "model": "i2em"}))
    hh, hv, vv = (found[:, :, ALL.index(one)] for one in ("HH", "HV", "VV"))
    sine2, cosine = np.sin(np.radians(40.0)) ** 2, np.cos(np.radians(40.0))
    eps = complex(*SOIL["eps_r"])
    q = np.sqrt(eps - sine2)
    ratio = (cosine - q) / (cosine + q) * (eps * cosine + q) ** 2 / ((eps - 1) * (sine2 - eps * (1 + sine2)))
    np.testing.assert_allclose(hh[0] / vv[0], ratio, rtol=1e-5)  # float32 amplitudes
    assert (np.abs(vv[1]) < 1e-2 * np.abs(vv[0])).all()  # higher powers fall as k h
    assert not hh[2].any()
    assert not vv[2].any()
    assert (np.abs(hv[:2]) < 1e-6 * np.abs(vv[0])).all()  # level ground
    assert hv[2].all()


def test_of_rough_ground_two_parts_make_hh_and_vv() -> None:
    """At kh = 0.5 the second pair of amplitudes carries power of its own, so HH and VV are no longer one number."""
    found = parts(faces(ground(), {**SOIL, "model": "i2em"}))
    hh, vv = (found[:, :, ALL.index(one)] for one in ("HH", "VV"))
    coherence = np.abs((hh * vv.conj()).sum()) / np.sqrt((np.abs(hh) ** 2).sum() * (np.abs(vv) ** 2).sum())
    assert 0.9 < coherence < 0.999


@pytest.mark.full
@pytest.mark.parametrize("name", ["i2em", "oh"])
def test_looks_have_the_mean_power_and_the_channels_are_circular(name: str, tables: Path) -> None:
    """Many draws of a small face: mean |A|^2 is the sum of the parts', HV is independent of HH, VH is HV."""
    made = faces(ground(side=0.2), material(name, tables))
    draws = []
    for seed in range(300):
        body = CoherentBody.of(made, wp.get_device("cpu"), seed=seed)
        worker = Worker(body, np.array([K]), 1.0, ("rough",), 1, 0, None)
        draws.append(worker(Directions.of(np.array([20.0]), np.array([40.0]))).amplitude[0, 0, 3])
    hh, hv, vh, vv = np.array(draws).T
    assert np.array_equal(hv, vh)
    expected = dict(zip(ALL, powers(made), strict=True))
    for channel, looks in (("HH", hh), ("HV", hv), ("VV", vv)):
        power = 4.0 * np.pi * np.abs(looks) ** 2
        assert power.mean() == pytest.approx(expected[channel], rel=4.0 / np.sqrt(len(draws)) + 0.02), channel
        assert np.abs((looks**2).mean()) < 0.25 * (np.abs(looks) ** 2).mean()
    assert np.abs(np.vdot(hv, hh)) < 4.0 / np.sqrt(len(draws)) * np.linalg.norm(hv) * np.linalg.norm(hh)


def test_sigma0_is_that_of_each_frequency(tables: Path) -> None:
    """A sweep of two frequencies against two of one, to the bit; and HV against VH."""
    made = faces(ground(TURNED), material("i2em", tables))
    both = warpsar.rcs(made, [10.0, 50.0], 40.0, [0.5 * FREQUENCY, FREQUENCY], device="cpu").amplitude_m
    for i, one in enumerate((0.5, 1.0)):
        alone = warpsar.rcs(made, [10.0, 50.0], 40.0, [one * FREQUENCY], device="cpu").amplitude_m
        assert np.array_equal(both[:, :, i], alone[:, :, 0])
    assert np.array_equal(both[..., ALL.index("HV")], both[..., ALL.index("VH")])
    assert both.all()


def quarters(kinds: list[dict[str, Any]]) -> warpsar.Scene:
    """Ground of some materials, side by side."""
    pieces = [ground(side=0.3).vertices + np.array([0.3 * i, 0.0, 0.0]) for i in range(len(kinds))]
    mesh = rectangles(*pieces)
    names = tuple(f"m{i}" for i in range(len(kinds)))
    which = np.repeat(np.arange(len(kinds)), 2).astype(np.int32)
    base = scene(mesh, material=KA_SPM, terms=("rough",))
    mesh = warpsar.Mesh(mesh.vertices, mesh.faces, which, names)
    materials = {name: warpsar.Material(**one) for name, one in zip(names, kinds, strict=True)}
    return replace(base, mesh=mesh, materials=materials)


def test_models_stand_side_by_side(tables: Path) -> None:
    """Each face of several has the power that it has alone; scatterers of one model lie together."""
    kinds = [material(name, tables) for name in ("i2em", "ka_spm", "facet", "oh", "ka_spm with a term", "i2em")]
    made = quarters(kinds)
    body = CoherentBody.of(made, wp.get_device("cpu"))
    assert [group.kind for group in body.scatterer_groups] == [0, 1, 2, 4, 8]
    found = 4.0 * np.pi * (np.abs(parts(made)) ** 2).sum(axis=0)
    number = body.scatterers.numpy()["material"]
    for m, one in enumerate(kinds):
        alone = 4.0 * np.pi * (np.abs(parts(faces(ground(side=0.3), one))) ** 2).sum(axis=0)
        np.testing.assert_allclose(found[number == m], alone[:1] + 0.0 * found[number == m], rtol=1e-5, atol=1e-15)


def test_numbers_of_the_default_do_not_depend_on_other_models(tables: Path) -> None:
    """A further kind of number is a stream of its own: `ka_spm` ground is drawn as it always was."""
    bodies = [
        CoherentBody.of(faces(ground(), material(name, tables)), wp.get_device("cpu")).scatterers.numpy()
        for name in ("ka_spm", "i2em")
    ]
    for key in ("point", "diffuse", "specular"):
        assert np.array_equal(bodies[0][key], bodies[1][key])
    for key, which in (("diffuse", 1), ("specular", 2)):
        np.testing.assert_allclose(bodies[0][key] @ [1.0, 1.0j], drawn(len(bodies[0]), which), rtol=1e-5, atol=1e-6)


def drawn(count: int, which: int) -> np.ndarray:
    """Complex Gaussian numbers of the scatterers of seed 0, by SplitMix64 (Steele, Lea, Flood 2014) and Box-Muller."""
    golden, one, other = (np.uint64(each) for each in (0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB))
    seed = np.random.SeedSequence(0).generate_state(1, np.uint64)[0]
    number = np.arange(count, dtype=np.uint64) * np.uint64(4) + np.uint64(which + 1)
    with np.errstate(over="ignore"):
        z = seed + number * golden
        z = (z ^ (z >> np.uint64(30))) * one
        z = (z ^ (z >> np.uint64(27))) * other
        z ^= z >> np.uint64(31)
    high, low = (z >> np.uint64(32)).astype(float), (z & np.uint64(2**32 - 1)).astype(float)
    return np.sqrt(-np.log((high + 0.5) / 2**32)) * np.exp(2j * np.pi * (low + 0.5) / 2**32)


def test_what_has_no_derivative_says_so(tables: Path) -> None:
    kinds = [material(name, tables) for name in ("ka_spm", "i2em", "ka_spm with a term")]
    made = quarters(kinds)
    for name, has in (("materials.m1.rms_height_m", 'model = "i2em"'), ("materials.m2.eps_r", "a learned term")):
        said = rf"parameters: {name}: .* has {has}, whose scatterers have no derivative"
        with pytest.raises(InputError, match=said):
            warpsar.rcs_gradients(made, 10.0, 40.0, parameters=[name], device="cpu")
    with pytest.raises(InputError, match=r"pose\.heading_deg: materials\.m1"):
        warpsar.rcs_gradients(made, 10.0, 40.0, parameters=["pose.heading_deg"], device="cpu")
    # Others have theirs: what the second and third faces send does not depend on the first one's height.
    found = warpsar.rcs_gradients(made, 10.0, 40.0, parameters=["m0.rms_height_m"], device="cpu")
    slope = found.jacobian()["m0.rms_height_m"][0, 0, 0]
    step = 1e-6
    ends = []
    for sign in (-1.0, 1.0):
        other = made.materials["m0"].model_copy(update={"rms_height_m": 0.0012 + sign * step})
        changed = replace(made, materials={**made.materials, "m0": other})
        ends.append(warpsar.rcs(changed, 10.0, 40.0, device="cpu").amplitude_m[0, 0, 0])
    np.testing.assert_allclose(slope, (ends[1] - ends[0]) / (2.0 * step), rtol=1e-5)


def test_a_table_alone_reflects_nothing_and_that_is_said(tables: Path) -> None:
    given = material("facet", tables)
    made = scene(ground(), material=given)
    with pytest.raises(InputError, match='"facet" without eps_r and rms_height_m, which the terms single, multibounce'):
        warpsar.rcs(made, 10.0, 40.0, device="cpu")
    stated = scene(ground(), material={**given, "eps_r": 5.0, "rms_height_m": 0.001})
    found = warpsar.rcs(stated, 10.0, 40.0, device="cpu", rays_per_wavelength=4.0)
    assert found.terms_m["rough"].all()


@pytest.mark.cuda
@pytest.mark.parametrize("name", MODELS)
def test_a_gpu_says_the_same(name: str, tables: Path) -> None:
    """Amplitudes of a collection are float32; those of `rcs` are float64, but for what comes from tables."""
    made = faces(ground(TURNED), material(name, tables))
    for one, other in zip(parts(made), parts(made, "cuda"), strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-4, atol=1e-5 * np.abs(one).max(initial=1e-30))
    one, other = (warpsar.rcs(made, [10.0, 50.0], 40.0, device=name).amplitude_m for name in ("cpu", "cuda"))
    np.testing.assert_allclose(other, one, rtol=1e-4)
