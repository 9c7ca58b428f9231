"""Small worlds whose image is known in closed form, and sigma0 in NumPy, float64, from docs/physics.md."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Grid, Material, Radar, Sampling, View

FREQUENCY_HZ = 9.6e9
WAVENUMBER = 2 * np.pi * FREQUENCY_HZ / 299792458.0
SOIL = {"eps_r": 6.0, "rms_height_m": 0.0012, "correlation_length_m": 0.010}
BRICK = {"eps_r": 12.0, "rms_height_m": 0.001, "correlation_length_m": 0.008}


def sigma0(
    theta: Any,
    eps_r: Any = 6.0,
    rms_height_m: Any = 0.0012,
    correlation_length_m: Any = 0.010,
    specular_fraction: Any = 0.0,
    polarization: str = "HH",
    cos_psi: Any = 1.0,
    wavenumber: float = WAVENUMBER,
) -> np.ndarray:
    """Gaussian spectrum, real eps; theta [rad] to the normal, broadcast over everything."""
    theta, eps, h, length = (np.asarray(a, float) for a in (theta, eps_r, rms_height_m, correlation_length_m))
    sin2, cos = np.sin(theta) ** 2, np.cos(theta)
    q = np.sqrt(eps - sin2)
    a_hh = (cos - q) / (cos + q)
    a_vv = (eps - 1) * (sin2 - eps * (1 + sin2)) / (eps * cos + q) ** 2
    c2 = np.asarray(cos_psi, float) ** 2
    s2 = 1 - c2
    amplitude = {
        "HH": a_hh * c2 + a_vv * s2,
        "VV": a_hh * s2 + a_vv * c2,
        "HV": (a_vv - a_hh) * np.sqrt(c2 * s2),
    }[polarization]
    kh, kl = wavenumber * h, wavenumber * length
    spm = 4 * kh**2 * kl**2 * cos**4 * amplitude**2 * np.exp(-(kl**2) * sin2)
    r0 = (1 - np.sqrt(eps)) / (1 + np.sqrt(eps))
    m2 = 2 * h**2 / length**2
    go = r0**2 / (2 * m2 * cos**4) * np.exp(-(sin2 / cos**2) / (2 * m2)) * (polarization != "HV")
    return (1 - specular_fraction) * spm + specular_fraction * go


def axes(azimuth_deg: float, incidence_deg: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """d, u, v written out in angles: away from a radar that stands clockwise from north; along track; elevation."""
    a, i = np.deg2rad([azimuth_deg, incidence_deg])
    d = np.array([-np.sin(a) * np.sin(i), -np.cos(a) * np.sin(i), -np.cos(i)])
    u = np.array([np.cos(a), -np.sin(a), 0.0])
    v = np.array([np.sin(a) * np.cos(i), np.cos(a) * np.cos(i), -np.sin(i)])
    return d, u, v


def cos_twist(normal: np.ndarray, d: np.ndarray, u: np.ndarray) -> np.ndarray:
    across = np.cross(normal, d)
    return np.abs(across @ u) / np.linalg.norm(across, axis=-1)


def plate(corner: Any, edge_1: Any, edge_2: Any, cells: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a parallelogram of `cells` x `cells` quads."""
    t = np.linspace(0.0, 1.0, cells + 1)
    a, b = np.meshgrid(t, t, indexing="ij")
    vertices = np.asarray(corner, float) + a.reshape(-1, 1) * np.asarray(edge_1, float)
    vertices = vertices + b.reshape(-1, 1) * np.asarray(edge_2, float)
    at = np.arange(a.size).reshape(a.shape)
    p, q, r, s = (x.ravel() for x in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    return vertices, np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, s], 1)])


def ground(size: float, cells: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """A horizontal square about the origin."""
    return plate((-size / 2, -size / 2, 0.0), (size, 0, 0), (0, size, 0), cells)


def box(low: Any, high: Any) -> tuple[np.ndarray, np.ndarray]:
    """A closed cuboid between two corners."""
    (x0, y0, z0), (x1, y1, z1) = low, high
    x, y, z = (x1 - x0, 0, 0), (0, y1 - y0, 0), (0, 0, z1 - z0)
    sides = [
        plate(corner, e1, e2)
        for corner, e1, e2 in (
            (low, x, y), (low, y, z), (low, x, z),
            ((x0, y0, z1), x, y), ((x1, y0, z0), y, z), ((x0, y1, z0), x, z),
        )
    ]  # fmt: skip
    return join(sides)


def join(parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in parts[:-1]])
    return (
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([faces + start for (_, faces), start in zip(parts, starts, strict=True)]),
    )


def mesh_of(**parts: tuple[np.ndarray, np.ndarray]) -> Mesh:
    """A mesh with one material per named part."""
    vertices, faces = join(list(parts.values()))
    material = np.repeat(np.arange(len(parts)), [len(faces) for _, faces in parts.values()])
    return Mesh(vertices, faces.astype(np.int32), material.astype(np.int32), tuple(parts))


def view(azimuth_deg: float, incidence_deg: float, **more: Any) -> View:
    return View(name=more.pop("name", "view"), azimuth_deg=azimuth_deg, incidence_deg=incidence_deg, **more)


def scene_of(
    mesh: Mesh,
    views: View | list[View],
    *,
    shape: tuple[int, int] = (40, 40),
    spacing_m: tuple[float, float] = (0.5, 0.5),
    rays_per_pixel: float = 64.0,
    materials: dict[str, dict[str, Any]] | None = None,
    polarizations: tuple[str, ...] = ("HH",),
    sampling: dict[str, Any] | None = None,
    **radar: Any,
) -> Scene:
    """A scene in memory; every material is SOIL unless said otherwise."""
    return Scene(
        mesh=mesh,
        radar=Radar(frequency_hz=radar.pop("frequency_hz", FREQUENCY_HZ), polarizations=polarizations, **radar),
        grid=Grid(shape=shape, spacing_m=spacing_m),
        materials={name: Material(**(materials or {}).get(name, SOIL)) for name in mesh.materials},
        views=views if isinstance(views, list) else [views],
        sampling=Sampling(rays_per_pixel=rays_per_pixel, **(sampling or {})),
    )
