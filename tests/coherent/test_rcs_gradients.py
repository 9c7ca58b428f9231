"""Derivatives of complex amplitudes against closed forms and central differences."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp
from bodies import DIAGONAL, FREQUENCY, WAVELENGTH, K, dihedral, plate, rectangles, scene, square_trihedral
from surface_model import sigma0_kernel
from test_engine import curved_duct
from test_materials import stack

import warpsar
from warpsar import InputError
from warpsar.world.objects.pose import rotation

SLAB = {"eps_r": (2.6, -0.2), "rms_height_m": 0.0, "thickness_m": 0.003}
ROUGH = {"eps_r": (5.0, -1.0), "rms_height_m": 0.001, "correlation_length_m": 0.01, "specular_fraction": 0.1}


def slopes(mesh: warpsar.Mesh, azimuth: Any, incidence: Any, *names: str, finer: float = 10.0, **more: Any) -> Any:
    found = warpsar.rcs_gradients(
        scene(mesh, **more), azimuth, incidence, parameters=names, device="cpu", rays_per_wavelength=finer
    )
    return found.rcs.amplitude_m, found.jacobian()


def amplitude(mesh: warpsar.Mesh, azimuth: Any, incidence: Any, **more: Any) -> np.ndarray:
    return warpsar.rcs(scene(mesh, **more), azimuth, incidence, device="cpu").amplitude_m


def moved(mesh: warpsar.Mesh, vertex: int, axis: int, step: float) -> warpsar.Mesh:
    vertices = mesh.vertices.copy()
    vertices[vertex, axis] += step
    return warpsar.Mesh.of(vertices, mesh.faces)


def by_vertex(mesh: warpsar.Mesh, vertex: int, axis: int, step: float, *angles: Any, **more: Any) -> np.ndarray:
    ends = [amplitude(moved(mesh, vertex, axis, s), *angles, **more) for s in (step, -step)]
    return (ends[0] - ends[1]) / (2 * step)


def agrees(found: np.ndarray, expected: np.ndarray, share: float) -> bool:
    """To a share of the largest."""
    return bool(np.abs(found - expected).max() <= share * np.abs(expected).max())


def test_a_plate_that_moves_away() -> None:
    """d/dx of e^{2jk s.x} is 2jk s, and its area's share at normal incidence is -jk / (2 pi) of each side."""
    az, inc = np.deg2rad([70.0, 85.0]), np.deg2rad(80.0)
    found, jacobian = slopes(plate(0.15, 0.21), [70.0, 85.0], 80.0, "pose.position_m", terms=("single", "edges"))
    s = np.stack([np.sin(az) * np.sin(inc), np.cos(az) * np.sin(inc), np.full(2, np.cos(inc))], axis=-1)
    expected = 2j * K * s[:, None, None, None] * found[..., None]
    assert agrees(jacobian["pose.position_m"], expected, 1e-9)
    _, jacobian = slopes(plate(0.15, 0.21), 90.0, 90.0, "mesh.vertices", terms=("single",))
    wider = jacobian["mesh.vertices"][0, 0, 0, 0][1:3, 1].sum()  # both vertices of one side
    assert wider == pytest.approx(-1j * K / (2 * np.pi) * 0.21, rel=1e-9)


@pytest.mark.parametrize("term", ["single", "edges"])
@pytest.mark.parametrize(("vertex", "axis"), [(0, 1), (2, 2), (1, 1)])
def test_vertices_of_a_plate_in_its_plane(term: str, vertex: int, axis: int) -> None:
    """Differences of the exact phase integral, and of fringe currents: 1e-7 of rounding and step."""
    angles, mesh = ([70.0, 85.0], 80.0), plate(0.15, 0.21)
    _, jacobian = slopes(mesh, *angles, "mesh.vertices", terms=(term,))
    expected = by_vertex(mesh, vertex, axis, 1e-6, *angles, terms=(term,))
    assert agrees(jacobian["mesh.vertices"][..., vertex, axis], expected, 1e-6)


def test_edges_of_a_box() -> None:
    """Each vertex turns faces, changes outer angles, and how far a face goes from its edge: 1e-7 m keep faces flat."""
    box = trimesh.creation.box((0.12, 0.2, 0.16))
    mesh, angles = warpsar.Mesh.of(box.vertices, box.faces), ([70.0, 35.0], 80.0)
    _, jacobian = slopes(mesh, *angles, "mesh.vertices", terms=("edges",))
    for vertex, axis in ((7, 2), (5, 0)):
        expected = by_vertex(mesh, vertex, axis, 1e-7, *angles, terms=("edges",))
        assert agrees(jacobian["mesh.vertices"][..., vertex, axis], expected, 1e-5)


def test_a_plate_that_turns() -> None:
    mesh, angles = plate(0.15, 0.21), ([70.0, 85.0], 80.0)
    _, jacobian = slopes(mesh, *angles, "pose.heading_deg", "pose.pitch_deg", "pose.roll_deg", terms=("single",))
    for i, name in enumerate(("heading", "pitch", "roll")):
        ends = []
        for step in (1e-3, -1e-3):
            turned = mesh.vertices @ rotation(*(step * np.eye(3)[i])).T
            ends.append(amplitude(warpsar.Mesh.of(turned, mesh.faces), *angles, terms=("single",)))
        assert agrees(jacobian[f"pose.{name}_deg"], (ends[0] - ends[1]) / 2e-3, 1e-5)


def test_a_slab_against_its_matrices() -> None:
    """-R of the conductor's amplitude, and R by 2 x 2 matrices: its differences to 1e-6."""
    turned, step = 31.0, 1e-6
    conductor = amplitude(plate(0.3, 0.2), 90.0 - turned, 90.0, terms=("single",))[0, 0, 0]
    names = "materials.default.eps_r", "materials.default.thickness_m"
    _, jacobian = slopes(plate(0.3, 0.2), 90.0 - turned, 90.0, *names, terms=("single",), material=SLAB)
    sine = np.sin(np.deg2rad(turned))

    def change(eps: complex, thickness: float) -> np.ndarray:
        ends = [stack(2.6 - 0.2j + s * eps, 0.003 + s * thickness, False, sine) for s in (step, -step)]
        te, tm = (np.array(ends[0]) - np.array(ends[1])) / (2 * step)
        return -np.array([tm, te]) * conductor[[0, 3]]

    eps = jacobian["materials.default.eps_r"][0, 0, 0][[0, 3]]
    assert agrees(eps[:, 0], change(1.0, 0.0), 1e-6)
    assert agrees(eps[:, 1], change(1.0j, 0.0), 1e-6)
    assert agrees(jacobian["materials.default.thickness_m"][0, 0, 0][[0, 3]], change(0.0, 1.0), 1e-6)


def test_the_polarization_across_a_slab() -> None:
    """Differences of the engine, to 1e-6 of the largest: the material, and a corner that moves in the plane."""
    mesh, angles, step = plate(0.3, 0.2), ([47.0, 75.0], 83.0), 1e-6
    more = {"terms": ("edges",)}
    names = ("materials.default.eps_r", "materials.default.thickness_m", "mesh.vertices")
    _, jacobian = slopes(mesh, *angles, *names, material=SLAB, **more)
    for name, values in (
        ("thickness_m", [0.003 + step, 0.003 - step]),
        ("eps_r", [(2.6 + step, -0.2), (2.6 - step, -0.2)]),
    ):
        ends = [amplitude(mesh, *angles, material={**SLAB, name: value}, **more) for value in values]
        found = jacobian[f"materials.default.{name}"]
        assert agrees(found[..., 0] if name == "eps_r" else found, (ends[0] - ends[1]) / (2 * step), 1e-6)
    moved = np.zeros_like(mesh.vertices)
    moved[2, 1] = step
    ends = [
        amplitude(warpsar.Mesh.of(mesh.vertices + s * moved, mesh.faces), *angles, material=SLAB, **more)
        for s in (1, -1)
    ]
    assert agrees(jacobian["mesh.vertices"][..., 2, 1], (ends[0] - ends[1]) / (2 * step), 1e-6)


@pytest.mark.parametrize("conductor", [False, True])
def test_two_bounces_on_slabs(conductor: bool) -> None:
    """Differences of the engine, slabs in air and on a conductor: tubes do not change with what faces are made of."""
    mesh, angles, step = dihedral(0.3, 0.24), ([40.0, 52.0], 80.0), 1e-6
    slab, more = {**SLAB, "conductor": conductor}, {"terms": ("multibounce",)}
    names = ("materials.default.eps_r", "materials.default.thickness_m")
    _, jacobian = slopes(mesh, *angles, *names, material=slab, **more)
    for name, values in (
        ("thickness_m", [0.003 + step, 0.003 - step]),
        ("eps_r", [(2.6 + step, -0.2), (2.6 - step, -0.2)]),
    ):
        ends = [amplitude(mesh, *angles, material={**slab, name: value}, **more) for value in values]
        found = jacobian[f"materials.default.{name}"]
        assert agrees(found[..., 0] if name == "eps_r" else found, (ends[0] - ends[1]) / (2 * step), 1e-6)


def test_two_bounces_on_half_spaces() -> None:
    """Both parts of eps_r, against differences of the engine."""
    mesh, angles, step = dihedral(0.3, 0.24), ([40.0, 52.0], 80.0), 1e-6
    more = {"terms": ("multibounce",)}
    half = {"eps_r": (5.0, -0.7), "rms_height_m": 0.0}
    _, jacobian = slopes(mesh, *angles, "materials.default.eps_r", material=half, **more)
    for part in (0, 1):
        moved = [(5.0 + s * step * (part == 0), -0.7 + s * step * (part == 1)) for s in (1, -1)]
        ends = [amplitude(mesh, *angles, material={**half, "eps_r": value}, **more) for value in moved]
        assert agrees(jacobian["materials.default.eps_r"][..., part], (ends[0] - ends[1]) / (2 * step), 1e-6)


def test_the_coherent_part_of_a_rough_face() -> None:
    """exp(-2 (k h cos)^2): its derivative in h is -4 k^2 h cos^2 times it."""
    material = {"eps_r": 6.0, "rms_height_m": 0.002, "correlation_length_m": 0.02}
    found, jacobian = slopes(
        plate(0.3, 0.2), 65.0, 90.0, "materials.default.rms_height_m", "materials.default.correlation_length_m",
        terms=("single",), material=material,
    )  # fmt: skip
    expected = -4 * K**2 * 0.002 * np.cos(np.deg2rad(25.0)) ** 2 * found
    assert agrees(jacobian["materials.default.rms_height_m"], expected, 1e-9)
    assert not jacobian["materials.default.correlation_length_m"].any()


def test_rough_scatterers_follow_sigma0() -> None:
    """One normal for all of them, so each amplitude goes as the root of sigma0: Re(dA / A) = d ln sigma0 / 2."""
    ground = rectangles([[-0.2, -0.2, 0], [0.2, -0.2, 0], [0.2, 0.2, 0], [-0.2, 0.2, 0]])
    material = {"eps_r": 7.0, "rms_height_m": 0.0012, "correlation_length_m": 0.01, "specular_fraction": 0.0}
    names = ("materials.default.eps_r", "materials.default.rms_height_m", "materials.default.correlation_length_m")
    found, jacobian = slopes(ground, [0.0, 130.0], 25.0, *names, terms=("rough",), material=material)

    def sigma0(eps: float, h: float, length: float) -> np.ndarray:
        out = wp.empty(2, dtype=wp.float64, device="cpu")
        inputs = [K, np.cos(np.deg2rad(25.0)), eps, 0.0, h, length, 0.0, out]
        wp.launch(sigma0_kernel, 2, inputs=inputs, device="cpu")
        return out.numpy()

    at = np.array([7.0, 0.0012, 0.01])
    for i, name in enumerate(names):
        step = 1e-5 * at[i] * np.eye(3)[i]
        expected = np.log(sigma0(*(at + step)) / sigma0(*(at - step))) / (4e-5 * at[i])
        for p, polarization in ((0, 0), (3, 1)):
            ratio = jacobian[name][:, 0, 0, p] / found[:, 0, 0, p]
            assert ratio.real == pytest.approx(expected[polarization], rel=1e-5)


def test_rough_scatterers_with_all_their_parts() -> None:
    """Differences of the engine: places, numbers and their count are those of the seed."""
    mesh, angles = plate(0.3, 0.2), ([60.0, 85.0], 80.0)
    names = ("materials.default.rms_height_m", "materials.default.correlation_length_m", "pose.pitch_deg")
    _, jacobian = slopes(mesh, *angles, *names, material=ROUGH)
    for name in names[:2]:
        key = name.rpartition(".")[2]
        step = 1e-4 * ROUGH[key]
        ends = [amplitude(mesh, *angles, material={**ROUGH, key: ROUGH[key] + s}) for s in (step, -step)]
        assert agrees(jacobian[name], (ends[0] - ends[1]) / (2 * step), 1e-6)
    ends = [
        amplitude(warpsar.Mesh.of(mesh.vertices @ rotation(0, s, 0).T, mesh.faces), *angles, material=ROUGH)
        for s in (1e-3, -1e-3)
    ]
    assert agrees(jacobian["pose.pitch_deg"], (ends[0] - ends[1]) / 2e-3, 1e-5)


def test_an_edge_that_takes_light_from_another_plate() -> None:
    """A plate before another one: its edge moves, one loses the strip that the other gains."""
    a = 8 * WAVELENGTH
    mesh = rectangles([[0, -a, -a], [0, a, -a], [0, a, a], [0, -a, a]], [[1, 0, -a], [1, a, -a], [1, a, a], [1, 0, a]])
    _, jacobian = slopes(mesh, 90.0, 90.0, "mesh.vertices", terms=("single",))
    found = jacobian["mesh.vertices"][0, 0, 0, 0][[4, 7], 1].sum()
    expected = -1j * K / (2 * np.pi) * 2 * a * (1 - np.exp(2j * K))
    assert found == pytest.approx(expected, rel=1e-6)


def test_a_trihedral_that_grows() -> None:
    """Three bounces: A = sqrt(3) a^2 / lambda. Its aperture is a hexagon, whose border no vertex holds by itself."""
    a = 10 * WAVELENGTH
    mesh = square_trihedral(a)
    _, jacobian = slopes(mesh, 45.0, DIAGONAL, "mesh.vertices", terms=("multibounce",))
    found = (jacobian["mesh.vertices"][0, 0, 0] * mesh.vertices / a).sum(axis=(1, 2))
    expected = 2 * np.sqrt(3) * a / WAVELENGTH
    assert np.abs(found[[0, 3]]) == pytest.approx(expected, rel=0.02)


@pytest.mark.full
def test_a_trihedral_that_turns() -> None:
    """Three bounces off the axis, against differences over azimuth: a heading of 1 degree is an azimuth of -1 degree.

    Tubes of lambda / 60 and a step of 0.5 degrees leave the differences 2 %.
    """
    mesh, incidence, more = square_trihedral(10 * WAVELENGTH), DIAGONAL - 6.0, {"terms": ("multibounce",)}
    _, jacobian = slopes(mesh, 38.0, incidence, "pose.heading_deg", finer=20.0, **more)
    beside = scene(mesh, **more)
    ends = warpsar.rcs(beside, [37.5, 38.5], incidence, device="cpu", rays_per_wavelength=60.0).amplitude_m[:, 0, 0]
    assert agrees(jacobian["pose.heading_deg"][0, 0, 0][[0, 3]], (ends[0] - ends[1])[[0, 3]], 0.04)


def test_a_sphere_that_grows() -> None:
    """Physical optics: A = -jk (r e^{2jkr} / (2jk) - (e^{2jkr} - 1) / (2jk)^2). Tubes of lambda / 10: 5 %."""
    radius, x = 5 * WAVELENGTH, 2j * K
    mesh = warpsar.Mesh.of(trimesh.creation.icosphere(4, radius=radius))
    found = warpsar.rcs_gradients(
        scene(mesh, terms=("single",), polarizations=("HH",)), 20.0, 70.0, parameters=["mesh.vertices"], device="cpu"
    )
    parts = [(found.vjp([[[[c]]]])["mesh.vertices"] * mesh.vertices).sum() / radius for c in (1.0, 1.0j)]

    def closed(r: float) -> complex:
        return complex(-1j * K * (r * np.exp(x * r) / x - (np.exp(x * r) - 1) / x**2))

    expected = (closed(radius + 1e-6) - closed(radius - 1e-6)) / 2e-6
    assert abs(parts[0] + 1j * parts[1] - expected) < 0.05 * abs(expected)


@pytest.mark.parametrize(("terms", "share"), [(("single", "multibounce"), 0.03), (("edges",), 1e-6)])
def test_a_duct_that_grows(terms: tuple[str, ...], share: float) -> None:
    """A(k, (1 + e) x) = (1 + e) A(k (1 + e), x), so d/de = A + k dA/dk. Rays are the same for all frequencies."""
    mesh = curved_duct()
    body = scene(mesh, terms=terms, polarizations=("VV",))
    found = warpsar.rcs_gradients(body, [80.0, 95.0], 89.0, parameters=["mesh.vertices"], device="cpu")
    grown = np.zeros(2, complex)
    for i in range(2):
        for unit in (1.0, 1.0j):
            cotangent = np.zeros(found.rcs.amplitude_m.shape, complex)
            cotangent[i] = unit
            grown[i] += unit * (found.vjp(cotangent)["mesh.vertices"] * mesh.vertices).sum()
    beside = [FREQUENCY * (1 - 1e-5), FREQUENCY * (1 + 1e-5)]
    ends = warpsar.rcs(body, [80.0, 95.0], 89.0, beside, device="cpu").amplitude_m[:, 0, :, 0]
    expected = found.rcs.amplitude_m[:, 0, 0, 0] + (ends[:, 1] - ends[:, 0]) / 2e-5
    assert agrees(grown, expected, share)


def test_near_by_tubes_take_the_place_of_exact_borders() -> None:
    """At 1e6 m the wave is plane, and a plate's tubes of lambda / 40 have the derivative of its phase integral."""
    mesh, angles = plate(0.15, 0.21), (85.0, 80.0)
    _, exact = slopes(mesh, *angles, "mesh.vertices", terms=("single",))
    _, tubes = slopes(mesh, *angles, "mesh.vertices", terms=("single",), slant_range_m=1e6, finer=40.0)
    assert agrees(tubes["mesh.vertices"], exact["mesh.vertices"], 0.01)


def test_one_pass_back_is_the_jacobian() -> None:
    found = warpsar.rcs_gradients(
        scene(dihedral(0.1, 0.08)),
        [40.0, 50.0],
        [80.0, 85.0],
        parameters=["mesh.vertices", "pose.heading_deg"],
        device="cpu",
    )
    shape = found.rcs.amplitude_m.shape
    random = np.random.default_rng(3)
    cotangent = random.standard_normal(shape) + 1j * random.standard_normal(shape)
    jacobian, gradient = found.jacobian(), found.vjp(cotangent)
    for name in found.parameters:
        whole = cotangent.reshape(*shape, *(1,) * (jacobian[name].ndim - 4)).conj() * jacobian[name]
        assert gradient[name] == pytest.approx(whole.real.sum(axis=(0, 1, 2, 3)), rel=1e-9, abs=1e-12)


def test_same_bits_for_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for threads in ("1", "3"):
        monkeypatch.setenv("WARPSAR_THREADS", threads)
        one = warpsar.rcs_gradients(
            scene(dihedral(0.1, 0.08)), [40.0, 50.0, 60.0], 80.0, parameters=["mesh.vertices"], device="cpu"
        )
        found.append(one.vjp(one.rcs.amplitude_m)["mesh.vertices"])
    assert np.array_equal(*found)
    assert found[0].any()


@pytest.mark.parametrize(
    ("names", "material", "message"),
    [
        (["radar.terms"], None, "is a choice, not a number"),
        (["radar.max_bounces"], None, "is a choice, not a number"),
        (["visibility"], None, "is discrete"),
        (["default.conductor"], None, "has no derivative here"),
        (["materials.default.eps_r"], None, "the scene does not state it"),
        (["materials.default.rms_height_m"], None, "a smooth face has no scatterers"),
        (["mesh.vertices"], ROUGH, "drawn anew"),
        (["nothing"], None, "found no such parameter"),
        ([], None, "must be one or more names"),
    ],
)
def test_what_has_no_derivative_is_refused(names: list[str], material: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        warpsar.rcs_gradients(scene(plate(0.1, 0.1), material=material), 80.0, parameters=names, device="cpu")


def test_a_face_along_the_line_of_sight_is_refused() -> None:
    with pytest.raises(InputError, match="a flat face stands exactly along the line of sight"):
        warpsar.rcs_gradients(scene(plate(0.1, 0.1)), [80.0, 0.0], parameters=["mesh.vertices"], device="cpu")


def test_a_cotangent_of_another_shape_is_refused() -> None:
    found = warpsar.rcs_gradients(scene(plate(0.1, 0.1)), [80.0], parameters=["mesh.vertices"], device="cpu")
    with pytest.raises(InputError, match=r"cotangent: found shape \(2,\)"):
        found.vjp([1.0, 2.0])


def test_an_object_that_moves_and_turns(tmp_path: Path) -> None:
    """A plate among others: its own position and heading, against the scene with the plate elsewhere."""

    def placed(east: float, heading: float) -> warpsar.Scene:
        table = f"""
            [scene]
            [radar]
            frequency_hz = {FREQUENCY!r}
            polarizations = ["VV"]
            terms = ["single", "edges"]
            [image]
            shape = [4, 4]
            spacing_m = [1.0, 1.0]
            [materials.body]
            conductor = true
            [[views]]
            name = "none"
            azimuth_deg = 0.0
            incidence_deg = 45.0
            [[objects]]
            name = "still"
            primitive = "plate"
            size_m = [0.2, 0.3, 0.0]
            material = "body"
            [[objects]]
            name = "loose"
            primitive = "plate"
            size_m = [0.15, 0.1, 0.0]
            position_m = [{0.5 + east!r}, 0.1, 0.0]
            heading_deg = {20.0 + heading!r}
            material = "body"
        """
        path = tmp_path / "scene.toml"
        path.write_text("\n".join(line.strip() for line in table.splitlines()))
        return warpsar.Scene.load(path)

    names = ["objects.loose.position_m", "objects.loose.heading_deg"]
    found = warpsar.rcs_gradients(placed(0.0, 0.0), [30.0, 77.0], 50.0, parameters=names, device="cpu").jacobian()
    for name, step in (("objects.loose.position_m", (1e-6, 0.0)), ("objects.loose.heading_deg", (0.0, 1e-4))):
        ends = [
            warpsar.rcs(placed(sign * step[0], sign * step[1]), [30.0, 77.0], 50.0, device="cpu").amplitude_m
            for sign in (1.0, -1.0)
        ]
        slope = found[name][..., 0] if name == "objects.loose.position_m" else found[name]
        assert agrees(slope, (ends[0] - ends[1]) / (2 * max(step)), 1e-5)


@pytest.mark.cuda
def test_cuda_has_the_gradients_of_the_cpu() -> None:
    """To the sums' order; rays at borders may meet other faces there (float32)."""
    found = []
    for device in ("cpu", "cuda"):
        one = warpsar.rcs_gradients(
            scene(dihedral(0.1, 0.08), material=SLAB), [40.0, 50.0], 80.0,
            parameters=["mesh.vertices", "materials.default.eps_r"], device=device,
        )  # fmt: skip
        found.append(one.vjp(np.ones(one.rcs.amplitude_m.shape)))
    for name in found[0]:
        assert agrees(found[1][name], found[0][name], 0.02)
