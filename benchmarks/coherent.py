"""How fast `warpsar.rcs` is on the Austin suite's boxes and model aircraft, how its time grows, what gradients take.

    python benchmarks/coherent.py DATA [--device cuda] [--only cylindrical] [--growth] [--gradients] [--large]
        [--out coherent.json] [--write]

DATA is the folder of the suite (benchmarks/rcs_checks.py), with austin_bodies/ beside it. A sweep: 361 angles, 2.56,
5.12, 7 and 10.24 GHz, HH and VV, tubes of a tenth of the shortest wavelength. `wall` is the time of day, `cpu` that of
the process on all its threads: on a busy machine the second says more. `with its error` is the wall time where a second
sweep, of tubes of twice the width, tells the error of the spacing, as in `warpsar.rcs`. Reading the mesh and building
the tree are `prepare`.

`--gradients` times, beside the values of `warpsar.rcs` (with their errors), one pass back to all vertices (`vjp`), of
31 angles from 10 to 70 degrees in two polarizations, at 7 GHz, and at the four frequencies together.

`--large` times a direction of the aircraft in its full size of 15 m, 174,112 faces, at 10.24 GHz, with more and
more rays.
`stated error` is the median of `spacing_error_db`; `off` is the median |dB| from the sweep with the most rays.

`--profile` prints seconds for each kernel instead, on one thread: it waits for each launch to end.
"""

from __future__ import annotations

import dataclasses
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import tables
import trimesh
import warp as wp
from rcs_checks import BODIES, MATERIALS, ROOT, scene_of
from simulate import machine

import warpsar
from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions
from warpsar.coherent.sweep import sweep
from warpsar.runtime import devices
from warpsar.world.mesh import read_mesh

FREQUENCIES = (2.56e9, 5.12e9, 7e9, 10.24e9)
ANGLES = 361
METAL = {name: make for name, (_, make) in BODIES.items() if name not in MATERIALS}
FULL_SIZE = 592.763 / 9.1875
"""Of the aircraft, over the model that was measured: the lengths that the suite states [in]."""
DENSITIES, LARGE_ANGLES = (4.0, 5.0, 7.0, 10.0, 14.0, 20.0), 16
METAL["aircraft"] = lambda data: read_mesh(data.parent / "austin_bodies" / "prime_closed_duct.obj")


def measure(body: CoherentBody, angles: int, frequencies: tuple[float, ...], **more: Any) -> dict[str, Any]:
    directions = Directions.of(90.0 - np.linspace(0.0, 180.0, angles), 90.0)
    sweep(body, directions[:2], frequencies[:1], **more)  # kernels, first touch
    wall, cpu = time.perf_counter(), time.process_time()
    found = sweep(body, directions, frequencies, **more)
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    started = time.perf_counter()
    sweep(body, directions, frequencies, compare=True, **more)
    both = time.perf_counter() - started
    return {"angles": angles, "frequencies": len(frequencies), "segments": found.segments, "wall_s": wall, "cpu_s": cpu,
            "with_error_s": both}  # fmt: skip


def profile(body: CoherentBody, angles: int, frequencies: tuple[float, ...]) -> str:
    """Where the time of a sweep goes: launches, threads and seconds of each kernel, and of the host."""
    directions = Directions.of(90.0 - np.linspace(0.0, 180.0, angles), 90.0)
    sweep(body, directions[:2], frequencies[:1])
    rows: dict[str, list[float]] = {}
    launch = wp.launch

    def timed(kernel: Any, dim: Any, *args: Any, **more: Any) -> None:
        wp.synchronize_device(body.device)
        started = time.perf_counter()
        launch(kernel, dim, *args, **more)
        wp.synchronize_device(body.device)
        row = rows.setdefault(kernel.key, [0, 0, 0.0])
        for i, one in enumerate((1, np.prod(dim), time.perf_counter() - started)):
            row[i] += one

    os.environ["WARPSAR_THREADS"] = "1"
    wp.launch = timed
    try:
        wall = time.perf_counter()
        sweep(body, directions, frequencies)
        wall = time.perf_counter() - wall
    finally:
        wp.launch = launch
    rest = wall - sum(row[2] for row in rows.values())
    lines = [(name, int(n), f"{threads / 1e6:.1f} M", f"{seconds:.3f}") for name, (n, threads, seconds) in rows.items()]
    lines.sort(key=lambda line: -float(line[3]))
    return tables.markdown(("kernel", "launches", "threads", "seconds"), [*lines, ("the rest", "", "", f"{rest:.3f}")])


def prepared(
    data: Path, name: str, device: str | None, cuts: int = 0, scale: float = 1.0
) -> tuple[CoherentBody, dict[str, Any]]:
    """A body on the device. `cuts`: how often each of its faces is cut into four."""
    started = time.process_time()
    mesh = METAL[name](data)
    for _ in range(cuts):
        mesh = warpsar.Mesh.of(*trimesh.remesh.subdivide(mesh.vertices, mesh.faces))
    if scale != 1.0:
        mesh = warpsar.Mesh.of(scale * mesh.vertices, mesh.faces)
    scene = scene_of(mesh)
    radar = warpsar.Radar(frequency_hz=max(FREQUENCIES), polarizations=("HH", "VV"))
    body = CoherentBody.of(dataclasses.replace(scene, radar=radar), devices.resolve_device(device))
    return body, {"body": name, "faces": len(body.shape.faces), "prepare_cpu_s": time.process_time() - started}


def growth(
    body: CoherentBody, about: dict[str, Any], finer: tuple[CoherentBody, dict[str, Any]]
) -> list[dict[str, Any]]:
    """One number at a time: angles, frequencies, rays, faces."""
    few = FREQUENCIES[-1:]
    return [
        {**its, "what": what, **measure(one, angles, frequencies, **more)}
        for what, (one, its), angles, frequencies, more in (
            ("start", (body, about), 46, few, {}),
            ("angles x 2", (body, about), 91, few, {}),
            ("frequencies x 4", (body, about), 46, FREQUENCIES, {}),
            ("rays x 4", (body, about), 46, few, {"rays_per_wavelength": 20.0}),
            ("faces x 4", finer, 46, few, {}),
        )
    ]


def large(data: Path, device: str | None, densities: tuple[float, ...] = DENSITIES) -> list[dict[str, Any]]:
    """A direction of the aircraft in its full size, with few rays and with many."""
    body, about = prepared(data, "aircraft", device, cuts=1, scale=FULL_SIZE)
    directions = Directions.of(np.linspace(-87.0, 93.0, LARGE_ANGLES, endpoint=False), 90.0)
    few, rows, sums = FREQUENCIES[-1:], [], []
    sweep(body, directions[:1], few, rays_per_wavelength=densities[0], compare=True)  # kernels, first touch
    for density in densities:
        seconds = []
        for compare in (False, True):
            started = time.perf_counter()
            found = sweep(body, directions, few, rays_per_wavelength=density, compare=compare)
            seconds.append((time.perf_counter() - started) / LARGE_ANGLES)
        total = found.amplitude.sum(axis=2)[:, 0, (0, 3)]  # HH and VV
        sums.append(total)
        stated = 20.0 * np.log10(1.0 + found.spacing_error[:, 0, (0, 3)] / np.abs(total))
        rows.append({**about, "rays_per_wavelength": density, "segments": found.segments / LARGE_ANGLES,
                     "direction_s": seconds[0], "with_error_s": seconds[1], "stated_db": float(np.median(stated)),
                     "aliased": float(found.aliased.mean())})  # fmt: skip
    for made, total in zip(rows, sums, strict=True):
        made["off_db"] = float(np.median(np.abs(20.0 * np.log10(np.abs(total / sums[-1])))))
    return rows


def large_table(rows: list[dict[str, Any]]) -> str:
    header = ("faces", "rays per wavelength", "segments a direction", "a direction [ms]", "with its error [ms]",
              "stated error [dB]", "off [dB]", "tubes that alias")  # fmt: skip
    return tables.markdown(
        header,
        [
            (r["faces"], f"{r['rays_per_wavelength']:g}", f"{r['segments'] / 1e6:.1f} M",
             f"{1e3 * r['direction_s']:.0f}", f"{1e3 * r['with_error_s']:.0f}", f"{r['stated_db']:.2f}",
             f"{r['off_db']:.2f}", f"{100.0 * r['aliased']:.2g} %")
            for r in rows
        ],
    )  # fmt: skip


def gradients(data: Path, name: str, device: str | None) -> list[dict[str, Any]]:
    """Seconds of a value, and of its gradients to all vertices, on the processor's clock and on the wall's."""
    scene = scene_of(METAL[name](data))
    azimuth = np.linspace(10.0, 70.0, 31) + 0.013  # no face stands along the line of sight
    rows = []
    for frequencies in (FREQUENCIES[2:3], FREQUENCIES):
        asked = (azimuth, 88.0, frequencies)
        for angles in (azimuth[:2], azimuth):  # the first loads kernels
            made = warpsar.rcs_gradients(scene, angles, *asked[1:], parameters=["mesh.vertices"], device=device)
            started = time.perf_counter(), time.process_time()
            made.vjp(made.rcs.amplitude_m)
            back = time.perf_counter() - started[0], time.process_time() - started[1]
        started = time.perf_counter(), time.process_time()
        warpsar.rcs(scene, *asked, device=device)
        value = time.perf_counter() - started[0], time.process_time() - started[1]
        rows.append({"body": name, "faces": len(scene.mesh.faces), "frequencies": len(frequencies), "value_s": value,
                     "vjp_s": back})  # fmt: skip
    return rows


def gradients_table(rows: list[dict[str, Any]]) -> str:
    header = ("body", "faces", "frequencies", "value, wall [s]", "CPU [s]", "back, wall [s]", "CPU [s]",
              "back over value, CPU", "both over value, CPU")  # fmt: skip
    lines = []
    for r in rows:
        (wall, cpu), (back, back_cpu) = r["value_s"], r["vjp_s"]
        lines.append((r["body"], r["faces"], r["frequencies"], *(f"{x:.2f}" for x in (wall, cpu, back, back_cpu)),
                      f"{back_cpu / cpu:.1f}", f"{1.0 + back_cpu / cpu:.1f}"))  # fmt: skip
    return tables.markdown(header, lines)


def row(r: dict[str, Any]) -> tuple[Any, ...]:
    rate = r["segments"] / r["wall_s"]
    return (r.get("what", r["body"]), r["faces"], r["angles"], r["frequencies"], f"{r['segments'] / 1e6:.1f} M",
            f"{r['wall_s']:.2f}", f"{r['cpu_s']:.2f}", f"{rate / 1e6:.2f} M", f"{r['with_error_s']:.2f}",
            f"{r['prepare_cpu_s']:.1f}")  # fmt: skip


def main() -> None:
    parser = tables.parser(__doc__)
    default = Path(os.environ.get("WARPSAR_MEASURED") or ROOT.parent / "shared" / "data") / "austin_rcs"
    parser.add_argument("data", type=Path, nargs="?", default=default)
    parser.add_argument("--device")
    parser.add_argument("--only", choices=[name.split()[0] for name in METAL], help="one body")
    parser.add_argument("--profile", action="store_true", help="seconds for each kernel")
    parser.add_argument("--growth", action="store_true", help="also how the time of the cobra duct grows")
    parser.add_argument("--gradients", action="store_true", help="also what gradients to all vertices take")
    parser.add_argument("--large", action="store_true", help="also a direction of the aircraft in its full size")
    options = parser.parse_args()
    if options.source:
        result = tables.stored(options.source)
    else:
        sweeps: list[dict[str, Any]] = []
        grown: list[dict[str, Any]] = []
        pulled: list[dict[str, Any]] = []
        result = {"made": tables.made(), "machine": machine(options.device), "sweeps": sweeps, "growth": grown,
                  "gradients": pulled}  # fmt: skip
        for name in (n for n in METAL if options.only in (None, n.split()[0])):
            body, about = prepared(options.data, name, options.device)
            if options.profile:
                print(name, profile(body, ANGLES, FREQUENCIES), sep="\n\n")
                continue
            sweeps.append({**about, **measure(body, ANGLES, FREQUENCIES)})
            tables.save(options.out, result)
            if options.gradients:
                pulled += gradients(options.data, name, options.device)
                tables.save(options.out, result)
            if options.growth and name.startswith("cobra"):
                grown += growth(body, about, prepared(options.data, name, options.device, cuts=1))
                tables.save(options.out, result)
        if options.large:
            result["large"] = large(options.data, options.device)
            tables.save(options.out, result)
    header = ("sweep", "faces", "angles", "frequencies", "segments", "wall [s]", "CPU [s]", "segments per wall second",
              "with its error, wall [s]", "prepare, CPU [s]")  # fmt: skip
    if options.profile:
        return
    kind = result["machine"]["device"].split(":")[0]
    bodies = {f"coherent.{kind}": tables.markdown(header, map(row, result["sweeps"]))}
    if result["growth"]:
        bodies[f"coherent.growth.{kind}"] = tables.markdown(header, map(row, result["growth"]))
    if result.get("gradients"):
        bodies[f"coherent.gradients.{kind}"] = gradients_table(result["gradients"])
    if result.get("large"):
        bodies[f"coherent.large.{kind}"] = large_table(result["large"])
    tables.publish(bodies, result, options.write)


if __name__ == "__main__":
    main()
