"""Read the cars and the two reflectors off az001 and az002, and write objects.toml: how the committed one was made.

python data/gotcha/read_off.py DATA_FOLDER

DATA_FOLDER holds gotcha/data_3dsar_pass1_az001_HH.mat and az002; az003 is never opened. The mean power of both views is
focused on z = 0, 0.2 m apart. Rows of cars are told by eye, as rectangles and the way the cars in them stand
(rows.toml); where in a row cars are is decided here. The radar is in the east. A car returns most from the line where
its side meets the ground, and what has the height of the ground stays in its place: so the line filter, as long as the
side of a car that faces the radar, has its maximum at the foot of that side. Maxima are taken brightest first, none
closer to another than cars can stand, down to the contrast that rows.toml states. Every car gets the size of a common
one, since shapes cannot be told at this resolution; what is read off is where it is, and which way it stands.
Reflectors are the maxima near where the pictures show them; their legs follow from the peak, as that of a perfect
triangular trihedral seen along its axis, 4 pi a^4 / 3 lambda^2 (Ruck, Radar Cross Section Handbook, 1970), over the
grass, whose sigma0 is taken for -16 dB: a guess good to some 4 dB, and the legs to a quarter.
"""

from __future__ import annotations

import argparse
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

HERE = Path(__file__).resolve().parent
STEP_M = 0.2
HALF_M = 62.0
VIEWS = ("az001", "az002")
GRASS = ((0.0, 20.0), (50.0, 60.0))  # nothing but grass: [west, south], [east, north]
GRASS_SIGMA0 = 10.0**-1.6
# Area whose clutter is as bright as a point of the same power: integral of the impulse response, in range that of a
# Hann window (1.5 cells of c / 2B) laid on the ground, in azimuth one cell of lambda / 2 (aperture angle).
CELL_M2 = 1.5 * 0.241 / np.sin(np.radians(44.255)) * 1.285
WAVELENGTH_M = 299_792_458.0 / 9.6e9


def power_on_the_ground(data: Path, device: str | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Mean power of the train views on z = 0, [north, east], and its axis (the same for both) [m]."""
    from warpsar.formats import registry
    from warpsar.formats.base.data import PhaseHistory
    from warpsar.measured.focus import focus

    axis = np.arange(-HALF_M, HALF_M + STEP_M / 2, STEP_M)
    east, north = np.meshgrid(axis, axis)
    points = np.stack([east, north, np.zeros_like(east)], axis=-1)
    total = np.zeros(east.shape)
    for name in VIEWS:
        history = registry.read([data / "gotcha" / f"data_3dsar_pass1_{name}_HH.mat"])
        assert isinstance(history, PhaseHistory)
        history = history.with_autofocus()
        (image,) = focus(history, points, reference_point_m=np.zeros(3), window_range="hann", device=device)
        total += np.abs(image.astype(complex)) ** 2
    return total / len(VIEWS), axis


def extent_m(car: dict[str, Any], table: dict[str, Any]) -> tuple[float, float]:
    """East and north extent of a car that faces the radar with its side or with an end."""
    along, across = table["length_m"], table["width_m"]
    return (across, along) if car["facing"] == "side" else (along, across)


def cars_in(
    row: dict[str, Any],
    table: dict[str, Any],
    power: np.ndarray,
    axis: np.ndarray,
    taken: list[dict[str, Any]],
) -> list[dict[str, Any]]:
    """Cars of one row, brightest first: the middle of the foot of the side that faces the radar, and its contrast. None
    overlaps another of its row, or one of `taken`."""
    from scipy.ndimage import uniform_filter

    east_extent, north_extent = extent_m(row, table)
    line = uniform_filter(power, (round(north_extent / STEP_M), round(table["line_m"] / STEP_M)))
    contrast = 10.0 * np.log10(line / np.median(power))
    (west, south), (east, north) = row["corners"]
    x, y = np.meshgrid(axis, axis)
    half = north_extent / 2 - table["overhang_m"]
    free = (x >= west) & (x <= east) & (y >= south + half) & (y <= north - half)

    def occupy(car: dict[str, Any]) -> None:
        other = extent_m(car, table)
        apart = (x - east_extent / 2) - (car["foot_m"][0] - other[0] / 2), y - car["foot_m"][1]
        reach = [
            (mine + theirs) / 2 + table["gap_m"]
            for mine, theirs in zip((east_extent, north_extent), other, strict=True)
        ]
        free[(np.abs(apart[0]) < reach[0]) & (np.abs(apart[1]) < reach[1])] = False

    for car in taken:
        occupy(car)
    found: list[dict[str, Any]] = []
    while True:
        best = np.where(free, contrast, -np.inf)
        k = np.unravel_index(int(np.argmax(best)), best.shape)
        if not best[k] >= row["least_db"]:
            return found
        place = [round(float(axis[k[1]]), 1), round(float(axis[k[0]]), 1)]
        found.append({"foot_m": place, "facing": row["facing"], "contrast_db": round(float(best[k]), 1)})
        occupy(found[-1])


def reflectors(near: list[list[float]], power: np.ndarray, axis: np.ndarray) -> list[dict[str, Any]]:
    """The maximum within 2 m of each place, interpolated by parabolas in dB."""
    found = []
    west, south, east, north = (int(np.argmin(np.abs(axis - at))) for corner in GRASS for at in corner)
    grass = float(power[south:north, west:east].mean())
    for x, y in near:
        close = np.hypot(axis[None, :] - x, axis[:, None] - y) < 2.0
        i, j = np.unravel_index(int(np.argmax(np.where(close, power, 0.0))), power.shape)
        shift = []
        for three in (power[i, j - 1 : j + 2], power[i - 1 : i + 2, j]):
            a, b, c = np.log(three)
            shift.append(0.5 * (a - c) / (a - 2 * b + c) * STEP_M)
        place = [round(float(axis[j] + shift[0]), 2), round(float(axis[i] + shift[1]), 2)]
        over = float(power[i, j]) / grass
        cross_section = over * GRASS_SIGMA0 * CELL_M2
        leg = (3.0 * WAVELENGTH_M**2 * cross_section / (4.0 * np.pi)) ** 0.25
        peak = round(10.0 * float(np.log10(over)), 1)
        found.append({"corner_m": place, "leg_m": round(float(leg), 2), "over_grass_db": peak})
    return found


def write(data: Path, device: str | None = None) -> Path:
    table = tomllib.loads((HERE / "rows.toml").read_text(encoding="utf-8"))
    power, axis = power_on_the_ground(data, device)
    lines = [
        "# Written by data/gotcha/read_off.py from az001 and az002 and rows.toml; metres, east and north. foot_m:",
        "# middle of the line where the side that faces the radar (east) meets the ground. contrast_db: of that line",
        "# over the picture's median. corner_m: where a reflector focuses on z = 0; over_grass_db: its peak; leg_m:",
        "# what a perfect trihedral of that cross-section would have if grass were -16 dB.",
        "",
    ]
    taken: list[dict[str, Any]] = []
    for row in table["rows"]:
        cars = sorted(cars_in(row, table["car"], power, axis, taken), key=lambda car: car["foot_m"])
        taken += cars
        lines += [f"# {row['name']}"]
        for car in cars:
            lines += ["[[cars]]", *(f"{key} = {_toml(value)}" for key, value in car.items()), ""]
    for one in reflectors(table["reflectors"]["near_m"], power, axis):
        lines += ["[[reflectors]]", *(f"{key} = {_toml(value)}" for key, value in one.items()), ""]
    path = HERE / "objects.toml"
    path.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8", newline="\n")
    return path


def _toml(value: Any) -> str:
    return f'"{value}"' if isinstance(value, str) else str(value)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    print(write(parser.parse_args().data))
