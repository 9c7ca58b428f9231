"""What `twin` says differs, on made images whose truth is known: six things wrong, one at a time, and nothing.

    python benchmarks/twin_differences.py run $DATA/sentinel1_rome -o out/twin_differences --seeds 12
    python benchmarks/twin_differences.py table -o out/twin_differences [--write]

The annotation is real: Sentinel-1B over Rome, with its orbit, grid, calibration and noise. The ground is made, another
for each seed: a place in the scene, 7 km of posts of one arc second, fields of grass, soil, gravel, asphalt and water,
some 500 m wide. Even seeds are hills, odd ones farmland, nearly level. Each field has a level of its own, 1 dB about
the library's, and levels wander by 1 dB inside of fields. Speckle is that of 4.4 looks, the product's. Images come from
`twin` on the true ground; then `twin` is asked with what a user would have declared. A run appends one line of JSON
to runs.jsonl in the folder; runs that are there already are not made again.
"""

import re
import tempfile
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import runs
import tables
from scipy.ndimage import distance_transform_edt, gaussian_filter
from scipy.spatial import cKDTree

import warpsar
from warpsar.formats import registry
from warpsar.products.product import Product
from warpsar.runtime import devices
from warpsar.terrain.differences import HEIGHT, RANGE, TerrainDifference, TerrainDifferences, differences
from warpsar.terrain.result import SimulatedProduct

POSTS, POST_DEG = 230, 1.0 / 3600.0
COVERS = 3
"""Cells of land cover along a side of a post's: 10 m, as ESA WorldCover has them."""
FIELD_POSTS = 16.0
CLASSES = {40: 0.35, 10: 0.35, 60: 0.1, 50: 0.15, 80: 0.05}
"""Of WorldCover, and their shares."""
GRASS, SOIL, BUILT_UP, WATER = 10, 40, 50, 80
FIELD_DB = WANDERING_DB = 1.0
LOOKS = 4.4
RELIEF = {"hills": 40.0, "level": 2.0}
"""Standard deviation of heights [m]."""
OFFSET_M, GEOID_M = 15.0, 48.6
CALIBRATION_DB, NOISE_DB = 6.0, 4.0
FIELD = "the field"
WRONG = {
    "nothing": "nothing",
    "calibration": f"the calibration, by {CALIBRATION_DB:g} dB",
    "noise": f"the annotated noise, by {NOISE_DB:g} dB",
    "height": f"the DEM's height, by {OFFSET_M:g} m",
    "geoid": f"the geoid left out, {GEOID_M:g} m",
    "lake": "a lake that is declared as soil",
    "town": "a field of grass that is declared as built-up",
}


@dataclass(frozen=True)
class TwinGround:
    """Heights (posts), classes and the number of the field (cells of land cover), and the corner, west and north."""

    heights: np.ndarray
    classes: np.ndarray
    field: np.ndarray
    corner: tuple[float, float]

    def field_at(self, latitude: np.ndarray | float, longitude: np.ndarray | float) -> np.ndarray:
        """Of places [deg]; 0 where nothing is known of a place."""
        step, last = POST_DEG / COVERS, self.field.shape[0] - 1
        row, column = (self.corner[1] - np.asarray(latitude)) / step, (np.asarray(longitude) - self.corner[0]) / step
        at = [np.clip(np.nan_to_num(each), 0, last).astype(int) for each in (row, column)]
        return np.asarray(self.field[at[0], at[1]])


def relief_of(seed: int) -> str:
    return list(RELIEF)[seed % len(RELIEF)]


def ground_of(seed: int, product: Product) -> TwinGround:
    random = np.random.default_rng([20261128, seed])
    at = random.uniform(1500.0, product.grid.lines - 1500.0), random.uniform(1500.0, product.grid.pixels - 1500.0)
    latitude, longitude, _ = product.to_ground(*at, 200.0)
    rough = sum(gaussian_filter(random.standard_normal((POSTS, POSTS)), posts) * posts for posts in (3.0, 10.0))
    heights = 300.0 + RELIEF[relief_of(seed)] * rough / np.std(rough)
    side = POSTS * COVERS
    count = round((POSTS / FIELD_POSTS) ** 2)
    middles = cKDTree(random.uniform(0.0, side, (count, 2)))
    field = middles.query(np.stack(np.indices((side, side)), axis=-1) + 0.5)[1]
    of_field = random.choice(list(CLASSES), count, p=list(CLASSES.values()))
    corner = longitude - 0.5 * POSTS * POST_DEG, latitude + 0.5 * POSTS * POST_DEG
    return TwinGround(heights.astype(np.float32), of_field[field].astype(np.uint8), field, corner)


def written(path: Path, values: np.ndarray, corner: tuple[float, float]) -> Path:
    """A GeoTIFF of the ground, in degrees."""
    import rasterio
    from rasterio.transform import from_origin

    step = POSTS * POST_DEG / values.shape[0]
    with rasterio.open(
        path, "w", driver="GTiff", width=values.shape[1], height=values.shape[0], count=1, dtype=values.dtype.name,
        crs="EPSG:4326", transform=from_origin(*corner, step, step),
    ) as file:  # fmt: skip
        file.write(values, 1)
    return path


def chosen_field(ground: TwinGround, of: int, random: np.random.Generator) -> int:
    """A field of a class, of the median's size or larger, away from the edge."""
    sizes = np.bincount(ground.field.ravel())
    inner = slice(60, -60)
    rim = np.ones(ground.field.shape, bool)
    rim[inner, inner] = False
    kinds = np.zeros(sizes.size, int)
    kinds[ground.field.ravel()] = ground.classes.ravel()
    fit = np.flatnonzero((kinds == of) & (sizes >= np.median(sizes)))
    return int(random.choice(np.setdiff1d(fit, ground.field[rim])))


def levelled(ground: TwinGround, field: int) -> TwinGround:
    """A field as level as a lake, with shores of 8 posts."""
    posts = (ground.field == field).reshape(POSTS, COVERS, POSTS, COVERS).any(axis=(1, 3))
    inside = np.clip(1.0 - distance_transform_edt(~posts) / 8.0, 0.0, 1.0)
    heights = (1.0 - inside) * ground.heights + inside * ground.heights[posts].mean()
    return replace(ground, heights=heights.astype(np.float32))


def natural(ground: TwinGround, random: np.random.Generator, found: SimulatedProduct) -> np.ndarray:
    """Factors of the pixels' power: each field has a level of its own, and levels wander over some 100 m."""
    own = random.normal(0.0, FIELD_DB, int(ground.field.max()) + 1)
    wandering = gaussian_filter(random.standard_normal(found.window.shape), 6.0)
    field = ground.field_at(found.image["latitude"], found.image["longitude"])
    factor = 10.0 ** (0.1 * (own[field] + WANDERING_DB * wandering / wandering.std()))
    return np.asarray(factor / factor[np.isfinite(found.image["beta0"])].mean())


def told(ground: TwinGround, one: TerrainDifference, wrong_field: int) -> str:
    """The name of a hypothesis; of a region, whether its place is in the field that is wrong."""
    place = re.search(r"about (-?[\d.]+) (-?[\d.]+),", one.words)
    if not one.name.startswith(("region ", "part ")) or place is None:
        return one.name
    return FIELD if int(ground.field_at(float(place[1]), float(place[2]))) == wrong_field else "another field"


def asked(
    ground: TwinGround, declared: SimulatedProduct, power: np.ndarray, truth: Mapping[str, float], field: int, seed: int
) -> dict[str, Any]:
    """What is said of speckled power, and whether the interval of the first that is right holds the `truth`."""
    speckle = np.random.default_rng([7, seed]).gamma(LOOKS, 1.0 / LOOKS, power.shape)
    measured = (power * speckle).astype(np.float32)
    answer = differences(replace(declared, image={**declared.image, "measured": measured}))
    if not isinstance(answer, TerrainDifferences):
        return {"words": [str(answer)], "found": []}
    found = [
        {"name": told(ground, one, field), "named": bool(one.named), "value": round(one.value, 2),
         "low": round(one.low, 2), "high": round(one.high, 2), "tied": list(one.tied)}
        for one in answer.found
    ]  # fmt: skip
    mine = [one for one in found if one["name"] in truth]
    held = [bool(one["low"] <= truth[one["name"]] <= one["high"]) for one in mine[:1]]
    return {"words": list(answer.words), "found": found, "held": held[0] if held else None, "truth": dict(truth)}


def one_run(seed: int, folder: str, device: str) -> dict[str, Any]:
    (product,) = registry.products(next(Path(folder).glob("S1B*.SAFE")))
    ground, random = ground_of(seed, product), np.random.default_rng([11, seed])
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:

        def twin(heights: np.ndarray, classes: np.ndarray) -> SimulatedProduct:
            dem = written(Path(scratch) / "dem.tif", heights, ground.corner)
            cover = written(Path(scratch) / "cover.tif", classes, ground.corner)
            return warpsar.twin(product, dem, geoid_offset_m=0.0, landcover=cover, device=device, surface="grass")

        lake, town = (chosen_field(ground, of, random) for of in (SOIL, GRASS))
        ground = levelled(ground, lake)
        base = twin(ground.heights, ground.classes)
        with_lake = twin(ground.heights, np.where(ground.field == lake, WATER, ground.classes).astype(np.uint8))
        with_town = twin(ground.heights, np.where(ground.field == town, BUILT_UP, ground.classes).astype(np.uint8))

        def moved(by_m: float) -> np.ndarray:
            return beta0_on(base, twin(ground.heights + np.float32(by_m), ground.classes))

        def field_db(of: int, true: SimulatedProduct, declared: SimulatedProduct) -> float:
            """Mean over the pixels of a field: true power, with what is natural, over what is declared [dB]."""
            at = ground.field_at(base.image["latitude"], base.image["longitude"]) == of
            with np.errstate(all="ignore"):
                ratio = 10.0 * np.log10((beta0_on(base, true) * nature)[at] / beta0_on(base, declared)[at])
            return float(ratio[np.isfinite(ratio)].mean())

        nature = natural(ground, random, base)
        bare, noise = beta0_on(base, base), base.image["noise"]
        signs = dict(zip(WRONG, random.choice([-1.0, 1.0], len(WRONG)).tolist(), strict=True))
        cosine = float(np.nanmean(np.cos(np.deg2rad(base.image["ellipsoid_incidence"]))))
        rows: dict[str, Any] = {}

        def ask(
            kind: str, beta0: np.ndarray, truth: Mapping[str, float], *, factor: float = 1.0, noisier: float = 1.0,
            declared: SimulatedProduct = base, field: int = -1,
        ) -> None:  # fmt: skip
            power = factor * (beta0 * nature + noisier * noise)
            rows[kind] = asked(ground, declared, power, truth, field, seed)

        def height_truth(by_m: float) -> dict[str, float]:
            return {HEIGHT: by_m, RANGE: -by_m * cosine}

        ask("nothing", bare, {})
        by_db = signs["calibration"] * CALIBRATION_DB
        ask("calibration", bare, {"calibration": by_db}, factor=10.0 ** (0.1 * by_db))
        by_db = signs["noise"] * NOISE_DB
        ask("noise", bare, {"noise": by_db}, noisier=10.0 ** (0.1 * by_db))
        for kind, by_m in (("height", OFFSET_M), ("geoid", GEOID_M)):
            ask(kind, moved(signs[kind] * by_m), height_truth(signs[kind] * by_m))
        ask("lake", beta0_on(base, with_lake), {FIELD: field_db(lake, with_lake, base)}, field=lake)
        ask("town", bare, {FIELD: field_db(town, base, with_town)}, declared=with_town, field=town)
    return {"number": seed, "relief": relief_of(seed), "asked": rows, "seconds": round(time.perf_counter() - begun, 1)}


def beta0_on(declared: SimulatedProduct, true: SimulatedProduct) -> np.ndarray:
    """beta0 of another twin of the same product, on the pixels of the declared one; NaN where it has none."""
    made = np.full(declared.window.shape, np.nan)
    ends = [
        (max(a[0], b[0]), min(a[1], b[1]))
        for a, b in ((declared.window.lines, true.window.lines), (declared.window.pixels, true.window.pixels))
    ]
    to, of = (
        tuple(
            slice(low - first[0], high - first[0])
            for (low, high), first in zip(ends, (one.window.lines, one.window.pixels), strict=True)
        )
        for one in (declared, true)
    )
    made[to] = true.image["beta0"][of]
    return made


def verdict(kind: str, row: Mapping[str, Any]) -> str:
    """right, silent, beside (right, and something else), or what is named wrongly."""
    names = [one["name"] for one in row["found"] if one["named"]]
    right = set(row.get("truth", {}))
    if kind == "nothing":
        return "right" if not names else ", ".join(names)
    if not names:
        return "silent"
    if right & set(names):
        others = [name for name in names if name not in right]
        return "right" if not others else f"right, and {', '.join(others)}"
    return ", ".join(names)


@click.group()
def main() -> None:
    """What differs between a product and its twin."""


@main.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False))
@runs.out
@click.option("--seeds", type=click.IntRange(min=1), default=12, show_default=True, help="How many grounds.")
@runs.first
@runs.jobs(1)
@runs.max_time
@runs.device
def run(folder: str, out: Path, seeds: int, first: int, jobs: int, max_time: float, device: str | None) -> None:
    """Make the runs that are not in the folder yet. FOLDER holds the product."""
    where = devices.resolve_device(device)
    runs.append(
        out, range(first, first + seeds), one_run,
        lambda row: f"{row['number']}: " + "; ".join(f"{k}: {verdict(k, one)}" for k, one in row["asked"].items()),
        folder, where.alias, jobs=jobs, max_time=max_time,
    )  # fmt: skip


@runs.table(main)
def table(rows: list[runs.Row]) -> dict[str, str]:
    """What was named, and how often intervals held the truth."""
    body = []
    for relief in RELIEF:
        for kind, words in WRONG.items():
            mine = [row["asked"][kind] for row in rows if row["relief"] == relief]
            counts = Counter(verdict(kind, one) for one in mine)
            wrongly = "; ".join(f"{n} {name}" for name, n in counts.items() if name not in ("right", "silent"))
            held = [one["held"] for one in mine if one.get("held") is not None]
            inside = "" if kind == "nothing" else f"{sum(held)} of {len(held)}"
            body.append([relief, words, len(mine), counts["right"], counts["silent"], wrongly or "0", inside])
    head = ["ground", "wrong", "images", "named", "nothing named", "named otherwise", "95 % interval holds the truth"]
    return {"twin.differences": tables.markdown(head, body)}


if __name__ == "__main__":
    main()
