"""`warpsar simulate --product phase-history` and `--product slc`, and the same in Python."""

from __future__ import annotations

import time
from importlib.util import find_spec
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp

from warpsar.collection import cphd, sicd
from warpsar.collection.bodies import Bodies
from warpsar.collection.direct import direct, direct_of_rough, refuse_direct
from warpsar.collection.history import Collected
from warpsar.collection.history import phase_history as recorded
from warpsar.collection.noise import with_image_noise, with_noise
from warpsar.collection.plan import Plan, plans_of
from warpsar.collection.scatterers import Scatterers, band_error_db, rough_alone, scatterers_of
from warpsar.collection.slc import Slc, focused
from warpsar.io import complex_image
from warpsar.io.images import replacing
from warpsar.io.quick_look import QuickLook, draw_together
from warpsar.runtime import console, devices
from warpsar.runtime.busy import busy
from warpsar.scene.scene import Scene, scene_or_file
from warpsar.simulation.outputs import make_folder, refuse_unlikely_size, write_json
from warpsar.world.world import World

WIDE_BAND, SAID_DB = 0.06, 0.5
"""Share of the middle frequency from which a band's amplitudes are looked at, and the error at its ends that is said:
even an amplitude that goes as the frequency squared, as of small roughness, changes by less in a narrower band."""
ALIASED = 0.01
"""Share of tubes that are too wide after a curved surface from which a warning is due."""


def phase_history(
    scene: World | PathLike[str] | str, *, device: str | None = None, seed: int | None = None
) -> list[Collected]:
    """The phase history of every view of a scene, or of a scene file, with `[collection]`.

    `seed` (else that of `[sampling]`) draws the scatterers of rough faces and the noise: views with one seed see one
    surface. `Collected.samples` is complex64, (polarizations, frequencies, pulses). Raises InputError and DeviceError.
    """
    scene, where = scene_or_file(scene), devices.resolve_device(device)
    plans = plans_of(scene, where)
    bodies = Bodies(scene, plans, where, scene.seed(seed))
    return [collected(bodies, plan, index) for index, plan in enumerate(plans)]


def collected(bodies: Bodies, plan: Plan, index: int) -> Collected:
    """One view; `index` is its number, which tells its noise from that of others."""
    found = seen(bodies, plan)
    with busy(f"{plan.view.name}: {found.count} scatterers, {len(plan.track)} pulses"):
        made = recorded(plan, found, tuple(bodies.world.radar.polarizations), bodies.device)
    return with_noise(made, bodies.seed + 7919 * index)


def slc(scene: World | PathLike[str] | str, *, device: str | None = None, seed: int | None = None) -> list[Slc]:
    """The complex image of every view of a scene, or of a scene file, with `[collection]`.

    It is backprojected, or direct, as the table says.

    `Slc.images` holds complex64 arrays, (rows, columns), whose power is beta0 in the mean. `seed` as in
    `phase_history`. Raises InputError and DeviceError.
    """
    scene, where = scene_or_file(scene), devices.resolve_device(device)
    plans = plans_of(scene, where)
    bodies = Bodies(scene, plans, where, scene.seed(seed))
    return [image_of(bodies, plan, index) for index, plan in enumerate(plans)]


def image_of(bodies: Bodies, plan: Plan, index: int) -> Slc:
    """The complex image of one view; `index` as in `collected`."""
    world, device = bodies.world, bodies.device
    if plan.table.focus == "backprojection":
        made = collected(bodies, plan, index)
        with busy(f"{plan.view.name}: focusing"):
            return focused(made, world.grid, device)
    refuse_direct(plan, world.name)
    with busy(f"{plan.view.name}: scatterers into the image"):
        if rough_alone(world):
            load_kernels(device)
            image = direct_of_rough(bodies, plan)
        else:
            image = direct(plan, seen(bodies, plan, once=True), tuple(world.radar.polarizations), world.grid, device)
    return with_image_noise(image, bodies.seed + 7919 * index)


def seen(bodies: Bodies, plan: Plan, *, once: bool = False) -> Scatterers:
    """The scatterers of one view; `once`: as the middle of the track sees them."""
    load_kernels(bodies.device)
    with busy(f"{plan.view.name}: scatterers"):
        found = scatterers_of(bodies.world, plan, bodies.of(plan), once=once)
    if not found.count:
        console.warn([f"{plan.view.name}: nothing sends back; radar.terms are {', '.join(bodies.world.radar.terms)}"])
    if plan.bandwidth_hz > WIDE_BAND * plan.centre_hz:
        error = band_error_db(bodies.world, plan, bodies.of(plan))
        if error > SAID_DB:
            share = 100.0 * plan.bandwidth_hz / plan.centre_hz
            console.warn(
                [
                    f"{plan.view.name}: a band of {share:.2g} % of its middle frequency has the amplitudes of "
                    f"{plan.centre_hz / 1e9:.4g} GHz; at its ends they are wrong by up to {error:.2g} dB"
                ]
            )
    if found.aliased > ALIASED:
        console.warn([f"{plan.view.name}: {100 * found.aliased:.2g} % of the tubes are too wide after curved surfaces"])
    return found


def load_kernels(device: wp.Device) -> None:
    names = ("coherent.tubes", "coherent.radiate", "coherent.edges", "coherent.rough", "collection", "backproject")
    devices.load_kernels(device, *names)


def run(
    scene_path: Path | str,
    out: Path | str,
    product: str,
    *,
    device: str | None = None,
    seed: int | None = None,
    yes: bool = False,
) -> dict[str, Any]:
    """`warpsar simulate --product`: files of every view, and simulate.json, in `out`. Returns the JSON's content.

    `yes` takes a mesh whose size is unlikely.
    """
    started = time.perf_counter()
    with busy("reading the scene"):
        scene = Scene.load(scene_path)
    refuse_unlikely_size(scene, yes)
    where, out = devices.resolve_device(device), Path(out)
    plans = plans_of(scene, where)
    make_folder(out)
    console.say_device(where)
    warnings = [*scene.warnings, *_warnings(scene)]
    console.warn(warnings)
    bodies = Bodies(scene, plans, where, scene.seed(seed))
    write = _phase_history if product == "phase-history" else _slc
    entries = [write(bodies, plan, index, out) for index, plan in enumerate(plans)]
    content = {"product": product, "warnings": warnings, "views": entries}
    content = write_json(out / "simulate.json", scene, where, scene.seed(seed), started, content)
    names = [name for entry in entries for name in entry["files"].values()]
    console.say(f"{out}:\n  {', '.join(names[:4])}{f' and {len(names) - 4} more' if len(names) > 4 else ''}")
    return content


def _warnings(scene: Scene) -> list[str]:
    found = []
    if find_spec("sarkit") is None:
        found.append('no CPHD and no SICD are written: they need sarkit: pip install "warpsar[sicd]"')
    elif scene.origin is None:
        found.append("[scene] has no origin: files in earth coordinates put it at latitude 0, longitude 0")
    return found


def _phase_history(bodies: Bodies, plan: Plan, index: int, out: Path) -> dict[str, Any]:
    made = collected(bodies, plan, index)
    files = {"npz": f"{plan.view.name}.npz"}
    with replacing(out / files["npz"]) as temporary, temporary.open("wb") as file:
        np.savez(file, **made.arrays())
    if find_spec("sarkit") is not None:
        files["cphd"] = f"{plan.view.name}.cphd"
        cphd.write(out / files["cphd"], made)
    return {**facts(plan), "files": files, "scatterers": made.scatterers}


def _slc(bodies: Bodies, plan: Plan, index: int, out: Path) -> dict[str, Any]:
    made = image_of(bodies, plan, index)
    name = plan.view.name
    files = {"npz": f"{name}.npz", "quick_look": f"{name}.png"}
    complex_image.write(out / files["npz"], made.range_m, made.azimuth_m, made.images)
    power = {pol: np.abs(image) ** 2 for pol, image in made.images.items()}
    draw_together([QuickLook.of(out / files["quick_look"], name, power, bodies.world.grid.spacing_m)])
    for pol in made.images if find_spec("sarkit") is not None else ():
        files[f"sicd_{pol}"] = f"{name}.nitf" if len(made.images) == 1 else f"{name}_{pol}.nitf"
        sicd.write(out / files[f"sicd_{pol}"], made, pol)
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
