"""The ten scenes of the gallery: what stands where. Each function writes its mesh, and says what the radar does."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from gallery_shapes import ShapeParts, all_of, fractal, turn
from numpy.typing import NDArray

Array = NDArray[np.float64]
BOUNCES: dict[str, dict[str, Any]] = {"multibounce": {"strength": 1.0}}


@dataclass(frozen=True)
class Shot:
    """How a scene is looked at: `spacing_m` square, `shape` in range and azimuth; `extra` is text of its own for the
    scene file, `effects` tables beside the system's response."""

    words: str
    azimuth_deg: float
    incidence_deg: float
    shape: tuple[int, int]
    spacing_m: float
    reference_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    effects: dict[str, dict[str, Any]] = field(default_factory=lambda: BOUNCES)
    extra: str = ""
    mesh: str = "scene.obj"


def detailed(level: float, spread_m: float, *materials: str) -> dict[str, dict[str, Any]]:
    """Bounces, and detail that the mesh does not have: hatches, rails, engines. The level is our choice."""
    return BOUNCES | {"unresolved_detail": {"level": level, "spread_m": spread_m, "materials": list(materials)}}


def tables(**library: str) -> str:
    """Tables of materials that have a name of their own and a surface of the library."""
    return "".join(f'\n[materials.{name}]\nlibrary = "{surface}"\n' for name, surface in library.items())


def roughened(name: str, surface: str, rms_height_m: float, correlation_length_m: float) -> str:
    """A table of a surface that is rougher than small perturbation takes (kh < 0.3): our choice of heights, with the
    model that holds for them (kh < 3, h / l < 0.4)."""
    own = f'model = "i2em"\nrms_height_m = {rms_height_m}\ncorrelation_length_m = {correlation_length_m}\n'
    return tables(**{name: surface}) + own


def car(number: int, x: float, y: float, heading: float, size: tuple[float, float, float] = (4.6, 1.8, 1.5)) -> str:
    kind = "truck" if size[0] > 6 else "car"
    return (
        f'\n[[objects]]\nname = "{kind}{number}"\nprimitive = "{kind}"\nsize_m = {list(size)}\n'
        f'position_m = [{x:g}, {y:g}, 0.02]\nheading_deg = {heading:g}\nmaterial = "painted_steel"\n'
    )


def city_block(folder: Path) -> Shot:
    parts = ShapeParts()

    def ground(x: Array, y: Array) -> NDArray[np.str_]:
        street = (np.abs(x) > 48) | (np.abs(y) > 48)
        return np.where(street, "asphalt", np.where((np.abs(x) < 26) & (np.abs(y) < 26), "grass", "concrete"))

    parts.ground((124.0, 124.0), 1.0, ground)
    for i, y in enumerate((-38.0, 38.0)):
        for j, x in enumerate((-36.0, -18.0, 0.0, 18.0, 36.0)):
            height = 11.0 + 2.0 * ((3 * i + 2 * j) % 4)
            parts.house("facades", "roof_tiles", (x, y, 0.0), (12.0, 17.0, height), 4.0, 90.0)
    for x, floors in ((-38.0, 18.0), (38.0, 24.0)):
        parts.prism("offices", "concrete", [(x - 6, -24), (x + 6, -24), (x + 6, 24), (x - 6, 24)], floors)
        parts.box("metal", (x, 0.0, floors), (3.0, 5.0, 2.0))
    cars = [car(i, x, y, 90.0) for i, (x, y) in enumerate((x, y) for y in (-52.0, 52.0) for x in (-30, -8, 14, 36))]
    parts.write(folder / "scene.obj")
    return Shot(
        "a city block: terraces, two office slabs, parked cars",
        25.0,
        42.0,
        (380, 380),
        0.4,
        effects=detailed(0.3, 1.0, "facades", "offices", "roof_tiles"),
        extra=tables(facades="brick", offices="concrete") + "".join(cars),
    )


def _aeroplane(parts: ShapeParts, x: float, y: float, heading: float) -> None:
    one = ShapeParts()
    one.rod("aircraft", (0.0, -16.0, 3.6), (0.0, 15.0, 3.6), 2.0, 32)
    one.ball("aircraft", (0.0, 15.0, 3.6), (2.0, 4.5, 2.0))
    wing = [(0, 4, 3.2), (17, -5, 4.0), (17, -7, 4.0), (0, -3, 3.2)]
    tail = [(0, -13, 4.5), (6.5, -16, 5.0), (6.5, -17.5, 5.0), (0, -16, 4.5)]
    for sheet in (wing, tail):
        for side in (1.0, -1.0):
            one.add("aircraft", np.array(sheet, float) * (side, 1.0, 1.0), np.array([[0, 1, 2], [0, 2, 3]]))
    fin = [(0, -11, 5.4), (0, -16, 11.0), (0, -18, 11.0), (0, -16.5, 5.0)]
    one.add("aircraft", np.array(fin, float), np.array([[0, 1, 2], [0, 2, 3]]))
    for side in (6.0, -6.0):
        one.rod("aircraft", (side, -2.0, 2.0), (side, 3.0, 2.0), 1.1, 24)
    for material, vertices, faces in one.pieces:
        parts.add(material, vertices @ turn(heading).T + (x, y, 0.0), faces)


def airport(folder: Path) -> Shot:
    parts = ShapeParts()

    def ground(x: Array, y: Array) -> NDArray[np.str_]:
        runway, apron = np.abs(y + 85) < 22, (y > -20) & (np.abs(x) < 120)
        taxiway = (np.abs(x - 90) < 9) & (y < 0)
        return np.where(runway | taxiway, "asphalt", np.where(apron, "concrete", "grass"))

    parts.ground((300.0, 240.0), 3.0, ground)
    parts.prism("terminal", "concrete", [(-100, 75), (40, 75), (40, 100), (-100, 100)], 14.0)
    for x in (70.0, 102.0):
        angle = np.linspace(0.0, np.pi, 25)
        arch = np.column_stack([13.0 * np.cos(angle), 11.0 * np.sin(angle)])
        both = np.concatenate([np.column_stack([arch[:, 0] + x, np.full(25, y), arch[:, 1]]) for y in (65.0, 105.0)])
        i = np.arange(24)
        parts.add("hangars", both, np.concatenate([np.stack([i, i + 1, i + 26], 1), np.stack([i, i + 26, i + 25], 1)]))
        ends = [np.column_stack([np.full(23, s), np.arange(1, 24) + s, np.arange(2, 25) + s]) for s in (0, 25)]
        parts.add("hangars", both, np.concatenate(ends))
    parts.cylinder("concrete", (-125.0, 60.0, 0.0), 4.0, 30.0)
    parts.frustum("glass", (-125.0, 60.0, 30.0), (5.0, 7.0), 5.0)
    for x, heading in ((-80.0, 0.0), (-25.0, 0.0), (30.0, 15.0)):
        _aeroplane(parts, x, 40.0, heading)
    _aeroplane(parts, 90.0, -40.0, 180.0)
    parts.write(folder / "scene.obj")
    return Shot(
        "an airport: apron, runway, hangars, a terminal and four aeroplanes",
        165.0,
        45.0,
        (350, 480),
        0.75,
        effects=detailed(0.15, 1.5, "aircraft", "terminal"),
        # corrugated sheets, seamed and bolted: smooth ones would be as black as their shadow
        extra=tables(aircraft="metal", terminal="glass") + roughened("hangars", "metal", 0.001, 0.012),
    )


def ship(folder: Path) -> Shot:
    parts = ShapeParts()
    parts.ground((200.0, 60.0), 2.0, lambda x, y: np.full(x.shape, "water_rough"), lambda x, y: np.zeros(x.shape))
    sea = parts.pieces.pop()
    parts.add(sea[0], sea[1] + (0.0, -30.0, 0.0), sea[2])
    parts.prism("concrete", "concrete", [(-100, 0), (100, 0), (100, 45), (-100, 45)], 3.5)
    hull = [(-62, -14), (-66, -10), (-66, -8), (-62, -3), (48, -3), (62, -6), (70, -9), (62, -12), (48, -15)]
    hull = [(x, y - 1.0) for x, y in hull]
    parts.prism("ship", "ship", hull[::-1] if _clockwise(hull) else hull, 9.0)
    parts.box("ship", (-52.0, -9.5, 9.0), (12.0, 11.0, 12.0))
    parts.box("ship", (-52.0, -9.5, 21.0), (9.0, 13.0, 3.0))
    parts.cylinder("ship", (-59.0, -9.5, 9.0), 1.8, 14.0)
    parts.rod("ship", (-50.0, -9.5, 24.0), (-50.0, -9.5, 32.0), 0.3)
    random = np.random.default_rng(4)
    for x in np.arange(-38.0, 48.0, 6.6):
        for y in (-13.0, -9.5, -6.0):
            for level in range(int(random.integers(1, 5))):
                parts.box("containers", (float(x), y, 9.0 + 2.6 * level), (6.1, 2.44, 2.55))
    for x in (-10.0, 45.0):
        for a in (-7.0, 7.0):
            for y in (4.0, 18.0):
                parts.rod("cranes", (x + a, y, 3.5), (x + a, y, 30.0), 0.7)
        for a in (-7.0, 7.0):
            parts.box("cranes", (x + a, 3.0, 29.0), (1.2, 50.0, 1.6))
        parts.box("cranes", (x, 14.0, 31.0), (8.0, 8.0, 4.0))
    for x in range(-80, 90, 22):
        parts.box("containers", (float(x), 32.0, 3.5), (12.2, 2.44, 2.6 * (1 + x % 3)))
    parts.write(folder / "scene.obj")
    # no mirrors: walls of containers are corrugated, plates of a ship dented between their ribs, cranes lattices
    extra = roughened("ship", "painted_steel", 0.004, 0.012)
    extra += roughened("containers", "metal", 0.01, 0.03) + roughened("cranes", "painted_steel", 0.006, 0.018)
    effects = detailed(0.3, 1.5, "ship", "containers", "cranes")
    return Shot(
        "a container ship at a quay with two cranes", 148.0, 48.0, (330, 420), 0.5, effects=effects, extra=extra
    )


def _clockwise(outline: list[tuple[float, float]]) -> bool:
    x, y = np.array(outline).T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))) < 0.0


def vehicle(folder: Path) -> Shot:
    parts = ShapeParts()
    rough = fractal(240, 1.2, 7) * 0.03
    parts.ground((24.0, 24.0), 0.1, all_of("grass"), lambda x, y: rough.ravel() - 0.03)
    for side in (-1.35, 1.35):
        parts.prism(
            "tracks", "tracks", [(side - 0.3, -3.0), (side + 0.3, -3.0), (side + 0.3, 3.0), (side - 0.3, 3.0)], 0.9
        )
        for y in np.linspace(-2.5, 2.5, 6):
            parts.rod("tracks", (side - 0.32, y, 0.42), (side + 0.32, y, 0.42), 0.4, 24)
    parts.prism("hull", "hull", [(-1.7, -3.2), (1.7, -3.2), (1.7, 2.3), (-1.7, 2.3)], 0.7, 0.85)
    front = np.array(
        [(-1.7, 2.3, 0.85), (1.7, 2.3, 0.85), (1.7, 3.4, 1.0), (-1.7, 3.4, 1.0), (-1.7, 2.3, 1.55), (1.7, 2.3, 1.55)]
    )
    parts.add("hull", front, np.array([(4, 2, 3), (4, 5, 2), (0, 2, 1), (0, 3, 2), (0, 4, 3), (1, 2, 5)]))
    parts.frustum("hull", (0.0, -0.4, 1.55), (1.35, 1.0), 0.75, 10)
    parts.rod("tracks", (0.0, 0.6, 1.95), (0.0, 5.0, 2.05), 0.09)
    parts.cylinder("tracks", (0.5, -0.9, 2.3), 0.3, 0.25, 16)
    for x in (-1.2, 1.2):
        parts.box("tracks", (x, -2.9, 1.55), (0.7, 0.5, 0.35))
    parts.write(folder / "scene.obj")
    # armour is cast and bolted: flat faces of a mesh would throw spots of light far over the grass
    extra = roughened("hull", "painted_steel", 0.003, 0.012) + tables(tracks="metal")
    effects = detailed(0.4, 0.25, "hull", "tracks")
    return Shot("a tracked vehicle on grass", 35.0, 55.0, (200, 240), 0.08, (0.0, 0.0, 0.8), effects, extra)


def terrain(folder: Path) -> Shot:
    import rasterio
    from rasterio.transform import from_origin

    # ridges where a smooth field changes its sign, and smaller relief upon them
    ridges = 0.55 - np.abs(fractal(383, 2.6, 11))
    heights = (1200.0 + 420.0 * ridges + 60.0 * fractal(383, 1.8, 5)).astype(np.float32)
    profile = {"driver": "GTiff", "width": 384, "height": 384, "count": 1, "dtype": "float32", "crs": "EPSG:32632"}
    place = from_origin(600000.0, 5200000.0, 20.0, 20.0)
    with rasterio.open(folder / "dem.tif", "w", transform=place, compress="deflate", **profile) as target:
        target.write(heights, 1)
    return Shot(
        "mountains from an elevation model of 20 m",
        100.0,
        38.0,
        (480, 560),
        14.0,
        (0.0, 0.0, 1200.0),
        {},
        tables(default="soil_wet"),
        "dem.tif",
    )


def trihedrals(folder: Path) -> Shot:
    parts = ShapeParts()
    parts.ground((38.0, 34.0), 1.0, all_of("grass"))
    parts.write(folder / "scene.obj")
    text = ""
    for i, x in enumerate((-12.0, -6.0, 0.0, 6.0, 12.0)):
        for j, y in enumerate((-10.0, 0.0, 10.0)):
            leg = (0.3, 0.5, 0.8)[j]
            # three equal legs: walls at right angles where length and width are alike
            text += (
                f'\n[[objects]]\nname = "corner{i}{j}"\nprimitive = "trihedral"\n'
                f"size_m = [{leg * 2**0.5:.4f}, {leg * 2**0.5:.4f}, {leg}]\nposition_m = [{x:g}, {y:g}, 0.3]\n"
                f'heading_deg = {20.0 + 12.0 * (i - 2):g}\nmaterial = "metal"\n'
            )
    words = "fifteen trihedral corner reflectors: legs of 0.3, 0.5 and 0.8 m, turned by -24 to 24 degrees"
    return Shot(words, 20.0, 52.0, (230, 300), 0.15, extra=text)


def forest(folder: Path) -> Shot:
    parts = ShapeParts()
    relief = fractal(60, 2.2, 3).ravel() * 0.4
    parts.ground((120.0, 120.0), 2.0, lambda x, y: np.where(np.abs(x + 48) < 3, "gravel", "grass"), lambda x, y: relief)
    random = np.random.default_rng(2)
    number = 0
    for x in np.arange(-18.0, 32.0, 5.0):
        for y in np.arange(-58.0, 60.0, 5.0):
            a, b = (float(v) for v in np.array([x, y]) + random.uniform(-1.8, 1.8, 2))
            tall, wide = float(random.uniform(11, 18)), float(random.uniform(2.0, 3.2))
            parts.rod("trunks", (a, b, -0.5), (a, b, 0.5 * tall), 0.2, 8)
            parts.ball("crowns", (a, b, 0.68 * tall), (wide, wide, 0.34 * tall), 0.10, number)
            number += 1
    parts.write(folder / "scene.obj")
    extra = tables(crowns="grass", trunks="wood")
    detail = {"unresolved_detail": {"level": 0.05, "spread_m": 2.0, "materials": ["crowns"]}}
    words = "a forest's edge: crowns are lumpy surfaces with unresolved detail; the models have no volume of leaves"
    return Shot(words, 270.0, 45.0, (280, 330), 0.45, (0.0, 0.0, 3.0), detail, extra)


def bridge(folder: Path) -> Shot:
    parts = ShapeParts()

    def ground(x: Array, y: Array) -> NDArray[np.str_]:
        return np.where(np.abs(x) < 48, "water_calm", "grass")

    def bank(x: Array, y: Array) -> Array:
        return np.clip((np.abs(x) - 48.0) * 0.5, 0.0, 7.0)

    parts.ground((180.0, 90.0), 2.0, ground, bank)
    parts.box("asphalt", (0.0, 0.0, 9.0), (160.0, 11.0, 0.8))
    for x in (-25.0, 25.0):
        parts.box("concrete", (x, 0.0, 0.0), (3.0, 9.0, 9.0))
    for y in (-6.0, 6.0):
        parts.box("metal", (0.0, y, 8.6), (130.0, 0.5, 1.4))
        parts.box("metal", (0.0, y, 17.2), (110.0, 0.5, 0.6))
        for i, x in enumerate(np.arange(-60.0, 61.0, 10.0)):
            top = 17.4 if abs(x) < 60 else 9.8
            parts.rod("metal", (float(x), y, 9.5), (float(x), y, top), 0.22, 24)
            if abs(x + 5) < 55:
                ends = ((float(x), y, 9.6), (float(x) + 10.0, y, 17.4))
                ends = ends if i % 2 else ((float(x), y, 17.4), (float(x) + 10.0, y, 9.6))
                parts.rod("metal", *ends, 0.22, 24)
    parts.write(folder / "scene.obj")
    words = "a truss bridge over calm water: behind it lie the paths by way of the water"
    return Shot(words, 175.0, 45.0, (260, 440), 0.4, (0.0, 0.0, 3.0))


def tank_farm(folder: Path) -> Shot:
    parts = ShapeParts()

    def dike(x: Array, y: Array) -> Array:
        inside = [np.maximum(np.abs((a + 45.0) % 90.0 - 45.0) - 37.0, 0.0) for a in (x - 45.0, y - 45.0)]
        return np.asarray(np.clip(2.2 * np.maximum(*inside) / 4.0, 0.0, 2.2))

    parts.ground((184.0, 184.0), 1.0, all_of("gravel"), dike)
    for i, (x, y) in enumerate(((-45.0, -45.0), (45.0, -45.0), (-45.0, 45.0), (45.0, 45.0))):
        radius, height = (26.0, 24.0, 20.0, 26.0)[i], (14.0, 16.0, 18.0, 12.0)[i]
        angle = 2.0 * np.pi * np.arange(96) / 96
        rings = [
            np.column_stack([x + radius * np.cos(angle), y + radius * np.sin(angle), np.full(96, z)])
            for z in (0.0, height)
        ]
        a, b = np.arange(96), (np.arange(96) + 1) % 96
        sides = np.concatenate([np.stack([a, b, b + 96], 1), np.stack([a, b + 96, a + 96], 1)])
        parts.add("painted_steel", np.concatenate(rings), sides)
        parts.cylinder("roofs", (x, y, height * (0.3, 0.85, 0.6, 0.5)[i]), radius - 0.3, 0.5, 96)
        for turn_deg in np.arange(0.0, 360.0, 30.0):
            east, north = radius * np.sin(np.radians(turn_deg)), radius * np.cos(np.radians(turn_deg))
            parts.rod(
                "metal",
                (x + 1.01 * east, y + 1.01 * north, 0.0),
                (x + 1.01 * east, y + 1.01 * north, height + 1.0),
                0.12,
                8,
            )
        parts.rod("metal", (x, y - radius - 30.0 * (y < 0), 0.8), (x, y - radius, 0.8), 0.4)
    parts.rod("metal", (-90.0, 0.0, 3.2), (90.0, 0.0, 3.2), 0.5)
    parts.write(folder / "scene.obj")
    words = "a tank farm: four tanks with floating roofs at different levels, behind dikes"
    # seams, supports and dirt: smooth roofs would be as black as the shadow of the rim
    extra = roughened("roofs", "painted_steel", 0.0008, 0.012)
    return Shot(words, 210.0, 40.0, (400, 530), 0.5, extra=extra)


def wind_turbine(folder: Path) -> Shot:
    parts = ShapeParts()
    relief = fractal(100, 2.0, 5).ravel() * 0.5

    def ground(x: Array, y: Array) -> NDArray[np.str_]:
        return np.where((np.abs(x + 0.3 * y) < 2.5) | (np.hypot(x, y) < 14), "gravel", "grass")

    parts.ground((200.0, 200.0), 2.0, ground, lambda x, y: relief)
    parts.frustum("tower", (0.0, 0.0, 0.0), (2.3, 1.4), 80.0, 96)
    parts.box("tower", (0.0, -1.5, 80.0), (3.6, 10.0, 3.8))
    hub = np.array([0.0, -7.5, 82.0])
    parts.ball("tower", tuple(hub), (1.7, 1.8, 1.7))
    for turn_deg in (15.0, 135.0, 255.0):
        out = np.array([np.sin(np.radians(turn_deg)), 0.0, np.cos(np.radians(turn_deg))])
        side = np.cross(out, (0.0, 1.0, 0.0))
        t = 2.0 * np.pi * np.arange(64) / 64
        rings = []
        for along in np.linspace(2.0, 40.0, 40):
            chord, thick = (
                np.interp(along, (2.0, 8.0, 40.0), (0.9, 1.7, 0.4)),
                np.interp(along, (2.0, 40.0), (0.5, 0.1)),
            )
            twist = np.radians(12.0 - 0.25 * along)
            wide = side * np.cos(twist) + np.array([0.0, np.sin(twist), 0.0])
            rings.append(hub + along * out + np.outer(chord * np.cos(t), wide) + np.outer(thick * np.sin(t), (0, 1, 0)))
        a, b = np.arange(64), (np.arange(64) + 1) % 64
        strips = [np.stack([a + k, b + k + 64, b + k], 1) for k in range(0, 39 * 64, 64)]
        strips += [np.stack([a + k, a + k + 64, b + k + 64], 1) for k in range(0, 39 * 64, 64)]
        parts.add("blades", np.concatenate(rings), np.concatenate(strips))
    parts.box("concrete", (0.0, 0.0, 0.0), (8.0, 8.0, 0.8))
    parts.box("painted_steel", (9.0, 3.0, 0.6), (3.0, 5.0, 2.5))
    parts.write(folder / "scene.obj")
    words = "a wind turbine of 80 m: it lies towards the radar, and its shadow away from it"
    extra = tables(tower="painted_steel", blades="glass") + "rms_height_m = 0.0002\n"
    return Shot(words, 200.0, 50.0, (400, 400), 0.5, (0.0, 0.0, 20.0), detailed(0.3, 1.0, "tower", "blades"), extra)


SCENES: dict[str, Callable[[Path], Shot]] = {
    "city_block": city_block,
    "airport": airport,
    "ship": ship,
    "vehicle": vehicle,
    "terrain": terrain,
    "trihedrals": trihedrals,
    "forest": forest,
    "bridge": bridge,
    "tank_farm": tank_farm,
    "wind_turbine": wind_turbine,
}
