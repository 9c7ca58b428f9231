"""Nearest faces of a view's rays: Warp's BVH, the raster, and on the CPU Embree where embreex is installed.

    python benchmarks/rays.py --out rays_cpu.json [--write]
    python benchmarks/rays.py --device cuda --out rays_gpu.json

The town of benchmarks/scenes.py, of few and of many faces, under few and many rays, for a plane wave and for a track.
One thread of the CPU and its seconds, or wall times of CUDA; medians. Setting up is apart, since a BVH serves all views
of a mesh and the raster one view.
`differ`: rays whose face is another one than the BVH's (they lie on edges). embreex sends rays one by one; with
packets Embree is what benchmarks/peer.py measures as Mitsuba's trace.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from dataclasses import replace
from typing import Any

from warpsar.runtime import devices

os.environ["WARPSAR_THREADS"] = "1"

import numpy as np
import tables
from peer import timed
from scenes import town_scene
from simulate import machine, said

PIXELS = (423, 380)
SIZES = {  # faces, rays per pixel
    "cpu": ((200, 32.0), (20_000, 32.0), (900_000, 4.0), (900_000, 32.0)),
    "cuda": ((200, 128.0), (20_000, 128.0), (900_000, 0.25), (900_000, 1.0), (900_000, 4.0), (900_000, 128.0)),
}
TRACKS = (None, 8000.0)


def measure(
    device: Any, faces: int, rays_per_pixel: float, slant_range_m: float | None, repeats: int
) -> dict[str, Any]:
    import warp as wp

    from warpsar.kernels.raster import sample_kernel
    from warpsar.simulation.rays import hit_grid
    from warpsar.trace.rays import ray_grid
    from warpsar.trace.target import Target
    from warpsar.trace.trace import ParallelRaster, Raster, nearest_faces
    from warpsar.world.world import geometry_of

    kind, clock = (Raster, "cpu_s") if device.is_cpu else (ParallelRaster, "wall_s")
    scene = town_scene(faces, PIXELS, rays_per_pixel)
    geometry = replace(geometry_of(scene, scene.views[0]), slant_range_m=slant_range_m)
    kept: dict[str, Any] = {}

    def with_bvh() -> Target:
        target = Target.upload(scene.mesh, scene.reference_point_m, device)
        assert target.bvh is not None
        return target

    def run(name: str, task: Any) -> float:
        def keep() -> None:
            kept[name] = task()

        return timed(keep, lambda: wp.synchronize_device(device), repeats)[clock]

    found: dict[str, Any] = {"faces": len(scene.mesh.faces), "slant_range_m": slant_range_m}
    found["bvh_setup_s"] = run("target", with_bvh)
    target = kept["target"]
    grid = hit_grid(scene)
    density = scene.sampling.density_per_m2(scene.grid)
    rays = ray_grid(target, geometry, grid, density, grid.pixel_area_m2)
    first, last = rays.first_cell, rays.end_cell
    found["rays"] = (last - first) * rays.elevation_cells
    width = max(1, (last - first) // rays.cells_per_column // (16 if device.is_cpu else 1)) * rays.cells_per_column
    bands = [(begin, min(begin + width, last)) for begin in range(first, last, width)]
    found["bvh_s"] = run("bvh", lambda: [nearest_faces(target, rays, *band, 0) for band in bands])
    found["raster_setup_s"] = run("raster", lambda: kind(target, rays))
    raster = kept["raster"]
    found["raster_s"] = run("nearest", lambda: [raster.nearest(*band, 0) for band in bands])
    expected, nearest = (np.concatenate([part.numpy() for part in kept[name]]) for name in ("bvh", "nearest"))
    found["raster_differ"] = int(np.sum(nearest != expected))
    found["chosen"] = "BVH" if kind.where_it_pays(target, rays, first, last) is None else "raster"
    if device.is_cpu and importlib.util.find_spec("embreex") and slant_range_m is None:
        samples: Any = wp.empty(found["rays"], dtype=wp.vec2, device=device)
        wp.launch(sample_kernel, last - first, inputs=[rays, first, 0], outputs=[samples], device=device)
        at = samples.numpy().astype(float)
        origins = (at[:, :1] * geometry.u + at[:, 1:] * geometry.v - rays.standoff * geometry.d).astype(np.float32)
        directions = np.broadcast_to(geometry.d.astype(np.float32), origins.shape).copy()
        found["embreex_setup_s"] = run("embree", lambda: embree(target.vertices.numpy(), target.faces.numpy()))
        found["embreex_s"] = run("embreex", lambda: kept["embree"].run(origins, directions))
        found["embreex_differ"] = int(np.sum(kept["embreex"] != expected))
    return found


def embree(vertices: np.ndarray, faces: np.ndarray) -> Any:
    """Embree's scene of a mesh, built."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, vertices, faces)
    scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))
    return scene


def table(result: dict[str, Any]) -> str:
    names = ("bvh", "raster", "embreex")
    rows = []
    for row in result["sizes"]:
        rates = [f"{row['rays'] / row[f'{n}_s'] / 1e6:.1f}" if f"{n}_s" in row else "" for n in names]
        setups = [f"{row[f'{n}_setup_s']:.2g}" if f"{n}_setup_s" in row else "" for n in names]
        wave = "plane" if row["slant_range_m"] is None else f"{row['slant_range_m'] / 1000:g} km"
        faces, rays = f"{row['faces']:,}", f"{row['rays']:,}"
        rows.append([faces, rays, wave, *rates, *setups, row["raster_differ"], row["chosen"]])
    header = ["faces", "rays", "wave", "Mrays per s: BVH", "raster", "embreex"]
    header += ["setup, s: BVH", "raster", "embreex", "differ", "chosen"]
    return f"{said(result)}.\n\n{tables.markdown(header, rows)}"


def measure_all(device_name: str, repeats: int) -> dict[str, Any]:

    result: dict[str, Any] = {**machine(device_name), "sizes": []}
    device = devices.resolve_device(device_name)
    for slant_range_m in TRACKS:
        for faces, rays in SIZES[device_name]:
            print(f"{faces} faces, {rays:g} rays per pixel", file=sys.stderr)
            result["sizes"].append(measure(device, faces, rays, slant_range_m, repeats))
    return result


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device", choices=sorted(SIZES), default="cpu")
    parser.add_argument("--repeats", type=int, default=3, help="runs of which the median counts")
    options = parser.parse_args()
    result = tables.result_of(options, lambda: measure_all(options.device, options.repeats))
    tables.publish({f"rays.{result['device'].split(':')[0]}": table(result)}, result, options.write)


if __name__ == "__main__":
    main()
