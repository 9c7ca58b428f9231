"""The engine's own properties: the same bits, energy, edges, meshes that are not welded."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp
from bodies import FREQUENCY, WAVELENGTH, K, amplitudes, cross_section, decibels, dihedral, plate, rectangles, scene
from scipy.special import erf, fresnel
from worlds import scene_of, view

import warpsar
from warpsar.coherent import rays as cells
from warpsar.coherent import sweep as sweeping
from warpsar.coherent import traced
from warpsar.coherent.body import CoherentBody
from warpsar.coherent.contributors import contributors
from warpsar.coherent.directions import Directions, radar_records
from warpsar.coherent.joints import joints
from warpsar.coherent.shape import shape_of
from warpsar.coherent.sweep import AmplitudeSweep, sweep
from warpsar.kernels.coherent import edges, tubes
from warpsar.kernels.coherent.cells import TubeEnds
from warpsar.runtime.structs import allocate


def curved_duct() -> warpsar.Mesh:
    """A closed duct: half of a ring of square section, 3 wavelengths wide, its mouth at +X, a wall at its end."""
    width, bend = 3 * WAVELENGTH, 6 * WAVELENGTH
    turn = np.linspace(0.0, np.pi / 2, 121)
    rings = [
        np.stack([-r * np.sin(turn), bend - r * np.cos(turn), np.full_like(turn, z)], axis=1)
        for r in (bend - width / 2, bend + width / 2)
        for z in (-width / 2, width / 2)
    ]
    sides = [(0, 1), (2, 3), (0, 2), (1, 3)]
    corners = [
        [rings[a][i], rings[a][i + 1], rings[b][i + 1], rings[b][i]] for a, b in sides for i in range(len(turn) - 1)
    ]
    corners.append([rings[j][-1] for j in (0, 1, 3, 2)])
    loose = rectangles(*corners)
    one = trimesh.Trimesh(loose.vertices, loose.faces)
    one.merge_vertices()
    return warpsar.Mesh.of(one.vertices, one.faces)


@pytest.fixture
def duct() -> warpsar.Mesh:
    return curved_duct()


def test_same_bits_for_any_number_of_threads(duct: warpsar.Mesh, monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for threads in ("1", "3"):
        monkeypatch.setenv("WARPSAR_THREADS", threads)
        found.append(amplitudes(duct, np.linspace(60.0, 120.0, 9), 90.0, finer=20.0))
    assert np.array_equal(*found)
    assert np.abs(found[0]).max() > 0.01


@pytest.mark.full
@pytest.mark.parametrize(
    ("rays", "part_bytes", "task", "face_bytes"),
    [
        (
            1000,
            2**15,
            2**14,
            50_000,
        ),  # several directions in a task and in a launch of faces
        (200, 2**24, 1000, 2**26),  # several tasks for each direction
    ],
)
def test_launches_may_be_small(
    duct: warpsar.Mesh, monkeypatch: pytest.MonkeyPatch, rays: int, part_bytes: int, task: int, face_bytes: int
) -> None:
    """How much goes into one launch changes the order of sums, and nothing else: also where parts of cells wait."""
    directions = Directions.of(np.linspace(60.0, 120.0, 5), 90.0)
    material = {"eps_r": 4.0, "rms_height_m": 0.001, "correlation_length_m": 0.02}

    def swept(**more: Any) -> list[AmplitudeSweep]:
        bodies = [CoherentBody.of(scene(duct, **of), wp.get_device("cpu")) for of in ({}, {"material": material})]
        return [sweep(body, directions, [0.5 * FREQUENCY, FREQUENCY], compare=True, **more) for body in bodies]

    large = swept() + swept(layers=True)
    for module, name, value in (
        (traced, "RAYS_TOGETHER", rays),
        (traced, "_PART_BYTES", part_bytes),
        (sweeping, "_RAYS_OF_TASK", task),
        (sweeping, "FACE_BYTES", face_bytes),
    ):
        monkeypatch.setattr(module, name, {"cpu": value})
    for one, other in zip(large, swept() + swept(layers=True), strict=True):
        assert one.segments == other.segments
        assert one.refined.max() > 0.1
        for name in ("amplitude", "bounces", "fresnel_number", "refined", "aliased", "spacing_error"):
            expected, found = getattr(one, name), getattr(other, name)
            if expected is not None:
                assert np.abs(found - expected).max() < 1e-11 * np.abs(expected).max()


def test_frequencies_together_are_those_alone(duct: warpsar.Mesh) -> None:
    """The rays are those of the highest frequency."""
    together = warpsar.rcs(scene(duct), [80.0, 95.0], 90.0, [0.5 * FREQUENCY, FREQUENCY], device="cpu")
    alone = warpsar.rcs(scene(duct), [80.0, 95.0], 90.0, FREQUENCY, device="cpu")
    assert np.array_equal(together.amplitude_m[:, :, 1], alone.amplitude_m[:, :, 0])


@pytest.mark.cuda
def test_cuda_is_the_cpu_to_float32(duct: warpsar.Mesh) -> None:
    """Float32 names the face that a ray hits: at borders rays may differ, and where tubes are wide."""
    found = {d: warpsar.rcs(scene(duct), np.linspace(60.0, 120.0, 9), 90.0, device=d) for d in ("cpu", "cuda")}
    difference = found["cuda"].amplitude_m - found["cpu"].amplitude_m
    assert np.linalg.norm(difference) < 0.02 * np.linalg.norm(found["cpu"].amplitude_m)


@pytest.mark.cuda
def test_edges_on_cuda_are_those_of_the_cpu() -> None:
    """Fringe currents are float64. On a plate nothing hides an edge, so no ray decides: what is left is the libraries'
    last digit in sine and cosine, times phases of some hundred radians."""
    body = scene(plate(6 * WAVELENGTH, 4 * WAVELENGTH))
    found = [warpsar.rcs(body, np.linspace(-60.0, 60.0, 13), 90.0, device=d).terms_m["edges"] for d in ("cpu", "cuda")]
    assert np.abs(found[0]).max() > 0.0
    assert np.abs(found[0] - found[1]).max() < 1e-12 * np.abs(found[0]).max()


def test_tubes_that_spread_are_cut_and_the_error_of_the_spacing_is_told(duct: warpsar.Mesh) -> None:
    """A bend spreads tubes. Cutting them halves the error; tubes of twice the width tell what is left of it.

    Where a convex wall is grazed the field goes as x^(-1/4) of the way to the silhouette. So an error falls with the
    spacing to the power of 3/4 there, and what doubling changes is 0.7 of it: the estimate may be too low by half.
    """
    body = CoherentBody.of(scene(duct), wp.get_device("cpu"))
    directions = Directions.of(np.linspace(60.0, 120.0, 11), 90.0)

    def swept(finer: float, levels: int, compare: bool = False) -> AmplitudeSweep:
        return sweep(body, directions, [FREQUENCY], rays_per_wavelength=finer, levels=levels, compare=compare)

    fine = swept(40.0, 5).amplitude.sum(axis=2)
    whole, cut = swept(10.0, 0), swept(10.0, 5, compare=True)
    error = np.abs(cut.amplitude.sum(axis=2) - fine)[:, :, [0, 3]]
    assert np.linalg.norm(error) < 0.75 * np.linalg.norm((whole.amplitude.sum(axis=2) - fine)[:, :, [0, 3]])
    assert whole.aliased.max() > 0.1
    assert cut.aliased.max() < 0.01
    assert cut.spacing_error is not None
    told = cut.spacing_error[:, :, [0, 3]]
    assert 0.5 < np.linalg.norm(told) / np.linalg.norm(error) < 3.0
    assert (error < 2.0 * told).mean() > 0.6


def test_parts_of_a_cell_cover_it() -> None:
    place, size = np.array([[1.0, 2.0], [5.0, 6.0], [9.0, 9.0]]), np.array([[0.4, 0.2], [0.4, 0.2], [0.4, 0.2]])
    rays = cells.CellRays.of(place, size, wp.get_device("cpu"))
    turn = wp.array([[2.0, 2.0], [1.0, 2.0], [1.0, 1.0]], dtype=wp.vec2d, device="cpu")
    found = rays.parts(turn, 1.5, wp.array([4, 6, 6], dtype=int, device="cpu"))
    assert found is not None
    used = found.cells.size.numpy().any(axis=1)
    expected = {(0.9, 1.95, 0.2, 0.1), (1.1, 1.95, 0.2, 0.1), (0.9, 2.05, 0.2, 0.1), (1.1, 2.05, 0.2, 0.1)}
    expected |= {(5.0, 5.95, 0.4, 0.1), (5.0, 6.05, 0.4, 0.1)}
    parts = np.concatenate([found.cells.place.numpy(), found.cells.size.numpy()], axis=1)[used]
    assert {tuple(map(float, row)) for row in np.round(parts, 9)} == expected
    assert used.sum() == len(expected)


def test_a_closed_duct_returns_what_enters(duct: warpsar.Mesh) -> None:
    """Flux: the cross-section of the tubes that leave through the mouth over that of those that enter, to 5 %."""
    body = CoherentBody.of(scene(duct), wp.get_device("cpu"))
    directions = Directions.of([75.0, 90.0, 100.0], 90.0)
    grid = cells.CellGrid(body, directions, WAVELENGTH / 10)
    rays = grid[: len(grid)]
    radars = wp.array(radar_records(directions, body.origin, None), dtype=tubes.TubeRadar, device="cpu")
    n, most = len(rays), 40
    hits = wp.empty((most, n), dtype=tubes.Hit, device="cpu")
    ends = allocate(TubeEnds, n, wp.get_device("cpu"))
    inputs = [body.rays, radars, radars, 0, rays.cells, 1.0, K, most]
    wp.launch(tubes.trace_kernel, n, inputs=inputs, outputs=[hits, ends], device="cpu")
    found, times = hits.numpy().T, ends.count.numpy()
    area = rays.cells.size.numpy().prod(axis=1)
    mouth = body.origin[0]  # the middle's distance behind the mouth
    first, last = found[:, 0], found[np.arange(n), np.maximum(times - 1, 0)]
    entering = (times > 0) & (first["d"] @ [1.0, 0.0, 0.0] < 0)
    # A tube enters that crosses the plane of the mouth inside its square before its first hit.
    along = (first["point"][:, 0] + mouth) / first["d"][:, 0]
    across = first["point"] - along[:, None] * first["d"] + body.origin
    inside = entering & (np.abs(across[:, 1]) < 1.5 * WAVELENGTH) & (np.abs(across[:, 2]) < 1.5 * WAVELENGTH)
    out = last["d"] - 2 * np.einsum("ij,ij->i", last["d"], last["normal"])[:, None] * last["normal"]
    leaving = inside & (times < most) & (out[:, 0] > 0)
    way = -(last["point"][:, 0] + mouth) / np.where(out[:, 0] == 0, 1, out[:, 0])
    exits = last["point"] + way[:, None] * out + body.origin
    leaving &= (np.abs(exits[:, 1:]) < 1.5 * WAVELENGTH * (1 + 1e-6)).all(axis=1)
    entered = (area * inside).sum()
    assert entered == pytest.approx(
        sum((3 * WAVELENGTH) ** 2 * np.cos(np.deg2rad(a)) for a in (15.0, 0.0, 10.0)), rel=0.05
    )
    assert (area * leaving).sum() == pytest.approx(entered, rel=0.05)


@pytest.mark.full
@pytest.mark.parametrize("phi", [0.4, 1.2, 2.0, 2.9, 4.0, 5.8])
@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_fringe_currents_of_a_half_plane(phi: float, tilt: float) -> None:
    """The transform of Sommerfeld's exact currents on both sides of a half-plane, less those of physical optics.

    Integrated numerically with Fresnel integrals (Born and Wolf, 11.5), with a wave that decays a little so that the
    integral ends.
    """
    s = np.array([np.cos(phi) * np.cos(tilt), np.sin(phi) * np.cos(tilt), np.sin(tilt)])
    kt, k = K * np.cos(tilt), K
    root = (np.arange(400_000) + 0.5) / 400_000 * np.sqrt(400 * WAVELENGTH)  # currents go as 1 / sqrt(x) at the edge
    x, step = root**2, 2 * root * (root[1] - root[0])
    damped = np.exp(-((x / (120 * WAVELENGTH)) ** 2))
    rho = np.sqrt(2 * kt * x / np.pi)

    def part(angle: float) -> np.ndarray:
        """e^{jq} F of one of both waves: e^{j kt x cos} (1 + j) / 2 INT_{-inf}^w e^{-j pi t^2 / 2} dt."""
        w = np.sqrt(2.0) * rho * np.cos(angle / 2)
        sine, cosine = fresnel(w)
        return np.exp(1j * kt * x * np.cos(angle)) * (1 + 1j) / 2 * ((cosine - 1j * sine) + (1 - 1j) / 2)

    def slope(angle: float) -> np.ndarray:
        """d part / d angle."""
        w = np.sqrt(2.0) * rho * np.cos(angle / 2)
        inner = (1 + 1j) / 2 * np.exp(-1j * np.pi / 2 * w**2) * -np.sqrt(2.0) * rho * np.sin(angle / 2) / 2
        return -1j * kt * x * np.sin(angle) * part(angle) + np.exp(1j * kt * x * np.cos(angle)) * inner

    total = np.zeros((2, 3), complex)
    for row, e in enumerate((np.array([-np.sin(phi), np.cos(phi), 0.0]), None)):
        e = np.cross(s, np.array([-np.sin(phi), np.cos(phi), 0.0])) if e is None else e
        h = -np.cross(s, e)
        kz = -k * s[2]
        for side, (theta, normal) in enumerate(((0.0, 1.0), (2 * np.pi, -1.0))):
            hard = part(theta - phi) + part(theta + phi)
            soft = (slope(theta - phi) - slope(theta + phi)) / x  # dE / dphi / rho
            lit = float((phi < np.pi) == (side == 0))
            wave = np.exp(1j * kt * x * np.cos(phi))
            hard = hard - 2 * lit * wave
            soft = soft - 2j * kt * np.sin(phi) * lit * wave
            back = np.exp(1j * kt * x * np.cos(phi)) * damped
            fh = (hard * back * step).sum()
            fs = (soft * back * step).sum()
            # Along z the derivative of H_z, by parts; its value at the edge is 1 less physical optics' 2 on a lit side.
            edge = (1.0 - 2.0 * lit) * h[2]
            gradient = -edge - 1j * kt * np.cos(phi) * fh * h[2]
            jx = normal * h[2] * fh
            jz = normal * (-1j * k / kt**2 * e[2] * fs + 1j * kz / kt**2 * gradient)
            total[row] += [jx, 0.0, jz]
    outer = _fringes(s, phi)
    for row in range(2):
        scale = np.abs(total).max()
        assert outer[row] == pytest.approx(total[row], abs=0.01 * scale)


@wp.kernel
def _fringe_kernel(k: wp.float64, s: wp.vec3d, reach: wp.float64, e: wp.array[wp.vec3d], out: wp.array[wp.vec3d]):
    i = wp.tid()
    x = wp.vec3d(wp.float64(1.0), wp.float64(0.0), wp.float64(0.0))
    n = wp.vec3d(wp.float64(0.0), wp.float64(1.0), wp.float64(0.0))
    two = wp.float64(2.0)
    out[i] = edges.fringe(e[i], k, s, x, n, two, reach) + edges.fringe(e[i], k, s, x, -n, two, reach)


def _fringes(s: np.ndarray, phi: float, reach_m: float = 1e9) -> np.ndarray:
    across = np.array([-np.sin(phi), np.cos(phi), 0.0])
    fields = np.stack([across, np.cross(s, across)])
    out = wp.empty(2, dtype=wp.vec3d, device="cpu")
    inputs = [K, wp.vec3d(*s), reach_m, wp.array(fields, dtype=wp.vec3d, device="cpu")]
    wp.launch(_fringe_kernel, 2, inputs=inputs, outputs=[out], device="cpu")
    return 1j * out.numpy()


def test_edges_are_found_also_where_parts_are_not_welded() -> None:
    """A box of six parts, each cut into other triangles, has twelve right-angled edges, each once, and no border."""
    a = 1.0
    parts = []
    for axis in range(3):
        for side in (0.0, a):
            n = 2 + axis + int(side)
            ticks = np.linspace(0.0, a, n)
            i, j = np.meshgrid(ticks, ticks, indexing="ij")
            flat = np.stack([i.ravel(), j.ravel()], axis=1)
            vertices = np.insert(flat, axis, side, axis=1)
            r, c = (each.ravel() for each in np.meshgrid(np.arange(n - 1), np.arange(n - 1), indexing="ij"))
            first = r * n + c
            faces = np.concatenate(
                [np.stack([first, first + n, first + 1], 1), np.stack([first + 1, first + n, first + n + 1], 1)]
            )
            parts.append(trimesh.Trimesh(vertices, faces, process=False))
    body = trimesh.util.concatenate(parts)
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces, np.int32)
    found = joints(vertices, faces)
    assert (found.other >= 0).all()
    shape = shape_of(vertices, faces, np.zeros(len(faces), np.int32))
    length = np.linalg.norm(shape.wedges.end - shape.wedges.start, axis=1) * shape.wedges.share
    assert length.sum() == pytest.approx(12 * a)
    assert shape.wedges.outer == pytest.approx(1.5)
    assert len(shape.regions.area) == 6
    assert shape.regions.area == pytest.approx(a * a)


def test_a_mesh_that_is_cut_finer_has_the_same_amplitude() -> None:
    coarse = plate(0.2, 0.3)
    fine = trimesh.Trimesh(coarse.vertices, coarse.faces).subdivide().subdivide()
    found = [amplitudes(mesh, [70.0, 90.0], 85.0) for mesh in (coarse, warpsar.Mesh.of(fine.vertices, fine.faces))]
    assert found[1] == pytest.approx(found[0], abs=1e-9)


def test_a_shadow_takes_its_share() -> None:
    """Half of a plate in the shadow of another, seen along both normals: a quarter of the cross-section."""
    a = 8 * WAVELENGTH
    lower = rectangles([[0, -a, -a], [0, a, -a], [0, a, a], [0, -a, a]])
    both = rectangles([[0, -a, -a], [0, a, -a], [0, a, a], [0, -a, a]], [[1, 0, -a], [1, a, -a], [1, a, a], [1, 0, a]])
    front = rectangles([[1, 0, -a], [1, a, -a], [1, a, a], [1, 0, a]])
    origin = {"reference": (0.0, 0.0, 0.0), "terms": ("single",)}
    whole = amplitudes(lower, 90.0, 90.0, **origin)[0, 0, 0]
    seen = amplitudes(both, 90.0, 90.0, **origin)[0, 0, 0] - amplitudes(front, 90.0, 90.0, **origin)[0, 0, 0]
    assert decibels(cross_section(seen)) == pytest.approx(decibels(cross_section(whole) / 4), abs=0.1)


def test_no_cross_polarized_return_is_said_as_that() -> None:
    """HV of a tilted plate by physical optics is what rounding leaves of 0, 300 dB down. More rays do not help it."""
    tilt = trimesh.transformations.euler_matrix(0.3, 0.5, 0.7)[:3, :3]
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * 3 * WAVELENGTH @ tilt.T
    mesh = warpsar.Mesh.of(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    for polarizations in (("HH", "HV"), ("HV",)):
        made = scene_of(mesh, [view(0.0, 40.0)], materials={"default": {"conductor": True}}, frequency_hz=FREQUENCY)
        radar = made.radar.model_copy(update={"polarizations": polarizations, "terms": ("single", "multibounce")})
        found = warpsar.rcs(replace(made, radar=radar), [10.0, 35.0], [25.0, 40.0], device="cpu")
        assert 0.0 < found.rcs_m2[..., -1].max() < 1e-25
        assert any("there is no HV return" in one for one in found.warnings)
        assert not any("HH" in one for one in found.warnings)
        assert polarizations == ("HH", "HV") or not any("rays-per-wavelength" in one for one in found.warnings)


@pytest.mark.parametrize("y", [0.02, 0.1, 100.0])
def test_a_current_ends_with_its_face(y: float) -> None:
    """Close to grazing what goes like 1 / phi is that of e^{-jkx} / sqrt(x), times e^{jkx cos(phi)}, up to the end.

    The transform is erf(sqrt(j y)) of an endless one. What does not grow like 1 / phi is 5 % of the rest.
    """
    phi = 0.05
    s = np.array([np.cos(phi), np.sin(phi), 0.0])
    whole, cut = (np.abs(_fringes(s, phi, end)[0, 0]) for end in (1e9, y / (K * (1.0 - np.cos(phi)))))
    assert cut / whole == pytest.approx(np.abs(erf(np.sqrt(1j * y))), abs=0.06)


def test_contributors_add_up_to_the_terms() -> None:
    """Faces and edges of a dihedral between slanted directions: the sums of `rcs`, to the rounding of 1e5 tubes."""
    made = scene(dihedral(0.15, 0.12))
    found = contributors(made, 40.0, 80.0)
    whole = warpsar.rcs(made, [40.0], [80.0])
    for term, of_faces in found.faces_m.items():
        amplitude = whole.terms_m[term][0, 0, 0]
        np.testing.assert_allclose(np.abs(of_faces.sum(axis=0)), np.abs(amplitude), atol=1e-12)
    assert np.abs(found.faces_m["multibounce"][:, 0]).min() > 0.0  # both plates send
    edges = whole.terms_m["edges"][0, 0, 0]
    np.testing.assert_allclose(np.abs(found.edges_m.sum(axis=0)), np.abs(edges), atol=1e-12)
    assert len(found.start) == 7  # six borders, and the outer side of the fold
