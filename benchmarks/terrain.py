"""How long `warpsar twin` takes, and how much memory: 2,500 x 2,500 pixels of Sentinel-1 over hills of 30 m posts.

    python benchmarks/terrain.py $DATA/sentinel1_rome

The annotation is real. The hills are made: slopes of 20 degrees on average, so some lie over others and some are in
shadow. Timed are the layers alone (`warpsar.twin`), once more after the kernels are compiled.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import warpsar
from warpsar.formats import registry
from warpsar.runtime.threads import thread_count

SIZE = 2500
POST_DEG = 1.0 / 3600.0


def hills(path: Path, longitude: float, latitude: float) -> None:
    """30 km by 30 km of posts of 1 arc second: smoothed noise, the same for ever."""
    import rasterio
    from rasterio.transform import from_origin
    from scipy.ndimage import gaussian_filter

    rows, columns = 1150, 1500
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


def main(folder: Path, device: str | None) -> None:
    (product,) = registry.products(next(folder.glob("S1B*.SAFE")))
    line, pixel = 8000.0, 20000.0
    corners = product.to_ground([line, line + SIZE], [pixel, pixel + SIZE], 700.0)
    middle = corners.mean(axis=0)
    half_lat, half_lon = (share * abs(np.diff(corners[:, i])[0]) for i, share in ((0, 0.47), (1, 0.38)))
    crop = (middle[1] - half_lon, middle[0] - half_lat, middle[1] + half_lon, middle[0] + half_lat)
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "hills.tif"
        hills(path, float(middle[1]), float(middle[0]))
        for name in ("first", "again"):
            wall, cpu = time.perf_counter(), time.process_time()
            found = warpsar.twin(product, path, geoid_offset_m=0.0, crop=crop, device=device)
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            lines, pixels = found.window.shape
            peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
            print(f"{name}: {lines} x {pixels} pixels, {found.blocks} blocks: {wall:.1f} s, {cpu:.1f} s of CPU", end="")
            print(f" with {thread_count()} threads; {peak:.2f} GiB at most")
    ground = np.isfinite(found.image["surfaces"])
    for name in ("layover", "shadow"):
        print(f"{name}: {np.mean(found.image[name][ground] >= 0.5):.1%} of pixels")


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2] if len(sys.argv) > 2 else None)
