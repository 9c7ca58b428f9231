"""Scene -> images: the whole forward model, and the files of `warpsar simulate`."""

from __future__ import annotations

import shlex
import time
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from warpsar.effects.base.effect import DeclaredEffect
from warpsar.effects.registry import declared
from warpsar.errors import refuse_number
from warpsar.io.grey_scale import GreyScale
from warpsar.io.quick_look import draw, draw_blank, shades
from warpsar.render.bands import BandedRender, stretches
from warpsar.render.render import ViewRender
from warpsar.runtime import console, devices, once
from warpsar.runtime.busy import busy
from warpsar.runtime.memory import PARTS, OutOfMemoryError, in_parts, ran_out
from warpsar.scene.scene import Scene, scene_or_file
from warpsar.simulation.checks import Findings, grid_warnings
from warpsar.simulation.estimate import SimulationForecast, estimate
from warpsar.simulation.files import Output, refuse_formats, written
from warpsar.simulation.formats import registry
from warpsar.simulation.ground import MapGround
from warpsar.simulation.outputs import make_folder, refuse_unlikely_size, write_json
from warpsar.simulation.rays import effects_grid, hit_grid, trace_view, view_seed
from warpsar.simulation.speckle import declare as declare_speckled
from warpsar.simulation.speckle import refuse_declaring, responses
from warpsar.simulation.strong_scatterers import StrongScatterers, strongest_of, together
from warpsar.simulation.view import SimulatedView
from warpsar.surface.stage import Stage
from warpsar.trace.hits import DEFAULT_MEMORY_GIB, WHOLE, Hits, Strip
from warpsar.trace.layers import covered
from warpsar.trace.layers import layers as layers_of
from warpsar.trace.rays import ray_count
from warpsar.version import __version__
from warpsar.world.tables import View
from warpsar.world.world import World, geometry_of, refuse_without_views

SHARE_LEFT_OUT, RAYS_LEFT_OUT = 0.25, 16.0
"""Share of the rays by which power beyond the last bounce is found, and how many of a pixel there are at least."""


class Simulation:
    """Images of a scene's views, with its declared materials and effects, one at a time.

    `seed` overrides the scene's; `merge` false keeps every ray's hit; `bar` counts rays. `part`: which
    part of another image the scene's image is. `tells`: whether findings have what only further work finds out.
    `scatterers`: how many of the strongest are listed.
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
        pictures: bool = False,
        bar: Any = None,
        part: Strip = WHOLE,
        tells: bool = True,
        scatterers: int = 0,
    ) -> None:
        self.tells = tells
        self.scene, self.stage, self.bar, self.part = scene, stage, bar, part
        self.seed = scene.seed(seed)
        self.layers, self.variance, self.merge, self.max_memory_gib = layers, variance, merge, max_memory_gib
        self.pictures, self.scatterers = pictures, scatterers
        self.findings = Findings()
        self.grid = replace(hit_grid(scene), strip=self.part)
        self.density = scene.sampling.density_per_m2(scene.grid)

    def rays(self, view: View) -> int:
        """How many rays the view takes."""
        return ray_count(self.stage.target, geometry_of(self.scene, view), self.grid, self.density) * (
            1 + self.variance
        )

    def view(self, view: View, index: int) -> SimulatedView:
        """The images of `view`, with the jitter of the scene's view number `index`.

        Raises OutOfMemoryError where the device cannot hold the hits of 1/256 of it.
        """
        scene, stage, grid = self.scene, self.stage, self.grid
        hits, count, beta0, shares, lit, strongest = self._images(view, view_seed(self.seed, index))
        axes = [
            start + (np.arange(n) + 0.5) * step
            for start, n, step in zip(grid.start_m, grid.shape, grid.spacing_m, strict=True)
        ]
        rays = self.rays(view) // (1 + self.variance) if hits is None else hits.rays
        one = SimulatedView(view.name, beta0, axes[0], axes[1], rays, count, metadata=metadata(scene, view))
        one.lit_fraction, one.scatterers = float(lit.mean()), strongest
        if self.variance:
            # half the squared difference of two independent images is each one's variance
            other = self._images(view, view_seed(self.seed + 1, index + len(scene.views)), again=True)[2]
            one.sampling_variance = {p: ((beta0[p] - other[p]) ** 2 / 2).astype(np.float32) for p in beta0}
        if self.pictures:
            one.covered = covered(stage.target, geometry_of(scene, view), grid)
        if self.layers:
            if hits is None or hits.grid != grid:  # binned for an effect
                hits = self._trace(view, view_seed(self.seed, index), [])
            with busy(f"{view.name}: layers"):
                one.layers = layers_of(stage.target, scene.mesh, hits, self.density) | shares
        return one

    def strip(self, view: View, first: int, columns: int) -> Simulation:
        """The same of some columns of the image of `view`, from `first` on, with the rays that they have in the whole.

        Of the rays that enter beside the image for several bounces, a strip has a part as large as itself.
        """
        grid, step = self.scene.grid, self.scene.grid.spacing_m[1]
        low, high = (ends[1] for ends in self.stage.target.ends(geometry_of(self.scene, view)))
        width = grid.shape[1] * step
        seen = min(high, width) - max(low, -width)  # of twice the image, what has mesh
        part = grid.model_copy(update={"shape": (grid.shape[0], columns)})
        return Simulation(
            replace(self.scene, grid=part),
            self.stage,
            seed=self.seed,
            layers=self.layers,
            variance=self.variance,
            pictures=self.pictures,
            merge=self.merge,
            max_memory_gib=self.max_memory_gib,
            part=Strip(
                azimuth_m=(first + 0.5 * columns - 0.5 * grid.shape[1]) * step,
                beside=float(np.clip(0.5 * (seen / width - 1.0), 0.0, 0.5)),
            ),
        )

    def _trace(self, view: View, seed: int, effects: list[DeclaredEffect], **more: Any) -> Hits:
        more |= {"max_memory_gib": self.max_memory_gib, "strip": self.part}
        return trace_view(self.scene, self.stage, view, seed=seed, effects=effects, **more)

    def _images(
        self, view: View, seed: int, again: bool = False
    ) -> tuple[Hits | None, int, dict[str, np.ndarray], dict[str, np.ndarray], np.ndarray, StrongScatterers | None]:
        """Hits, where they fit into memory, and their number; images; shares of them that effects tell apart; the
        pixels that single-bounce light reaches; the strongest scatterers. `again`: the view's findings are known."""
        effects = declared(self.scene, view)
        try:
            hits = self._trace(view, seed, effects, merge=self.merge, progress=self.bar)
            with busy(f"{view.name}: surfaces and pixels"):
                render = view_render(self.scene, self.stage, view, hits)
                beta0 = render.forward()
            lit = _lit(render, beta0)
            self.findings.add(self.stage, render, beta0, lit)
            if self.tells and not again:
                with busy(f"{view.name}: power beyond the last bounce"):
                    self._tell_more(view, seed, effects, render)
            shares = {n: a.numpy().reshape(render.shape) for n, a in render.layers.items()}
            return hits, hits.count, beta0, shares, lit, None if again else self._strongest([render])
        except (MemoryError, RuntimeError, OutOfMemoryError) as error:
            if not ran_out(error):
                raise
        with busy(f"{view.name}: in bands"):
            banded = partial(self._in_bands, view, seed, effects, again)
            count, beta0, lit, strongest = in_parts(banded, f"view {view.name}", PARTS[1:])
        return None, count, beta0, {}, lit, strongest

    def _strongest(self, renders: Iterable[ViewRender]) -> StrongScatterers | None:
        """Of all the renders, each after a forward run."""
        if not self.scatterers:
            return None
        parts = [strongest_of(one, self.scene.reference_point_m, self.scatterers) for one in renders]
        return together(parts, self.scatterers)

    def _tell_more(self, view: View, seed: int, effects: list[DeclaredEffect], render: ViewRender) -> None:
        """Find doubts about the mesh; and what power rays have that go on after the last bounce, by fewer rays."""
        for at, one in enumerate(effects):
            self.findings.add_remarks(render, one.effect.doubts(render))
            if one.effect.follows_rays and (settings := one.effect.further(render)) is not None:
                wider = [*effects[:at], replace(one, settings={**one.settings, **settings}), *effects[at + 1 :]]
                least = min(self.density, RAYS_LEFT_OUT / self.scene.grid.pixel_area_m2)
                hits = self._trace(view, seed, wider, rays_per_m2=max(SHARE_LEFT_OUT * self.density, least))
                other = ViewRender(self.stage, view, hits, render.shape, self.scene.radar.polarizations, wider)
                other.forward()
                self.findings.add_left_out(render, one.effect.left_out(render, other))

    def _in_bands(
        self, view: View, seed: int, effects: list[DeclaredEffect], again: bool, bands: int
    ) -> tuple[int, dict[str, np.ndarray], np.ndarray, StrongScatterers | None]:
        """Number of hits, images, their lit pixels, and scatterers, with the hits of one band at a time in memory."""
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
        hits = count  # below, the bands are traced once more
        return hits, beta0, _lit(render, beta0), None if again else self._strongest(render.pieces())


def _lit(render: ViewRender | BandedRender, polarizations: Iterable[str]) -> np.ndarray:
    """Pixels that single-bounce light reaches in any of the polarizations, shape (rows, cols), bool."""
    lit: np.ndarray = np.logical_or.reduce([render.lit(name) for name in polarizations])
    return lit


def simulate(
    scene: Scene | PathLike[str] | str,
    *,
    device: str | None = None,
    seed: int | None = None,
    layers: bool = False,
    variance: bool = False,
    merge: bool = True,
    max_memory_gib: float = DEFAULT_MEMORY_GIB,
    scatterers: int = 0,
) -> list[SimulatedView]:
    """Images of every view of the scene, or of a scene file, with its declared materials and effects.

    `seed` overrides the scene's; `merge` false keeps every ray's hit; `scatterers`: how many of the strongest each
    view lists. Raises DeviceError for a device that is not there.
    """
    scene = scene_or_file(scene)
    refuse_without_views(scene)
    refuse_number(max_memory_gib, "max_memory_gib", above=True)
    refuse_number(scatterers, "scatterers", whole=True)
    stage = Stage.of(scene, devices.resolve_device(device))
    made = Simulation(
        scene,
        stage,
        seed=seed,
        layers=layers,
        variance=variance,
        merge=merge,
        max_memory_gib=max_memory_gib,
        scatterers=scatterers,
    )
    console.warn(grid_warnings(scene, stage, scene.views))
    made.bar = console.progress(sum(map(made.rays, scene.views)), "rays", "ray")
    found = [made.view(view, index) for index, view in enumerate(scene.views)]
    made.bar.close()
    console.warn(made.findings.warnings(scene))
    return found


def view_render(scene: Scene, stage: Stage, view: View, hits: Hits) -> ViewRender:
    """One traced view with the scene's declared effects, ready to run."""
    return ViewRender(stage, view, hits, scene.grid.shape, scene.radar.polarizations, declared(scene, view))


def _written_views(made: Simulation, output: Output) -> tuple[list[dict[str, Any]], list[str]]:
    """Make this process's share of the views and write them. Returns the entries of all views, and what to warn of."""
    scene = made.scene
    costs = [made.rays(view) for view in scene.views]
    mine = once.mine(costs)
    if (forecasted := expected(made, output, mine)) is not None:
        console.say(str(forecasted))
    made.bar = console.progress(sum(costs[index] for index in mine), "rays", "ray")
    summary = [(index, output.write(made.view(scene.views[index], index), index)) for index in mine]
    made.bar.close()
    everything = once.gather((summary, made.findings, shades(output.looks_at)))
    entries = sorted(each for part, _, _ in everything for each in part)
    with busy("drawing quick looks"):
        scale = GreyScale.of_counts(np.sum([counts for _, _, counts in everything], axis=0))
        for look in output.looks_at:
            draw(look, scale)
    found = Findings.together([findings for _, findings, _ in everything]).warnings(scene)
    console.warn(found)
    return [entry for _, entry in entries], found


def expected(made: Simulation, output: Output, mine: Sequence[int]) -> SimulationForecast | None:
    """What the images of the scene's views number `mine`, and their files, will take; None where that is not long."""
    if not mine:
        return None
    scene = made.scene
    costs = [made.rays(scene.views[index]) for index in mine]
    index = mine[int(np.argmax(costs))]

    def strip(first: int, columns: int) -> int:
        part = made.strip(scene.views[index], first, columns)
        ground = None if output.ground is None else MapGround.of(part.scene, part.stage)
        with TemporaryDirectory() as folder:
            image = part.view(scene.views[index], index)
            replace(output, out=Path(folder), ground=ground, looks_at=[]).write(image, index)
        return image.hits

    picture = partial(draw_blank, scene.radar.polarizations, scene.grid.shape, scene.grid.spacing_m)
    pictures = len(mine) * (1 if output.looks is None else 2)
    return estimate(costs, scene.grid.shape, len(scene.radar.polarizations), strip, pictures, picture)


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
    looks: float | None = None,
    declare: bool = False,
    formats: Sequence[str] = ("exr",),
    scatterers: int = 0,
    yes: bool = False,
) -> dict[str, Any]:
    """`warpsar simulate`: images (EXR), quick looks (PNG) and simulate.json in `out`. Returns the JSON's content.

    `formats`: of the images, named in `simulation.formats`. `looks` adds images with speckle; `declare` a scene.toml
    that names them as measured. `scatterers`: how many of the strongest are listed for each view. `yes` takes a mesh
    whose size is unlikely. Several processes share the views by the number of their rays.
    """
    started = time.perf_counter()
    refuse_formats(formats)
    with busy("reading the scene"):
        scene = Scene.load(scene_path)
    refuse_without_views(scene)
    refuse_unlikely_size(scene, yes)
    out = Path(out)
    if declare:
        refuse_declaring(scene, out, looks)
    where = devices.resolve_device(device)
    once.join(where)
    make_folder(out)  # refused now rather than after the work
    console.say_device(where)
    with busy("loading the mesh onto the device"):
        stage = Stage.of(scene, where)
    warnings = [*scene.warnings, *grid_warnings(scene, stage, scene.views)]
    console.warn(warnings)
    made = Simulation(
        scene,
        stage,
        seed=seed,
        layers=layers,
        variance=variance,
        pictures=True,
        merge=not per_ray,
        max_memory_gib=max_memory_gib or DEFAULT_MEMORY_GIB,
        scatterers=scatterers,
    )
    formats = tuple(dict.fromkeys(formats))
    on_ground = [one.title for one in map(registry.get, formats) if one.on_ground]
    ground = MapGround.of(scene, stage) if on_ground else None
    if on_ground and ground is None:
        console.say(f"note: [scene] has no origin, so {' and '.join(on_ground)} is in slant range alone")
    output = Output(
        out, made.seed, looks, formats, exr_speckle=declare, responses=responses(scene), ground=ground, mesh=scene.mesh
    )
    entries, found = _written_views(made, output)
    content = {
        "rays_per_m2": made.density,
        "materials": list(scene.mesh.materials),
        "processes": once.processes(),
        "warnings": warnings + found,
        "views": entries,
    }

    def write() -> dict[str, Any]:
        whole = content
        if declare and looks is not None:
            whole = whole | {"scene": declare_speckled(scene, out, looks)}
        whole = write_json(out / "simulate.json", scene, where, made.seed, started, whole)
        console.say(written(out, whole))
        if declare:
            file, folder = (shlex.quote(str(out / name)) for name in ("scene.toml", "evaluated"))
            console.say(
                f"next: warpsar evaluate {file} -o {folder} compares; warpsar learn and diagnose take this file, too"
            )
        return whole

    return once.write(write) or content


# ---- what an image says of itself


def metadata(scene: World, view: View) -> dict[str, Any]:
    """The facts of a view's image, under the same names in EXR, GeoTIFF, NetCDF, Zarr and simulate.json.

    Numbers, texts, and lists of them. `range_axis`, `azimuth_axis` and `elevation_axis` are unit vectors (east, north,
    up); `spacing_m` is (range, azimuth). `slant_range_m` is there for a strip-map alone, else the wave is plane.
    """
    geometry = geometry_of(scene, view)
    facts: dict[str, Any] = {
        "view": view.name,
        "azimuth_deg": view.azimuth_deg,
        "incidence_deg": view.incidence_deg,
        "frequency_hz": view.frequency_hz or scene.radar.frequency_hz,
        "spacing_m": list(scene.grid.spacing_m),
        "reference_point_m": list(scene.reference_point_m),
        "range_axis": geometry.d.tolist(),
        "azimuth_axis": geometry.u.tolist(),
        "elevation_axis": geometry.v.tolist(),
        "axes": "rows: slant range, near range first; columns: azimuth; the reference point is in the middle",
        "quantity": "beta0",
        "units": "1",
        "scale": "linear power",
        "calibration": "beta0: sum of sigma0 dA over the lit surface, divided by the pixel's area in the slant plane",
        "polarizations": list(scene.radar.polarizations),
        "polarization_basis": scene.radar.polarization_basis,
        "software": f"warpsar {__version__}",
    }
    if scene.origin is not None:
        facts |= {f"origin_{name}": value for name, value in scene.origin.model_dump().items()}
    if geometry.slant_range_m is not None:
        facts["slant_range_m"] = geometry.slant_range_m
    return facts
