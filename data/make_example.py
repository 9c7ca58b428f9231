"""Write the mesh of data/example: a street corner of 60 x 60 m, one OBJ group per material.

Run as `python data/make_example.py`; what it writes is committed, and the same to the byte in every run.
X is east, Y north, Z up, all in metres.
"""

import math
from itertools import pairwise
from pathlib import Path

FOLDER = Path(__file__).parent / "example"
HALF_M = 30  # the ground reaches from -30 to +30 m, in cells of 1 m

# Colours are for mesh viewers only; what the radar sees stands in scene.toml.
COLOURS = {
    "lawn": (0.35, 0.55, 0.25),
    "asphalt": (0.25, 0.25, 0.27),
    "concrete": (0.70, 0.70, 0.68),
    "brick": (0.65, 0.32, 0.25),
    "tiles": (0.50, 0.22, 0.18),
    "felt": (0.40, 0.40, 0.42),
    "steel": (0.60, 0.65, 0.75),
}

Point = tuple[float, float, float]
triangles: dict[str, list[tuple[Point, Point, Point]]] = {material: [] for material in COLOURS}


def polygon(material: str, *corners: Point) -> None:
    """A convex polygon, corners counterclockwise as seen from outside."""
    for second, third in pairwise(corners[1:]):
        triangles[material].append((corners[0], second, third))


def placed(x: float, y: float, heading_deg: float, outline: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """`outline` turned clockwise by `heading_deg`, then moved to (`x`, `y`)."""
    sine, cosine = math.sin(math.radians(heading_deg)), math.cos(math.radians(heading_deg))
    return [(x + a * cosine + b * sine, y - a * sine + b * cosine) for a, b in outline]


def rectangle(length: float, width: float) -> list[tuple[float, float]]:
    a, b = length / 2, width / 2
    return [(-a, -b), (a, -b), (a, b), (-a, b)]


def walls(material: str, outline: list[tuple[float, float]], top: float, bottom: float = 0.0) -> None:
    """Walls over a counterclockwise outline."""
    for (ax, ay), (bx, by) in zip(outline, outline[1:] + outline[:1], strict=True):
        polygon(material, (ax, ay, bottom), (bx, by, bottom), (bx, by, top), (ax, ay, top))


def block(wall: str, roof: str, outline: list[tuple[float, float]], top: float, bottom: float = 0.0) -> None:
    walls(wall, outline, top, bottom)
    polygon(roof, *((x, y, top) for x, y in outline))


def ground_height(x: float, y: float) -> float:
    """Flat, but for a smooth mound in the south-west."""
    distance = min(math.hypot(x + 18, y + 17) / 10, 1.0)
    return 1.5 * (1 + math.cos(math.pi * distance))


def ground_material(x: float, y: float) -> str:
    street = -4 <= x < 2
    lane = x >= 2 and -3 <= y < 3
    car_park = 5 <= x < 25 and -14 <= y < -3
    return "asphalt" if street or lane or car_park else "lawn"


def ground() -> None:
    for x in range(-HALF_M, HALF_M):
        for y in range(-HALF_M, HALF_M):
            corners = [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)]
            polygon(ground_material(x, y), *((a, b, ground_height(a, b)) for a, b in corners))


def office() -> None:
    """L-shaped, 10 m high, flat roof."""
    walls("concrete", [(7, 8), (26, 8), (26, 16), (15, 16), (15, 26), (7, 26)], 10)
    for left, right, south, north in [(7, 26, 8, 16), (7, 15, 16, 26)]:
        polygon("felt", (left, south, 10), (right, south, 10), (right, north, 10), (left, north, 10))


def house(x: float, y: float, heading_deg: float) -> None:
    """11 x 8 m, brick, eaves at 4 m, under a gable roof of tiles with its ridge at 7 m."""
    outline = placed(x, y, heading_deg, rectangle(11, 8))
    (west, east) = placed(x, y, heading_deg, [(-5.5, 0), (5.5, 0)])
    walls("brick", outline, 4)
    a, b, c, d = ((px, py, 4.0) for px, py in outline)
    ridge_west, ridge_east = (*west, 7.0), (*east, 7.0)
    polygon("brick", b, c, ridge_east)
    polygon("brick", d, a, ridge_west)
    polygon("tiles", a, b, ridge_east, ridge_west)
    polygon("tiles", c, d, ridge_west, ridge_east)


def tower(x: float, y: float, radius: float, top: float, sides: int = 32) -> None:
    """A round concrete tower under a steel cone."""
    angles = [2 * math.pi * i / sides for i in range(sides)]
    outline = [(x + radius * math.cos(angle), y + radius * math.sin(angle)) for angle in angles]
    walls("concrete", outline, top)
    for (ax, ay), (bx, by) in zip(outline, outline[1:] + outline[:1], strict=True):
        polygon("steel", (ax, ay, top), (bx, by, top), (x, y, top + 3))


def car(x: float, y: float) -> None:
    """A body and a cabin, nose to the north."""
    block("steel", "steel", placed(x, y, 0, rectangle(1.8, 4.4)), 0.9, 0.3)
    block("steel", "steel", placed(x, y - 0.3, 0, rectangle(1.6, 2.2)), 1.5, 0.9)


def write() -> None:
    corners = sorted({point for group in triangles.values() for triangle in group for point in triangle})
    number = {point: i for i, point in enumerate(corners, start=1)}
    lines = ["# Written by data/make_example.py; metres, Z up", "mtllib scene.mtl"]
    lines += [f"v {x:.4f} {y:.4f} {z:.4f}" for x, y, z in corners]
    for material, group in triangles.items():
        lines.append(f"usemtl {material}")
        lines += [f"f {number[a]} {number[b]} {number[c]}" for a, b, c in group]
    (FOLDER / "scene.obj").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")

    lines = ["# Written by data/make_example.py"]
    for material, (red, green, blue) in COLOURS.items():
        lines += [f"newmtl {material}", f"Kd {red:.2f} {green:.2f} {blue:.2f}"]
    (FOLDER / "scene.mtl").write_text("\n".join(lines) + "\n", encoding="utf-8", newline="\n")


if __name__ == "__main__":
    ground()
    office()
    house(-16, 18, 20)
    house(-14, 3, -15)
    tower(20, -22, 3, 15)
    block("brick", "brick", placed(-8, 11, 90, rectangle(14, 0.4)), 2)
    for east in (7, 10, 16, 22):
        car(east, -11)
    for east in (8.5, 13, 19):
        car(east, -6)
    write()
