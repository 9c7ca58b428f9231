"""Write the Gotcha scene into a folder: scene.obj and scene.mtl from regions.toml, and scene.toml as it is here.

python data/gotcha/make_scene.py FOLDER

Flat ground at z = 0 in square cells of 1 m (a pixel is 1 m by 1.4 m of ground, corners are read off to 1 or 2 m),
two triangles each; a cell has the material of the last region that holds its centre. So regions share their edges,
nothing overlaps, and nothing is left bare.
"""

from __future__ import annotations

import argparse
import shutil
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
CELL_M = 1.0


def table() -> dict[str, Any]:
    """`size_m` and `regions`, as regions.toml has them."""
    return tomllib.loads((HERE / "regions.toml").read_text(encoding="utf-8"))


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


def write(folder: Path) -> Path:
    """Write the scene; returns its scene.toml."""
    content = table()
    names, material = cells(content["regions"], content["size_m"])
    n = len(material)
    edge = np.arange(n + 1) * CELL_M - content["size_m"] / 2.0
    lines = ["# Written by data/gotcha/make_scene.py; metres, Z up", "mtllib scene.mtl"]
    lines += [f"v {x:g} {y:g} 0" for y in edge for x in edge]
    for index, name in enumerate(names):
        lines.append(f"usemtl {name}")
        for row, col in np.argwhere(material == index):
            south_west = row * (n + 1) + col + 1
            south_east, north_west = south_west + 1, south_west + n + 1
            lines.append(f"f {south_west} {south_east} {north_west + 1}")
            lines.append(f"f {south_west} {north_west + 1} {north_west}")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "scene.obj").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")
    colours = [line for name in names for line in (f"newmtl {name}", "Kd 0.70 0.70 0.70")]
    (folder / "scene.mtl").write_text("\n".join(colours) + "\n", encoding="utf-8", newline="\n")
    return Path(shutil.copyfile(HERE / "scene.toml", folder / "scene.toml"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    print(write(parser.parse_args().folder))
