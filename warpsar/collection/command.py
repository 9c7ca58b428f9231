"""`warpsar simulate --product phase-history` and `--product slc`, and the same in Python."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.collection.bodies import Bodies
from warpsar.collection.direct import DirectImage, direct, direct_of_rough, refuse_direct, rough_of
from warpsar.collection.forecast import forecast, placed_on_device, room_of
from warpsar.collection.history import Collected, mixed
from warpsar.collection.history import phase_history as recorded
from warpsar.collection.noise import lines, with_image_noise, with_noise
from warpsar.collection.places import TubeTally
from warpsar.collection.plan import HALFWAY_DEG, Plan, plans_of
from warpsar.collection.scatterers import Stream, band_error_db, rough_alone
from warpsar.collection.slc import Slc, focused
from warpsar.effects.base.product import Product
from warpsar.effects.base.recorder import lit_pixels
from warpsar.effects.registry import declared, names
from warpsar.formats import cphd, sicd
from warpsar.io import complex_image
from warpsar.io.images import replacing
from warpsar.io.quick_look import QuickLook, draw_together
from warpsar.runtime import console, devices
from warpsar.runtime.busy import busy
from warpsar.scene.scene import Scene, scene_or_file
from warpsar.simulation.command import view_render
from warpsar.simulation.outputs import make_folder, refuse_unlikely_size, write_json
from warpsar.simulation.rays import trace_view, view_seed
from warpsar.surface.stage import Stage

WIDE_BAND, STATED_DB = 0.06, 0.5
"""Share of the middle frequency from which a band's amplitudes are looked at, and the error at its ends that is said:
even an amplitude that goes as the frequency squared, as of small roughness, changes by less in a narrower band."""
ALIASED = 0.01
"""Share of the tubes' power, in tubes that are too wide after a curved surface, from which a warning is due."""


def with_samples_changed(made: Slc, scene: Scene, index: int, seed: int, device: wp.Device) -> Slc:
    """A complex image with what effects do to its samples; `index` is the number of the view, `seed` the scene's."""
    system = _System(made, scene, index, seed, device)
    images = {}
    for polarization, samples in made.images.items():
        system.polarization = polarization
        for one in made.plan.effects:
            samples = one.effect.samples(system, one.values, one.settings, samples)
        images[polarization] = samples
    return replace(made, images=images)


class _System:
    """The `ComplexImage` that effects see."""

    def __init__(self, made: Slc, scene: Scene, index: int, seed: int, device: wp.Device) -> None:
        self.made, self.scene, self.index, self.seed, self.device = made, scene, index, seed, device
        self.polarization = ""
        self._powers: dict[str, tuple[dict[str, Any], NDArray[np.bool_]]] = {}
        self._random = np.random.default_rng([seed, 3, index])

    def lines(self) -> NDArray[np.complex64]:
        return lines(self.made.plan, self.made.azimuth_m, len(self.made.range_m), self._random)

    def power(self, effect: str) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        if effect not in self._powers:
            before = names()[: names().index(effect)]
            effects = {name: table for name, table in self.scene.effects.items() if name in before}
            scene = replace(self.scene, effects=effects)
            view, stage = scene.views[self.index], Stage.of(scene, self.device)
            hits = trace_view(scene, stage, view, seed=view_seed(self.seed, self.index), effects=declared(scene, view))
            render = view_render(scene, stage, view, hits)
            self._powers[effect] = render.forward(), lit_pixels(render).reshape(render.shape)
        images, met = self._powers[effect]
        return images[self.polarization], met


def phase_history(
    scene: Scene | PathLike[str] | str, *, device: str | None = None, seed: int | None = None
) -> list[Collected]:
    """The phase history of every view of a scene, or of a scene file, with `[collection]`.

    `seed` (else that of `[sampling]`) draws the scatterers of rough faces and the noise: views with one seed see one
    surface. `Collected.samples` is complex64, (polarizations, frequencies, pulses). Raises InputError and DeviceError.
    """
    scene, where = scene_or_file(scene), devices.resolve_device(device)
    plans = plans_of(scene, where, "phase-history")
    bodies = Bodies(scene, plans, where, scene.seed(seed))
    return [collected(bodies, plan, index) for index, plan in enumerate(plans)]


def collected(bodies: Bodies, plan: Plan, index: int) -> Collected:
    """One view; `index` is its number, which tells its noise from that of others."""
    load_kernels(bodies.device)
    with _stream(bodies, plan) as found:
        made = recorded(plan, found, tuple(bodies.world.radar.polarizations), bodies.device)
    return with_noise(made, bodies.seed + 7919 * index)


def slc(scene: Scene | PathLike[str] | str, *, device: str | None = None, seed: int | None = None) -> list[Slc]:
    """The complex image of every view of a scene, or of a scene file, with `[collection]`.

    It is backprojected, or direct, as the table says.

    `Slc.images` holds complex64 arrays, (rows, columns), whose power is beta0 in the mean. `seed` as in
    `phase_history`. Raises InputError and DeviceError.
    """
    scene, where = scene_or_file(scene), devices.resolve_device(device)
    plans = plans_of(scene, where, "slc")
    bodies = Bodies(scene, plans, where, scene.seed(seed))
    return [image_of(bodies, plan, index) for index, plan in enumerate(plans)]


def image_of(bodies: Bodies, plan: Plan, index: int) -> Slc:
    """The complex image of one view; `index` as in `collected`."""
    made = _focused(bodies, plan, index)
    return with_samples_changed(made, bodies.world, index, bodies.seed, bodies.device)


def _focused(bodies: Bodies, plan: Plan, index: int) -> Slc:
    world, device = bodies.world, bodies.device
    if plan.table.focus == "backprojection":
        made = collected(bodies, plan, index)
        with busy(f"{plan.view.name}: focusing"):
            return focused(made, world.grid, device)
    refuse_direct(plan, world.name)
    load_kernels(device)
    names = tuple(world.radar.polarizations)
    image = _direct(bodies, plan, names)
    samples = mixed(plan, np.stack(list(image.images.values())), names)
    image = replace(image, images=dict(zip(names, samples, strict=True)))
    return with_image_noise(image, bodies.seed + 7919 * index)


def _direct(bodies: Bodies, plan: Plan, names: tuple[str, ...]) -> Slc:
    world, device = bodies.world, bodies.device
    if not placed_on_device(world, plan):
        with _stream(bodies, plan, once=True) as found:
            image = direct(plan, found, names, world.grid, device, bodies.tile_bytes)
    elif rough_alone(world):
        tiles = len(DirectImage(plan, names, world.grid, device).tiles(bodies.tile_bytes))
        with _warned_of_band(bodies, plan), console.share(f"{plan.view.name}: scatterers", tiles) as bar:
            image = direct_of_rough(bodies, plan, bar)
        if not image.scatterers:
            console.warn([f"{plan.view.name}: no rough face that the radar sees lies in the image"])
    else:
        with _stream(bodies, plan, once=True, rough=False) as found:
            image = direct(plan, found, names, world.grid, device, bodies.tile_bytes, rough_of(bodies, plan))
    return image


@contextmanager
def _stream(bodies: Bodies, plan: Plan, *, once: bool = False, rough: bool = True) -> Iterator[Stream]:
    """The scatterers of one view, under a bar; `once`: as the middle of the track sees them; `rough`: with those of
    rough faces. Warns at the end."""
    name = plan.view.name
    with busy(f"{name}: rough faces"):
        body = bodies.of(plan)
    found = Stream(bodies.world, plan, body, once=once, together=bodies.together, seed=bodies.seed, rough=rough)
    with _warned_of_band(bodies, plan), console.share(f"{name}: scatterers", found.looks) as bar:
        found.progress = bar
        yield found
    if not found.count and rough:
        console.warn([f"{name}: nothing sends back; radar.terms are {', '.join(bodies.world.radar.terms)}"])
    console.warn(f"{name}: {warning}" for warning in wide_tubes(found.tally))


@contextmanager
def _warned_of_band(bodies: Bodies, plan: Plan) -> Iterator[None]:
    """Warns at the end where amplitudes are those of the middle of a wide band."""
    yield
    if plan.bandwidth_hz > WIDE_BAND * plan.centre_hz:
        error = band_error_db(bodies.world, plan, bodies.of(plan))
        if error > STATED_DB:
            share = 100.0 * plan.bandwidth_hz / plan.centre_hz
            console.warn(
                [
                    f"{plan.view.name}: a band of {share:.2g} % of its middle frequency has the amplitudes of "
                    f"{plan.centre_hz / 1e9:.4g} GHz; at its ends they are wrong by up to {error:.2g} dB"
                ]
            )


def wide_tubes(tally: TubeTally) -> list[str]:
    """What tubes that are too wide mean for a product; empty where they hold little of the tubes' power."""
    if tally.power_share <= ALIASED:
        return []
    without = 10.0 * np.log10(max(1.0 - tally.power_share, 1e-9))
    return [
        f"{100 * tally.share:.2g} % of the tubes get wider than half a wavelength after curved faces, and hold "
        f"{100 * tally.power_share:.2g} % of the power of single and multibounce, which is {-without:.2g} dB lower "
        f"without them: each adds up as if its face were flat, so it is too strong toward the mirror direction and too "
        f"weak beside it. Rough ground, edges and flat faces are not touched. `warpsar rcs` cuts such tubes: compare "
        f"the level of the curved parts with it, or leave single and multibounce out of radar.terms"
    ]


def load_kernels(device: wp.Device) -> None:
    names = [f"coherent.{name}" for name in ("tubes", "radiate", "edges", "rough", "placing")]
    names += ["collection", "backproject", *(["pulse_lanes", "coherent.free_lanes"] if device.is_cpu else [])]
    devices.load_kernels(device, *names)


def run(
    scene_path: Path | str,
    out: Path | str,
    product: Product,
    *,
    device: str | None = None,
    seed: int | None = None,
    max_memory_gib: float | None = None,
    yes: bool = False,
) -> dict[str, Any]:
    """`warpsar simulate --product`: files of every view, and simulate.json, in `out`. Returns the JSON's content.

    `max_memory_gib` bounds what is held at a time; `yes` takes a mesh whose size is unlikely. Raises InputError where
    the product itself does not fit into the memory.
    """
    started = time.perf_counter()
    with busy("reading the scene"):
        scene = Scene.load(scene_path)
    refuse_unlikely_size(scene, yes)
    where, out = devices.resolve_device(device), Path(out)
    plans = plans_of(scene, where, product)
    room = room_of(scene, plans, product, where, max_memory_gib)
    make_folder(out)
    console.say_device(where)
    warnings = [*scene.warnings, *_warnings(scene)]
    console.warn(warnings)
    bodies = Bodies(scene, plans, where, scene.seed(seed), room.together, room.tile_bytes)
    load_kernels(where)
    with busy("estimating time and memory"):
        expected = forecast(bodies, plans, product)
    if expected is not None:
        console.say(str(expected))
    write = _phase_history if product == "phase-history" else _slc
    entries = [write(bodies, plan, index, out) for index, plan in enumerate(plans)]
    content = {"product": product, "warnings": warnings, "views": entries}
    content = write_json(out / "simulate.json", scene, where, scene.seed(seed), started, content)
    names = [name for entry in entries for name in entry["files"].values()]
    console.say(f"{out}:\n  {', '.join(names[:4])}{f' and {len(names) - 4} more' if len(names) > 4 else ''}")
    return content


def _warnings(scene: Scene) -> list[str]:
    found = []
    if cphd.EXTRA.missing is not None:
        found.append('no CPHD and no SICD are written: they need sarkit: pip install "warpsar[sicd]"')
    elif scene.origin is None:
        found.append("[scene] has no origin: files in earth coordinates put it at latitude 0, longitude 0")
    return found


def _phase_history(bodies: Bodies, plan: Plan, index: int, out: Path) -> dict[str, Any]:
    made = collected(bodies, plan, index)
    files = {"npz": f"{plan.view.name}.npz"}
    with replacing(out / files["npz"]) as temporary, temporary.open("wb") as file:
        np.savez(file, **made.arrays())
    if cphd.EXTRA.missing is None:
        files["cphd"] = f"{plan.view.name}.cphd"
        cphd.write(out / files["cphd"], made.signal())
    return {**facts(plan), "files": files, "scatterers": made.scatterers}


def _slc(bodies: Bodies, plan: Plan, index: int, out: Path) -> dict[str, Any]:
    made = image_of(bodies, plan, index)
    name = plan.view.name
    files = {"npz": f"{name}.npz", "quick_look": f"{name}.png"}
    complex_image.write(out / files["npz"], made.range_m, made.azimuth_m, made.images)
    power = {pol: np.abs(image) ** 2 for pol, image in made.images.items()}
    draw_together([QuickLook.of(out / files["quick_look"], name, power, bodies.world.grid.spacing_m)])
    far = plan.track.bistatic_deg() > HALFWAY_DEG
    if far:
        console.warn([f"{name}: no SICD is written: version 1.3 places pixels by one antenna, and there are two apart"])
    for pol in made.images if sicd.EXTRA.missing is None and not far else ():
        files[f"sicd_{pol}"] = f"{name}.nitf" if len(made.images) == 1 else f"{name}_{pol}.nitf"
        sicd.write(out / files[f"sicd_{pol}"], made.formed(pol))
    return {**facts(plan), "plane": made.plane, "files": files, "scatterers": made.scatterers}


def facts(plan: Plan) -> dict[str, Any]:
    """What simulate.json says of a view's collection."""
    return {
        "name": plan.view.name,
        "pulses": len(plan.track),
        "frequencies": plan.frequencies,
        "frequency_start_hz": plan.start_hz,
        "frequency_step_hz": plan.step_hz,
        "cells_m": list(plan.cells_m),
        "windows": list(plan.windows),
        "response_m2": plan.response_m2,
        "slant_range_m": plan.slant_range_m,
    }
