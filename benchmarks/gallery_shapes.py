"""Meshes of the gallery, made by code: parts of one material each, written as one OBJ. Metres; Z is up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from warpsar.world.mesh import Mesh
from warpsar.world.obj import write_obj

Outline = Sequence[tuple[float, float]]
Place = tuple[float, float, float]


class ShapeParts:
    """Triangles by material; every method adds some."""

    def __init__(self) -> None:
        self.pieces: list[tuple[str, NDArray[np.float64], NDArray[np.int32]]] = []

    def add(self, material: str, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
        self.pieces.append((material, np.asarray(vertices, float), np.asarray(faces, np.int32)))

    def mesh(self) -> Mesh:
        names = tuple(dict.fromkeys(material for material, _, _ in self.pieces))
        starts = np.cumsum([0, *(len(vertices) for _, vertices, _ in self.pieces[:-1])])
        vertices = np.concatenate([vertices for _, vertices, _ in self.pieces])
        faces = np.concatenate([f + start for (_, _, f), start in zip(self.pieces, starts, strict=True)])
        owner = np.concatenate([np.full(len(f), names.index(material)) for material, _, f in self.pieces])
        return Mesh(vertices, faces.astype(np.int32), owner.astype(np.int32), names)

    def write(self, path: Path) -> None:
        write_obj(path, self.mesh())

    def solid(
        self, material: str, body: trimesh.Trimesh, at: Place = (0.0, 0.0, 0.0), heading_deg: float = 0.0
    ) -> None:
        """A body, turned clockwise by its heading, then moved to `at`."""
        turned = body.vertices @ turn(heading_deg).T
        self.add(material, turned + at, body.faces)

    def box(self, material: str, at: Place, size: Place, heading_deg: float = 0.0) -> None:
        """Size across, along and up; `at` is the middle of its foot."""
        body = trimesh.creation.box(extents=size)
        body.vertices[:, 2] += size[2] / 2.0
        self.solid(material, body, at, heading_deg)

    def cylinder(self, material: str, at: Place, radius: float, height: float, sides: int = 48) -> None:
        body = trimesh.creation.cylinder(radius, height, sections=sides)
        body.vertices[:, 2] += height / 2.0
        self.solid(material, body, at)

    def rod(self, material: str, start: Place, end: Place, radius: float, sides: int = 16) -> None:
        body = trimesh.creation.cylinder(radius, segment=[start, end], sections=sides)
        self.add(material, body.vertices, body.faces)

    def frustum(self, material: str, at: Place, radii: tuple[float, float], height: float, sides: int = 40) -> None:
        angle = 2.0 * np.pi * np.arange(sides) / sides
        rings = [
            np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(sides, z)])
            for r, z in zip(radii, (0.0, height), strict=True)
        ]
        i, j = np.arange(sides), (np.arange(sides) + 1) % sides
        faces = np.concatenate([np.stack([i, j, j + sides], 1), np.stack([i, j + sides, i + sides], 1)])
        lid = np.stack([np.full(sides - 2, sides), np.arange(1, sides - 1) + sides, np.arange(2, sides) + sides], 1)
        self.add(material, np.concatenate(rings) + at, np.concatenate([faces, lid]))

    def ball(self, material: str, at: Place, radii: Place, roughness: float = 0.0, seed: int = 0) -> None:
        """An ellipsoid about `at`; `roughness` moves its vertices in and out, as a share of the radii."""
        body = trimesh.creation.icosphere(subdivisions=3)
        lumps = 1.0 + roughness * np.random.default_rng(seed).normal(size=(len(body.vertices), 1))
        self.add(material, body.vertices * lumps * radii + at, body.faces)

    def prism(self, walls: str, roof: str, outline: Outline, height: float, foot: float = 0.0) -> None:
        """Upright walls over an outline, counterclockwise and convex, and a flat roof."""
        flat = np.array(outline, float)
        n = len(flat)
        both = np.concatenate([np.column_stack([flat, np.full(n, z)]) for z in (foot, foot + height)])
        i, j = np.arange(n), (np.arange(n) + 1) % n
        self.add(walls, both, np.concatenate([np.stack([i, j, j + n], 1), np.stack([i, j + n, i + n], 1)]))
        top = np.arange(n, 2 * n)
        self.add(roof, both, np.stack([np.full(n - 2, n), top[1:-1], top[2:]], 1))

    def house(self, walls: str, roof: str, at: Place, size: Place, ridge: float, heading_deg: float = 0.0) -> None:
        """A gable roof over a box of (across, along, up); its ridge runs along."""
        x, y, z = size[0] / 2.0, size[1] / 2.0, size[2]
        corners = [(-x, -y), (x, -y), (x, y), (-x, y)]
        vertices = [(a, b, 0.0) for a, b in corners] + [(a, b, z) for a, b in corners]
        vertices += [(0.0, -y, z + ridge), (0.0, y, z + ridge)]
        sides = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
        faces = [t for a, b, c, d in sides for t in ((a, b, c), (a, c, d))] + [(4, 5, 8), (6, 7, 9)]
        slopes = [(5, 6, 9), (5, 9, 8), (7, 4, 8), (7, 8, 9)]
        placed = np.array(vertices) @ turn(heading_deg).T + at
        self.add(walls, placed, np.array(faces))
        self.add(roof, placed, np.array(slopes))

    def ground(
        self,
        size: tuple[float, float],
        cell: float,
        material: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.str_]],
        height: Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]] | None = None,
    ) -> None:
        """A grid of cells about the origin; `material` names that of each cell's middle, `height` lifts its corners."""
        counts = [round(s / cell) for s in size]
        x, y = (np.linspace(-s / 2.0, s / 2.0, n + 1) for s, n in zip(size, counts, strict=True))
        grid_x, grid_y = (a.ravel() for a in np.meshgrid(x, y, indexing="ij"))
        z = np.zeros(grid_x.size) if height is None else height(grid_x, grid_y)
        at = np.arange(grid_x.size).reshape(counts[0] + 1, counts[1] + 1)
        a, b, c, d = (corner.ravel() for corner in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
        middle = [(grid[a] + grid[c]) / 2.0 for grid in (grid_x, grid_y)]
        names = material(*middle)
        vertices = np.column_stack([grid_x, grid_y, z])
        for name in np.unique(names):
            mine = names == name
            faces = np.concatenate([np.stack([a, b, c], 1)[mine], np.stack([a, c, d], 1)[mine]])
            self.add(str(name), vertices, faces)


def turn(heading_deg: float) -> NDArray[np.float64]:
    """The rotation, clockwise seen from above."""
    h = np.radians(heading_deg)
    return np.array([[np.cos(h), np.sin(h), 0.0], [-np.sin(h), np.cos(h), 0.0], [0.0, 0.0, 1.0]])


def all_of(name: str) -> Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.str_]]:
    """One material everywhere."""
    return lambda x, y: np.full(x.shape, name)


def fractal(cells: int, roughness: float, seed: int) -> NDArray[np.float64]:
    """A square height field of `cells` + 1 points, mean 0 and standard deviation 1: noise with a power-law spectrum."""
    n = cells + 1
    k = np.hypot(*np.meshgrid(np.fft.fftfreq(n), np.fft.fftfreq(n)))
    k[0, 0] = np.inf
    noise = np.fft.fft2(np.random.default_rng(seed).normal(size=(n, n)))
    field = np.fft.ifft2(noise * k**-roughness).real
    return np.asarray((field - field.mean()) / field.std())
