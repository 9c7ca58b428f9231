"""Write the Gotcha scene into a folder: scene.obj and scene.mtl from regions.toml and objects.toml, and scene.toml.

python data/gotcha/make_scene.py FOLDER [--flat]

Flat ground at z = 0 in square cells of 1 m (corners of regions are read off to 1 or 2 m); a cell has the material of
the last region that holds its centre, and cells of one material are joined to rectangles, two triangles each. So
nothing overlaps, and nothing is left bare. On it stand cars, each a box down to the ground with a cabin that narrows
upwards, and two triangular trihedrals that open towards the radar. `--flat` leaves them out and has the cars and
targets as regions of bright ground instead: the simple scene to compare with.
"""

from __future__ import annotations

import argparse
import math
import shutil
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
CELL_M = 1.0
# A car from its foot line backwards: body to BODY_M, the cabin on it to the top; shares of length and width.
BODY_M = 0.8
TOP_M = 1.45
CABIN_FOOT = (0.60, 0.90)
CABIN_ROOF = (0.36, 0.75)
FLOOR_M = 0.02  # the reflectors' floor above the ground, so that no two surfaces coincide

Point = tuple[float, float, float]
Quad = tuple[Point, Point, Point, Point]


def read(name: str) -> dict[str, Any]:
    """regions.toml, rows.toml or objects.toml as they stand."""
    return tomllib.loads((HERE / name).read_text(encoding="utf-8"))


def table(*, flat: bool = False) -> dict[str, Any]:
    """`size_m` and `regions`, as regions.toml has them; those that are `flat_only` if asked."""
    content = read("regions.toml")
    content["regions"] = [region for region in content["regions"] if flat or not region.get("flat_only", False)]
    return content


def cells(regions: list[dict[str, Any]], size_m: float) -> tuple[list[str], np.ndarray]:
    """Material names, and the index of each cell's material, shape (n, n): [south to north, west to east]."""
    from matplotlib.path import Path as Outline

    names = list(dict.fromkeys(region["material"] for region in regions))
    n = round(size_m / CELL_M)
    centre = (np.arange(n) + 0.5) * CELL_M - size_m / 2.0
    points = np.stack(np.meshgrid(centre, centre), axis=-1).reshape(-1, 2)
    found = np.full(n * n, -1)
    for region in regions:
        for outline in region["outlines"]:
            found[Outline(outline).contains_points(points)] = names.index(region["material"])
    return names, found.reshape(n, n)


def rectangles(material: np.ndarray) -> Iterator[tuple[int, int, int, int]]:
    """West, south, east and north edge, in cells, of rectangles of one material that cover (rows, cols) once: runs
    along a row, as far north as every cell goes on alike."""
    left = np.ones(material.shape, bool)
    rows, cols = material.shape
    for south in range(rows):
        for west in range(cols):
            if not left[south, west]:
                continue

            def alike(row: int, first: int, last: int, of: int = int(material[south, west])) -> bool:
                return bool((left[row, first:last] & (material[row, first:last] == of)).all())

            east, north = west + 1, south + 1
            while east < cols and alike(south, east, east + 1):
                east += 1
            while north < rows and alike(north, west, east):
                north += 1
            left[south:north, west:east] = False
            yield west, south, east, north


def hexahedron(foot: list[Point], roof: list[Point]) -> Iterator[Quad]:
    """Sides and roof over a counterclockwise foot; it stands on something, so it has no floor."""
    for k in range(4):
        yield foot[k], foot[(k + 1) % 4], roof[(k + 1) % 4], roof[k]
    yield roof[0], roof[1], roof[2], roof[3]


def car(foot_m: list[float], facing: str, length_m: float, width_m: float) -> Iterator[Quad]:
    """A body and a cabin. `foot_m`: middle of the foot of the side towards the radar (east)."""
    east, north = (width_m, length_m) if facing == "side" else (length_m, width_m)
    x, y = foot_m[0] - east / 2.0, foot_m[1]

    def outline(share: tuple[float, float], z: float) -> list[Point]:
        along, across = share if facing == "end" else share[::-1]
        a, b = along * east / 2.0, across * north / 2.0
        return [(x - a, y - b, z), (x + a, y - b, z), (x + a, y + b, z), (x - a, y + b, z)]

    yield from hexahedron(outline((1.0, 1.0), 0.0), outline((1.0, 1.0), BODY_M))
    yield from hexahedron(outline(CABIN_FOOT, BODY_M), outline(CABIN_ROOF, TOP_M))


def trihedral(corner_m: list[float], leg_m: float) -> Iterator[tuple[Point, Point, Point]]:
    """Three right triangles about a corner, opening to the east and up."""
    half = leg_m * math.sqrt(0.5)
    x, y = corner_m
    corner = (x, y, FLOOR_M)
    tips = ((x + half, y - half, FLOOR_M), (x + half, y + half, FLOOR_M), (x, y, FLOOR_M + leg_m))
    for k in range(3):
        yield corner, tips[k], tips[(k + 1) % 3]


def bodies() -> dict[str, list[tuple[Point, Point, Point]]]:
    """Triangles of what stands on the ground, by material."""
    size, objects = read("rows.toml")["car"], read("objects.toml")
    vehicles = [
        triangle
        for one in objects["cars"]
        for a, b, c, d in car(one["foot_m"], one["facing"], size["length_m"], size["width_m"])
        for triangle in ((a, b, c), (a, c, d))
    ]
    reflectors = [t for one in objects["reflectors"] for t in trihedral(one["corner_m"], one["leg_m"])]
    return {"vehicle": vehicles, "reflector": reflectors}


def write(folder: Path, *, flat: bool = False) -> Path:
    """Write the scene; returns its scene.toml."""
    write_mesh(folder, table(flat=flat), {} if flat else bodies())
    return Path(shutil.copyfile(HERE / ("flat.toml" if flat else "scene.toml"), folder / "scene.toml"))


def write_mesh(folder: Path, content: dict[str, Any], standing: dict[str, list[tuple[Point, Point, Point]]]) -> None:
    """scene.obj and scene.mtl: the regions as ground, and the triangles of what stands on it, by material."""
    names, material = cells(content["regions"], content["size_m"])
    triangles: dict[str, list[tuple[Point, Point, Point]]] = {name: [] for name in names}
    for corners in rectangles(material):
        west, south, east, north = (k * CELL_M - content["size_m"] / 2.0 for k in corners)
        a, b, c, d = (west, south, 0.0), (east, south, 0.0), (east, north, 0.0), (west, north, 0.0)
        triangles[names[material[corners[1], corners[0]]]] += [(a, b, c), (a, c, d)]
    triangles |= standing
    lines = ["# Written by data/gotcha/make_scene.py; metres, Z up", "mtllib scene.mtl"]
    count = 0
    for name, mine in triangles.items():
        lines += [f"usemtl {name}", *_faces(mine, count, content["size_m"])]
        count += 3 * len(mine)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.obj").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    colours = [line for name in triangles for line in (f"newmtl {name}", "Kd 0.70 0.70 0.70")]
    (folder / "scene.mtl").write_text("\n".join(colours) + "\n", encoding="utf-8", newline="\n")


def _faces(triangles: Iterable[tuple[Point, Point, Point]], count: int, size_m: float) -> Iterator[str]:
    """OBJ lines of triangles whose vertices come after the first `count`; texture coordinates are the plan's."""
    for triangle in triangles:
        for x, y, z in triangle:
            yield f"v {x:.6g} {y:.6g} {z:.6g}"
            yield f"vt {x / size_m + 0.5:.6g} {y / size_m + 0.5:.6g}"
        yield "f " + " ".join(f"{k}/{k}" for k in range(count + 1, count + 4))
        count += 3


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--flat", action="store_true")
    options = parser.parse_args()
    print(write(options.folder, flat=options.flat))
