"""What two effects cost beside the image they act on, and beside the least that such work can take.

python benchmarks/effects.py --device cpu --out effects_cpu.json

multibounce: its paths are traced once and kept. The floor of tracing is a kernel that only sends the rays on from
mirror to mirror, with no way home, no bins and no records; that of the image, the single-bounce image's own time per
hit for as many bounces as its paths have. point_spread: on the CPU the floor is SciPy's direct sum over as many taps
(beside it in the JSON, its product of Fourier transforms); on CUDA, reading and writing the image once along each
axis at the rate of a copy. The example scene's first view, one polarization. The table shows CPU seconds of all
threads on the CPU, wall time on CUDA.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
import warp as wp
from peer import Row, timed
from simulate import machine

from warpsar.kernels.geometry import RayGrid, azimuth_of, elevation_of, intersect, jitter_of, ray_direction, ray_origin

ROOT = Path(__file__).resolve().parent.parent
WIDTHS = {"range_fwhm_m": 1.0, "azimuth_fwhm_m": 1.0}


@wp.kernel(enable_backward=False, module="unique")
def mirrors_kernel(
    grid: RayGrid,
    mesh: wp.uint64,
    vertices: wp.array(dtype=wp.vec3),
    faces: wp.array2d(dtype=int),
    first_cell: int,
    seed: int,
    max_bounces: int,
    size: float,
    # Out:
    queries: wp.array(dtype=int),
):
    """How often one column of rays asks the BVH, going from mirror to mirror."""
    i, j = wp.tid()
    cell = first_cell + i
    asked = int(0)  # noqa: UP018, RUF046 - a mutable scalar to Warp
    for k in range(j * 64, wp.min((j + 1) * 64, grid.elevation_cells)):
        jitter = jitter_of(grid, seed, cell, k)
        elevation = elevation_of(grid, k, jitter)
        origin = ray_origin(grid, azimuth_of(grid, cell, jitter), elevation)
        direction = ray_direction(grid, elevation)
        reach = grid.reach
        for _ in range(max_bounces):
            asked += 1
            query = wp.mesh_query_ray(mesh, origin, direction, reach)
            if not query.result:
                break
            corner = vertices[faces[query.face, 0]]
            hit = intersect(origin, direction, corner, vertices[faces[query.face, 1]], vertices[faces[query.face, 2]])
            slope = wp.dot(hit.normal, direction)
            origin = origin + hit.distance * direction - 1.0e-5 * size * wp.sign(slope) * hit.normal
            direction = direction - 2.0 * slope * hit.normal
            reach = size
    wp.atomic_add(queries, 0, asked)


def effects_of(scene: Any, name: str, **table: Any) -> list[Any]:
    from warpsar.effects import declared

    return declared(replace(scene, effects={name: table}), scene.views[0])


def measure(device_name: str, rays_per_pixel: float, repeats: int) -> dict[str, Any]:
    from warpsar import runtime
    from warpsar.effects.multibounce import trace_paths
    from warpsar.render import Stage, ViewRender
    from warpsar.scene import Scene
    from warpsar.simulation import trace_view
    from warpsar.trace import BinGrid, ray_grid

    device = runtime.resolve_device(device_name)
    synchronize = partial(wp.synchronize_device, device)
    scene = Scene.load(ROOT / "data" / "example" / "scene.toml")
    scene = replace(scene, sampling=scene.sampling.model_copy(update={"rays_per_pixel": rays_per_pixel}))
    stage, view, shape = Stage.of(scene, device), scene.views[0], scene.grid.shape
    times: dict[str, Row] = {}
    counts: dict[str, float] = {}

    def run(name: str, task: Any) -> None:
        times[name] = timed(task, synchronize, repeats)

    def images(name: str, effects: list[Any], hits: Any) -> ViewRender:
        """Forward and backward of an image of kept hits."""
        render = ViewRender(stage, view, hits, shape, ("HH",), effects)
        seed = {render.images["HH"]: np.ones(shape[0] * shape[1], np.float32)}
        run(f"{name}, image", render.program.forward)
        run(f"{name}, image and gradient", lambda: (render.program.forward(), render.program.backward(seed)))
        return render

    hits = trace_view(scene, stage, view, seed=0, effects=[])
    run("plain, trace", lambda: trace_view(scene, stage, view, seed=0, effects=[]))
    plain = images("plain", [], hits)
    counts["rays"], counts["hits"] = hits.rays, hits.count

    target, grid = stage.target, hits.grid
    wide = BinGrid((grid.shape[0], 2 * grid.shape[1]), grid.spacing_m)
    rays = ray_grid(target, hits.geometry, wide, hits.rays_per_m2, 1, scene.grid.pixel_area_m2)
    size = float(np.linalg.norm(np.ptp(target.corners, axis=0)))
    dim = (rays.end_cell - rays.first_cell, -(-rays.elevation_cells // 64))
    for bounces in (2, 3):
        name = f"multibounce {bounces}"
        effects = effects_of(scene, "multibounce", strength=1.0, max_bounces=bounces)
        run(f"{name}, trace", partial(trace_paths, plain, bounces))
        asked: Any = wp.zeros(1, dtype=int, device=device)
        inputs = [rays, target.bvh.id, target.vertices, target.faces, rays.first_cell, 0, bounces, size]
        run(f"{name}, mirrors alone", lambda i=inputs, a=asked: wp.launch(mirrors_kernel, dim, i, [a], device=device))
        render = images(name, effects, hits)
        paths = [p for p, _ in render.kept["multibounce"] if p is not None]
        counts[f"{name}, paths"] = sum(p.weight.shape[0] for p in paths)
        counts[f"{name}, bounces"] = sum(p.weight.shape[0] * len(p.bounces) for p in paths)
        asked.zero_()
        wp.launch(mirrors_kernel, dim, inputs, [asked], device=device)
        counts[f"{name}, queries"] = int(asked.numpy()[0])
    for window in ("gaussian", "taylor"):
        images(f"point_spread {window}", effects_of(scene, "point_spread", **WIDTHS, window=window), hits)
        reach = [
            min(n, int(3 * WIDTHS[k] / s) + 1) for n, k, s in zip(shape, WIDTHS, scene.grid.spacing_m, strict=True)
        ]
        taps = [2 * r + 1 for r in reach] if window == "gaussian" else [2 * n - 1 for n in shape]
        counts[f"point_spread {window}, taps"] = sum(taps)
        image = plain.forward()["HH"]
        kernels = [np.ones(t, np.float32) / t for t in taps]
        run(f"point_spread {window}, direct sum", lambda i=image, k=kernels: direct(i, k))
        run(f"point_spread {window}, transforms", lambda i=image: transforms(i))
    large = 1 << (26 if device.is_cpu else 28)
    source, copy = (wp.zeros(large, dtype=float, device=device) for _ in range(2))
    run("copy", lambda: wp.copy(copy, source))
    counts["copy_bytes"] = 8 * large
    counts["pixels"] = shape[0] * shape[1]
    return {"times": times, "counts": counts, "floors": floors(times, counts, "cpu_s" if device.is_cpu else "wall_s")}


def direct(image: np.ndarray, kernels: list[np.ndarray]) -> np.ndarray:
    from scipy.ndimage import correlate1d

    for axis, kernel in enumerate(kernels):
        image = correlate1d(image, kernel, axis, mode="constant")
    return image


def transforms(image: np.ndarray) -> np.ndarray:
    """Zeros beside the image keep what leaves one side from coming in at the other."""
    from scipy.fft import irfft2, rfft2

    wide = tuple(2 * n for n in image.shape)
    return irfft2(rfft2(image, wide), wide)[: image.shape[0], : image.shape[1]]


def floors(times: dict[str, Row], counts: dict[str, float], clock: str) -> list[dict[str, Any]]:
    """Each effect's own share of a time, the least it could be, and their ratio."""
    seconds = {name: row[clock] for name, row in times.items()}
    found = []

    def add(what: str, own: float, least: float) -> None:
        found.append({"what": what, "own_s": own, "floor_s": least, "ratio": own / least})

    for n in (2, 3):
        name = f"multibounce {n}"
        add(f"{name}: tracing", seconds[f"{name}, trace"], seconds[f"{name}, mirrors alone"])
        for part in ("image", "image and gradient"):
            own = seconds[f"{name}, {part}"] - seconds[f"plain, {part}"]
            add(f"{name}: {part}", own, seconds[f"plain, {part}"] * counts[f"{name}, bounces"] / counts["hits"])
    for window in ("gaussian", "taylor"):
        name = f"point_spread {window}"
        least = seconds[f"{name}, direct sum"]
        if clock == "wall_s":
            least = 2 * 8 * counts["pixels"] * seconds["copy"] / counts["copy_bytes"]
        for part, passes in (("image", 1), ("image and gradient", 2)):
            own = seconds[f"{name}, {part}"] - seconds[f"plain, {part}"]
            add(f"{name} ({counts[name + ', taps']:.0f} taps): {part}", own, passes * least)
    return found


def table(rows: list[dict[str, Any]]) -> str:
    lines = ["| | own share, ms | floor, ms | ratio |", "|---|---|---|---|"]
    lines += [f"| {r['what']} | {1e3 * r['own_s']:.3g} | {1e3 * r['floor_s']:.3g} | {r['ratio']:.3g} |" for r in rows]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--rays-per-pixel", type=float, default=32.0)
    parser.add_argument("--repeats", type=int, default=5, help="runs of which the median counts")
    parser.add_argument("--out", type=Path, help="JSON file")
    options = parser.parse_args()
    found = measure(options.device, options.rays_per_pixel, options.repeats)
    result = {"benchmark": "effects", **machine(options.device), **found}
    if options.out:
        options.out.write_text(json.dumps(result, indent=1) + "\n")
    print(", ".join(f"{name}: {count:,.0f}" for name, count in found["counts"].items()) + "\n")
    print(table(found["floors"]))


if __name__ == "__main__":
    main()
