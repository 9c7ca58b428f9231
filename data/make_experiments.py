"""Write the meshes of data/table3, table4, in_domain and fields, and the painted maps of data/fields.

Run as `python data/make_experiments.py`; what it writes is committed, and the same in every run. X is east, Y north,
Z up, all in metres. docs/experiments.md says what the scenes are for.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from warpsar.io.images import write_exr

FOLDER = Path(__file__).parent
Point = tuple[float, float, float]


@dataclass
class Face:
    """A convex planar polygon, corners counterclockwise as seen from outside; `uv` one pair per corner, or none."""

    material: str
    corners: list[Point]
    uv: list[tuple[float, float]] | None = None


def write_obj(folder: str, faces: list[Face]) -> None:
    corners = sorted({corner for face in faces for corner in face.corners})
    places = sorted({pair for face in faces for pair in face.uv or []})
    vertex = {corner: i for i, corner in enumerate(corners, start=1)}
    place = {pair: i for i, pair in enumerate(places, start=1)}
    lines = ["# Written by data/make_experiments.py; metres, Z up", "mtllib scene.mtl"]
    lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in corners]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in places]
    materials = list(dict.fromkeys(face.material for face in faces))
    for material in materials:
        lines.append(f"usemtl {material}")
        for face in (f for f in faces if f.material == material):
            names = [str(vertex[corner]) for corner in face.corners]
            if face.uv is not None:
                names = [f"{name}/{place[pair]}" for name, pair in zip(names, face.uv, strict=True)]
            lines += [f"f {names[0]} {names[i]} {names[i + 1]}" for i in range(1, len(names) - 1)]
    colours = [line for name in materials for line in (f"newmtl {name}", "Kd 0.70 0.70 0.70")]
    for name, content in (("scene.obj", lines), ("scene.mtl", ["# Written by data/make_experiments.py", *colours])):
        (FOLDER / folder / name).write_text("\n".join(content) + "\n", encoding="utf-8", newline="\n")


def plane(half: float, height: float = 0.0) -> list[Point]:
    return [(-half, -half, height), (half, -half, height), (half, half, height), (-half, half, height)]


def walls(material: str, outline: list[tuple[float, float]], top: float) -> list[Face]:
    """Walls on the ground over a counterclockwise outline."""
    sides = zip(outline, outline[1:] + outline[:1], strict=True)
    return [Face(material, [(*a, 0.0), (*b, 0.0), (*b, top), (*a, top)]) for a, b in sides]


def rectangle(west: float, south: float, east: float, north: float) -> list[tuple[float, float]]:
    return [(west, south), (east, south), (east, north), (west, north)]


def flat_block(material: str, outline: list[tuple[float, float]], top: float) -> list[Face]:
    return [*walls(material, outline, top), Face(material, [(x, y, top) for x, y in outline])]


def table3() -> list[Face]:
    """A cube of 8 m on a plane of 16 m, small so that not every pixel of the cube holds the plane too (layover)."""
    return [Face("plane", plane(8.0)), *flat_block("cube", rectangle(-4, -4, 4, 4), 8.0)]


def table4() -> list[Face]:
    """A building of a gabled house and a lower flat-roofed wing, on a plane."""
    a, b, c, d = ((x, y, 6.0) for x, y in rectangle(-8, -5, 6, 4))
    west, east = (-8.0, -0.5, 9.0), (6.0, -0.5, 9.0)
    house = walls("building", rectangle(-8, -5, 6, 4), 6.0)
    roof = [[a, b, east, west], [c, d, west, east], [b, c, east], [d, a, west]]
    wing = flat_block("building", rectangle(-2, 4, 5, 10), 4.0)
    return [Face("plane", plane(13.0)), *house, *(Face("building", r) for r in roof), *wing]


def in_domain() -> list[Face]:
    """Rolling ground of one material, 36 x 36 m in cells of 1.5 m, slopes up to 16 degrees: many local angles."""

    def point(i: int, j: int) -> Point:
        x, y = 1.5 * i - 18.0, 1.5 * j - 18.0
        return x, y, round(0.8 * (math.cos(2 * math.pi * x / 24) + math.cos(2 * math.pi * y / 24)), 4)

    cells = [(i, j) for i in range(24) for j in range(24)]
    lower = [Face("soil", [point(i, j), point(i + 1, j), point(i + 1, j + 1)]) for i, j in cells]
    upper = [Face("soil", [point(i, j), point(i + 1, j + 1), point(i, j + 1)]) for i, j in cells]
    return lower + upper


# --- fields: a painted building -------------------------------------------------------------------------------------

TEXELS, TEXEL_M = 64, 0.75
# eps_r, rms height [m], correlation length [m]; at 15.2 GHz all inside the domain of small perturbation
PAINTS = {
    "grass": (9.0, 0.90e-3, 4.4e-3),
    "asphalt": (4.5, 0.45e-3, 3.0e-3),
    "paving": (6.0, 0.65e-3, 5.0e-3),
    "brick": (4.0, 0.80e-3, 4.0e-3),
    "concrete": (6.9, 0.60e-3, 3.2e-3),
    "glass": (6.0, 0.30e-3, 2.5e-3),
    "tiles": (5.0, 0.85e-3, 5.5e-3),
    "metal": (40.0, 0.50e-3, 3.0e-3),
    "felt": (3.0, 0.70e-3, 3.6e-3),
}


class Atlas:
    """Charts laid side by side, one texel of margin round each; a texel is TEXEL_M of surface."""

    def __init__(self) -> None:
        self.paint = np.full((TEXELS, TEXELS), "grass", dtype="<U8")
        self.used = np.zeros((TEXELS, TEXELS), bool)

    def place(self, corners: list[Point], along: Point, paint: dict[tuple[float, float, float, float], str]) -> Face:
        """A planar polygon as a face of the material "site". `along` is the chart's first axis, the first corner its
        origin; `paint` gives the paints of rectangles (from, to along the axis; from, to across) in metres, later
        ones over earlier ones."""
        points = np.array(corners)
        first = np.array(along) / np.linalg.norm(along)
        normal = np.cross(points[1] - points[0], points[2] - points[0])
        second = np.cross(normal / np.linalg.norm(normal), first)
        flat = np.column_stack([(points - points[0]) @ first, (points - points[0]) @ second])
        flat -= flat.min(axis=0)
        wide, high = (math.ceil(n / TEXEL_M - 1e-6) + 2 for n in flat.max(axis=0))
        row, col = self.room(high, wide)
        self.used[row : row + high, col : col + wide] = True
        y, x = np.mgrid[0:high, 0:wide]
        x_m, y_m = (x - 0.5) * TEXEL_M, (y - 0.5) * TEXEL_M  # the margin carries the border's paint
        chart = self.paint[row : row + high, col : col + wide]
        for (x0, x1, y0, y1), name in paint.items():
            chart[(x_m >= x0) & (x_m < x1) & (y_m >= y0) & (y_m < y1)] = name
        uv = (flat / TEXEL_M + 1.0 + np.array([col, row])) / TEXELS
        return Face("site", corners, [(float(u), float(v)) for u, v in uv])

    def room(self, high: int, wide: int) -> tuple[int, int]:
        """The lowest, then leftmost, free rectangle (row 0 at v = 0)."""
        for row in range(TEXELS - high + 1):
            for col in range(TEXELS - wide + 1):
                if not self.used[row : row + high, col : col + wide].any():
                    return row, col
        raise ValueError(f"no room for a chart of {wide} x {high} texels")


EVERYWHERE = (-99.0, 99.0, -99.0, 99.0)


def windows(wide: float, top: float) -> dict[tuple[float, float, float, float], str]:
    """Brick over a concrete base, windows of 1.5 x 1.5 m every 3 m."""
    base = {EVERYWHERE: "brick", (-99.0, 99.0, -99.0, 1.0): "concrete"}
    starts = np.arange(1.5, wide - 2.0, 3.0)
    return base | {(x, x + 1.5, 2.25, min(top, 3.75)): "glass" for x in starts.tolist()}


def fields() -> tuple[list[Face], dict[str, np.ndarray]]:
    """A brick house under a tiled and metal roof, a concrete wing under felt, on grass with a street and a yard."""
    atlas = Atlas()
    ground = {EVERYWHERE: "grass", (0.0, 5.25, -99.0, 99.0): "asphalt", (5.25, 24.0, 21.0, 27.0): "paving"}
    faces = [atlas.place(plane(15.0), (1, 0, 0), ground)]
    x0, y0, x1, y1, eaves, ridge = -7.0, -6.0, 7.0, 3.0, 6.0, 9.0
    middle = (y0 + y1) / 2
    south, north = [(x0, y0), (x1, y0)], [(x1, y1), (x0, y1)]
    for (ax, ay), (bx, by) in (south, north):
        corners = [(ax, ay, 0.0), (bx, by, 0.0), (bx, by, eaves), (ax, ay, eaves)]
        faces.append(atlas.place(corners, (bx - ax, by - ay, 0), windows(x1 - x0, eaves)))
    for x, ya, yb in ((x1, y0, y1), (x0, y1, y0)):
        corners = [(x, ya, 0.0), (x, yb, 0.0), (x, yb, eaves), (x, middle, ridge), (x, ya, eaves)]
        faces.append(atlas.place(corners, (0, yb - ya, 0), windows(y1 - y0, eaves)))
    for (ax, ay), (bx, by), paint in ((*south, "tiles"), (*north, "metal")):
        corners = [(ax, ay, eaves), (bx, by, eaves), (bx, middle, ridge), (ax, middle, ridge)]
        faces.append(atlas.place(corners, (bx - ax, by - ay, 0), {EVERYWHERE: paint}))
    outline = rectangle(-1, 3, 6, 9)
    for face in walls("site", outline, 4.0)[1:]:  # the first side stands against the house
        a, b = face.corners[:2]
        faces.append(atlas.place(face.corners, (b[0] - a[0], b[1] - a[1], 0), {EVERYWHERE: "concrete"}))
    faces.append(atlas.place([(x, y, 4.0) for x, y in outline], (1, 0, 0), {EVERYWHERE: "felt"}))
    painted = atlas.paint[::-1]  # image row 0 lies at v = 1
    values = np.array([[PAINTS[name] for name in row] for row in painted.tolist()], np.float32)
    keys = ("eps_r", "rms_height_m", "correlation_length_m")
    return faces, {key: values[:, :, i] for i, key in enumerate(keys)}


if __name__ == "__main__":
    write_obj("table3", table3())
    write_obj("table4", table4())
    write_obj("in_domain", in_domain())
    site, maps = fields()
    write_obj("fields", site)
    for key, values in maps.items():
        write_exr(FOLDER / "fields" / f"{key}.exr", {key: values})
