"""A transmitter apart from the receiver, and a band so wide that amplitudes change in it: right, said, or refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import trimesh
import warp as wp
from collected_scenes import FREQUENCY, ROUGH, WAVELENGTH, field, scene, square_trihedral
from numpy.typing import NDArray

import warpsar
from warpsar.coherent.body import CoherentBody
from warpsar.collection import places
from warpsar.collection.plan import plan_of
from warpsar.kernels import collection as kernels
from warpsar.kernels.coherent.tubes import TubeRadar
from warpsar.runtime import devices
from warpsar.runtime.structs import fill
from warpsar.world.collection import Transmitter
from warpsar.world.taper import width_in_cells

F64 = NDArray[np.float64]
A = 10 * WAVELENGTH
K = 2 * np.pi / WAVELENGTH
AXIS = np.ones(3) / np.sqrt(3)
PEAK = K / (2 * np.pi) * np.sqrt(3) * A**2
"""Amplitude of the corner along its axis: k / 2 pi times its aperture."""
FAR = 10e3
FOUR = ("HH", "HV", "VH", "VV")


def toward(azimuth_deg: float, incidence_deg: float) -> F64:
    azimuth, incidence = np.deg2rad([azimuth_deg, incidence_deg])
    sine = np.sin(incidence)
    return np.array([np.sin(azimuth) * sine, np.cos(azimuth) * sine, np.cos(incidence)])


def basis(s: F64) -> F64:
    """H and V of an antenna in the direction `s`, (2, 3)."""
    u = np.array([s[1], -s[0], 0.0]) / np.hypot(s[0], s[1])
    return np.array([u, np.cross(-u, s)])


def seen(
    mesh: warpsar.Mesh,
    transmitter: F64,
    receiver: F64,
    terms: tuple[str, ...] = ("single", "multibounce"),
    material: dict[str, Any] | None = None,
) -> NDArray[np.complex128]:
    """Amplitudes [m] of HH, HV, VH and VV in the middle of band and track: transmitted first, received second."""
    azimuth, incidence = np.rad2deg([np.arctan2(receiver[0], receiver[1]), np.arccos(receiver[2])])
    made = scene(
        mesh,
        material=material or {"conductor": True},
        view={"azimuth_deg": float(azimuth), "incidence_deg": float(incidence)},
        radar={"terms": terms, "polarizations": FOUR},
        collection={
            "pulses": 32,
            "aperture_deg": 0.02,
            "resolution_m": None,
            "bandwidth_hz": 1e7,
            "transmitter": Transmitter(position_m=tuple(FAR * transmitter)),
        },
    )
    (found,) = warpsar.phase_history(made, device="cpu")
    plan, middle = found.plan, found.samples.shape[1] // 2
    samples = found.samples[:, middle, plan.middle].astype(complex)
    return samples / np.sqrt(4 * np.pi)


def plate(a: float, b: float, tilt_deg: float = 0.0) -> warpsar.Mesh:
    """A rectangle about the origin, turned about its side along x."""
    c, s = np.cos(np.deg2rad(tilt_deg)), np.sin(np.deg2rad(tilt_deg))
    corners = np.array([[-a, -b], [a, -b], [a, b], [-a, b]]) / 2
    vertices = np.stack([corners[:, 0], c * corners[:, 1], s * corners[:, 1]], axis=1)
    return warpsar.Mesh.of(vertices, np.array([[0, 1, 2], [0, 2, 3]]))


def optics_of_plate(a: float, b: float, transmitter: F64, receiver: F64) -> NDArray[np.complex128]:
    """Physical optics of a level conducting rectangle: -jk / 4 pi times its currents 2 n x H, and two sinc (Balanis,
    Advanced Engineering Electromagnetics, 11.3)."""
    n = np.array([0.0, 0.0, 1.0])
    both = transmitter + receiver
    integral = a * b * np.sinc(K * a * both[0] / (2 * np.pi)) * np.sinc(K * b * both[1] / (2 * np.pi))
    found = [
        p_out @ (2.0 * np.cross(n, np.cross(-transmitter, p_in)))
        for p_in in basis(transmitter)
        for p_out in basis(receiver)
    ]
    return -1j * K / (4 * np.pi) * integral * np.array(found)


@pytest.mark.parametrize(
    ("sent", "received"),
    [
        ((0.0, 40.0), (180.0, 40.0)),
        ((0.0, 40.0), (180.0, 37.0)),
        ((0.0, 20.0), (90.0, 20.0)),
        ((0.0, 60.0), (172.0, 58.0)),
    ],
)
def test_a_plate_has_the_pattern_of_physical_optics(sent: Any, received: Any) -> None:
    """Mirror direction and beside it, in and out of the plane of incidence: to 2 % of the mirrored amplitude."""
    a, b = 8 * WAVELENGTH, 6 * WAVELENGTH
    transmitter, receiver = toward(*sent), toward(*received)
    found = seen(plate(a, b), transmitter, receiver, ("single",))
    expected = optics_of_plate(a, b, transmitter, receiver)
    peak = K * a * b * transmitter[2] / (2 * np.pi)
    assert np.abs(np.abs(found) - np.abs(expected)).max() < 0.02 * peak
    if np.abs(expected).max() > 0.5 * peak:
        strong = int(np.abs(expected).argmax())
        assert np.angle(found[strong] / expected[strong]) == pytest.approx(0.0, abs=0.05)


@pytest.mark.full
@pytest.mark.parametrize("angle_deg", [30.0, 60.0, 90.0])
def test_a_sphere_is_that_of_optics(angle_deg: float) -> None:
    """pi a^2 at every angle, and the way to the point that mirrors: to 0.8 dB and 0.2 rad, which are what the end of
    the currents at the border of light adds (1 / sqrt(k a))."""
    radius = 5 * WAVELENGTH
    ball = trimesh.creation.icosphere(5, radius=radius)
    mesh = warpsar.Mesh.of(np.asarray(ball.vertices), np.asarray(ball.faces))
    found = seen(mesh, toward(0.0, angle_deg / 2), toward(180.0, angle_deg / 2), ("single",))
    assert np.abs(10 * np.log10(4 * np.abs(found[[0, 3]]) ** 2 / radius**2)).max() < 0.8
    assert np.abs(found[[1, 2]]).max() < 1e-3 * np.abs(found).max()
    mirrored = np.exp(2j * K * radius * np.cos(np.deg2rad(angle_deg / 2)))
    assert np.abs(np.angle(found[[0, 3]] / mirrored)).max() < 0.2


def by_rays(
    transmitter: F64, receiver: F64, axes: tuple[int, ...] = (0, 1, 2), rays: int = 400
) -> NDArray[np.complex128]:
    """Mirrors of the square corner by rays of the transmitter, with their fields, and the currents of every hit:
    HH, HV, VH, VV. `axes`: of the normals of the squares that are there."""
    u, v = basis(transmitter)
    edge = np.linspace(-1.3 * A, 1.3 * A, rays)
    first, second = (each.ravel()[:, None] for each in np.meshgrid(edge, edge))
    place = first * u + second * v + 3 * A * transmitter
    way, alive = np.full(len(place), -3 * A), np.ones(len(place), bool)
    direction = np.broadcast_to(-transmitter, place.shape).copy()
    fields = [np.broadcast_to(p, place.shape).copy() for p in (u, v)]
    total = np.zeros(4, complex)
    for _ in axes:
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = -place / direction
        steps = np.where((steps > 1e-9) & (direction < 0.0), steps, np.inf)
        for axis in range(3):
            met = place + np.where(np.isfinite(steps[:, [axis]]), steps[:, [axis]], 0.0) * direction
            others = np.delete(met, axis, axis=1)
            inside = (others >= -1e-9).all(axis=1) & (others <= A).all(axis=1) & (axis in axes)
            steps[:, axis] = np.where(inside, steps[:, axis], np.inf)
        face, step = steps.argmin(axis=1), steps.min(axis=1)
        alive &= np.isfinite(step)
        step = np.where(alive, step, 0.0)
        place, way = place + step[:, None] * direction, way + step
        normal = np.eye(3)[face]
        area = (edge[1] - edge[0]) ** 2 / np.maximum(-(normal * direction).sum(axis=1), 1e-9)
        turn = np.where(alive, area * np.exp(-1j * K * (way - place @ receiver)), 0.0)
        currents = [2.0 * np.cross(normal, np.cross(direction, each)) for each in fields]
        total += [(turn * (each @ p)).sum() for each in currents for p in basis(receiver)]
        fields = [2.0 * (normal * each).sum(axis=1, keepdims=True) * normal - each for each in fields]
        direction[np.arange(len(place)), face] *= -1.0
    return -1j * K / (4 * np.pi) * total


@pytest.mark.full
@pytest.mark.parametrize(
    ("angle_deg", "allowed"), [(1.0, 0.01), (3.0, 0.01), (8.0, 0.01), (20.0, 0.01), (45.0, 0.01), (70.0, 0.03)]
)
def test_a_corner_fades_as_the_receiver_leaves_its_beam(angle_deg: float, allowed: float) -> None:
    """In all polarizations, to a share of its peak: the borders of faces between rays, which graze them at the end."""
    half, across = np.deg2rad(angle_deg) / 2, np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    sent, received = (np.cos(half) * AXIS + sign * np.sin(half) * across for sign in (1.0, -1.0))
    expected = by_rays(sent, received)
    assert np.abs(expected).max() < 0.97 * PEAK
    found = seen(square_trihedral(A), sent, received)
    assert np.abs(found - expected).max() < allowed * PEAK


def lit(mesh: warpsar.Mesh, material: dict[str, Any], *ends: F64, count: int = 40_000) -> tuple[F64, F64, F64]:
    """What rough places send between antennas in some directions: places (n, 3) [m], amplitudes (n, 4) [m] without the
    phase of the ways, received first, and areas (n,) [m2]."""
    made = scene(mesh, material=material)
    corners = mesh.vertices[mesh.faces]
    total = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    body = CoherentBody.of(
        made, devices.resolve_device("cpu"), spacing_m=float(np.sqrt(total / count)), rough_only=True
    )
    worker = places.worker_of(body, K, ("rough",), 1, 1.0)
    radar = places.sight(body, *(1e7 * end for end in ends))[1]
    found = places.complex_of(places.rough_amplitudes(worker, radar, body.placed)).astype(complex)
    return body.placed.points.numpy() + body.origin, found, body.placed.scatterers.numpy()["area"]


def perturbation(eps: complex, height: float, length: float, t: F64, s: F64) -> F64:
    """First order for a Gaussian correlation (Ulaby, Moore and Fung, Microwave Remote Sensing II, 1982, 12.5), of HH,
    HV, VH and VV, sent first: 16 pi k^4 h^2 cos^2 cos^2 |alpha|^2 W."""
    ct, cs = t[2], s[2]
    st, ss = np.sqrt(1 - ct**2), np.sqrt(1 - cs**2)
    level = -(t[:2] / max(st, 1e-12)), s[:2] / max(ss, 1e-12)
    cosine = float(level[0] @ level[1])
    sine = float(level[0][0] * level[1][1] - level[0][1] * level[1][0])
    q, w = np.sqrt(eps - st**2), np.sqrt(eps - ss**2)
    alpha = np.array([
        (eps - 1) * cosine / ((ct + q) * (cs + w)),
        (eps - 1) * sine * w / ((ct + q) * (eps * cs + w)),
        (eps - 1) * sine * q / ((eps * ct + q) * (cs + w)),
        (eps - 1) * (eps * st * ss - cosine * q * w) / ((eps * ct + q) * (eps * cs + w)),
    ])  # fmt: skip
    across = K * np.hypot(*(t[:2] + s[:2]))
    spectrum = length**2 * np.exp(-((across * length / 2) ** 2)) / (4 * np.pi)
    return 16 * np.pi * K**4 * height**2 * ct**2 * cs**2 * np.abs(alpha) ** 2 * spectrum


GEOMETRIES = [
    ((20.0, 40.0), (20.0, 40.0)),
    ((20.0, 40.0), (200.0, 25.0)),
    ((0.0, 35.0), (70.0, 50.0)),
    ((0.0, 60.0), (120.0, 45.0)),
]


@pytest.mark.parametrize(("sent", "received"), GEOMETRIES)
def test_rough_ground_scatters_to_any_side(sent: Any, received: Any) -> None:
    """Small perturbation of first order, 40,000 places: to 4 standard errors (2 %). Where both directions are one it is
    the amplitude of one antenna, place by place."""
    material = {"eps_r": (6.0, -0.5), "rms_height_m": 0.0005, "correlation_length_m": 0.008, "spectrum": "gaussian"}
    t, s = toward(*sent), toward(*received)
    _, found, area = lit(field(2.0, 2.0), material, t, s)
    power = 4 * np.pi * (np.abs(found) ** 2).sum(axis=0)[[0, 2, 1, 3]] / area.sum()
    expected = perturbation(6.0 - 0.5j, 0.0005, 0.008, t, s)
    np.testing.assert_allclose(power, expected, rtol=0.03, atol=1e-6 * expected.max())
    _, back, _ = lit(field(2.0, 2.0), material, s, t)
    np.testing.assert_allclose(back[:, [0, 2, 1, 3]], found, atol=1e-5 * np.abs(found).max())
    if sent == received:
        _, one, _ = lit(field(2.0, 2.0), material, t)
        np.testing.assert_allclose(found, one, atol=1e-5 * np.abs(one).max())


def test_very_rough_ground_mirrors_by_its_slopes() -> None:
    """Geometric optics in the plane of incidence: |R(half angle)|^2 exp(-tan^2 / 2 m^2) / 2 m^2 cos^4 of the slope."""
    material = {"eps_r": 5.0, "rms_height_m": 0.02, "correlation_length_m": 0.1, "specular_fraction": 1.0}
    t, s = toward(0.0, 50.0), toward(180.0, 30.0)
    _, found, area = lit(field(2.0, 2.0), material, t, s)
    power = 4 * np.pi * (np.abs(found) ** 2).sum(axis=0) / area.sum()
    half, tilt, variance = np.deg2rad(40.0), np.deg2rad(10.0), 2 * (0.02 / 0.1) ** 2
    q = np.sqrt(5.0 - np.sin(half) ** 2)
    fresnel = (np.cos(half) - q) / (np.cos(half) + q), (5.0 * np.cos(half) - q) / (5.0 * np.cos(half) + q)
    lobe = np.exp(-(np.tan(tilt) ** 2) / (2 * variance)) / (2 * variance * np.cos(tilt) ** 4)
    np.testing.assert_allclose(power[[0, 3]], lobe * np.square(fresnel), rtol=0.03)
    assert power[[1, 2]].max() < 1e-6 * power.max()


def test_what_one_of_both_antennas_does_not_see_sends_nothing() -> None:
    """A wall of 2 m along x hides ground from a receiver at 45 degrees in the south, and from a transmitter at 60
    degrees in the north: by its height times the tangent."""
    ground = field(1.0, 12.0)
    wall = [[-0.5, 0, 0], [0.5, 0, 0], [0.5, 0, 2.0], [-0.5, 0, 2.0]]
    mesh = warpsar.Mesh.of(
        np.concatenate([ground.vertices, wall]), np.concatenate([ground.faces, [[4, 5, 6], [4, 6, 7]]])
    )
    place, found, _ = lit(mesh, ROUGH, toward(0.0, 60.0), toward(180.0, 45.0))
    level = (np.abs(place[:, 2]) < 1e-6) & (np.abs(place[:, 0]) < 0.45)
    y, seen_there = place[level, 1], (found[level] != 0.0).any(axis=1)
    hidden = (y > -2.0 * np.tan(np.deg2rad(60.0))) & (y < 2.0)
    near = np.minimum(np.abs(y - 2.0), np.abs(y + 2.0 * np.tan(np.deg2rad(60.0)))) < 0.02
    assert np.array_equal(seen_there[~near], ~hidden[~near])
    assert seen_there.any()
    assert not seen_there.all()
    upright = place[:, 2] > 0.01  # each side of the wall has one antenna
    assert not found[upright].any()


def walled(a: float) -> warpsar.Mesh:
    """Rough ground, `ground`, before a conducting wall, both `a` wide, in a corner of one object."""
    ground = [[-a, 0, 0], [a, 0, 0], [a, 2 * a, 0], [-a, 2 * a, 0]]
    wall = [[-a, 0, 0], [a, 0, 0], [a, 0, 2 * a], [-a, 0, 2 * a]]
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    vertices = np.concatenate([ground, wall]).astype(float)
    return warpsar.Mesh.of(vertices, faces, face_material=np.array([0, 0, 1, 1]), materials=("ground", "wall"))


def recorded(transmitter_m: F64 | None, receiver: F64, device: str = "cpu", **more: Any) -> NDArray[np.complex128]:
    """All samples of ground before a wall, (4, frequencies, pulses)."""
    azimuth, incidence = np.rad2deg([np.arctan2(receiver[0], receiver[1]), np.arccos(receiver[2])])
    apart = {} if transmitter_m is None else {"transmitter": Transmitter(position_m=tuple(transmitter_m), **more)}
    made = scene(
        walled(0.25),
        view={"azimuth_deg": float(azimuth), "incidence_deg": float(incidence)},
        radar={"terms": ("single", "multibounce", "rough"), "polarizations": FOUR},
        collection={"pulses": 32, "aperture_deg": 0.1, "resolution_m": None, "bandwidth_hz": 1e8, **apart},
    )
    made = replace(made, materials={"ground": warpsar.Material(**ROUGH), "wall": warpsar.Material(conductor=True)})
    (found,) = warpsar.phase_history(made, device=device)
    return found.samples.astype(complex)


def test_antennas_beside_each_other_are_one() -> None:
    """All terms of rough ground before a wall, in all polarizations: to 1 % of the strongest sample."""
    receiver = toward(10.0, 50.0)
    one = recorded(None, receiver)
    two = recorded(FAR * receiver + [0.0, 0.0, 1e-3], receiver, velocity_m_s=tuple(100.0 * basis(receiver)[0]))
    assert np.abs(two - one).max() < 0.01 * np.abs(one).max()
    crossed = np.abs(one[1]).max()
    assert np.abs(two[1:3] - one[1:3]).max() < 0.02 * crossed


@pytest.mark.cuda
def test_a_gpu_says_the_same() -> None:
    """To 1 % of the strongest sample: rays along the edges of faces."""
    ends = FAR * toward(-60.0, 40.0), toward(50.0, 50.0)
    one, other = (recorded(*ends, device) for device in ("cpu", "cuda"))
    assert np.abs(one - other).max() < 0.01 * np.abs(one).max()


@pytest.mark.full
@pytest.mark.parametrize(("azimuth_deg", "incidence_deg"), [(20.0, 50.0), (60.0, 50.0)])
def test_ground_and_wall_mirror_to_the_other_side(azimuth_deg: float, incidence_deg: float) -> None:
    """A dihedral sends a wave back in elevation and on in azimuth: 31 and 83 degrees between the antennas. To 2 %."""
    sent, received = toward(azimuth_deg, incidence_deg), toward(-azimuth_deg, incidence_deg)
    corner = square_trihedral(A)
    found = seen(warpsar.Mesh.of(corner.vertices[:8], corner.faces[:4]), sent, received)
    expected = by_rays(sent, received, (1, 2))
    assert np.abs(expected).max() > 0.2 * PEAK
    assert np.abs(found - expected).max() < 0.02 * np.abs(expected).max()


@wp.kernel(enable_backward=False)
def places_kernel(
    radar_in: wp.array[TubeRadar],
    rates: kernels.Rates,
    entry_in: wp.array[wp.vec3d],
    leave_in: wp.array[wp.vec3d],
    way_in: wp.array[wp.float64],
    place_out: wp.array[wp.vec3d],
):
    i = wp.tid()
    place_out[i] = kernels.effective_place(radar_in[0], radar_in[1], rates, entry_in[i], leave_in[i], way_in[i])


@pytest.mark.parametrize("turning", [(0.0, 1.0), (1.0, 1.0), (1.0, -0.3)])
def test_the_place_of_bounces_has_their_way_and_its_change(turning: tuple[float, float]) -> None:
    """Where a wave enters and leaves at places 3 m apart, 60 degrees between the antennas: the way to 1 um, and its
    change over 0.1 degrees of each antenna's own path to 20 um. Midway it is wrong by more than 0.5 mm."""
    made = scene(field(4.0, 4.0), material={"conductor": True}, radar={"terms": ("single",)})
    body = CoherentBody.of(made, devices.resolve_device("cpu"))
    ends = [FAR * toward(0.0, 30.0), FAR * toward(180.0, 30.0)]
    paths = [turn * np.array([0.9, 0.3, 0.1]) for turn in turning]
    rates = [path - (path @ end) * end / FAR**2 for path, end in zip(paths, ends, strict=True)]
    random = np.random.default_rng(0)
    entry, leave = random.uniform(-2.0, 2.0, (2, 50, 3))

    def way(*points: F64, moved: float = 0.0) -> F64:
        at = [end + moved * FAR * rate for end, rate in zip(ends, rates, strict=True)]
        return np.sum(
            [np.linalg.norm(p - a, axis=1) - np.linalg.norm(a) for p, a in zip(points, at, strict=True)], axis=0
        )

    given = fill(kernels.Rates, transmitter=wp.vec3d(*rates[0]), receiver=wp.vec3d(*rates[1]))
    whole = way(entry, leave) + 0.5  # with a way between both
    out = wp.empty(50, dtype=wp.vec3d, device="cpu")
    arrays = [wp.array(each, dtype=wp.vec3d, device="cpu") for each in (entry - body.origin, leave - body.origin)]
    inputs = [places.sight(body, *ends)[1], given, *arrays, wp.array(whole, dtype=wp.float64, device="cpu")]
    wp.launch(places_kernel, 50, inputs=inputs, outputs=[out], device="cpu")
    found = out.numpy() + body.origin
    np.testing.assert_allclose(way(found, found), whole, atol=1e-6)
    angle = np.deg2rad(0.1)
    change = way(entry, leave, moved=angle) - way(entry, leave)
    np.testing.assert_allclose(way(found, found, moved=angle) - way(found, found), change, atol=2e-5)
    midway = 0.5 * (entry + leave)
    assert np.abs(way(midway, midway, moved=angle) - way(midway, midway) - change).max() > 5e-4


@pytest.mark.parametrize(
    ("angle_deg", "more", "message"),
    [
        (11.5, {"radar": {"terms": ("edges", "rough")}}, None),
        (20.0, {}, None),
        (20.0, {"radar": {"terms": ("edges", "rough")}}, r'at most 12 with radar.terms "edges", of backscatter'),
        (20.0, {"material": ROUGH | {"model": "i2em"}}, r'at most 12 with the model "i2em", of backscatter'),
        (20.0, {"radar": {"variant": "as_printed"}}, r'at most 12 with radar.variant "as_printed"'),
        (155.0, {}, r"found the transmitter 155\S* degrees from the receiver.*at most 150 with forward scatter"),
    ],
)
def test_what_needs_one_antenna_is_refused_by_name(angle_deg: float, more: Any, message: str | None) -> None:
    tilt = 78.0 - angle_deg  # in the plane of incidence of the view, on the other side of the zenith
    view = {"azimuth_deg": 30.0, "incidence_deg": 78.0}
    place = tuple(FAR * toward(30.0, tilt))
    radar = {"terms": ("rough",)} | more.get("radar", {})
    collection = {"transmitter": Transmitter(position_m=place), "resolution_m": None, "bandwidth_hz": 1e8, "pulses": 64}
    collection |= {"aperture_deg": 0.2}
    made = scene(field(2.0, 2.0), **(more | {"radar": radar, "collection": collection, "view": view}))
    for product in (warpsar.slc, warpsar.phase_history):
        if message is None:
            assert product(made, device="cpu")
        else:
            with pytest.raises(warpsar.InputError, match=message):
                product(made, device="cpu")


def test_the_widths_hold_between_antennas_apart() -> None:
    """At 60 degrees between them a band resolves by cos(30 degrees) less; beside a transmitter at rest a track half as
    much. Band and track are wider by that; stated ones are refused."""

    def made(**more: Any) -> warpsar.Scene:
        place = tuple(FAR * toward(30.0, 20.0))
        return scene(
            field(4.0, 4.0),
            view={"azimuth_deg": 210.0, "incidence_deg": 40.0},
            radar={"terms": ("rough",)},
            collection={"transmitter": Transmitter(position_m=place), "resolution_m": (0.5, 0.5)} | more,
        )

    plan = plan_of(made(), made().views[0], devices.resolve_device("cpu"))
    assert width_in_cells(plan.windows[0]) * plan.cells_m[0] == pytest.approx(0.5, rel=1e-3)
    assert width_in_cells(plan.windows[1]) * plan.cells_m[1] == pytest.approx(0.5, rel=0.02)
    for axis, stated in (("range", {"bandwidth_hz": 0.9 * plan.bandwidth_hz}), ("azimuth", {"aperture_deg": 3.0})):
        with pytest.raises(warpsar.InputError, match=f"found 0.5 m in {axis}"):
            plan_of(made(**stated), made().views[0], devices.resolve_device("cpu"))


def test_a_wide_band_says_what_its_middle_hides(capsys: pytest.CaptureFixture[str]) -> None:
    """A flat conductor sends back in proportion to the frequency: 20 log10(1 - 0.31) at the lower end."""

    def said(share: float, **more: object) -> str:
        collection = {"bandwidth_hz": share * FREQUENCY, "resolution_m": None, "aperture_deg": 2.0}
        made = scene(field(1.0, 1.0), collection=collection, shape=(16, 16), spacing=(0.1, 0.1), **more)
        warpsar.phase_history(made, device="cpu")
        return capsys.readouterr().err

    smooth = {"material": {"conductor": True}, "radar": {"terms": ("single",)}}
    assert "a band of 62 % of its middle frequency" in said(0.62, **smooth)
    assert f"up to {-20 * np.log10(1 - 0.31):.2g} dB" in said(0.62, **smooth)
    assert "wrong by up to" in said(0.62)
    assert "wrong by up to" not in said(0.04)
