"""warpsar beside Mitsuba 3: the same scene, the same rays, on one machine in one run; ratios, JSON and a table.

    python benchmarks/peer.py --device cpu --rays-per-pixel 4 32 128 --out peer_cpu.json [--write]
    python benchmarks/peer.py --device cuda --rays-per-pixel 32 128 --out peer_gpu.json
    python benchmarks/peer.py --from peer_gpu.json --write

Needs `pip install mitsuba`; on the CPU also LLVM (Debian: libllvm15). The town of benchmarks/scenes.py with a
permittivity, a roughness and a correlation length at every vertex. Mitsuba sends the rays that warpsar drew, and its
image, loss and gradient are the same equations in Dr.Jit: from every ray, as its user would write them, and from
warpsar's merged hits. The first ratio is engine and algorithm together, the second the engine's share alone. Wall
times are medians; beside them CPU seconds of all threads, which other programs on the machine change less. Each
number of rays has a process of its own.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from statistics import median
from typing import Any

import numpy as np
import tables
from scenes import MATERIAL, measuring, town_scene
from simulate import machine, said

from warpsar.runtime import devices

Row = dict[str, float]
KEYS = ("rms_height_m", "correlation_length_m", "eps_r")
FRACTION = 0.3  # tau of `town_scene`


def timed(task: Callable[[], Any], synchronize: Callable[[], None], repeats: int) -> Row:
    """Median wall and CPU seconds of a task that has run once before."""
    task()
    synchronize()
    walls, cpus = [], []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        task()
        synchronize()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return {"wall_s": median(walls), "cpu_s": median(cpus)}


def smooth_scene(faces: int, pixels: tuple[int, int], rays: float) -> Any:
    """The town with fields that vary over some 10 m, as merging supposes; polarizations in the facet's own basis, since
    the peer does not turn them."""
    scene = town_scene(faces, pixels, rays, layout="vertex")
    x, y = np.asarray(scene.mesh.vertices)[:, :2].T
    for phase, key in enumerate(KEYS):
        scene.mesh.vertex_scalars[key] = MATERIAL[key] * (1.0 + 0.2 * np.sin(x / 9.0 + phase) * np.cos(y / 11.0))
    return replace(scene, radar=scene.radar.model_copy(update={"polarization_basis": "local"}))


def ours(scene: Any, device: Any, repeats: int) -> tuple[dict[str, Row], dict[str, Any]]:
    """warpsar's timings, and what Mitsuba needs to do the same."""
    import warp as wp

    from warpsar.render.render import ViewRender
    from warpsar.simulation.rays import hit_grid, view_seed
    from warpsar.surface.stage import Stage
    from warpsar.trace.trace import trace
    from warpsar.world.world import geometry_of

    def synchronize() -> None:
        wp.synchronize_device(device)

    view, grid, density = scene.views[0], hit_grid(scene), scene.sampling.density_per_m2(scene.grid)
    geometry, seed = geometry_of(scene, view), view_seed(scene.sampling.seed, 0)
    kept: dict[str, Any] = {}

    def build() -> None:
        kept["stage"] = Stage.of(scene, device)
        kept["bvh"] = kept["stage"].target.bvh  # which no ray may ask for

    def traced(**options: Any) -> Any:
        kept["hits"] = None
        kept["hits"] = trace(kept["stage"].target, geometry, grid, density, seed=seed, **options)
        return kept["hits"]

    def render(hits: Any) -> ViewRender:
        return ViewRender(kept["stage"], view, hits, scene.grid.shape, scene.radar.polarizations, [])

    def fresh() -> None:
        kept["render"] = render(traced())
        kept["render"].program.forward()

    rows = {
        "build": timed(build, synchronize, min(repeats, 3)),
        "trace": timed(traced, synchronize, repeats),
        "fresh image": timed(fresh, synchronize, repeats),
        "image of kept hits": timed(kept["render"].program.forward, synchronize, repeats),
    }
    image = next(iter(render(traced(deposit="nearest")).forward().values()))
    rows["iteration"], fitted = iteration(scene, kept["stage"], image, device, repeats)
    return rows, {"image": image, **fitted, **rays_of(scene, kept["stage"], device, geometry, grid, density, seed)}


def gradient_task(problem: Any, device: Any) -> Callable[[], Any]:
    """Image, loss and gradient of a problem: on CUDA as one captured graph."""
    import warp as wp

    if not device.is_cuda:
        return partial(problem.gradient, problem.x0)
    problem.run_on_device()  # loads what a capture cannot
    with wp.ScopedCapture(device) as capture:
        problem.run_on_device()
    return partial(wp.capture_launch, capture.graph)


def iteration(scene: Any, stage: Any, image: np.ndarray, device: Any, repeats: int) -> tuple[Row, dict[str, Any]]:
    """Time of image, loss and gradient; the speckled image that is fitted, its gradient, and the merged hits."""
    import warp as wp

    from warpsar.learning.problem import FitProblem
    from warpsar.simulation.rays import Rays

    # nearest bins, as Mitsuba's: gradients can be held against one another
    sampling = scene.sampling.model_copy(update={"deposit": "nearest"})
    fitted = replace(measuring(scene, [image]), sampling=sampling)
    problem = FitProblem(fitted, device, loss="mse", rays=Rays(stage, seed=scene.sampling.seed))
    _, gradient = problem.gradient(problem.x0)
    synchronize = partial(wp.synchronize_device, device)
    row = timed(gradient_task(problem, device), synchronize, 10 * repeats if device.is_cuda else repeats)
    seen = np.zeros(image.size, np.float32)
    seen[problem.observations[0].pixels] = 1.0
    hits = problem.views[0].render.hits
    names = ("face", "pixel", "barycentric", "weight", "cos_incidence")
    return row, {
        "measured": fitted.measured(fitted.views[0], "HH").ravel(),
        "seen": seen,
        "gradient": gradient,
        "merged": {name: getattr(hits, name).numpy() for name in names},
    }


def rays_of(scene: Any, stage: Any, device: Any, geometry: Any, grid: Any, density: float, seed: int) -> dict[str, Any]:
    """The rays that were traced, as Mitsuba needs them."""
    import warp as wp

    from warpsar.kernels.raster import sample_kernel
    from warpsar.trace.rays import ray_grid

    rays = ray_grid(stage.target, geometry, grid, density, scene.grid.pixel_area_m2)
    cells = rays.end_cell - rays.first_cell
    samples: Any = wp.empty(cells * rays.elevation_cells, dtype=wp.vec2, device=device)
    wp.launch(sample_kernel, cells, inputs=[rays, rays.first_cell, seed], outputs=[samples], device=device)
    return {
        "samples": samples.numpy(),
        "axes": (geometry.d, geometry.u, geometry.v),
        "wavenumber": geometry.wavenumber,
        "standoff": rays.standoff,
        "cell_m2": rays.azimuth_step * rays.elevation_step,
        "start_m": grid.start_m,
    }


# One long function: Mitsuba's types exist once a variant is chosen, and all that is timed shares its arrays.
def theirs(scene: Any, variant: str, given: dict[str, Any], repeats: int) -> tuple[dict[str, Row], dict[str, Any]]:
    """Mitsuba's timings, and how near its image and gradient are."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant(variant)
    Float, UInt32 = mi.Float, mi.UInt32  # noqa: N806 - types of the variant
    corners = (np.asarray(scene.mesh.vertices) - np.asarray(scene.reference_point_m)).astype(np.float32)
    faces = np.ascontiguousarray(scene.mesh.faces, np.uint32)
    kept: dict[str, Any] = {}

    def build() -> None:
        mesh = mi.Mesh("town", len(corners), len(faces))
        parameters = mi.traverse(mesh)
        parameters["vertex_positions"], parameters["faces"] = corners.ravel(), faces.ravel()
        parameters.update()
        kept["scene"] = mi.load_dict({"type": "scene", "town": mesh})

    d, u, v = given["axes"]
    samples = given["samples"].astype(np.float64)
    origins = (samples[:, :1] * u + samples[:, 1:] * v - given["standoff"] * d).astype(np.float32)
    origin, direction = mi.Point3f(origins.T), mi.Vector3f(*(float(x) for x in d))
    (rows, cols), (down, across) = scene.grid.shape, scene.grid.spacing_m
    column = UInt32(((samples[:, 0] - given["start_m"][1]) / across).astype(np.uint32))
    offset = -given["standoff"] - given["start_m"][0]
    point, index = Float(corners.ravel()), UInt32(faces.ravel())
    values = [np.log(scene.mesh.vertex_scalars[key] - (key == "eps_r")).astype(np.float32) for key in KEYS]
    zeta = [Float(value) for value in values]
    k, tau = given["wavenumber"], FRACTION
    dr.eval(origin, column, point, index, zeta)

    def nodes_at(face: Any, b1: Any, b2: Any, active: Any) -> tuple[list[Any], list[Any]]:
        at = [dr.gather(UInt32, index, 3 * face + i, active) for i in range(3)]
        weights = (1 - b1 - b2, b1, b2)
        return at, [sum(dr.gather(Float, z, i, active) * w for i, w in zip(at, weights, strict=True)) for z in zeta]

    def sigma0(z: list[Any], cosine: Any) -> Any:
        """HH in the facet's own basis: first-order small perturbation and geometric optics (docs/physics.md)."""
        h, length, eps = dr.exp(z[0]), dr.exp(z[1]), 1 + dr.exp(z[2])
        cos2 = cosine * cosine
        sin2 = 1 - cos2
        root = dr.sqrt(eps - sin2)
        amplitude = (cosine - root) / (cosine + root)
        kh, kl = k * h, k * length
        diffuse = 4 * kh * kh * kl * kl * cos2 * cos2 * amplitude * amplitude * dr.exp(-kl * kl * sin2)
        smooth = dr.sqrt(eps)
        normal = (1 - smooth) / (1 + smooth)
        slopes = 2 * h * h / (length * length)
        specular = normal * normal / (cos2 * cos2 * 2 * slopes) * dr.exp(-(sin2 / cos2) / (2 * slopes))
        return (1 - tau) * diffuse + tau * specular

    def trace() -> None:
        found = kept["scene"].ray_intersect_preliminary(mi.Ray3f(origin, direction), coherent=True)
        dr.eval(found.t, found.prim_index, found.prim_uv)
        kept["found"] = found

    def image_of(found: Any) -> Any:
        active = found.is_valid()
        b1, b2 = found.prim_uv.x, found.prim_uv.y
        at, z = nodes_at(found.prim_index, b1, b2, active)
        a, b, c = (mi.Point3f(*(dr.gather(Float, point, 3 * i + axis, active) for axis in range(3))) for i in at)
        cosine = dr.abs(dr.dot(dr.normalize(dr.cross(b - a, c - a)), direction))
        row = dr.floor((found.t + offset) / down)
        active &= (row >= 0) & (row < rows) & (cosine > 1e-6)
        weight = given["cell_m2"] / (cosine * scene.grid.pixel_area_m2)
        image = dr.zeros(Float, rows * cols)
        dr.scatter_reduce(dr.ReduceOp.Add, image, sigma0(z, cosine) * weight, UInt32(row) * cols + column, active)
        return image

    merged = given["merged"]
    m_face, m_pixel = UInt32(merged["face"].astype(np.uint32)), UInt32(merged["pixel"].astype(np.uint32))
    m_b1, m_b2 = Float(merged["barycentric"][:, 0].copy()), Float(merged["barycentric"][:, 1].copy())
    m_weight, m_cosine = Float(merged["weight"]), Float(merged["cos_incidence"])
    dr.eval(m_face, m_pixel, m_b1, m_b2, m_weight, m_cosine)

    def image_of_merged() -> Any:
        _, z = nodes_at(m_face, m_b1, m_b2, True)
        image = dr.zeros(Float, rows * cols)
        dr.scatter_reduce(dr.ReduceOp.Add, image, sigma0(z, m_cosine) * m_weight, m_pixel)
        return image

    measured, seen = Float(given["measured"]), Float(given["seen"])

    def iterate(image: Callable[[], Any]) -> None:
        for z in zeta:
            dr.enable_grad(z)
        difference = image() - measured
        dr.backward(dr.sum(seen * difference * difference))
        kept["gradient"] = [dr.grad(z) for z in zeta]
        dr.eval(kept["gradient"])
        for z in zeta:
            dr.disable_grad(z)

    def fresh() -> None:
        trace()
        dr.eval(image_of(kept["found"]))

    def whole() -> None:
        found = kept["scene"].ray_intersect_preliminary(mi.Ray3f(origin, direction), coherent=True)
        iterate(lambda: image_of(found))

    found_rows = {
        "build": timed(build, dr.sync_thread, min(repeats, 3)),
        "trace": timed(trace, dr.sync_thread, repeats),
        "fresh image": timed(fresh, dr.sync_thread, repeats),
        "image of kept hits": timed(lambda: dr.eval(image_of(kept["found"])), dr.sync_thread, repeats),
        "iteration, tracing": timed(whole, dr.sync_thread, repeats),
        "iteration": timed(lambda: iterate(lambda: image_of(kept["found"])), dr.sync_thread, repeats),
    }
    gradient = np.concatenate(
        [kept["gradient"][i].numpy().astype(float) for i in (2, 0, 1)]
    )  # warpsar's order: eps_r, h, l
    image = image_of(kept["found"]).numpy().reshape(given["image"].shape)
    found_rows["image of merged hits"] = timed(lambda: dr.eval(image_of_merged()), dr.sync_thread, repeats)
    found_rows["iteration, merged hits"] = timed(lambda: iterate(image_of_merged), dr.sync_thread, repeats)
    agreement = {
        "image_rms_difference": float(np.sqrt(np.mean((image - given["image"]) ** 2) / np.mean(image**2))),
        "gradient_cosine": float(
            gradient @ given["gradient"] / (np.linalg.norm(gradient) * np.linalg.norm(given["gradient"]))
        ),
    }
    return found_rows, {"mitsuba": mi.__version__, "variant": variant, **agreement}


# Rows of the table: what is compared, warpsar's timing, Mitsuba's, and the least ratio of the target.
COMPARED: tuple[tuple[str, str, str, dict[str, float | None]], ...] = (
    ("BVH built", "build", "build", {}),
    ("rays to (merged) hits", "trace", "trace", {}),
    ("fresh image: trace and shade", "fresh image", "fresh image", {"cpu": 1.0}),
    ("warpsar's fresh image, Mitsuba's trace alone", "fresh image", "trace", {"cuda": 1.0}),
    ("image of kept hits", "image of kept hits", "image of kept hits", {}),
    ("the same, Mitsuba on merged hits", "image of kept hits", "image of merged hits", {}),
    ("iteration: image, loss, gradient", "iteration", "iteration", {"cpu": 10.0, "cuda": 50.0}),
    ("the same, Mitsuba tracing anew", "iteration", "iteration, tracing", {}),
    ("the same, Mitsuba on merged hits", "iteration", "iteration, merged hits", {}),
)


def compared(kind: str, own: dict[str, Row], other: dict[str, Row]) -> list[dict[str, Any]]:
    return [
        {
            "what": what,
            "warpsar_s": own[mine]["wall_s"],
            "mitsuba_s": other[yours]["wall_s"],
            "ratio": other[yours]["wall_s"] / own[mine]["wall_s"],
            "cpu_ratio": other[yours]["cpu_s"] / max(own[mine]["cpu_s"], 1e-9),
            "target": target.get(kind),
        }
        for what, mine, yours, target in COMPARED
    ]


def table(result: dict[str, Any]) -> str:
    """A column per number of rays: both times, and Mitsuba's over warpsar's; on the CPU also that of CPU seconds."""
    sizes, cuda = result["sizes"], result["device"].startswith("cuda")
    rows: list[list[str]] = []
    for index, (what, *_) in enumerate(COMPARED):
        cells = []
        for size in sizes:
            one = size["compared"][index]
            ratios = f"{one['ratio']:.3g}" + ("" if cuda else f"; {one['cpu_ratio']:.3g}")
            cells.append(f"{1e3 * one['warpsar_s']:.3g} / {1e3 * one['mitsuba_s']:.3g} ({ratios})")
        target = sizes[0]["compared"][index]["target"]
        rows.append([what, *cells, "" if target is None else f"{target:g}"])
    about = (
        ("merged hits", "merged_hits", ","),
        ("images differ, of the rms", "image_rms_difference", ".1e"),
        ("cosine of the gradients", "gradient_cosine", ".6f"),
    )
    rows += [[what, *(format(size[key], form) for size in sizes), ""] for what, key, form in about]
    kinds = "ratio" if cuda else "ratio; ratio of CPU seconds"
    header = [f"ms: warpsar / Mitsuba ({kinds})", *(f"{size['rays']:,} rays" for size in sizes), "target"]
    first = sizes[0]
    of = f"{first['faces']:,} faces, {' x '.join(map(str, first['pixels']))} pixels, {first['parameters']:,} parameters"
    return f"{said(result)}, Mitsuba {first['mitsuba']}; {of}.\n\n{tables.markdown(header, rows)}"


def measure(device_name: str, faces: int, pixels: tuple[int, int], rays: float, repeats: int) -> dict[str, Any]:
    """Both programs in this process, one after the other."""
    import warp as wp

    device = devices.resolve_device(device_name)
    scene = smooth_scene(faces, pixels, rays)
    own, given = ours(scene, device, repeats)
    found: dict[str, Any] = {
        "faces": len(scene.mesh.faces),
        "vertices": len(scene.mesh.vertices),
        "pixels": list(pixels),
        "rays_per_pixel": rays,
        "rays": len(given["samples"]),
        "merged_hits": len(given["merged"]["face"]),
        "parameters": 3 * len(scene.mesh.vertices),
        "peak_host_gib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
    }
    if device.is_cuda and wp.is_mempool_enabled(device):
        found["peak_device_gib"] = wp.get_mempool_used_mem_high(device) / 2**30
    other, about = theirs(scene, "cuda_ad_mono" if device.is_cuda else "llvm_ad_mono", given, repeats)
    return found | about | {"warpsar": own, "peer": other, "compared": compared(device_name, own, other)}


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Each number of rays in a process of its own."""
    result: dict[str, Any] = {**machine(options.device), "sizes": []}
    for rays in options.rays_per_pixel:
        command = [sys.executable, __file__, "--one", "--device", options.device, "--faces", str(options.faces)]
        command += ["--pixels", *map(str, options.pixels), "--rays-per-pixel", str(rays)]
        command += ["--repeats", str(options.repeats)]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        result["sizes"].append(json.loads(done.stdout.splitlines()[-1]))
        tables.save(options.out, result)  # after every size: a later one may not end
    return result


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--faces", type=int, default=900_482)
    parser.add_argument("--pixels", type=int, nargs=2, default=(423, 380), metavar=("ROWS", "COLS"))
    parser.add_argument("--rays-per-pixel", type=float, nargs="+", default=[4.0])
    parser.add_argument("--repeats", type=int, default=7, help="runs of which the median counts")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)  # measured in this process
    options = parser.parse_args()
    if options.source is None and importlib.util.find_spec("mitsuba") is None:
        parser.error("the peer is not installed: pip install mitsuba (and, for --device cpu, LLVM: Debian's libllvm15)")
    if options.one:
        rays = options.rays_per_pixel[0]
        print(json.dumps(measure(options.device, options.faces, tuple(options.pixels), rays, options.repeats)))
        return
    result = tables.stored(options.source) if options.source else run(options)
    tables.publish({f"peer.{result['device'].split(':')[0]}": table(result)}, result, options.write)


if __name__ == "__main__":
    main()
