"""How long `warpsar twin` takes, and how much memory: 2,500 x 2,500 pixels of Sentinel-1 over hills of 30 m posts.

    python benchmarks/terrain.py $DATA/sentinel1_rome [--device cuda] [--size 2500] [--once]

The annotation is real. The hills are made: slopes of 20 degrees on average, so some lie over others and some are in
shadow. Timed are the layers alone (`warpsar.twin`), once more after the kernels are compiled, and the whole command
with its GeoTIFFs, pictures and report, twice, too; `--once` leaves out the second time. `--size` takes more lines and
pixels, with more hills; from 26,102 on it is the whole scene, of 16,705 lines of 26,102 pixels. With `pixels` the
product has pixels of speckle, and what is timed is layers, comparison and what differs. Memory at most is that of the
process up to then.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np

import warpsar
from warpsar.formats import registry
from warpsar.runtime.threads import thread_count
from warpsar.terrain import command
from warpsar.terrain.comparison import compared
from warpsar.terrain.differences import differences

SIZE = 2500
POST_DEG = 1.0 / 3600.0


def hills(path: Path, longitude: float, latitude: float, size: int = SIZE) -> None:
    """30 km by 30 km of posts of 1 arc second for 2,500 lines: smoothed noise, the same for ever."""
    import rasterio
    from rasterio.transform import from_origin
    from scipy.ndimage import gaussian_filter

    rows, columns = 1150 * size // SIZE, 1500 * size // SIZE
    rough = np.random.default_rng(7).standard_normal((rows, columns))
    heights = np.full((rows, columns), 900.0)
    for posts, spread_m in ((6.0, 60.0), (20.0, 120.0)):
        part = gaussian_filter(rough, posts, mode="wrap")
        heights += spread_m * part / part.std()
    top, left = latitude + 0.5 * rows * POST_DEG, longitude - 0.5 * columns * POST_DEG
    with rasterio.open(
        path, "w", driver="GTiff", width=columns, height=rows, count=1, dtype="float32", crs="EPSG:4326",
        transform=from_origin(left, top, POST_DEG, POST_DEG),
    ) as file:  # fmt: skip
        file.write(heights.astype(np.float32), 1)


class TerrainSpeckle:
    """Amplitudes of a single look, made where they are read."""

    dtype = np.dtype(np.uint16)

    def __init__(self, lines: int, pixels: int) -> None:
        self.shape = lines, pixels

    def __getitem__(self, window: tuple[slice, slice], /) -> np.ndarray:
        shape = [part.stop - part.start for part in window]
        power = np.random.default_rng([part.start for part in window]).exponential(1.0, shape)
        return (100.0 * np.sqrt(power)).astype(np.uint16)


@contextmanager
def timed(what: str) -> Iterator[None]:
    wall, cpu = time.perf_counter(), time.process_time()
    yield
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"{what}: {wall:.1f} s, {cpu:.1f} s of CPU with {thread_count()} threads; {peak:.2f} GiB at most", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--device")
    parser.add_argument("--size", type=int, default=SIZE)
    parser.add_argument("--once", action="store_true")
    parser.add_argument("--only", nargs="+", choices=("layers", "command", "pixels"), default=("layers", "command"))
    options = parser.parse_args()
    names = ("first",) if options.once else ("first", "again")
    size, safe = options.size, next(options.folder.glob("S1B*.SAFE"))
    (product,) = registry.products(safe)
    lines, pixels = min(size, product.grid.lines), min(size, product.grid.pixels)
    line, pixel = min(8000.0, product.grid.lines - lines), min(20000.0, product.grid.pixels - pixels)
    corners = product.to_ground([line, line + lines], [pixel, pixel + pixels], 700.0)
    middle = corners.mean(axis=0)
    half_lat, half_lon = (share * abs(np.diff(corners[:, i])[0]) for i, share in ((0, 0.47), (1, 0.38)))
    crop = (middle[1] - half_lon, middle[0] - half_lat, middle[1] + half_lon, middle[0] + half_lat)
    if size >= product.grid.pixels:
        crop = None
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "hills.tif"
        hills(path, float(middle[1]), float(middle[0]), size)
        if "layers" in options.only:
            for name in names:
                with timed(f"layers, {name}"):
                    found = warpsar.twin(product, path, geoid_offset_m=0.0, crop=crop, device=options.device)
            print(f"{found.window.shape[0]} x {found.window.shape[1]} pixels, {found.forecast.blocks} blocks")
            ground = np.isfinite(found.image["surfaces"])
            for name in ("layover", "shadow"):
                print(f"{name}: {np.mean(found.image[name][ground] >= 0.5):.1%} of pixels")
            del found, ground
        if "command" in options.only:
            for name in names:
                with timed(f"command, {name}"):
                    command.run(
                        safe, path, Path(scratch) / "twin", crop=crop, geoid_offset_m=0.0, device=options.device
                    )
        if "pixels" in options.only:
            speckled = replace(product, samples=TerrainSpeckle(product.grid.lines, product.grid.pixels))
            for name in names:
                with timed(f"with pixels, {name}"):
                    found = warpsar.twin(speckled, path, geoid_offset_m=0.0, crop=crop, device=options.device)
                    compared(found)
                    differences(found)
                del found


if __name__ == "__main__":
    main()
