"""A material's `model`: images, gradients, tables of sigma0, and what is refused at the door."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scattering_reference as reference
import warp as wp
from worlds import SOIL, WAVENUMBER, box, ground, mesh_of, scene_of, sigma0, view

from warpsar import InputError, Material, Scene, learn, renderer, simulate
from warpsar.kernels.codes import Polarization
from warpsar.kernels.models import facet
from warpsar.kernels.shade import HitSurfaces
from warpsar.learning.problem import FitProblem
from warpsar.learning.trust import outside_domains
from warpsar.models import registry
from warpsar.runtime.structs import fill
from warpsar.surface.tables import Tables

TABLE = "incidence_deg,HH,VV,HV\n20,-8,-7,-16\n40,-14,-12,-22\n60,-20,-16,-29\n"
ROUGH = {"eps_r": (9.0, -0.8), "rms_height_m": 0.003, "correlation_length_m": 0.03, "spectrum": "exponential"}


@pytest.fixture
def table(tmp_path: Path) -> Path:
    path = tmp_path / "lawn.csv"
    path.write_text(TABLE)
    return path


def lawn(material: dict[str, Any], polarizations: tuple[str, ...] = ("HH", "VV", "HV")) -> Scene:
    return scene_of(
        mesh_of(lawn=ground(12.0)),
        view(30, 40),
        shape=(20, 22),
        spacing_m=(0.7, 0.6),
        polarizations=polarizations,
        materials={"lawn": material},
    )


def middle(scene: Scene, polarization: str) -> float:
    """sigma0 of level ground at 40 degrees: beta0 times the sine of the incidence."""
    image = renderer(scene, device="cpu")()["view"][polarization]
    return float(image[8:12, 8:14].mean() * np.sin(np.radians(40.0)))


def test_level_ground_has_the_models_sigma0(table: Path) -> None:
    theta, eps, kh, kl = np.radians(40.0), 9.0 - 0.8j, 0.003 * WAVENUMBER, 0.03 * WAVENUMBER
    for polarization in ("HH", "VV", "HV"):
        found = middle(lawn({**ROUGH, "model": "i2em"}), polarization)
        hv = polarization == "HV"
        expected = reference.i2em_hv(theta, eps, kh, kl) if hv else reference.i2em(polarization, theta, eps, kh, kl)
        assert found == pytest.approx(expected, rel=0.16 if hv else 1e-4)  # HV: its quadrature
        found = middle(lawn({"model": "oh", "eps_r": 9.0, "rms_height_m": 0.003}), polarization)
        assert found == pytest.approx(reference.oh(polarization, theta, reference.topp(9.0), kh), rel=1e-4)
        found = middle(lawn({"model": "facet", "sigma0": table, "level": 2.0}), polarization)
        assert found == pytest.approx(2 * 10 ** ({"HH": -14, "VV": -12, "HV": -22}[polarization] / 10), rel=1e-4)
    found = middle(lawn({"model": "dubois", "eps_r": 9.0, "rms_height_m": 0.003}, ("HH",)), "HH")
    assert found == pytest.approx(reference.dubois("HH", theta, 9.0, kh, 200 * np.pi / WAVENUMBER), rel=1e-4)


def test_a_table_is_interpolated_in_decibels_and_held_at_its_ends(table: Path) -> None:
    for incidence, expected in ((10, -8.0), (30, -11.0), (50, -17.0), (75, -20.0)):
        scene = replace(lawn({"model": "facet", "sigma0": table}, ("HH",)), views=[view(30, incidence)])
        image = renderer(scene, device="cpu")()["view"]["HH"]
        found = image[9:11, 8:14].mean() * np.sin(np.radians(incidence))
        assert 10 * np.log10(found) == pytest.approx(expected, abs=0.001)


def block_on_lawn(materials: dict[str, dict[str, Any]]) -> Scene:
    return scene_of(
        mesh_of(lawn=ground(12.0), block=box((-2, -1.5, 0), (2, 1.5, 2))),
        [view(30, 40, name="a"), view(250, 55, name="b")],
        shape=(20, 22),
        spacing_m=(0.7, 0.6),
        polarizations=("HH", "VV"),
        materials=materials,
        rays_per_pixel=16.0,
    )


def test_every_hit_has_the_model_of_its_material() -> None:
    """A block of another model changes the ground's pixels by nothing, and the images are sums over the materials."""
    own = {**ROUGH, "model": "i2em"}
    both = renderer(block_on_lawn({"lawn": SOIL, "block": own}), device="cpu")()
    plain = renderer(block_on_lawn({"lawn": SOIL, "block": SOIL}), device="cpu")()
    other = renderer(block_on_lawn({"lawn": own, "block": SOIL}), device="cpu")()
    all_own = renderer(block_on_lawn({"lawn": own, "block": own}), device="cpu")()
    for name in ("a", "b"):
        for polarization in ("HH", "VV"):
            one, two, three, four = (each[name][polarization] for each in (both, plain, other, all_own))
            np.testing.assert_allclose(one + three, two + four, rtol=1e-5, atol=1e-7)
            corner = one[-3:, :3], two[-3:, :3]  # far from the block
            np.testing.assert_array_equal(*corner)


@pytest.mark.parametrize("model", ["i2em", "oh", "dubois", "facet"])
def test_gradients_are_those_of_differences(model: str, table: Path) -> None:
    own: dict[str, Any] = {**ROUGH, "model": model}
    if model == "facet":
        own = {"model": model, "sigma0": table, "learn": ("level",)}
    elif model != "i2em":
        del own["correlation_length_m"]
    scene = block_on_lawn({"lawn": own, "block": {**SOIL, "learn": ("eps_r",)}})
    render = renderer(scene, device="cpu")
    random = np.random.default_rng(0)
    seeds = {name: {p: random.random(image.shape) for p, image in one.items()} for name, one in render().items()}
    parameters = render.values
    gradient = render.vjp(parameters, seeds)
    assert set(gradient) == set(parameters)
    for name, value in parameters.items():
        step = 1e-2 * np.asarray(value)

        def at(change: float, name: str = name, step: Any = step, value: Any = value) -> float:
            images = render({**parameters, name: value + change * step})
            return float(sum((seeds[v][p] * images[v][p]).sum() for v in seeds for p in seeds[v]))

        expected = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / 12
        assert float(np.sum(gradient[name] * step)) == pytest.approx(expected, rel=2e-3)  # float32 sums


REFUSED = [
    ({"model": "iem"}, "model"),
    ({"model": "i2em", "spectrum": "separable", "correlation_length_m": [0.02, 0.01]}, "separable"),
    ({"model": "i2em", "learn": ["specular_fraction"]}, "does not depend on it"),
    ({"model": "i2em", "specular_fraction": 0.1}, "specular_fraction"),
    ({"model": "oh", "learn": ["correlation_length_m"]}, "does not depend on it"),
    ({"model": "facet"}, "needs sigma0"),
    ({"sigma0": "lawn.csv"}, 'model = "facet" alone'),
    ({"model": "dubois"}, "HH and VV alone"),
    ({"model": "facet", "sigma0": "lawn.csv", "level": "bright"}, 'a name needs layout = "texture"'),
    ({"model": "facet", "sigma0": "lawn.csv", "level": "bright", "layout": "vertex"}, "vertex scalar of the mesh"),
    ({"model": "facet", "sigma0": "lawn.csv", "level": 0.0}, "level: .*a number above 0 to 1e\\+06"),
    ({"model": "facet", "sigma0": "lawn.csv", "tolerance": {"level": 0.1}, "learn": []}, "tolerance.*level"),
    ({"model": "facet", "sigma0": "lawn.csv", "learn": ["eps_r"]}, "does not depend on it"),
    ({"learn": ["level"]}, "level"),
]


@pytest.mark.parametrize(("keys", "said"), REFUSED)
def test_what_does_not_fit_the_model_is_refused(keys: dict[str, Any], said: str, table: Path) -> None:
    keys = {key: str(table) if key == "sigma0" else value for key, value in keys.items()}
    with pytest.raises((InputError, ValueError), match=said):
        lawn({**SOIL, **keys})


TABLES = [
    ("incidence_deg,HH\n20,-8\n40,-14\n", "must have VV, HV too"),
    ("incidence_deg,HH,VV,HV\n40,-8,-8,-9\n20,-14,-8,-9\n", "must ascend"),
    ("incidence_deg,HH,VV,HV\n20,-8,-8,-9\n20,-14,-8,-9\n", "must ascend"),
    ("incidence_deg,HH,VV,HV\n40,-8,-8,-9\n40.0000001,-14,-8,-9\n", "must ascend"),  # one angle in float32
    ("incidence_deg,HH,VV,HV\n20,-8,-8,-9\n", "two or more"),
    ("incidence_deg,HH,VV,HV\n20,-8,-8,nan\n30,-8,-8,-9\n", "must be numbers"),
    ("incidence_deg,HH,VV,HV\n20,-8,-8\n30,-8,-8,-9\n", "must be 4 numbers"),
    ("angle,HH\n20,-8\n40,-14\n", "must be incidence_deg"),
    ("incidence_deg,HH,HH\n20,-8,1\n40,-14,1\n", "must be incidence_deg"),
    ("", "none"),
]


@pytest.mark.parametrize(("text", "said"), TABLES)
def test_a_table_that_is_none_is_refused(text: str, said: str, table: Path) -> None:
    table.write_text(text)
    with pytest.raises(InputError, match=said):
        lawn({"model": "facet", "sigma0": table})


@pytest.mark.parametrize("eps_r", [300.0, 1e9])
def test_dubois_is_finite_for_what_is_no_soil(eps_r: float) -> None:
    """Its powers of ten of eps' tan(theta) leave float32 within the bounds of a fit, 300."""
    scene = replace(lawn({**ROUGH, "model": "dubois", "eps_r": eps_r}, ("HH", "VV")), views=[view(30, 80)])
    for image in simulate(scene, device="cpu")[0].beta0.values():
        assert np.isfinite(image).all()
        assert image.max() > 1.0


def test_an_effect_of_the_default_alone_is_refused() -> None:
    scene = lawn({**ROUGH, "model": "i2em"})
    with pytest.raises(InputError, match=r"two_scale; allowed with it: ka_spm$"):
        replace(scene, effects={"two_scale": {"slope_variance": 0.02}})


def test_effects_of_a_surface_are_refused_beside_a_table(table: Path) -> None:
    scene = lawn({"model": "facet", "sigma0": table})
    rough = [name for name in registry.names() if registry.get(name).of_surface]
    assert {"ka_spm", "oh", "two_scale"} <= set(rough)
    with pytest.raises(InputError, match=rf"multibounce; allowed with it: {', '.join(rough)}$"):
        replace(scene, effects={"multibounce": {"strength": 1.0}})


def test_a_scene_file_keeps_model_and_table(table: Path) -> None:
    scene = lawn({"model": "facet", "sigma0": table, "level": 1.5})
    path = table.parent / "scene.toml"
    scene.save(path)
    again = Scene.load(path)
    assert again.materials["lawn"].model == "facet"
    assert again.materials["lawn"].level == 1.5
    assert 'sigma0 = "lawn.csv"' in path.read_text()
    assert Material(**ROUGH, model="i2em").learn == ("eps_r", "rms_height_m", "correlation_length_m")
    assert Material(model="oh", eps_r=6.0, rms_height_m=0.01).learn == ("eps_r", "rms_height_m")


def test_learned_coordinates_have_no_slope_to_what_a_model_has_not() -> None:
    """The default's small-perturbation image of the same surface stays what it was."""
    found = middle(lawn(SOIL), "HH")
    assert found == pytest.approx(float(sigma0(np.radians(40.0))), rel=1e-4)


@pytest.mark.parametrize(
    ("kl", "spectrum", "polarization", "outside"),
    [
        (3.6, "gaussian", "HV", 0.0),
        (4.4, "gaussian", "HV", 1.0),
        (4.4, "gaussian", "VH", 1.0),
        (4.4, "gaussian", "HH", 0.0),
        (4.4, "exponential", "HV", 0.0),
    ],
)
def test_hv_of_a_gaussian_has_a_domain_of_its_own(
    kl: float, spectrum: str, polarization: str, outside: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its integral has too few waves beyond kl = 4: `learn` counts that area, and `simulate` warns of it."""
    soil = {**ROUGH, "model": "i2em", "spectrum": spectrum, "correlation_length_m": kl / WAVENUMBER}
    scene = lawn(soil, ("VV", polarization))
    images = simulate(scene, device="cpu")[0].beta0
    assert ("kl < 4 for HV of a gaussian" in capsys.readouterr().err) == bool(outside)
    seen = [view(30, 40).model_copy(update={"images": images, "looks": 4.0})]
    problem = FitProblem(replace(scene, views=seen), wp.get_device("cpu"))
    assert outside_domains(problem, problem.x0) == {"lawn": {"i2em": pytest.approx(outside)}}


@pytest.mark.parametrize(
    ("material", "said"),
    [
        ({**ROUGH, "model": "i2em"}, None),
        ({**ROUGH, "model": "i2em", "rms_height_m": 0.02, "correlation_length_m": 0.1}, "i2em .kh < 3"),
        ({"model": "oh", "eps_r": 9.0, "rms_height_m": 0.003}, None),
        ({"model": "oh", "eps_r": 40.0, "rms_height_m": 0.003}, "oh .kh from 0.13"),
        ({"model": "dubois", "eps_r": 9.0, "rms_height_m": 0.02}, "dubois .kh < 2.5"),
        ({"model": "facet", "level": 1.0}, None),
    ],
)
def test_what_lies_outside_a_models_domain_is_said(
    material: dict[str, Any], said: str | None, table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    given = {**material, "sigma0": table} if material["model"] == "facet" else material
    simulate(lawn(given, ("HH", "VV")), device="cpu")
    message = capsys.readouterr().err
    assert (said is None) == ("domain" not in message)
    if said is not None:
        assert re.search(f"100 % of its lit area lies outside the domain of {said}", message)


@pytest.mark.full
def test_a_fit_with_the_right_model_finds_the_surface(table: Path) -> None:
    """eps, h and l of an i2em surface from three incidences, HH and VV, without speckle; `level` of a table."""
    truth = {**ROUGH, "eps_r": 9.0, "model": "i2em"}

    def scene(material: dict[str, Any]) -> Scene:
        seen = [view(120 * k, incidence, name=f"v{k}") for k, incidence in enumerate((30, 40, 50))]
        return replace(lawn(material, ("HH", "VV")), views=seen)

    def with_images(material: dict[str, Any], begin: dict[str, Any]) -> Scene:
        made = scene(material)
        images = {one.name: one.beta0 for one in simulate(made, device="cpu")}
        seen = [one.model_copy(update={"images": images[one.name], "looks": 100.0}) for one in made.views]
        return replace(made, views=seen, materials={"lawn": Material(**{**material, **begin})})

    begun = with_images(truth, {"eps_r": 6.0, "rms_height_m": 0.004, "correlation_length_m": 0.024})
    found = learn(begun, device="cpu")
    soil = found.scene.materials["lawn"]
    assert soil.eps_r == pytest.approx(9.0, rel=0.02)
    assert soil.rms_height_m == pytest.approx(0.003, rel=0.01)
    assert soil.correlation_length_m == pytest.approx(0.03, rel=0.03)
    assert found.domains == {"lawn": {"i2em": 0.0}}
    begun = with_images({"model": "facet", "sigma0": table, "level": 2.0}, {"level": 0.7})
    begun = replace(begun, materials={"lawn": Material(model="facet", sigma0=table, level=0.7, learn=("level",))})
    assert learn(begun, device="cpu").scene.materials["lawn"].level == pytest.approx(2.0, rel=1e-3)


def test_a_tables_sigma0_has_the_derivatives_of_differences_to_its_values(table: Path) -> None:
    """The kernel's adjoint by Warp: between 40 and 60 degrees two rows count, each with its share."""
    tables = Tables.of([table], wp.get_device("cpu"))
    assert tables is not None
    angles = np.radians([44.0, 50.0, 75.0])

    def put(values: Any, dtype: Any, grad: bool = False) -> wp.array:
        return wp.array(values, dtype=dtype, device="cpu", requires_grad=grad)

    def sigma(db: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, out = put(db.astype(np.float32), float, True), put(np.zeros(3, np.float32), float, True)
        zero = put(np.zeros(3, np.int32), int)
        cosine = put(np.cos(angles).astype(np.float32), float)
        where = dict.fromkeys(("face", "face_material", "spectrum"), zero)
        where |= dict.fromkeys(("cos_incidence", "cos_twist", "cos2_azimuth", "eps_im", "aspect"), cosine)
        surfaces = fill(HitSurfaces, polarization=int(Polarization.VV), local_basis=1, **where)
        inputs = [put(np.arange(3, dtype=np.int32), int), surfaces, tables.rows]
        inputs += [tables.incidence_deg, values, put(np.zeros((3, 4), np.float32), wp.vec4)]
        with wp.Tape() as tape:
            none = wp.empty(0, dtype=wp.vec4, device="cpu")
            wp.launch(facet.scatter_kernel, 3, inputs=inputs, outputs=[out, none], device="cpu")
        tape.backward(grads={out: put(np.ones(3, np.float32), float)})
        return out.numpy().astype(float), values.grad.numpy()

    base = tables.sigma0_db.numpy().astype(float)
    found = sigma(base)[1]
    for row in range(3):
        moved = np.zeros_like(base)
        moved[row, Polarization.VV] = 0.05
        expected = (sigma(base + moved)[0].sum() - sigma(base - moved)[0].sum()) / 0.1
        assert found[row, Polarization.VV] == pytest.approx(expected, rel=2e-3, abs=1e-6)
    assert not found[:, Polarization.HH].any()


def bright_lawn(table: Path, given: dict[str, Any]) -> Scene:
    """Level ground seen from north, so that columns go along x; its vertices have the scalar `bright`, exp(0.1 x)."""
    mesh = mesh_of(lawn=ground(24.0, 6))
    mesh = replace(mesh, vertex_scalars={"bright": np.exp(0.1 * mesh.vertices[:, 0])})
    seen = [view(0, incidence, name=f"v{incidence}") for incidence in (35, 50)]
    material = {"model": "facet", "sigma0": table, **given}
    return scene_of(mesh, seen, shape=(20, 22), spacing_m=(0.7, 0.6), materials={"lawn": material})


@pytest.mark.parametrize("layout", ["vertex", "texture"])
def test_a_models_own_value_may_be_a_map(layout: str, table: Path) -> None:
    """Its logarithm is linear in x, and a pixel has the mean of exp(0.1 x) over its width of 0.6 m."""
    flat = bright_lawn(table, {})
    x = flat.mesh.vertices[:, 0]
    flat = replace(flat, mesh=replace(flat.mesh, uv=np.stack([(x + 14.0) / 28.0, np.full(len(x), 0.5)], axis=1)))
    texels = np.tile(np.exp(0.1 * np.linspace(-12.0, 12.0, 7)), (2, 1))  # their centres stand at the vertices
    material = Material(model="facet", sigma0=table, layout=layout, level="bright" if layout == "vertex" else texels)
    scene = replace(flat, materials={"lawn": material})
    plain, found = (renderer(one, device="cpu")()["v35"]["HH"][10] for one in (flat, scene))
    centre = (np.arange(22) - 10.5) * 0.6
    expected = np.exp(0.1 * centre) * np.sinh(0.03) / 0.03
    # float32, and the sampling noise of where in the pixel the rays lie
    assert found / plain == pytest.approx(expected, rel=1e-3)


def test_a_fit_finds_the_map_of_a_models_own_value(table: Path) -> None:
    truth = bright_lawn(table, {"layout": "vertex", "level": "bright"})
    images = {one.name: one.beta0 for one in simulate(truth, device="cpu")}
    seen = [one.model_copy(update={"images": images[one.name], "looks": 100.0}) for one in truth.views]
    flat = replace(truth.mesh, vertex_scalars={"bright": np.ones(len(truth.mesh.vertices))})
    material = truth.materials["lawn"].model_copy(update={"learn": ("level",)})
    found = learn(replace(truth, mesh=flat, views=seen, materials={"lawn": material}), device="cpu").scene
    inside = np.abs(truth.mesh.vertices[:, :2]).max(axis=1) < 5.0  # what the image holds
    assert inside.sum() == 9
    level = found.field("lawn", "level")
    assert level[inside] == pytest.approx(truth.mesh.vertex_scalars["bright"][inside], rel=0.01)


def test_a_models_own_value_may_be_known(table: Path) -> None:
    """Far better known than the images tell, it stays; and its prior is a parabola of the value."""
    truth = lawn({"model": "facet", "sigma0": table, "level": 2.0}, ("HH",))
    images = {one.name: one.beta0 for one in simulate(truth, device="cpu")}
    seen = [one.model_copy(update={"images": images[one.name], "looks": 1.0}) for one in truth.views]

    def known(sd: float) -> Scene:
        tolerance = {"level": {"about": 1.5, "sd": sd}}
        material = Material(model="facet", sigma0=table, level=1.6, learn=("level",), tolerance=tolerance)
        return replace(truth, views=seen, materials={"lawn": material})

    problem = FitProblem(known(0.5), wp.get_device("cpu"))
    assert problem.prior.value(problem.x0) == pytest.approx(0.5 * (0.1 / 0.5) ** 2, rel=1e-9)
    assert learn(known(1e-4), device="cpu").scene.materials["lawn"].level == pytest.approx(1.5, abs=3e-4)
    assert learn(known(10.0), device="cpu").scene.materials["lawn"].level == pytest.approx(2.0, rel=5e-3)
