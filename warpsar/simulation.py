"""Scene -> images: the forward model from end to end, and the files of `warpsar simulate`."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar import runtime
from warpsar.effects import declared
from warpsar.frame import geometry_of
from warpsar.outputs import write_json
from warpsar.trace import DEFAULT_MEMORY_GIB, BinGrid, Hits, ray_count, trace

if TYPE_CHECKING:
    from warpsar.render import DeclaredEffect, Stage, ViewRender
    from warpsar.scene import Scene, View


@dataclass
class SimulatedView:
    """One view's images.

    `beta0[pol]`: linear power, dimensionless, shape (rows, cols), float32, rows along slant range. `range_m` and
    `azimuth_m`: pixel centres about the reference point [m]. `sampling_variance[pol]`: variance of beta0 that the
    jitter of the rays leaves (two seeds). `layers`: see `warpsar.layers.layers`,
    and by name the shares of beta0 that effects tell apart (`beta0_2_bounces_HH`), before the image stage.
    """

    name: str
    beta0: dict[str, np.ndarray]
    range_m: np.ndarray
    azimuth_m: np.ndarray
    rays: int
    hits: int
    sampling_variance: dict[str, np.ndarray] = field(default_factory=dict)
    layers: dict[str, np.ndarray] = field(default_factory=dict)


def view_seed(scene_seed: int, index: int) -> int:
    """Seed of view `index`: views do not share their jitter. Fits a signed 32-bit integer."""
    return (scene_seed * 7919 + index * 104729 + 1) % (2**31 - 1)


def trace_view(
    scene: Scene,
    stage: Stage,
    view: View,
    *,
    seed: int,
    effects: list[DeclaredEffect],
    rays_per_m2: float | None = None,
    merge: bool = True,
    **options: Any,
) -> Hits:
    """Hits of one view, with the scene's sampling unless `rays_per_m2` is given, binned as its effects ask."""
    grid = effects_grid(scene, effects)
    return trace(
        stage.target,
        geometry_of(scene, view),
        grid,
        rays_per_m2 or scene.sampling.density_per_m2(scene.grid),
        seed=seed,
        deposit=scene.sampling.deposit,
        merge=merge,
        pixel_area_m2=scene.grid.pixel_area_m2,
        **options,
    )


def hit_grid(scene: Scene, bins_per_pixel: int = 1, margin_m: float = 0.0) -> BinGrid:
    """Bins of the hits: the image's pixels, or `bins_per_pixel` of them per axis, and whole pixels of margin."""
    shape = [
        (n + 2 * math.ceil(margin_m / step)) * bins_per_pixel
        for n, step in zip(scene.grid.shape, scene.grid.spacing_m, strict=True)
    ]
    spacing = [step / bins_per_pixel for step in scene.grid.spacing_m]
    return BinGrid((shape[0], shape[1]), (spacing[0], spacing[1]), bins_per_pixel)


def effects_grid(scene: Scene, effects: list[DeclaredEffect]) -> BinGrid:
    """Bins as fine and as wide as the effects ask."""
    fine = max((e.effect.bins_per_pixel for e in effects), default=1)
    margin = max((e.effect.margin_m(scene.grid, e.values) for e in effects), default=0.0)
    return hit_grid(scene, fine, margin)


class Rays:
    """One set of rays through a scene: hits of its views, traced when first asked for, and kept.

    Models that differ in materials and effects alone share them, so that they are compared on the same rays.
    """

    def __init__(self, stage: Stage, rays_per_m2: float | None = None, seed: int = 0) -> None:
        self.stage, self.rays_per_m2, self.seed = stage, rays_per_m2, seed
        self._kept: dict[tuple[str, BinGrid], Hits] = {}

    def hits(self, scene: Scene, view: View, effects: list[DeclaredEffect]) -> Hits:
        key = (view.name, effects_grid(scene, effects))
        if key not in self._kept:
            index = [v.name for v in scene.views].index(view.name)
            self._kept[key] = trace_view(
                scene,
                self.stage,
                view,
                seed=view_seed(self.seed, index),
                effects=effects,
                rays_per_m2=self.rays_per_m2,
            )
        return self._kept[key]


def simulate(
    scene: Scene,
    *,
    device: str | None = None,
    seed: int | None = None,
    layers: bool = False,
    variance: bool = False,
    merge: bool = True,
    max_memory_gib: float = DEFAULT_MEMORY_GIB,
) -> list[SimulatedView]:
    """Images of every view of the scene, with its declared materials and effects.

    `seed` overrides the scene's; `merge` false keeps every ray's hit. Raises DeviceError for a device that is
    not there.
    """
    from warpsar.render import Stage

    stage = Stage.of(scene, runtime.resolve_device(device))
    seed = scene.sampling.seed if seed is None else seed
    grid = hit_grid(scene)
    density = scene.sampling.density_per_m2(scene.grid)
    total = sum(ray_count(stage.target, geometry_of(scene, view), grid, density) for view in scene.views)
    bar = runtime.progress(total * (2 if variance else 1), "rays", "ray")
    axes = [
        start + (np.arange(n) + 0.5) * step
        for start, n, step in zip(grid.start_m, grid.shape, grid.spacing_m, strict=True)
    ]
    found = []
    for index, view in enumerate(scene.views):

        def images(with_seed: int, view: View = view) -> tuple[Hits, dict[str, np.ndarray], dict[str, np.ndarray]]:
            hits = trace_view(
                scene,
                stage,
                view,
                seed=with_seed,
                effects=declared(scene, view),
                merge=merge,
                max_memory_gib=max_memory_gib,
                progress=bar,
            )
            render = view_render(scene, stage, view, hits)
            beta0 = render.forward()
            return hits, beta0, {name: a.numpy().reshape(render.shape) for name, a in render.layers.items()}

        hits, beta0, shares = images(view_seed(seed, index))
        one = SimulatedView(view.name, beta0, axes[0], axes[1], hits.rays, hits.count)
        if variance:
            # half the squared difference of two independent images is each one's variance
            _, other, _ = images(view_seed(seed + 1, index + len(scene.views)))
            one.sampling_variance = {p: ((beta0[p] - other[p]) ** 2 / 2).astype(np.float32) for p in beta0}
        if layers:
            from warpsar.layers import layers as layers_of

            if hits.grid != grid:  # binned for an effect
                hits = trace_view(
                    scene, stage, view, seed=view_seed(seed, index), effects=[], max_memory_gib=max_memory_gib
                )
            one.layers = layers_of(stage.target, scene.mesh, hits, density) | shares
        found.append(one)
    bar.close()
    return found


def view_render(scene: Scene, stage: Stage, view: View, hits: Hits) -> ViewRender:
    """One traced view with the scene's declared effects, ready to run."""
    from warpsar.render import ViewRender

    return ViewRender(stage, view, hits, scene.grid.shape, scene.radar.polarizations, declared(scene, view))


def render_view(scene: Scene, stage: Stage, view: View, hits: Hits) -> dict[str, np.ndarray]:
    """beta0 by polarization of one traced view, with the scene's declared effects."""
    return view_render(scene, stage, view, hits).forward()


def run(
    scene_path: Path | str,
    out: Path | str,
    *,
    device: str | None = None,
    seed: int | None = None,
    layers: bool = False,
    variance: bool = False,
    per_ray: bool = False,
    max_memory_gib: float | None = None,
) -> dict[str, Any]:
    """`warpsar simulate`: images (EXR), quick looks (PNG) and simulate.json in `out`. Returns the JSON's content."""
    from warpsar.images import quick_look, write_exr
    from warpsar.scene import Scene

    started = time.perf_counter()
    scene = Scene.load(scene_path)
    out = Path(out)
    where = runtime.resolve_device(device)
    out.mkdir(parents=True, exist_ok=True)  # refused now rather than after the work
    runtime.say_device(where)
    for warning in scene.warnings:
        runtime.say(f"warning: {warning}")
    views = simulate(
        scene,
        device=where.alias,
        seed=seed,
        layers=layers,
        variance=variance,
        merge=not per_ray,
        max_memory_gib=max_memory_gib or DEFAULT_MEMORY_GIB,
    )
    summary = []
    for view in views:
        files = {"image": f"{view.name}.exr", "quick_look": f"{view.name}.png"}
        write_exr(out / files["image"], view.beta0)
        first = next(iter(view.beta0.values()))
        quick_look(out / files["quick_look"], first)
        extra = dict(view.layers)
        extra |= {f"sampling_variance_{p}": v for p, v in view.sampling_variance.items()}
        if extra:
            files["layers"] = f"{view.name}_layers.exr"
            write_exr(out / files["layers"], extra)
        lit = first > 0
        summary.append(
            {
                "name": view.name,
                "files": files,
                "rays": view.rays,
                "hits": view.hits,
                "lit_fraction": float(lit.mean()),
                "mean_beta0": {p: float(image.mean(dtype=float)) for p, image in view.beta0.items()},
            }
        )
    return write_json(
        out / "simulate.json",
        scene,
        where,
        scene.sampling.seed if seed is None else seed,
        started,
        {
            "rays_per_m2": scene.sampling.density_per_m2(scene.grid),
            "materials": list(scene.mesh.materials),
            "views": summary,
        },
    )
