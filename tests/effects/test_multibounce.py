"""Multibounce against theory (where a dihedral and a trihedral peak) and against a path tracer of a few lines."""

from typing import Any

import numpy as np
import pytest
import worlds
from effect_worlds import STRIP_MAP, Case, gradients_of, refusal, render_of, with_effect
from worlds import BRICK, SOIL, WAVENUMBER, ground, mesh_of, plate, scene_of, view

from warpsar.effects.registry import declared
from warpsar.render.render import ViewRender
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.simulation.rays import trace_view
from warpsar.world.mesh import Mesh

WORKING = [
    Case({"strength": 0.8}),
    Case({"strength": 0.8, "max_bounces": 4}, STRIP_MAP),
    Case({"strength": 0.8, "reflection": "lobe"}),
    Case({"strength": 0.8, "reflection": "lobe", "max_bounces": 4}, STRIP_MAP),
]

SPACING = 0.5
CORNER = (0.3, 0.1, 1.0)  # not on the edge of a pixel


def dihedral(height: float = 4.0) -> Mesh:
    """A wall along the x axis on the soil north of it, its face to the north."""
    return mesh_of(soil=plate((-8, 0, 0), (16, 0, 0), (0, 12, 0)), wall=plate((-5, 0, 0), (10, 0, 0), (0, 0, height)))


def trihedral() -> Mesh:
    """Three squares of 4 m that meet at CORNER, open to the north-east and upward."""
    return mesh_of(
        soil=plate(CORNER, (4, 0, 0), (0, 4, 0)),
        wall=plate(CORNER, (4, 0, 0), (0, 0, 4)),
        brick=plate(CORNER, (0, 4, 0), (0, 0, 4)),
    )


def corner_scene(mesh: Mesh, azimuth_deg: float, incidence_deg: float, **more: Any) -> Scene:
    more = {"shape": (48, 48), "rays_per_pixel": 64.0, "polarizations": ("HH", "VV")} | more
    materials = {"soil": SOIL, "wall": BRICK, "brick": BRICK}
    scene = scene_of(mesh, view(azimuth_deg, incidence_deg), materials=materials, **more)
    return with_effect(scene, "multibounce", {"strength": 1.0, "reflection": "lobe"})


def layers_of(scene: Scene) -> dict[str, np.ndarray]:
    """Shares of beta0 by number of bounces and polarization, float64."""
    render = render_of(scene)
    render.forward()
    return {name: a.numpy().astype(float).reshape(render.shape) for name, a in render.layers.items()}


# ---- a path tracer in NumPy: every triangle for every ray, straight from docs/checks.md ----


def fresnel(polarization: str, cos: Any, eps: Any) -> Any:
    q = np.sqrt(eps - 1 + cos**2)
    r = (cos - q) / (cos + q) if polarization == "HH" else (eps * cos - q) / (eps * cos + q)
    return r**2


class PathTracer:
    """Single precision nowhere, no merging, no BVH: every ray, from a random place, against every triangle."""

    def __init__(self, scene: Scene, materials: dict[str, dict[str, float]]) -> None:
        mesh = scene.mesh
        self.corners = mesh.vertices
        self.p0, p1, p2 = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        self.e1, self.e2 = p1 - self.p0, p2 - self.p0
        normal = np.cross(self.e1, self.e2)
        self.normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
        keys = ("eps_r", "rms_height_m", "correlation_length_m")
        self.material = np.array([[materials[mesh.materials[m]][key] for key in keys] for m in mesh.face_material])
        one = scene.views[0]
        self.d, self.u, self.v = worlds.axes(one.azimuth_deg, one.incidence_deg)

    def meet(self, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Face and distance of the first surface of every ray; infinitely far where there is none."""
        q = np.cross(direction[:, None], self.e2)
        o = origin[:, None] - self.p0
        w = np.cross(o, self.e1)
        with np.errstate(divide="ignore", invalid="ignore"):
            det = (self.e1 * q).sum(axis=2)
            b1, b2 = (o * q).sum(axis=2) / det, (direction[:, None] * w).sum(axis=2) / det
            t = (self.e2 * w).sum(axis=2) / det
        t[~((b1 >= 0) & (b2 >= 0) & (b1 + b2 <= 1) & (t > 1e-9))] = np.inf
        return t.argmin(axis=1), t.min(axis=1)

    def returns(self, rays: int, max_bounces: int, seed: int) -> dict[tuple[int, str], np.ndarray]:
        """By (bounces, polarization): range, azimuth and radar cross-section of every ray's return, shape (n, 3)."""
        random = np.random.default_rng(seed)
        a, b = self.corners @ self.u, self.corners @ self.v
        weight = np.ptp(a) * np.ptp(b) / rays
        point = random.uniform(a.min(), a.max(), (rays, 1)) * self.u - 100.0 * self.d
        point = point + random.uniform(b.min(), b.max(), (rays, 1)) * self.v
        direction = np.broadcast_to(self.d, point.shape)
        length, entry, left = np.full(rays, -100.0), point, {"HH": np.ones(rays), "VV": np.ones(rays)}
        found = {}
        for bounce in range(1, max_bounces + 1):
            face, t = self.meet(point, direction)
            on = np.isfinite(t)
            face, t, point, direction, length, entry = (x[on] for x in (face, t, point, direction, length, entry))
            point, length = point + t[:, None] * direction, length + t
            entry = point if bounce == 1 else entry
            left = {p: x[on] for p, x in left.items()}
            n, (eps, h, correlation) = self.normal[face], self.material[face].T
            slope = (n * direction).sum(axis=1)
            if bounce > 1:
                _, home = self.meet(point, np.broadcast_to(-self.d, point.shape))
                free = np.isinf(home) & (slope * (n @ self.d) > 0)
                half = -direction - self.d
                half = half / np.linalg.norm(half, axis=1, keepdims=True)
                tan2 = np.abs((half * n).sum(axis=1)) ** -2.0 - 1
                m2 = 2 * (h / correlation) ** 2 + 1e-4
                lobe = np.exp(-tan2 / (2 * m2)) / (2 * m2) * (1 + tan2) ** 2
                for p, power in left.items():
                    returned = power * fresnel(p, -(half * direction).sum(axis=1), eps) * lobe * weight / np.abs(slope)
                    seen = (length + point @ self.d) / 2, (entry + point) @ self.u / 2, returned
                    found[bounce, p] = np.stack(seen, axis=1)[free]
            for p in left:
                left[p] = left[p] * fresnel(p, np.abs(slope), eps) * np.exp(-((2 * WAVENUMBER * h * slope) ** 2))
            direction = direction - 2 * slope[:, None] * n
        return found


@pytest.mark.parametrize(
    ("mesh", "azimuth_deg", "incidence_deg", "bounces"),
    [(dihedral(), 3.0, 50.0, (2,)), (trihedral(), 40.0, 52.0, (2, 3))],
    ids=["dihedral", "trihedral"],
)
def test_power_and_place_of_every_bounce_are_the_path_tracers(
    mesh: Mesh, azimuth_deg: float, incidence_deg: float, bounces: tuple[int, ...]
) -> None:
    """Totals, and means of range and azimuth, by bounces and polarization: energy is neither lost nor counted twice.

    The tracer's own error is that of the share of its rays that return, and of the power they return with.
    """
    scene = corner_scene(mesh, azimuth_deg, incidence_deg)
    tracer = PathTracer(scene, {"soil": SOIL, "wall": BRICK, "brick": BRICK})
    found = tracer.returns(100_000, 3, seed=1)
    ours = layers_of(scene)
    rows = (np.arange(48) - 23.5) * SPACING
    for count in bounces:
        for polarization in ("HH", "VV"):
            image = ours[f"beta0_{count}_bounces_{polarization}"] * SPACING**2
            where_r, where_u, power = found[count, polarization].T
            error = np.hypot(power.std() / power.mean(), 1.0) / np.sqrt(power.size)
            # and 0.5 % for the regular cells of ours, about 2000 of them, cut by the borders of what returns
            assert image.sum() == pytest.approx(power.sum(), rel=3 * error + 0.005)
            assert error < 0.01
            # a pixel's middle stands for what lies in it
            mean_r, mean_u = (rows @ image.sum(axis=1), rows @ image.sum(axis=0)) / image.sum()
            assert mean_r == pytest.approx(np.average(where_r, weights=power), abs=SPACING)
            assert mean_u == pytest.approx(np.average(where_u, weights=power), abs=0.5 * SPACING)


def test_a_dihedral_peaks_at_the_foot_of_the_wall() -> None:
    """Range of the foot for every height of the wall; azimuth of the wall; nothing else is nearly as bright."""
    image = layers_of(corner_scene(dihedral(), 0.0, 50.0))["beta0_2_bounces_HH"]
    lines = np.flatnonzero(image.sum(axis=1) > 0.01 * image.sum(axis=1).max())
    # y = 0, z = 0 is range 0, the edge between rows 23 and 24: one of them, whichever, and not both
    assert lines.tolist() in ([23], [24])
    lit = np.flatnonzero(image[lines[0]] > 0.01 * image.max())
    u_low, u_high = sorted(np.array([[-5, 0, 0], [5, 0, 0]]) @ worlds.axes(0.0, 50.0)[1])
    assert (lit.min(), lit.max()) == (24 + round(u_low / SPACING), 23 + round(u_high / SPACING))
    # uniform along the wall, but for the cells that its top and the rim of the ground it mirrors cut
    assert image[lines[0], lit] == pytest.approx(image[lines[0], lit].mean(), rel=0.02)


@pytest.mark.parametrize("incidence_deg", [35.0, 50.0])
def test_a_dihedrals_power_is_the_incoherent_integral(incidence_deg: float) -> None:
    """Per metre of wall: both ways round, area of the rays that meet wall and ground, times the lobe at its peak.

    A ray within H sin(inc) of the foot meets the wall first, one within H sin(inc) on the ground side the ground; each
    is mirrored by its first surface and returned by its second exactly along its way in.
    """
    theta, height = np.deg2rad(incidence_deg), 3.0
    image = layers_of(corner_scene(dihedral(height), 0.0, incidence_deg))
    for polarization in ("HH", "VV"):
        mirror, last = {}, {}
        for name, material, cos in (("soil", SOIL, np.cos(theta)), ("wall", BRICK, np.sin(theta))):
            r = fresnel(polarization, cos, material["eps_r"])
            h = material["rms_height_m"]
            m2 = 2 * (h / material["correlation_length_m"]) ** 2 + 1e-4
            mirror[name] = r * np.exp(-((2 * WAVENUMBER * h * cos) ** 2))
            # half vector = normal for a mirror's own direction? It is turned: between incoming and the radar's
            incoming = np.array([np.sin(theta), np.cos(theta)])
            to_radar = np.array([np.sin(theta), np.cos(theta)])
            # (horizontal, up) components; the mirror turns one of them, and the way home turns it back
            incoming = incoming * ([1, -1] if name == "wall" else [-1, 1])
            half = incoming + to_radar
            half /= np.linalg.norm(half)
            normal = np.array([1.0, 0.0]) if name == "wall" else np.array([0.0, 1.0])
            beta = np.arccos(half @ normal)
            half_angle = fresnel(polarization, float(half @ incoming), material["eps_r"])
            last[name] = half_angle * np.exp(-(np.tan(beta) ** 2) / (2 * m2)) / (2 * m2 * np.cos(beta) ** 4) / cos
        across = height * np.sin(theta)  # of wall seen, and of ground whose mirror image is the wall
        power = across * (mirror["wall"] * last["soil"] + mirror["soil"] * last["wall"]) * 10.0
        assert (image[f"beta0_2_bounces_{polarization}"] * SPACING**2).sum() == pytest.approx(power, rel=5e-3)


def test_a_trihedral_peaks_at_its_corner() -> None:
    """Three bounces: range and azimuth of the corner, whatever the direction."""
    for azimuth_deg, incidence_deg in ((45.0, 54.7), (30.0, 45.0)):
        image = layers_of(corner_scene(trihedral(), azimuth_deg, incidence_deg))["beta0_3_bounces_HH"]
        d, u, _ = worlds.axes(azimuth_deg, incidence_deg)
        row, col = np.floor(np.array([d @ CORNER, u @ CORNER]) / SPACING).astype(int) + 24
        assert np.unravel_index(image.argmax(), image.shape) == (row, col)
        assert image[row, col] > 0.9999 * image.sum()


def test_what_is_hidden_from_the_radar_does_not_return() -> None:
    """A roof over the corner: rays can still come in beside it and out under it, but not home."""
    open_mesh = dihedral()
    roof = plate((-8, -6, 9), (16, 0, 0), (0, 30, 0))
    covered = mesh_of(
        soil=plate((-8, 0, 0), (16, 0, 0), (0, 12, 0)), wall=plate((-5, 0, 0), (10, 0, 0), (0, 0, 4.0)), brick=roof
    )
    assert layers_of(corner_scene(open_mesh, 0.0, 40.0))["beta0_2_bounces_HH"].sum() > 0
    assert layers_of(corner_scene(covered, 0.0, 40.0))["beta0_2_bounces_HH"].sum() == 0


def test_a_plane_alone_has_no_second_bounce() -> None:
    image = layers_of(corner_scene(mesh_of(soil=ground(12.0, cells=3)), 10.0, 40.0))
    assert image["beta0_2_bounces_HH"].max() == 0
    assert image["beta0_3_bounces_HH"].max() == 0


def test_strip_map_tends_to_the_plane_wave() -> None:
    """At 100 km the fan of rays is parallel to 1e-4: the same powers in the same places."""
    plane = layers_of(corner_scene(dihedral(), 3.0, 50.0))["beta0_2_bounces_HH"]
    strip = layers_of(corner_scene(dihedral(), 3.0, 50.0, slant_range_m=1e5))["beta0_2_bounces_HH"]
    assert strip.sum() == pytest.approx(plane.sum(), rel=2e-3)
    # a line on the edge of two rows may fall into the other
    assert strip.sum(axis=0) == pytest.approx(plane.sum(axis=0), rel=0.02, abs=0.01 * plane.sum(axis=0).max())


def test_layers_add_up_to_the_image() -> None:
    scene = corner_scene(trihedral(), 40.0, 52.0)
    one = simulate(scene, device="cpu", layers=True)[0]
    single = simulate(
        scene_of(scene.mesh, scene.views, shape=(48, 48), materials={"soil": SOIL, "wall": BRICK, "brick": BRICK}),
        device="cpu",
    )[0]
    total = single.beta0["HH"].astype(float) + one.layers["beta0_2_bounces_HH"] + one.layers["beta0_3_bounces_HH"]
    assert one.beta0["HH"] == pytest.approx(total, rel=1e-5)
    assert one.layers["beta0_3_bounces_HH"].max() > 0


def test_lobes_of_rays_that_were_sent_for_fields_are_those_of_their_own() -> None:
    """Both readings of a reflection share their rays: which one was asked first changes nothing."""
    scene = corner_scene(trihedral(), 40.0, 52.0, shape=(24, 24), rays_per_pixel=16.0)
    fields = with_effect(scene, "multibounce", {"strength": 1.0, "reflection": "roughness"})
    effects = [declared(one, one.views[0]) for one in (scene, fields)]
    render = render_of(scene)
    hits = trace_view(scene, render.stage, scene.views[0], seed=3, effects=effects[0])
    for_fields, for_lobes = (
        ViewRender(render.stage, scene.views[0], hits, scene.grid.shape, ("HH",), one).forward()["HH"]
        for one in (effects[1], effects[0])
    )
    assert (for_lobes == render.forward()["HH"]).all()
    assert (for_lobes != for_fields).any()


def test_three_bounces_have_derivatives_to_all_their_surfaces() -> None:
    """Trihedral: every material is mirror and last surface; differences over steps of 1 % in log coordinates."""
    scene = corner_scene(trihedral(), 40.0, 52.0, shape=(24, 24), rays_per_pixel=16.0)
    render = render_of(scene)
    seed = np.random.default_rng(2).uniform(0.5, 1.5, render.shape)
    nodes = render.stage.surface.nodes.copy()
    gradient = gradients_of(render, seed)["nodes"]

    def loss() -> float:
        return sum(float((seed * image.astype(float)).sum()) for image in render.forward().values())

    scale = loss()
    for index in np.flatnonzero(nodes > -30):
        ends = []
        for step in (0.01, -0.01):
            moved = nodes.copy()
            moved[index] += step
            render.set_parameters(moved)
            ends.append(loss())
        assert gradient[index] == pytest.approx((ends[0] - ends[1]) / 0.02, rel=5e-3, abs=1e-4 * scale)


@pytest.mark.parametrize("bounces", [9, True])
def test_other_numbers_of_bounces_are_refused(bounces: Any) -> None:
    assert "allowed is 2 or 3 or 4" in refusal("multibounce", {"max_bounces": bounces})
