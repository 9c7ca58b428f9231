"""Write the SLICY scene into a folder: scene.obj and scene.mtl from objects.toml, and scene.toml as it is here.

python data/slicy/make_scene.py FOLDER
"""

from __future__ import annotations

import argparse
import math
import shutil
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
SIDES = 24  # of a cylinder
FLOOR_M = 0.01  # a trihedral's floor above the roof, so that no two surfaces coincide


def read(name: str) -> dict[str, Any]:
    return tomllib.loads((HERE / name).read_text(encoding="utf-8"))


def prism(outline: np.ndarray, low_m: float, high_m: float) -> Iterator[np.ndarray]:
    """Sides and roof over a convex counterclockwise outline, (n, 2)."""
    foot = np.column_stack([outline, np.full(len(outline), low_m)])
    roof = np.column_stack([outline, np.full(len(outline), high_m)])
    n = len(outline)
    for k in range(n):
        a, b, c, d = foot[k], foot[(k + 1) % n], roof[(k + 1) % n], roof[k]
        yield np.array([a, b, c])
        yield np.array([a, c, d])
    for k in range(1, n - 1):
        yield np.array([roof[0], roof[k], roof[k + 1]])


def triangles() -> dict[str, list[np.ndarray]]:
    """Triangles (3, 3) by material; x to the left in the image (see objects.toml), y away from the radar."""
    table = read("objects.toml")
    half = table["half_size_m"]
    square = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
    ground = np.column_stack([square, np.zeros(4)])
    body = table["body"]
    turned = math.radians(body["turned_deg"])
    left, back = np.array([-math.cos(turned), math.sin(turned)]), np.array([math.sin(turned), math.cos(turned)])
    corner, roof = np.array(body["corner_m"]), body["height_m"]
    width, depth = body["width_m"] * left, body["depth_m"] * back
    outline = np.array([corner, corner + depth, corner + depth + width, corner + width])
    metal = list(prism(outline, 0.0, roof))
    circle = np.linspace(0.0, 2.0 * math.pi, SIDES, endpoint=False)
    for one in table["cylinders"]:
        ring = one["at_m"] + one["radius_m"] * np.column_stack([np.cos(circle), np.sin(circle)])
        metal += prism(ring, roof, roof + one["height_m"])
    for one in table["trihedrals"]:
        base = np.array([*one["corner_m"], roof + FLOOR_M])
        side = one["leg_m"] * math.sqrt(0.5)
        tips = base + np.array([[-side, -side, 0.0], [side, -side, 0.0], [0.0, 0.0, one["leg_m"]]])
        metal += [np.array([base, tips[k], tips[(k + 1) % 3]]) for k in range(3)]
    return {"grass": [ground[[0, 1, 2]], ground[[0, 2, 3]]], "metal": metal}


def write(folder: Path) -> Path:
    """Write the scene; returns its scene.toml."""
    (view,) = read("scene.toml")["views"]
    azimuth = math.radians(view["azimuth_deg"])
    away = np.array([-math.sin(azimuth), -math.cos(azimuth)])
    turn = np.array([[away[1], -away[0]], away])  # the image's left (-z x d) and down, in east and north
    lines, count = ["# Written by data/slicy/make_scene.py; metres, Z up", "mtllib scene.mtl"], 0
    content = triangles()
    for name, mine in content.items():
        lines.append(f"usemtl {name}")
        for triangle in mine:
            for (x, y), z in zip(triangle[:, :2] @ turn, triangle[:, 2], strict=True):
                lines.append(f"v {x:.6g} {y:.6g} {z:.6g}")
            lines.append(f"f {count + 1} {count + 2} {count + 3}")
            count += 3
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.obj").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    colours = [line for name in content for line in (f"newmtl {name}", "Kd 0.70 0.70 0.70")]
    (folder / "scene.mtl").write_text("\n".join(colours) + "\n", encoding="utf-8", newline="\n")
    return Path(shutil.copyfile(HERE / "scene.toml", folder / "scene.toml"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    print(write(parser.parse_args().folder))
