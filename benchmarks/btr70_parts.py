"""The vehicle's mesh in parts, so that each may carry its own amount of unresolved detail (btr70.py).

An OBJ keeps its shape. Long triangles are split, and each goes to the part in which its middle lies: `LENGTHS` pieces
of equal length along the vehicle, and three layers (running gear, hull, deck). Both sides of the vehicle are alike.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from warpsar.world.mesh import read_mesh

LENGTHS = 8
LAYERS = (0.42, 0.80)  # of the height, where one layer ends and the next begins
LAYER_NAMES = ("gear", "hull", "deck")  # upwards
LONGEST = 0.06  # of the length: no edge is longer


def names() -> list[str]:
    """The parts, from front to rear and up."""
    return [f"part{along}{layer}" for along in range(LENGTHS) for layer in LAYER_NAMES]


def split(corners: np.ndarray, longest: float) -> np.ndarray:
    """Triangles (n, 3, 3) halved at their longest edge until none is longer than `longest`."""
    done = []
    while len(corners):
        edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        short = edges.max(axis=1) <= longest
        done.append(corners[short])
        corners, first = corners[~short], edges[~short].argmax(axis=1)
        row = np.arange(len(corners))
        a, b, c = (corners[row, (first + k) % 3] for k in range(3))
        half = 0.5 * (a + b)
        corners = np.concatenate([np.stack([a, half, c], 1), np.stack([half, b, c], 1)])
    return np.concatenate(done)


def part_of(middles: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Index into `names()` of points (n, 3) in the file's frame: front -X, up +Y."""
    place = (middles - low) / (high - low)
    along = np.clip((place[:, 0] * LENGTHS).astype(int), 0, LENGTHS - 1)
    return np.asarray(3 * along + np.digitize(place[:, 1], LAYERS))


def write(source: Path, to: Path) -> Path:
    """The OBJ `source` as an OBJ whose materials are the parts; returns `to`."""
    mesh = read_mesh(source)
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    corners = split(mesh.vertices[mesh.faces].astype(float), LONGEST * float(high[0] - low[0]))
    part = part_of(corners.mean(axis=1), low, high)
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in corners.reshape(-1, 3)]
    for number, name in enumerate(names()):
        lines.append(f"usemtl {name}")
        lines += [f"f {3 * k + 1} {3 * k + 2} {3 * k + 3}" for k in np.flatnonzero(part == number)]
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return to
