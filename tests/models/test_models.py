"""What every backscatter model promises, whichever are in the registry: a new one is tested without a change here."""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import jsonschema
import numpy as np
import pytest
import warp as wp
from scipy.optimize import brentq
from worlds import WAVENUMBER, box, ground, mesh_of, scene_of, view

from warpsar import InputError, Material, Scene, renderer, simulate
from warpsar.kernels import scatter
from warpsar.kernels.codes import Polarization, Spectrum
from warpsar.kernels.lane_kernels import at_once
from warpsar.models import registry
from warpsar.models.base.model import BackscatterModel, Domain, SurfaceParameter
from warpsar.models.base.parameters import OF_SURFACES
from warpsar.scene.schema import scene_schema
from warpsar.surface import stage
from warpsar.surface.surface import kinds_of, places_of

ROOT = Path(__file__).resolve().parents[2]
MODELS = registry.names()
OF_FUNCTIONS = [name for name in MODELS if not registry.get(name).from_table]
SURFACE = {"eps_r": 9.0, "rms_height_m": 0.003, "correlation_length_m": 0.03}
SYMBOLS = {"eps_r": "eps", "rms_height_m": "h", "correlation_length_m": "l", "specular_fraction": "τ"}
"""As docs/scattering.md has the parameters of surfaces; those of one model alone go by their keys."""
BOUNDED = [
    (name, key, end)
    for name in MODELS
    for key in ("incidence_deg", "kh", "kl", "moisture", "slope")
    for end in np.atleast_1d(getattr(registry.get(name).domain, key)).tolist()
    if np.isfinite(end) and not (key == "incidence_deg" and end in (0.0, 90.0)) and end != 0.0
]
"""Where domains end: model, measure, and its end."""


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A table of sigma0, for models that take one."""
    path = tmp_path / "lawn.csv"
    path.write_text("incidence_deg,HH,VV,HV\n10,-8,-7,-16\n40,-14,-12,-22\n80,-20,-16,-29\n")
    return path


def material(name: str, table: Path, **more: Any) -> dict[str, Any]:
    """A material of the model: a soil, or the example of each parameter that it has alone; all of it is learned."""
    model = registry.get(name)
    given: dict[str, Any] = {key: value for key, value in SURFACE.items() if key in model.keys}
    given |= {key: one.example for key, one in registry.own_parameters().items() if key in model.keys}
    if "specular_fraction" in model.keys:
        given["specular_fraction"] = 0.2
    if model.from_table:
        given["sigma0"] = table
    if "exponential" in model.spectra and "correlation_length_m" in model.keys:
        given["spectrum"] = "exponential"
    return {"model": name, "learn": model.keys, **given, **more}


def lawn(name: str, table: Path, incidence_deg: float = 40.0, **more: Any) -> Scene:
    """Level ground of the model, and a block that is turned about every line of sight."""
    given = material(name, table, **more)
    return scene_of(
        mesh_of(lawn=ground(12.0), block=box((-2, -1.5, 0), (2, 1.5, 2))),
        view(30.0, incidence_deg),
        shape=(16, 18),
        spacing_m=(0.9, 0.8),
        rays_per_pixel=16.0,
        polarizations=registry.get(name).channels,
        materials={"lawn": given, "block": {**given, "learn": ()}},
    )


# ---- files ----


def test_the_models_are_the_files_of_two_folders() -> None:
    for folder in ("warpsar/models", "kernels/models"):
        files = {path.stem for path in (ROOT / folder).glob("*.py")} - {"__init__", "registry"}
        assert files == set(MODELS)


@pytest.mark.parametrize("name", MODELS)
def test_a_model_has_the_name_of_its_file_and_words(name: str) -> None:
    model = registry.get(name)
    assert model.name == name
    assert model.summary
    assert [registry.get(other).order for other in MODELS].count(model.order) == 1
    assert set(model.channels) <= {"HH", "VV", "HV", "VH"}


@pytest.mark.parametrize("name", MODELS)
def test_a_model_has_its_row_in_the_documentation(name: str) -> None:
    """Of docs/scattering.md: which parameters can be learned, and where the domain ends, are those declared."""
    page = (ROOT / "docs" / "scattering.md").read_text(encoding="utf-8")
    rows = re.findall(rf"^\| `{name}` \|(.*)\|$", page, re.MULTILINE)
    assert rows, f"docs/scattering.md has no row of {name}"
    words, _, learned, domain = (cell.strip() for cell in rows[0].split("|"))
    model = registry.get(name)
    assert model.summary.split(",")[0].split(";")[0] in words
    expected = {SYMBOLS.get(key, key) for key in model.keys} | ({"sigma0"} if model.from_table else set())
    assert set(re.findall(r"[\wτ]+", learned.replace(" or ", " "))) == expected
    numbers = {float(number) for number in re.findall(r"\d+(?:\.\d+)?", domain)}
    for owner, _, end in BOUNDED:
        assert owner != name or any(end == pytest.approx(number, abs=0.005) for number in numbers), f"{end} in {domain}"


# ---- parameters ----


@pytest.mark.parametrize("name", MODELS)
def test_every_parameter_is_a_key_of_its_own_model_alone(name: str, table: Path) -> None:
    scene = lawn(name, table)
    allowed = set(registry.get(name).keys)
    for kind in kinds_of(name):
        parameter = scene.parameters[f"materials.lawn.{kind.key}"]
        assert parameter.freed
        assert parameter.low <= kind.low < kind.high <= parameter.high
        assert parameter.fit_bounds == (kind.low, kind.high)
        assert parameter.value == getattr(scene.materials["lawn"], kind.key)
        assert kind.from_coordinate(kind.to_coordinate(parameter.value)) == pytest.approx(float(parameter.value))
    others = {one.key: one for one in (*OF_SURFACES, *registry.own_parameters().values()) if one.key not in allowed}
    for key in others:
        with pytest.raises(InputError, match=f"found {key}; sigma0 of the model {name} does not depend on it"):
            Material(**material(name, table, learn=(key,)))
    for key in registry.own_parameters().keys() & others.keys():
        with pytest.raises(InputError, match=f'found {key} and model = "{name}"'):
            Material(**material(name, table, **{key: 0.7 * others[key].default}))


@pytest.mark.parametrize("key", registry.own_parameters())
def test_a_models_own_key_is_in_the_schema_with_its_limits(key: str, tmp_path: Path) -> None:
    own = registry.own_parameters()[key]
    field = scene_schema()["properties"]["materials"]["additionalProperties"]["properties"][key]
    assert field["description"] == own.description
    assert field["default"] == own.default
    jsonschema.validate(own.example, field)
    least = own.limits[0] if own.from_low else np.nextafter(own.limits[0], np.inf)
    for inside in (float(least), own.limits[1]):
        jsonschema.validate(inside, field)
    for outside in (float(np.nextafter(least, -np.inf)), 1.01 * own.limits[1]):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(outside, field)
        with pytest.raises(InputError, match=key):
            Material(model=MODELS[0], **SURFACE, **{key: outside})


@pytest.mark.parametrize("name", MODELS)
def test_a_scene_file_keeps_the_material(name: str, table: Path) -> None:
    scene = lawn(name, table)
    path = table.parent / "scene.toml"
    scene.save(path)
    assert Scene.load(path).materials["lawn"].model_dump() == scene.materials["lawn"].model_dump()


@pytest.mark.parametrize("name", MODELS)
def test_a_polarization_that_a_model_has_not_is_refused(name: str, table: Path) -> None:
    scene = lawn(name, table)
    for channel in {"HH", "VV", "HV", "VH"} - set(registry.get(name).channels):
        with pytest.raises(InputError, match=f'found "{name}" and {channel}'):
            replace(scene, radar=scene.radar.model_copy(update={"polarizations": (channel,)}))


# ---- domain ----


@pytest.mark.parametrize(("name", "key", "end"), BOUNDED)
def test_a_warning_comes_where_the_domain_ends(
    name: str, key: str, end: float, table: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Level ground 2 % to either side of an end, where no other measure ends."""

    def warned(value: float) -> bool:
        changed: dict[str, Any] = {
            "incidence_deg": {},
            "kh": {"rms_height_m": value / WAVENUMBER, "correlation_length_m": 10.0 * value / WAVENUMBER},
            "kl": {"correlation_length_m": value / WAVENUMBER},
            "moisture": {"eps_r": _permittivity(value) if key == "moisture" else 9.0},
            "slope": {"correlation_length_m": SURFACE["rms_height_m"] / value},
        }[key]
        given = {one: number for one, number in changed.items() if one in registry.get(name).keys}
        scene = lawn(name, table, value if key == "incidence_deg" else 40.0, **given)
        channels = tuple(one for one in scene.radar.polarizations if one in ("HH", "VV"))  # HV may have its own
        scene = replace(
            scene,
            mesh=mesh_of(lawn=ground(12.0)),
            materials={"lawn": scene.materials["lawn"]},
            radar=scene.radar.model_copy(update={"polarizations": channels}),
        )
        capsys.readouterr()
        simulate(scene, device="cpu")
        said = capsys.readouterr().err
        assert ("100 % of its lit area" in said) == ("outside the domain" in said)
        return f"outside the domain of {registry.get(name).domain.words}" in said

    assert {warned(0.98 * end), warned(1.02 * end)} == {True, False}


def _permittivity(moisture: float) -> float:
    """That of Topp, Davis and Annan 1980 at a moisture [m^3/m^3]."""

    def off(eps: float) -> float:
        return float(4.3e-6 * eps**3 - 5.5e-4 * eps**2 + 2.92e-2 * eps - 5.3e-2 - moisture)

    return float(brentq(off, 2.0, 40.0))


# ---- derivatives ----


@cache
def kernel_of(name: str) -> Any:
    both, places = scatter.functions_of(name).sigma0_and_slopes_of, scatter.places_of(name)

    @wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
    def slopes_kernel(
        codes: wp.vec2i, wavenumber: wp.float64, given: wp.array2d(dtype=wp.float64), out: wp.array2d(dtype=wp.float64)
    ):
        """Rows of `given`: theta, cos psi and the coordinates; codes: polarization, spectrum."""
        i = wp.tid()
        one = wp.float64(1.0)
        zeta = wp.vector(length=wp.static(places), dtype=wp.float64)
        for k in range(wp.static(places)):
            zeta[k] = given[i, k + 2]
        found = both(codes[0], codes[1], 0, wavenumber, wp.cos(given[i, 0]), given[i, 1], one, one, one, zeta)
        for k in range(wp.static(places + 1)):
            out[i, k] = found[k]

    return slopes_kernel


@pytest.mark.parametrize("name", OF_FUNCTIONS)
def test_slopes_are_those_of_differences(name: str, table: Path) -> None:
    """In float64, by all places: those that a model has not change nothing."""
    model, random, n, step = registry.get(name), np.random.default_rng(2), 40, 1e-3
    stated = Material(**material(name, table))
    about = np.zeros(scatter.places_of(name))
    for place, kind in enumerate(places_of(name)):
        if kind.key in model.keys:
            about[place] = kind.to_coordinate(getattr(stated, kind.key))
    rows = np.column_stack([random.uniform(0.1, 1.2, n), random.uniform(0.6, 1.0, n), np.tile(about, (n, 1))])
    rows[:, 2:] += random.uniform(-0.4, 0.4, (n, about.size))
    spectrum = Spectrum[stated.spectrum.upper()]

    def at(channel: str, given: np.ndarray) -> np.ndarray:
        found = wp.zeros((n, about.size + 1), dtype=wp.float64, device="cpu")
        inputs = [wp.vec2i(int(Polarization[channel]), int(spectrum)), WAVENUMBER]
        inputs += [wp.array(given, dtype=wp.float64, device="cpu")]
        wp.launch(kernel_of(name), n, inputs=inputs, outputs=[found], device="cpu")
        return found.numpy()

    # of sigma0: five points leave step^4. A series ends where its terms fall below a tolerance, which jumps: over the
    # step that is 2 % of I2EM's single scattering, and 10 % of its double
    jump = {"i2em": 0.1}.get(name, 1e-5)
    for channel in model.channels:
        found = at(channel, rows)
        assert (found[:, 0] > 0.0).all()
        for place, kind in enumerate(places_of(name)):
            moved = np.zeros(rows.shape[1])
            moved[2 + place] = step
            near, far = (at(channel, rows + m * moved)[:, 0] - at(channel, rows - m * moved)[:, 0] for m in (1, 2))
            expected = (8 * near - far) / (12 * step)
            assert (np.abs(found[:, 1 + place] - expected) <= jump * found[:, 0]).all(), (channel, kind.key)
            if kind.key in model.keys and channel in ("HH", "VV"):
                assert found[:, 1 + place].any()
            elif kind.key not in model.keys:
                assert not found[:, 1 + place].any()


@pytest.mark.parametrize("name", MODELS)
def test_images_have_the_derivatives_of_differences(name: str, table: Path) -> None:
    """Both ways, to each parameter: what fits and Jacobians take."""
    render = renderer(lawn(name, table), device="cpu")
    parameters, random = render.values, np.random.default_rng(0)
    seeds = {view: {p: random.random(one.shape) for p, one in images.items()} for view, images in render().items()}
    gradient = render.vjp(parameters, seeds)
    assert set(gradient) == {f"materials.lawn.{key}" for key in registry.get(name).keys}
    for key, value in parameters.items():
        step = 1e-2 * float(value)

        def at(change: float, key: str = key, value: Any = value, step: float = step) -> float:
            return total(render({**parameters, key: value + change * step}))

        def total(images: Any) -> float:
            return float(sum((seeds[v][p] * images[v][p]).sum() for v in seeds for p in seeds[v]))

        expected = (8 * (at(1) - at(-1)) - (at(2) - at(-2))) / 12
        assert float(gradient[key]) * step == pytest.approx(expected, rel=2e-3)  # float32 sums
        assert total(render.jvp(parameters, {key: step})) == pytest.approx(expected, rel=2e-3)


# ---- what is none ----


def _law(**changed: Any) -> BackscatterModel:
    one = SurfaceParameter("slope_of_law", "s", "log", 1e-3, 1e3, (0.0, 1e6))
    given: dict[str, Any] = {"name": "law", "summary": "a law", "order": 99, "parameters": (one,)}
    return BackscatterModel(**{**given, "domain": Domain("it"), **changed})


def test_one_key_has_one_meaning(monkeypatch: pytest.MonkeyPatch) -> None:
    other = SurfaceParameter("level", "g", "linear", -1.0, 1.0, (-2.0, 2.0))
    found = registry.get
    monkeypatch.setattr(registry, "names", lambda: (*MODELS, "law"))
    monkeypatch.setattr(registry, "get", lambda name: _law(parameters=(other,)) if name == "law" else found(name))
    registry.own_parameters.cache_clear()
    with pytest.raises(ValueError, match="model law: level is the key of another parameter already"):
        registry.own_parameters()
    monkeypatch.undo()
    registry.own_parameters.cache_clear()


@wp.func
def value_alone(
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
    """A law that declares a parameter, and has no derivative to it."""
    value = cos_incidence * wp.exp(zeta[0])
    return wp.vector(value, value * 0.0)


def test_a_parameter_without_a_derivative_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = {"law": SimpleNamespace(sigma0_and_slopes_of=value_alone), "lawless": ModuleType("lawless")}
    monkeypatch.setattr(scatter, "functions_of", fake.get)
    with pytest.raises(AttributeError, match="sigma0_and_slopes_of"):
        scatter.scatter_kernel("lawless", True)
    kernel = scatter.scatter_kernel("law", True)
    with pytest.raises(NotImplementedError, match=r"scatter.py:\d+: 'found\[2\]': there are 2"):
        at_once(kernel)


def test_functions_of_another_number_of_coordinates_are_refused(monkeypatch: pytest.MonkeyPatch, table: Path) -> None:
    monkeypatch.setattr(stage, "places_of", lambda model: 8)
    with pytest.raises(ValueError, match=r"kernels/models/oh.py: takes 8 coordinates, and the model has 4"):
        simulate(lawn("oh", table), device="cpu")
