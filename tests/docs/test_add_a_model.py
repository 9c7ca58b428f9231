"""docs/add-a-model.md does what it says: its files and commands, in a copy of the repository."""

import json
import math
import re
from pathlib import Path

import pytest
from written_page import WrittenPage, run

TRUTH = {"nadir": 0.2, "cosine_power": 1.5}


@pytest.mark.full
def test_a_reader_gets_from_nothing_to_a_fit_that_finds_it(tmp_path: Path) -> None:
    page = WrittenPage("add-a-model.md")
    assert len(page.files) == 5
    checkout = page.checkout(tmp_path)
    tests, make, learn = page.commands
    passed = re.search(r"(\d+) passed", run(tests, checkout))
    assert passed is not None
    assert int(passed[1]) >= 10  # its own physics three times, and one test of all models at least for each promise
    run(make, checkout)
    run(learn, checkout)
    found = json.loads((checkout / "out" / "learned" / "learn.json").read_text())
    for key, true in TRUTH.items():
        told = found["materials"]["lawn"][key]
        assert told["sd_log"] < 0.1
        assert abs(math.log(told["value"] / true)) < 3.5 * told["sd_log"]


KEYS = [f"`several_{k}`" for k in range(5)]
SEVERAL = {
    "kernels/models/several.py": """
from typing import Any

import warp as wp

from warpsar.kernels.codes import Coordinate
from warpsar.kernels.scattering import bounded_cosine, is_crossed, sine_squared

PLACES = 8


@wp.func
def sigma0_and_slopes_of(
    polarization: int,
    spectrum: int,
    variant: int,
    wavenumber: Any,
    cos_incidence: Any,
    cos_twist: Any,
    cos2_azimuth: Any,
    eps_im: Any,
    aspect: Any,
    zeta: Any,
):
    zero = type(wavenumber)(0.0)
    c = bounded_cosine(cos_incidence)
    s = sine_squared(c)
    s4 = s * s
    found = wp.vector(zero, zero, zero, zero, zero, zero, zero, zero, zero)
    if not is_crossed(polarization):
        kh = wavenumber * wp.exp(zeta[Coordinate.HEIGHT])
        log = zeta[0] + zeta[2] * wp.log(c) + zeta[3] * s + zeta[4] * s4 + zeta[5] * s4 * s4 - kh
        value = wp.exp(log)
        by_cosine = value * wp.log(c)
        found = wp.vector(value, value, -kh * value, by_cosine, value * s, value * s4, value * s4 * s4, zero, zero)
    return found
""",
    "warpsar/models/several.py": """
from warpsar.models.base.model import BackscatterModel, Domain, SurfaceParameter
from warpsar.models.base.parameters import RMS_HEIGHT

OWN = [
    SurfaceParameter(f"several_{k}", f"a{k}", "linear", -9.0, 9.0, (-10.0, 10.0), 0.5, "A coefficient.", 0.2 * k - 1.0)
    for k in range(5)
]
MODEL = BackscatterModel("several", "a law of six numbers", 60, (RMS_HEIGHT, *OWN), Domain("it"), channels=("HH", "VV"))
""",
    "tests/models/test_several.py": """
from dataclasses import replace

import numpy as np
import pytest
import warp as wp
from worlds import ground, mesh_of, scene_of, view

from warpsar import Scene, renderer
from warpsar.effects.base.effect import DeclaredEffect, Effect
from warpsar.effects.base.parameter import EffectParameter
from warpsar.kernels.lane_kernels import LANES, at_once
from warpsar.kernels.scatter import scatter_kernel
from warpsar.render.render import ViewRender
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.kernels.shade import HitSurfaces
from warpsar.runtime.structs import fill

LAW = {"model": "several", "rms_height_m": 0.001, "several_0": -1.0, "several_4": 0.5}
SLOPE = 0.1  # of the last number, which stands in the second vector of a hit's coordinates, per metre


def lawn(**given: object) -> Scene:
    \"\"\"Level ground seen from north, so that columns go along x.\"\"\"
    mesh = mesh_of(lawn=ground(24.0, 6))
    mesh = replace(mesh, vertex_scalars={"last": 0.5 + SLOPE * mesh.vertices[:, 0]})
    seen = view(0, 60)
    return scene_of(mesh, seen, shape=(20, 22), spacing_m=(0.7, 0.6), materials={"lawn": {**LAW, **given}})


def expected() -> np.ndarray:
    \"\"\"A pixel has the mean of exp(rate x) over its width of 0.6 m.\"\"\"
    rate = SLOPE * np.sin(np.radians(60.0)) ** 8
    return np.exp(rate * (np.arange(22) - 10.5) * 0.6) * np.sinh(0.3 * rate) / (0.3 * rate)


def test_its_last_number_may_be_a_map() -> None:
    plain, found = (
        renderer(one, device="cpu")()["view"]["HH"][10] for one in (lawn(), lawn(layout="vertex", several_4="last"))
    )
    assert found / plain == pytest.approx(expected(), rel=1e-3)  # where in the pixel the rays lie


@wp.kernel
def tilt_kernel(
    p: wp.array(dtype=float),
    point: wp.array(dtype=wp.vec3),
    zeta: wp.array(dtype=wp.vec4),
    out: wp.array(dtype=wp.vec4),
):
    i = wp.tid()
    z = zeta[i]
    out[i] = wp.vec4(z[0], z[1] + p[0] * point[i][0], z[2], z[3])


class Tilt(Effect):
    name = "tilt"
    stage = "surface"
    order = 1
    summary = "the last number of the model, growing toward east"
    parameters = (EffectParameter("per_m", "1/m", 0.0, -1.0, 1.0, 0.0, description="Growth per metre."),)

    def coordinates(self, render, p, zeta, points, page):
        assert len(zeta) == render.shaded.count
        if page == 0:
            return zeta
        tilted = render.program.array(zeta.shape[0], wp.vec4)
        render.program.launch(tilt_kernel, zeta.shape[0], [p, points, zeta], [tilted])
        return tilted


def test_an_effect_sees_all_of_its_numbers() -> None:
    scene = lawn(learn=("several_4",))
    stage = Stage.of(scene, wp.get_device("cpu"))
    hits = Rays(stage).hits(scene, scene.views[0], [])

    def render(slope: float) -> ViewRender:
        tilt = DeclaredEffect(Tilt(), np.array([slope]))
        return ViewRender(stage, scene.views[0], hits, scene.grid.shape, ("HH",), [tilt])

    plain, tilted = render(0.0), render(SLOPE)
    image = tilted.forward()["HH"]
    assert image[10] / plain.forward()["HH"][10] == pytest.approx(expected(), rel=1e-3)
    assert len(tilted.more) == 1
    seed = np.linspace(0.5, 1.5, image.size).astype(np.float32)
    tilted.program.forward(gradient=True)
    tilted.program.backward({tilted.images["HH"]: seed})
    up, down = (float(render(SLOPE + step).forward()["HH"].ravel() @ seed.astype(float)) for step in (1e-3, -1e-3))
    # float32 images: 1e-7 of a sum over a step of 2e-3
    assert float(tilted.effect_values["tilt"].grad.numpy()[0]) == pytest.approx((up - down) / 2e-3, rel=1e-3)


@pytest.mark.parametrize("slopes", [False, True])
def test_sixteen_hits_at_once_have_the_numbers_of_one(slopes: bool) -> None:
    n, random = 5 * LANES + 3, np.random.default_rng(1)
    vec8 = wp.types.vector(length=8, dtype=float)

    def put(values: object, dtype: object = float) -> wp.array:
        kind = np.int32 if dtype is int else np.float32
        return wp.array(np.asarray(values, kind), dtype=dtype, device="cpu")

    mine = put(random.permutation(n), int)
    one, zero, none = put([1.0]), put([0], int), put(np.zeros(n), int)
    cosine = put(random.uniform(0.2, 0.9, n))
    zeta = put(random.normal(scale=0.5, size=(n, 8)) - [0, 6, 0, 0, 0, 0, 0, 0], vec8)
    of_hits = {"cos_incidence": cosine, "cos_twist": put(np.ones(n)), "cos2_azimuth": put(np.zeros(n)), "face": none}
    of_materials = {"face_material": zero, "spectrum": zero, "eps_im": one, "aspect": one}
    inputs = [mine, fill(HitSurfaces, wavenumber=200.0, **of_hits, **of_materials), zeta]
    found = []
    for kernel, threads in ((scatter_kernel("several", slopes), n), (at_once(scatter_kernel("several", slopes)), 6)):
        sigma, d_zeta = wp.zeros(n, dtype=float, device="cpu"), wp.zeros(n, dtype=vec8, device="cpu")
        wp.launch(kernel, threads, inputs=inputs, outputs=[sigma, d_zeta], device="cpu")
        found.append((sigma.numpy(), d_zeta.numpy()))
    (sigma, d_zeta), (at_once_sigma, at_once_d_zeta) = found
    assert (sigma > 0).all()
    # exp of vectors is within 2e-7
    assert at_once_sigma == pytest.approx(sigma, rel=1e-5)
    assert at_once_d_zeta == pytest.approx(d_zeta, rel=1e-5, abs=1e-6)
    assert np.any(d_zeta) == slopes
""",
    "docs/scattering.md": f"| `several` | a law of six numbers | h | h, {', '.join(KEYS)} | |\n",
}
"""A model of more parameters than one vector of the device holds."""


@pytest.mark.full
def test_a_model_may_have_more_parameters_than_four(tmp_path: Path) -> None:
    page = WrittenPage("add-a-model.md")
    page.files = SEVERAL
    files = "tests/models/test_several.py tests/models/test_models.py tests/coherent/test_rough_models.py"
    tests = f"pytest -q {files} -k several"
    passed = re.search(r"(\d+) passed", run(tests, page.checkout(tmp_path)))
    assert passed is not None
    assert int(passed[1]) >= 14
