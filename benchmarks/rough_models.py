"""How fast the scatterers of rough faces are, by model: complex amplitudes of a million places in four polarizations.

    python benchmarks/rough_models.py [--device cuda] [--count N] [--out rough_models.json] [--write]

The time is that of the kernel alone: CPU seconds on a CPU, wall time on a GPU. Visibility comes before it, and is the
same for every model.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
import tables
import warp as wp
from simulate import machine

import warpsar
from warpsar.coherent.body import CoherentBody
from warpsar.collection import places
from warpsar.collection.command import load_kernels
from warpsar.kernels import collection as kernels
from warpsar.kernels.coherent.rough_models import rough_places_kernel
from warpsar.runtime import devices
from warpsar.world import scattering_term

RUNS = 15
SIDE_M = 20.0
FREQUENCY_HZ = 9.6e9
K = 2.0 * np.pi * FREQUENCY_HZ / 299_792_458.0
KH = (0.1, 0.3, 1.3)
TABLE = "incidence_deg,HH,VV,HV\n" + "".join(f"{a},{-a / 5},{-a / 6},{-12 - a / 8}\n" for a in range(0, 91, 5))
PLACES = 100
"""Of the learned term."""


def material(model: str, kh: float, folder: Path) -> warpsar.Material:
    if model == "facet":
        (folder / "ground.csv").write_text(TABLE, encoding="utf-8")
        return warpsar.Material(model="facet", sigma0=folder / "ground.csv")
    base, _, term = model.partition(" ")
    more: dict[str, Any] = {}
    if term:
        at = np.random.default_rng(0).normal([0.8, -1.0, 1.0, 2.0], 0.2, (PLACES, 4))
        scattering_term.learned(base, at, {"HH": np.ones(PLACES)}).save(folder / "term.json")
        more["learned_term"] = folder / "term.json"
    return warpsar.Material(
        model=base,
        eps_r=(9.0, -1.5),
        rms_height_m=kh / K,
        correlation_length_m=10.0 * kh / K,
        spectrum="exponential",
        **more,
    )


def nanoseconds(model: str, kh: float, count: int, device: wp.Device) -> float:
    """Of a scatterer: the shortest of some launches."""
    side = 0.5 * SIDE_M
    corners = np.array([[-side, -side, 0.0], [side, -side, 0.0], [side, side, 0.0], [-side, side, 0.0]])
    mesh = warpsar.Mesh.of(corners, np.array([[0, 1, 2], [0, 2, 3]]))
    with tempfile.TemporaryDirectory() as folder:
        made = warpsar.Scene(
            mesh=mesh,
            radar=warpsar.Radar(frequency_hz=FREQUENCY_HZ, polarizations=("HH",), terms=("rough",)),
            grid=warpsar.Grid(shape=(4, 4), spacing_m=(1.0, 1.0)),
            materials={name: material(model, kh, Path(folder)) for name in mesh.materials},
            views=[warpsar.View(name="one", azimuth_deg=0.0, incidence_deg=40.0)],
        )
        body = CoherentBody.of(made, device, spacing_m=SIDE_M / np.sqrt(count))
        worker = places.worker_of(body, K, ("rough",), 1, 1.0)
    place_m = 1e4 * np.array([0.0, np.sin(np.radians(40.0)), np.cos(np.radians(40.0))])
    radar = places.sight(body, place_m)[1]
    assert body.scatterers is not None
    (group,) = body.scatterer_groups
    kernel, more = group.launched(kernels.rough_places_kernel, rough_places_kernel, worker.tables)
    n = body.scatterers.shape[0]
    seen = worker.free(radar, body.scatterer_points, body.scatterer_normals, both_sides=True)
    out = wp.zeros((n, 4), dtype=wp.vec2, device=device)
    clock = time.process_time if device.is_cpu else time.perf_counter
    inputs = [radar, K, body.surfaces, body.variant, body.scatterers, seen, *more]
    found = []
    for _ in range(RUNS):
        wp.synchronize()
        started = clock()
        wp.launch(kernel, n, inputs=inputs, outputs=[out], device=device)
        wp.synchronize()
        found.append(clock() - started)
    return min(found) / n * 1e9


def measure(device_name: str | None, count: int) -> dict[str, Any]:
    device = devices.resolve_device(device_name)
    load_kernels(device)
    names = ("ka_spm", "i2em", "oh", "dubois", "facet", "ka_spm with a term", "i2em with a term")
    times = {name: {str(kh): nanoseconds(name, kh, count, device) for kh in KH} for name in names}
    return {"ns": times, "machine": machine(device_name)}


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device")
    parser.add_argument("--count", type=int, default=10**6)
    options = parser.parse_args()
    result = tables.result_of(options, lambda: measure(options.device, options.count))
    rows = [[f"`{name}`", *(f"{one:.3g}" for one in each.values())] for name, each in result["ns"].items()]
    kind = result["machine"]["device"].partition(":")[0]
    header = (f"ns, {result['machine']['device_name']}", *(f"kh {kh}" for kh in KH))
    tables.publish({f"rough_models.{kind}": tables.markdown(header, rows)}, result, options.write)


if __name__ == "__main__":
    main()
