"""How fast collections are: the deposit alone, a town as one collection, focusing, and batches of complex images.

    python benchmarks/collection.py [--device cuda] [--only deposit town focus batch copy large history] [--small]
    [--out collection.json] [--write]

`deposit`: 10^6 scatterers x 1,000 pulses, 2,048 frequencies. `town`: the town of 900,482 faces as one collection of
1,024 pulses, with at least ten scatterers in each resolution cell, from the mesh to the phase history. `focus`: 1,024
pulses onto 1,024 x 1,024 pixels, and the same with torchbp where it can be imported. `batch`: direct complex images of
several azimuths, alone, with NPZ and with SICD files, beside images of beta0 of the same scene, alone and with EXR.
`large`: a direct complex image of 4,096 x 4,096 pixels of 0.5 m of a town of 2 km, with what the forecast says of it;
with `--small` its middle of 512 x 512 pixels, and the forecast of the whole. `history`: the phase history of the same
town, and its image. `copy`: bytes that a copy moves in a second, and the share of it that the deposit reads and adds.
What --out holds already is not measured again. `--small` is a trial of a few seconds on a CPU.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import tables
import warp as wp
from scenes import town_scene
from simulate import machine

import warpsar
from warpsar.collection import history as histories
from warpsar.collection.bodies import Bodies
from warpsar.collection.command import load_kernels
from warpsar.collection.direct import direct_of_rough
from warpsar.collection.forecast import forecast, room_of
from warpsar.collection.plan import Plan, plan_of
from warpsar.collection.scatterers import ScattererPart, Scatterers, body_of, scatterers_of, spacing_m, total_weight
from warpsar.collection.slc import Slc, focused
from warpsar.formats import sicd
from warpsar.io.images import write_exr
from warpsar.kernels import collection as kernels
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.world.collection import Collection

FACES = 900_482
RUNS = 5


def timed(work: Callable[[], Any], runs: int = RUNS) -> dict[str, Any]:
    """The shortest and the median of some runs after a first one [s], and what the processor spent on the shortest."""
    work()
    wp.synchronize()
    found = []
    for _ in range(runs):
        started, spent = time.perf_counter(), time.process_time()
        work()
        wp.synchronize()
        found.append((time.perf_counter() - started, time.process_time() - spent))
    best, processor = min(found)
    return {
        "best_s": best,
        "median_s": float(np.median([each for each, _ in found])),
        "processor_s": processor,
        "runs": runs,
    }


def ground(side_m: float, **table: Any) -> Scene:
    """A square of even ground, X band."""
    h = side_m / 2
    mesh = warpsar.Mesh.of(np.array([[-h, -h, 0], [h, -h, 0], [h, h, 0], [-h, h, 0]]), np.array([[0, 1, 2], [0, 2, 3]]))
    return Scene(
        mesh=mesh,
        radar=warpsar.Radar(frequency_hz=9.6e9, polarizations=("HH",), terms=("rough",)),
        grid=warpsar.Grid(shape=(64, 64), spacing_m=(0.2, 0.2)),
        materials={name: warpsar.Material(eps_r=6.0, rms_height_m=0.0012, correlation_length_m=0.01)
                   for name in mesh.materials},
        views=[warpsar.View(name="one", azimuth_deg=270.0, incidence_deg=45.0)],
        collection=Collection(slant_range_m=10e3, speed_m_s=100.0, resolution_m=(0.3, 0.3), **table),
    )  # fmt: skip


def points(plan: Plan, count: int, side_m: float) -> Scatterers:
    random = np.random.default_rng(0)
    place = random.uniform(-side_m / 2, side_m / 2, (count, 3)) * [1.0, 1.0, 0.0]
    amplitude = random.standard_normal((1, count, 2), dtype=np.float32).view(np.complex64)[..., 0]
    return Scatterers((ScattererPart(place, amplitude, np.ones(len(plan.track), np.float32)),), 0.0)


def deposit(device: wp.Device, small: bool) -> dict[str, Any]:
    """Scatterers that are on the device already into range bins there; then with transfers, FFT and spectra."""
    count, pulses = (10_000, 100) if small else (1_000_000, 1_000)
    side = 20.0 if small else 150.0
    scene = ground(side, pulses=None if small else pulses, frequencies=None if small else 2048)
    plan = plan_of(scene, scene.views[0], device)
    found = points(plan, count, side)
    whole = timed(lambda: histories.phase_history(plan, found, ("HH",), device), 3)
    track = histories.track_of(plan, device)
    parts = [histories.PartOnDevice.of(part, device) for part in found.parts]
    kernel = timed(lambda: _launched(plan, track, parts, device), 3)
    deposits = count * len(plan.track)
    touched = deposits * (kernels.WIDTH * 16 + 32)  # bytes added to (read and written), and read
    return {
        "scatterers": count,
        "pulses": len(plan.track),
        "frequencies": plan.frequencies,
        "kernel": kernel,
        "whole": whole,
        "deposits_per_s": deposits / kernel["best_s"],
        "bytes_per_s": touched / kernel["best_s"],
    }


def _launched(plan: Plan, shared: Any, parts: list[Any], device: wp.Device) -> None:
    """All pulses' deposits, on CUDA in one launch; without transfers and FFT."""
    every = slice(0, len(plan.track))
    histories.deposited(plan, shared, parts, every, histories.no_bins(plan, 1, every, device))


def town(device: wp.Device, small: bool) -> dict[str, Any]:
    """From the mesh to the phase history: the tree, scatterers with their visibility and sigma0, and the deposit."""
    scene = town_scene(2_000 if small else FACES, (64, 64), 4.0)
    table = Collection(
        slant_range_m=10e3,
        speed_m_s=100.0,
        resolution_m=(3.0, 3.0) if small else (0.5, 0.5),
        pulses=None if small else 1024,
        scatterers_per_cell=10.0,
    )
    radar = scene.radar.model_copy(update={"terms": ("rough",), "frequency_hz": 9.6e9})
    scene = replace(scene, radar=radar, collection=table)
    times: dict[str, float] = {}

    def step(name: str, work: Callable[..., Any], *what: Any) -> Any:
        started = time.perf_counter()
        found = work(*what)
        wp.synchronize()
        times[name] = time.perf_counter() - started
        return found

    for _ in range(2):  # the second time is the one that counts: kernels are there
        plan = step("plan", plan_of, scene, scene.views[0], device)
        body = step("body", body_of, scene, spacing_m(plan), device, 0)
        found = step("scatterers", scatterers_of, scene, plan, body)
        step("history", histories.phase_history, plan, found, ("HH",), device)
    return {
        "faces": len(scene.mesh.faces),
        "scatterers": found.count,
        "pulses": len(plan.track),
        "frequencies": plan.frequencies,
        "deposits": total_weight(found.parts),
        "seconds": times,
        "total_s": sum(times.values()),
    }


def focus(device: wp.Device, small: bool) -> dict[str, Any]:
    """Backprojection of random points; torchbp's of the same data beside it, where it is installed."""
    pixels = 64 if small else 1024
    scene = ground(20.0 if small else 150.0, pulses=None if small else 1024)
    scene = replace(scene, grid=warpsar.Grid(shape=(pixels, pixels), spacing_m=(0.14, 0.14)))
    plan = plan_of(scene, scene.views[0], device)
    made = histories.phase_history(plan, points(plan, 1000, 20.0), ("HH",), device)
    ours = timed(lambda: focused(made, scene.grid, device), 3)
    rate = pixels**2 * len(plan.track) / ours["best_s"]
    found = {"pixels": pixels**2, "pulses": len(plan.track), "warpsar": ours, "per_s": rate}
    return {**found, "torchbp": peer(made, scene)}


def peer(made: histories.Collected, scene: Scene) -> dict[str, Any] | str:
    """torchbp, onto as many pixels of a level plane; the reason where it cannot be run."""
    try:
        import torch
        import torchbp
    except ImportError as error:
        return f"not installed: {error}"
    plan = made.plan
    where = "cuda" if torch.cuda.is_available() else "cpu"
    bins = histories.OVERSAMPLING * 4 * plan.frequencies
    profiles = np.fft.ifft(made.samples[0].T, bins, axis=1).astype(np.complex64)
    data = torch.from_numpy(profiles).to(where)
    half = 0.5 * scene.grid.shape[0] * scene.grid.spacing_m[0]
    grid = {"x": (-half, half), "y": (-half, half), "nx": scene.grid.shape[0], "ny": scene.grid.shape[1]}
    place = torch.from_numpy(plan.track.receiver_m.astype(np.float32)).to(where)
    cell = 299792458.0 / (2.0 * plan.step_hz * bins)
    try:

        def work() -> None:
            torchbp.ops.backprojection_cart_2d(data, grid, plan.centre_hz, cell, place)
            if where == "cuda":
                torch.cuda.synchronize()

        return timed(work, 3)
    except Exception as error:  # another version's arguments
        return f"{type(error).__name__}: {error}"


def batch(device: wp.Device, small: bool) -> dict[str, Any]:
    """Direct images and their files, beside `warpsar.simulate` and its EXR, of the same views."""
    scene = town_scene(2_000 if small else 100_000, (128, 128) if small else (380, 423), 16.0)
    number = 8 if small else 16
    views = [warpsar.View(name=f"v{i:02d}", azimuth_deg=360.0 * i / number, incidence_deg=45.0) for i in range(number)]
    radar = scene.radar.model_copy(update={"terms": ("rough",), "frequency_hz": 9.6e9})
    cell = max(scene.grid.spacing_m) * 1.2
    table = Collection(slant_range_m=10e3, resolution_m=(cell, cell), focus="direct")
    scene = replace(scene, radar=radar, views=views, collection=table)
    plans = [plan_of(scene, view, device) for view in views]

    def body() -> Any:
        return Bodies(scene, plans, device, 0).patches(plans[0])

    def images() -> list[Slc]:
        bodies = Bodies(scene, plans, device, 0)
        return [direct_of_rough(bodies, plan) for plan in plans]

    def powers() -> list[Any]:
        return warpsar.simulate(scene, device=device.alias)

    with tempfile.TemporaryDirectory() as folder:

        def arrays() -> None:
            for one in images():
                np.savez(Path(folder) / f"{one.plan.view.name}.npz", one.images["HH"])

        def standard() -> None:
            for one in images():
                sicd.write(Path(folder) / f"{one.plan.view.name}.nitf", one.formed("HH"))

        def exr() -> None:
            for one in powers():
                write_exr(Path(folder) / f"{one.name}.exr", one.beta0, {})

        works = {"body": body, "slc": images, "npz": arrays, "sicd": standard, "beta0": powers, "exr": exr}
        if find_spec("sarkit") is None or find_spec("jbpy") is None:
            print("batch: SICD skipped: sarkit, or its jbpy, is not installed", file=sys.stderr)
            del works["sicd"]
        found = {name: timed(work, 2) for name, work in works.items()}
        return {
            "views": number,
            "pixels": list(scene.grid.shape),
            "faces": len(scene.mesh.faces),
            "seconds_each": {name: one["best_s"] / number for name, one in found.items()},
            "processor_s_each": {name: one["processor_s"] / number for name, one in found.items()},
        }


def wide_town(pixels: int) -> Scene:
    """The town of 100,000 faces, stretched to 2 km, and so many pixels of 0.5 m in its middle."""
    scene = town_scene(100_000, (pixels, pixels), 4.0)
    size = np.ptp(scene.mesh.vertices, axis=0)
    mesh = replace(scene.mesh, vertices=scene.mesh.vertices * [2000.0 / size[0], 2000.0 / size[1], 1.0])
    table = Collection(slant_range_m=650e3, resolution_m=(0.6, 0.6), focus="direct")
    radar = scene.radar.model_copy(update={"terms": ("rough",), "frequency_hz": 9.6e9})
    grid = scene.grid.model_copy(update={"spacing_m": (0.5, 0.5)})
    return replace(scene, mesh=mesh, radar=radar, collection=table, grid=grid)


def large(device: wp.Device, small: bool) -> dict[str, Any]:
    """What the forecast says, and what the clock says."""
    said = []
    for pixels in dict.fromkeys((4096, 512 if small else 4096)):
        scene = wide_town(pixels)
        plans = [plan_of(scene, view, device) for view in scene.views]
        room = room_of(scene, plans, "slc", device, None)
        bodies = Bodies(scene, plans, device, 0, room.together, room.tile_bytes)
        started = time.perf_counter()
        told = forecast(bodies, plans, "slc")
        said.append((pixels, told, time.perf_counter() - started))
    started, cpu = time.perf_counter(), time.process_time()
    image = direct_of_rough(bodies, plans[0])
    wp.synchronize()
    spent, cpu_s = time.perf_counter() - started, time.process_time() - cpu
    started = time.perf_counter()
    with_all = warpsar.slc(scene, device=device.alias)[0]
    whole = time.perf_counter() - started
    assert with_all.scatterers == image.scatterers
    return {
        "pixels": pixels,
        "scatterers": image.scatterers,
        "image_s": spent,
        "image_cpu_s": cpu_s,
        "whole_s": whole,
        "forecasts": [
            {"pixels": n, "scatterers": one.scatterers, "seconds": one.seconds, "gib": one.gib, "took_s": took}
            for n, one, took in said
            if one is not None
        ],
    }


def wide_history(device: wp.Device, small: bool) -> dict[str, Any]:
    """The phase history of the same town, what the forecast says of it, and the image that it is focused to."""
    scene = wide_town(64 if small else 4096)
    assert scene.collection is not None
    scene = replace(scene, collection=scene.collection.model_copy(update={"focus": "backprojection"}))
    if small:
        scene = replace(scene, mesh=replace(scene.mesh, vertices=scene.mesh.vertices * [0.01, 0.01, 1.0]))
    plans = [plan_of(scene, view, device) for view in scene.views]
    room = room_of(scene, plans, "phase-history", device, None)
    told = forecast(Bodies(scene, plans, device, 0, room.together, room.tile_bytes), plans, "phase-history")
    print("forecast:", told, file=sys.stderr, flush=True)
    started, cpu = time.perf_counter(), time.process_time()
    made = warpsar.phase_history(scene, device=device.alias)[0]
    spent, cpu_s = time.perf_counter() - started, time.process_time() - cpu
    started = time.perf_counter()
    focused(made, scene.grid, device)
    return {
        "pulses": len(plans[0].track),
        "frequencies": plans[0].frequencies,
        "scatterers": made.scatterers,
        "history_s": spent,
        "history_cpu_s": cpu_s,
        "focus_s": time.perf_counter() - started,
        "forecast": None if told is None else {"seconds": told.seconds, "gib": told.gib, "scatterers": told.scatterers},
    }


def copy(device: wp.Device, small: bool) -> dict[str, Any]:
    """Bytes read and written by a copy of 1 GiB, in a second."""
    count = 2**20 if small else 2**28
    one, other = (wp.zeros(count, dtype=float, device=device) for _ in range(2))
    found = timed(lambda: wp.copy(other, one))
    return {**found, "bytes_per_s": 8 * count / found["best_s"]}


WORK = {"copy": copy, "deposit": deposit, "town": town, "focus": focus, "batch": batch, "large": large,
        "history": wide_history}  # fmt: skip


def written(found: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows of the table in docs/benchmarks.md."""
    rows = []
    if "deposit" in found:
        one = found["deposit"]
        alone, whole = one["kernel"]["best_s"], one["whole"]["best_s"]
        rows.append((f"deposit, {one['scatterers']:,} scatterers x {one['pulses']:,} pulses",
                     f"{alone:.3g} s; with transfers and FFT {whole:.3g} s"))  # fmt: skip
        if "copy" in found:
            share = one["bytes_per_s"] / found["copy"]["bytes_per_s"]
            rows.append(("bytes that it reads and adds, of a copy's", f"{100 * share:.3g} %"))
    if "town" in found:
        one = found["town"]
        parts = ", ".join(f"{name} {value:.3g} s" for name, value in one["seconds"].items())
        rows.append((f"town, {one['faces']:,} faces, {one['scatterers']:,} scatterers x {one['pulses']:,} pulses",
                     f"{one['total_s']:.3g} s ({parts})"))  # fmt: skip
    if "focus" in found:
        one, other = found["focus"], found["focus"]["torchbp"]
        said = other if isinstance(other, str) else f"{other['best_s']:.3g} s"
        rows.append((f"backprojection, {one['pixels']:,} pixels x {one['pulses']:,} pulses",
                     f"{one['warpsar']['best_s']:.3g} s; torchbp {said}"))  # fmt: skip
    if "batch" in found:
        one, each = found["batch"], found["batch"]["seconds_each"]
        size = f"{one['views']} views of {one['faces']:,} faces, {one['pixels'][0]} x {one['pixels'][1]}"
        files = [f"{label} {each[name]:.3g} s" if name in each else f"{label} skipped: no sarkit"
                 for name, label in (("npz", "with its npz"), ("sicd", "with its SICD"))]  # fmt: skip
        own = f"{each['slc']:.3g} s (of it the body, once for all views, {each['body']:.3g} s)"
        rows.append((f"a direct complex image of {size}", ", ".join([own, *files])))
        ratio, spent = f"{each['slc'] / each['beta0']:.2g} times less", one["processor_s_each"]
        ratio += f", {spent['slc'] / spent['beta0']:.2g} times of the processor's time"
        rows.append(("beta0 of the same views", f"{each['beta0']:.3g} s, with its EXR {each['exr']:.3g} s: {ratio}"))
    if "large" in found:
        one = found["large"]
        said = "; ".join(
            f"forecast of {each['pixels']:,} x {each['pixels']:,}: {each['seconds']:.3g} s, "
            f"{each['scatterers']:.3g} scatterers, {each['gib']:.2g} GiB"
            for each in one["forecasts"]
        )
        size = f"{one['pixels']:,} x {one['pixels']:,} pixels of 0.5 m"
        spent = f"{one['image_s']:.3g} s ({one['image_cpu_s']:.3g} s of the processor)"
        more = f"with body and plan {one['whole_s']:.3g} s"
        rows.append(
            (
                f"a direct complex image of a town of 2 km, {size}",
                "; ".join(filter(None, [f"{spent}, {one['scatterers']:,} scatterers", more, said])),
            )
        )
    if "history" in found:
        one = found["history"]
        said = one["forecast"]
        told = "" if said is None else f"; forecast {said['seconds']:.3g} s, {said['gib']:.2g} GiB"
        rows.append(
            (
                f"its phase history, {one['pulses']:,} pulses x {one['frequencies']:,} frequencies",
                f"{one['history_s']:.3g} s ({one['history_cpu_s']:.3g} s of the processor), {one['scatterers']:,} "
                f"scatterers as all places of the track see them; focused in {one['focus_s']:.3g} s{told}",
            )
        )
    return rows


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device")
    parser.add_argument("--only", nargs="+", choices=WORK, default=list(WORK))
    parser.add_argument("--small", action="store_true")
    options = parser.parse_args()
    if options.source:
        result = tables.stored(options.source)
    else:
        device = devices.resolve_device(options.device)
        load_kernels(device)
        kept = options.out is not None and options.out.exists()
        result = json.loads(options.out.read_text(encoding="utf-8")) if kept else {}
        for name in options.only:
            if name not in result:
                result[name] = WORK[name](device, options.small)
                print(name, json.dumps(result[name]), flush=True)
                result |= {"made": tables.made(), "machine": machine(options.device)}
                tables.save(options.out, result)
    header = ("what", result["machine"]["device_name"])
    kind = result["machine"]["device"].partition(":")[0]
    tables.publish({f"collection.{kind}": tables.markdown(header, written(result))}, result, options.write)


if __name__ == "__main__":
    main()
