"""What effects cost beside the image they act on, and two of them beside the least that such work can take.

    python benchmarks/effects.py --device cpu --out effects_cpu.json [--write]

The example scene's first view, one polarization. First every effect of the registry, with the values that it declares
for its picture (`Effect.example`): its own share of a fresh image, of an image of kept hits, and of image and gradient.

Then two effects beside their floors. multibounce: its paths are traced once and kept. The floor of tracing is a kernel
that only sends the rays on from mirror to mirror, with no way home, no bins and no records; that of the image, the
single-bounce image's own time per hit for as many bounces as its paths have. point_spread: on the CPU the floor is
SciPy's direct sum over as many taps (beside it in the JSON, its product of Fourier transforms); on CUDA, reading and
writing the image once along each axis at the rate of a copy. The tables show CPU seconds of all threads on the CPU,
wall time on CUDA.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import tables
import warp as wp
from peer import Row, timed
from scenes import example_with
from simulate import machine, said

from warpsar.effects.registry import declared, names
from warpsar.kernels.geometry import RayGrid, azimuth_of, elevation_of, intersect, jitter_of, ray_direction, ray_origin
from warpsar.runtime import devices

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


class Bench:
    """The example's first view with its hits; times and counts of what is made of them."""

    def __init__(self, device_name: str, rays_per_pixel: float, repeats: int) -> None:
        from warpsar.surface.stage import Stage

        self.device, self.repeats = devices.resolve_device(device_name), repeats
        self.scene = example_with(None, rays_per_pixel)
        self.view, self.stage = self.scene.views[0], Stage.of(self.scene, self.device)
        self.clock = "cpu_s" if self.device.is_cpu else "wall_s"
        self.times: dict[str, Row] = {}
        self.counts: dict[str, float] = {}
        self.hits = self.traced([])
        self.run("plain, trace", lambda: self.traced([]))
        self.plain = self.images("plain", [], self.hits)
        self.counts |= {"rays": self.hits.rays, "hits": self.hits.count}

    def run(self, name: str, task: Any) -> None:
        self.times[name] = timed(task, partial(wp.synchronize_device, self.device), self.repeats)

    def seconds(self, name: str) -> float:
        return self.times[name][self.clock]

    def effects(self, name: str, **table: Any) -> list[Any]:
        return declared(replace(self.scene, effects={name: table}), self.view)

    def traced(self, effects: list[Any]) -> Any:
        from warpsar.simulation.rays import trace_view

        return trace_view(self.scene, self.stage, self.view, seed=0, effects=effects)

    def render(self, effects: list[Any], hits: Any) -> Any:
        from warpsar.render.render import ViewRender

        return ViewRender(self.stage, self.view, hits, self.scene.grid.shape, ("HH",), effects)

    def images(self, name: str, effects: list[Any], hits: Any) -> Any:
        """Times an image of kept hits, forward and backward; returns its render."""
        render = self.render(effects, hits)
        seed = {render.images["HH"]: np.ones(np.prod(self.scene.grid.shape), np.float32)}
        self.run(f"{name}, image", render.program.forward)
        self.run(f"{name}, image and gradient", lambda: (render.program.forward(), render.program.backward(seed)))
        return render


PARTS = ("fresh image", "image", "image and gradient")


def every_effect(bench: Bench) -> list[dict[str, Any]]:
    """Each effect's own share of a fresh image, of an image of kept hits, and of image and gradient [s].

    The plain image is timed anew beside every effect: clocks drift.
    """

    def time(name: str, effects: list[Any]) -> None:
        bench.run(f"{name}, fresh image", lambda: bench.render(effects, bench.traced(effects)).program.forward())
        bench.images(name, effects, bench.traced(effects))

    rows = []
    for name in names():
        time("plain", [])
        time(name, declared(example_with(name, 1.0), bench.view))
        own = {part: bench.seconds(f"{name}, {part}") - bench.seconds(f"plain, {part}") for part in PARTS}
        rows.append({"effect": name, **own})
    return rows


def bounces(bench: Bench) -> None:
    """multibounce with two and with three bounces, each a lobe at its end, and the mirrors alone."""
    from warpsar.effects.multibounce import trace_paths
    from warpsar.trace.hits import BinGrid
    from warpsar.trace.rays import ray_grid

    target, grid = bench.stage.target, bench.hits.grid
    wide = BinGrid((grid.shape[0], 2 * grid.shape[1]), grid.spacing_m)
    rays = ray_grid(target, bench.hits.geometry, wide, bench.hits.rays_per_m2, bench.scene.grid.pixel_area_m2)
    size = float(np.linalg.norm(np.ptp(target.corners, axis=0)))
    dim = (rays.end_cell - rays.first_cell, -(-rays.elevation_cells // 64))
    asked: Any = wp.zeros(1, dtype=int, device=bench.device)
    for most in (2, 3):
        name = f"multibounce {most}"
        bench.run(f"{name}, trace", partial(trace_paths, bench.plain, most))
        inputs = [rays, target.bvh.id, target.vertices, target.faces, rays.first_cell, 0, most, size]
        mirrors = partial(wp.launch, mirrors_kernel, dim, inputs, [asked], device=bench.device)
        bench.run(f"{name}, mirrors alone", mirrors)
        render = bench.images(
            name, bench.effects("multibounce", strength=1.0, max_bounces=most, reflection="lobe"), bench.hits
        )
        paths = [found[0].paths for found in render.recorded["multibounce"] if found is not None]
        bench.counts[f"{name}, paths"] = sum(p.weight.shape[0] for p in paths)
        bench.counts[f"{name}, bounces"] = sum(p.weight.shape[0] * len(p.bounces) for p in paths)
        asked.zero_()
        mirrors()
        bench.counts[f"{name}, queries"] = int(asked.numpy()[0])


def blurs(bench: Bench) -> None:
    """point_spread with a short and with a long window, SciPy beside it, and the rate of a copy."""
    shape, spacing = bench.scene.grid.shape, bench.scene.grid.spacing_m
    for window in ("gaussian", "taylor"):
        name = f"point_spread {window}"
        bench.images(name, bench.effects("point_spread", **WIDTHS, window=window), bench.hits)
        reach = [min(n, int(3 * WIDTHS[k] / s) + 1) for n, k, s in zip(shape, WIDTHS, spacing, strict=True)]
        taps = [2 * r + 1 for r in reach] if window == "gaussian" else [2 * n - 1 for n in shape]
        bench.counts[f"{name}, taps"] = sum(taps)
        image = bench.plain.forward()["HH"]
        bench.run(f"{name}, direct sum", partial(direct, image, [np.ones(t, np.float32) / t for t in taps]))
        bench.run(f"{name}, transforms", partial(transforms, image))
    large = 1 << (26 if bench.device.is_cpu else 28)
    source, copy = (wp.zeros(large, dtype=float, device=bench.device) for _ in range(2))
    bench.run("copy", lambda: wp.copy(copy, source))
    bench.counts["copy_bytes"] = 8 * large
    bench.counts["pixels"] = shape[0] * shape[1]


def measure(device_name: str, rays_per_pixel: float, repeats: int) -> dict[str, Any]:
    bench = Bench(device_name, rays_per_pixel, repeats)
    own = every_effect(bench)
    bounces(bench)
    blurs(bench)
    plain = {"effect": "(the image itself)", **{part: bench.seconds(f"plain, {part}") for part in PARTS}}
    return {"times": bench.times, "counts": bench.counts, "effects": [plain, *own], "floors": floors(bench)}


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


def floors(bench: Bench) -> list[dict[str, Any]]:
    """Each effect's own share of a time, the least it could be, and their ratio."""
    seconds, counts = bench.seconds, bench.counts
    found = []

    def add(what: str, own: float, least: float) -> None:
        found.append({"what": what, "own_s": own, "floor_s": least, "ratio": own / least})

    for n in (2, 3):
        name = f"multibounce {n}"
        add(f"{name}: tracing", seconds(f"{name}, trace"), seconds(f"{name}, mirrors alone"))
        for part in ("image", "image and gradient"):
            own = seconds(f"{name}, {part}") - seconds(f"plain, {part}")
            add(f"{name}: {part}", own, seconds(f"plain, {part}") * counts[f"{name}, bounces"] / counts["hits"])
    for window in ("gaussian", "taylor"):
        name = f"point_spread {window}"
        least = seconds(f"{name}, direct sum")
        if bench.clock == "wall_s":
            least = 2 * 8 * counts["pixels"] * seconds("copy") / counts["copy_bytes"]
        for part, passes in (("image", 1), ("image and gradient", 2)):
            own = seconds(f"{name}, {part}") - seconds(f"plain, {part}")
            add(f"{name} ({counts[name + ', taps']:.0f} taps): {part}", own, passes * least)
    return found


def table(result: dict[str, Any]) -> str:
    counts = result["counts"]
    own = [[row["effect"], *(f"{1e3 * row[part]:.3g}" for part in PARTS)] for row in result["effects"]]
    beside = [
        [row["what"], *(f"{1e3 * row[key]:.3g}" for key in ("own_s", "floor_s")), f"{row['ratio']:.3g}"]
        for row in result["floors"]
    ]
    said_of = f"{said(result)}; {counts['rays']:,} rays, {counts['hits']:,} hits, {counts['pixels']:,} pixels."
    return "\n\n".join(
        (
            said_of,
            tables.markdown(
                ["own share of", "fresh image, ms", "image of kept hits, ms", "image and gradient, ms"], own
            ),
            tables.markdown(["", "own share, ms", "floor, ms", "ratio"], beside),
        )
    )


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--rays-per-pixel", type=float, default=32.0)
    parser.add_argument("--repeats", type=int, default=5, help="runs of which the median counts")
    options = parser.parse_args()
    result = tables.result_of(
        options,
        lambda: machine(options.device) | measure(options.device, options.rays_per_pixel, options.repeats),
    )
    tables.publish({f"effects.{result['device'].split(':')[0]}": table(result)}, result, options.write)


if __name__ == "__main__":
    main()
