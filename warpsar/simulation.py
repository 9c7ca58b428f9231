"""Scene -> images: the forward model from end to end, and the files of `warpsar simulate`."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar import distributed, runtime
from warpsar.effects import declared
from warpsar.frame import geometry_of
from warpsar.memory import PARTS, OutOfMemoryError, in_parts, ran_out
from warpsar.outputs import write_json
from warpsar.trace import DEFAULT_MEMORY_GIB, BinGrid, Hits, ray_count, trace

if TYPE_CHECKING:
    from warpsar.render import DeclaredEffect, Stage, ViewRender
    from warpsar.scene import Scene, View


SAMPLED = 16  # columns of an image by which its hits are estimated


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
    max_memory_gib: float = DEFAULT_MEMORY_GIB,
    **options: Any,
) -> Hits:
    """Hits of one view, with the scene's sampling unless `rays_per_m2` is given, binned as its effects ask."""
    geometry, grid = geometry_of(scene, view), effects_grid(scene, effects)

    def traced(parts: int) -> Hits:
        return trace(
            stage.target,
            geometry,
            grid,
            rays_per_m2 or scene.sampling.density_per_m2(scene.grid),
            seed=seed,
            deposit=scene.sampling.deposit,
            merge=merge,
            pixel_area_m2=scene.grid.pixel_area_m2,
            max_memory_gib=max_memory_gib / parts,
            **options,
        )

    return in_parts(traced, f"view {view.name}")


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
            self._kept[key] = self.trace(scene, view, effects)
        return self._kept[key]

    def trace(
        self,
        scene: Scene,
        view: View,
        effects: list[DeclaredEffect],
        only_columns: tuple[int, int] | None = None,
        max_memory_gib: float = DEFAULT_MEMORY_GIB,
    ) -> Hits:
        """Hits of a view, or of a band of its columns, that are not kept here."""
        return trace_view(
            scene,
            self.stage,
            view,
            seed=view_seed(self.seed, [v.name for v in scene.views].index(view.name)),
            effects=effects,
            rays_per_m2=self.rays_per_m2,
            only_columns=only_columns,
            max_memory_gib=max_memory_gib,
        )

    def forget(self, view: View) -> None:
        """Let go of a view's hits."""
        for key in [key for key in self._kept if key[0] == view.name]:
            del self._kept[key]

    def most_hits(self, scene: Scene, view: View, effects: list[DeclaredEffect]) -> int:
        """More merged hits than a view will have: two of every ray."""
        grid, geometry = effects_grid(scene, effects), geometry_of(scene, view)
        density = self.rays_per_m2 or scene.sampling.density_per_m2(scene.grid)
        return 2 * ray_count(self.stage.target, geometry, grid, density)

    def expected_hits(self, scene: Scene, view: View, effects: list[DeclaredEffect]) -> int:
        """How many merged hits a view will have, from every `cols // SAMPLED`-th column of its grid."""
        columns = effects_grid(scene, effects).shape[1]
        stride = max(1, columns // SAMPLED)
        sample = range(stride // 2, columns, stride)
        found = sum(self.trace(scene, view, effects, (column, column + 1)).count for column in sample)
        return round(found * columns / len(sample))


class Simulation:
    """Images of a scene's views, with its declared materials and effects, one at a time.

    `seed` overrides the scene's; `merge` false keeps every ray's hit; `bar` counts rays.
    """

    def __init__(
        self,
        scene: Scene,
        stage: Stage,
        *,
        seed: int | None = None,
        layers: bool = False,
        variance: bool = False,
        merge: bool = True,
        max_memory_gib: float = DEFAULT_MEMORY_GIB,
        bar: Any = None,
    ) -> None:
        self.scene, self.stage, self.bar = scene, stage, bar
        self.seed = scene.sampling.seed if seed is None else seed
        self.layers, self.variance, self.merge, self.max_memory_gib = layers, variance, merge, max_memory_gib
        self.grid, self.density = hit_grid(scene), scene.sampling.density_per_m2(scene.grid)

    def rays(self, view: View) -> int:
        """Rays that the view will cost."""
        return ray_count(self.stage.target, geometry_of(self.scene, view), self.grid, self.density) * (
            1 + self.variance
        )

    def view(self, view: View, index: int) -> SimulatedView:
        """The images of `view`, with the jitter of the scene's view number `index`.

        Raises OutOfMemoryError where the device cannot hold the hits of 1/256 of it.
        """
        scene, stage, grid = self.scene, self.stage, self.grid
        hits, count, beta0, shares = self._images(view, view_seed(self.seed, index))
        axes = [
            start + (np.arange(n) + 0.5) * step
            for start, n, step in zip(grid.start_m, grid.shape, grid.spacing_m, strict=True)
        ]
        rays = self.rays(view) // (1 + self.variance) if hits is None else hits.rays
        one = SimulatedView(view.name, beta0, axes[0], axes[1], rays, count)
        if self.variance:
            # half the squared difference of two independent images is each one's variance
            other = self._images(view, view_seed(self.seed + 1, index + len(scene.views)))[2]
            one.sampling_variance = {p: ((beta0[p] - other[p]) ** 2 / 2).astype(np.float32) for p in beta0}
        if self.layers:
            from warpsar.layers import layers as layers_of

            if hits is None or hits.grid != grid:  # binned for an effect
                hits = self._trace(view, view_seed(self.seed, index), [])
            one.layers = layers_of(stage.target, scene.mesh, hits, self.density) | shares
        return one

    def _trace(self, view: View, seed: int, effects: list[DeclaredEffect], **more: Any) -> Hits:
        gib = self.max_memory_gib
        return trace_view(self.scene, self.stage, view, seed=seed, effects=effects, max_memory_gib=gib, **more)

    def _images(self, view: View, seed: int) -> tuple[Hits | None, int, dict[str, np.ndarray], dict[str, np.ndarray]]:
        """Hits, where they fit into memory, and their number; images; shares of them that effects tell apart."""
        effects = declared(self.scene, view)
        try:
            hits = self._trace(view, seed, effects, merge=self.merge, progress=self.bar)
            render = view_render(self.scene, self.stage, view, hits)
            beta0 = render.forward()
            return hits, hits.count, beta0, {n: a.numpy().reshape(render.shape) for n, a in render.layers.items()}
        except (MemoryError, RuntimeError, OutOfMemoryError) as error:
            if not ran_out(error):
                raise
        count, beta0 = in_parts(partial(self._in_bands, view, seed, effects), f"view {view.name}", PARTS[1:])
        return None, count, beta0, {}

    def _in_bands(
        self, view: View, seed: int, effects: list[DeclaredEffect], bands: int
    ) -> tuple[int, dict[str, np.ndarray]]:
        """Number of hits, and images, with the hits of one band at a time in memory."""
        from warpsar.bands import BandedRender, stretches

        count = 0

        def traced(only_columns: tuple[int, int]) -> Hits:
            nonlocal count
            hits = self._trace(view, seed, effects, merge=self.merge, only_columns=only_columns)
            count += hits.count
            return hits

        columns = stretches(effects_grid(self.scene, effects), bands)
        polarizations = self.scene.radar.polarizations
        render = BandedRender(self.stage, view, traced, columns, self.scene.grid.shape, polarizations, effects)
        beta0 = render.forward()
        return count, beta0


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
    made = Simulation(
        scene, stage, seed=seed, layers=layers, variance=variance, merge=merge, max_memory_gib=max_memory_gib
    )
    made.bar = runtime.progress(sum(map(made.rays, scene.views)), "rays", "ray")
    found = [made.view(view, index) for index, view in enumerate(scene.views)]
    made.bar.close()
    return found


def view_render(scene: Scene, stage: Stage, view: View, hits: Hits) -> ViewRender:
    """One traced view with the scene's declared effects, ready to run."""
    from warpsar.render import ViewRender

    return ViewRender(stage, view, hits, scene.grid.shape, scene.radar.polarizations, declared(scene, view))


def render_view(scene: Scene, stage: Stage, view: View, hits: Hits) -> dict[str, np.ndarray]:
    """beta0 by polarization of one traced view, with the scene's declared effects."""
    return view_render(scene, stage, view, hits).forward()


def channels(view: SimulatedView) -> dict[str, np.ndarray]:
    """What was asked for of a view beyond its images, by name: layers, shares and sampling variances."""
    return dict(view.layers) | {f"sampling_variance_{p}": v for p, v in view.sampling_variance.items()}


def _write(out: Path, view: SimulatedView) -> dict[str, Any]:
    """A view's files, and what simulate.json says of it."""
    from warpsar.images import quick_look, write_exr

    files = {"image": f"{view.name}.exr", "quick_look": f"{view.name}.png"}
    write_exr(out / files["image"], view.beta0)
    first = next(iter(view.beta0.values()))
    quick_look(out / files["quick_look"], first)
    extra = channels(view)
    if extra:
        files["layers"] = f"{view.name}_layers.exr"
        write_exr(out / files["layers"], extra)
    return {
        "name": view.name,
        "files": files,
        "rays": view.rays,
        "hits": view.hits,
        "lit_fraction": float((first > 0).mean()),
        "mean_beta0": {p: float(image.mean(dtype=float)) for p, image in view.beta0.items()},
    }


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
    """`warpsar simulate`: images (EXR), quick looks (PNG) and simulate.json in `out`. Returns the JSON's content.

    Several processes (`distributed`) share the views, dealt by their rays.
    """
    from warpsar.render import Stage
    from warpsar.scene import Scene

    started = time.perf_counter()
    scene = Scene.load(scene_path)
    out = Path(out)
    where = runtime.resolve_device(device)
    ranks = distributed.ranks(where)
    out.mkdir(parents=True, exist_ok=True)  # refused now rather than after the work
    runtime.say_device(where)
    for warning in scene.warnings:
        runtime.say(f"warning: {warning}")
    made = Simulation(
        scene,
        Stage.of(scene, where),
        seed=seed,
        layers=layers,
        variance=variance,
        merge=not per_ray,
        max_memory_gib=max_memory_gib or DEFAULT_MEMORY_GIB,
    )
    costs = [made.rays(view) for view in scene.views]
    mine = distributed.deal(costs, ranks.size)[ranks.rank]
    made.bar = runtime.progress(sum(costs[index] for index in mine), "rays", "ray")
    summary = [[index, _write(out, made.view(scene.views[index], index))] for index in mine]
    made.bar.close()
    summary = sorted(each for part in ranks.gather(summary) for each in part)
    content = {
        "rays_per_m2": made.density,
        "materials": list(scene.mesh.materials),
        "processes": ranks.size,
        "views": [entry for _, entry in summary],
    }
    if not ranks.first:
        return content
    return write_json(out / "simulate.json", scene, where, made.seed, started, content)
