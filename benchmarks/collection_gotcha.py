"""AFRL's Gotcha beside a simulation of its geometry: four surveyed vehicles and two reflectors, focused by one code.

    python benchmarks/collection_gotcha.py DATA [--views az001 az002 az003] [--device cuda] [--rays 10]
    [--out collection_gotcha.json] [--figures docs/figures] [--write]

DATA holds gotcha/ of the public releases. The track and the band are those of the measured files. The scene is a level
plane of asphalt with primitive cars of the surveyed footprints (conductors; heights are guesses) and two
trihedrals where the measured images show reflectors. Both phase histories go through `measured.focus` onto z = 0.

The data have no calibration, and the survey has no heights and no reflectors. So one gain is fitted: the median of the
four vehicles' energies. What is compared is then the place of each target's energy, the reflectors' widths, and levels
among targets. `--rays`: tubes in a wavelength; 4 is a trial.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent))

import numpy as np
import tables

import warpsar
from warpsar.collection.command import load_kernels
from warpsar.collection.history import phase_history
from warpsar.collection.plan import plan_of
from warpsar.collection.scatterers import body_of, scatterers_of, spacing_m
from warpsar.formats import registry
from warpsar.formats.base.data import PhaseHistory
from warpsar.io.figures import new, save
from warpsar.io.ply import write_ply
from warpsar.measured.focus import focus
from warpsar.runtime import devices

HEIGHTS_M = {"ChevyMalibu": 1.46, "ToyotaCamry": 1.49, "CASEtractor": 2.6, "HyundaiSantaFe": 1.68}
HALF_M = 4.5
STEP_M = 0.06
VEHICLE = {"ChevyMalibu": "car", "ToyotaCamry": "car", "CASEtractor": "truck", "HyundaiSantaFe": "car"}
REFLECTORS = {
    (-15.61, 21.61): 0.41,
    (-27.81, 38.83): 0.29,
}  # corner: leg [m], as in examples/measured/gotcha/ground.obj


def history(data: Path, name: str) -> PhaseHistory:
    found = registry.read([data / "gotcha" / f"data_3dsar_pass1_{name}_HH.mat"])
    assert isinstance(found, PhaseHistory)
    return found


def targets(data: Path) -> list[dict[str, Any]]:
    """The surveyed vehicles, and the reflectors that the measured images show."""
    with (data / "gotcha" / "surveyed_vehicles.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    found = [
        {
            "name": row["name"],
            "place_m": [float(row["x_m"]), float(row["y_m"])],
            "size_m": [float(row["length_m"]), float(row["width_m"]), HEIGHTS_M[row["name"]]],
            "heading_deg": -float(row["heading_ccw_deg"]) % 360.0,
            "primitive": VEHICLE[row["name"]],
        }
        for row in rows
    ]
    for index, (place, leg) in enumerate(REFLECTORS.items(), 1):
        found.append(
            {"name": f"reflector {index}", "place_m": list(place), "size_m": [leg] * 3, "primitive": "trihedral"}
        )
    return found


def scene_of(folder: Path, measured: PhaseHistory, bodies: list[dict[str, Any]], name: str) -> warpsar.Scene:
    """The scene file and the track of a measured file, in `folder`; the scene."""
    track = folder / f"{name}.csv"
    rows = [f"{i / 2000:.6f},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(measured.position_m.tolist())]
    track.write_text("time_s,x_m,y_m,z_m\n" + "\n".join(rows) + "\n", encoding="utf-8")
    facts = measured.facts(np.zeros(3))
    start, step = float(measured.frequency_start_hz[0]), float(measured.frequency_step_hz[0])
    count = measured.samples.shape[0]
    text = f"""
[scene]
mesh = "ground.ply"
[radar]
frequency_hz = {measured.centre_frequency_hz!r}
polarizations = ["HH"]
terms = ["single", "multibounce", "edges"]
max_bounces = 6
[image]
shape = [220, 120]
spacing_m = [0.25, 0.9]
[materials.default]
eps_r = [4.5, -0.3]
rms_height_m = 0.0012
correlation_length_m = 0.01
[materials.body]
conductor = true
[collection]
mode = "file"
trajectory = "{track.name}"
start_hz = {start - 0.5 * step!r}
stop_hz = {start + (count - 0.5) * step!r}
frequencies = {count}
window = "none"
[[views]]
name = "{name}"
azimuth_deg = {facts.azimuth_deg}
incidence_deg = {facts.incidence_deg}
"""
    for one in bodies:
        x, y = one["place_m"]
        corner = one["primitive"] == "trihedral"
        heading = float(facts.azimuth_deg or 0.0) if corner else one["heading_deg"]
        if corner:  # its corner lies behind its foot's middle
            away = np.deg2rad(heading)
            x, y = x + 0.5 * one["size_m"][0] * np.sin(away), y + 0.5 * one["size_m"][0] * np.cos(away)
        text += f"""
[[objects]]
name = "{one["name"].replace(" ", "_")}"
primitive = "{one["primitive"]}"
size_m = {one["size_m"]}
position_m = [{float(x)!r}, {float(y)!r}, 0.002]
heading_deg = {float(heading)!r}
material = "body"
"""
    side = 48.0
    corners = np.array([[-side, -side, 0], [side, -side, 0], [side, side, 0], [-side, side, 0]])
    write_ply(folder / "ground.ply", corners, np.array([[0, 1, 2], [0, 2, 3]]), {})
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return warpsar.Scene.load(path)


def simulated(data: Path, name: str, bodies: list[dict[str, Any]], device: str | None, rays: float) -> PhaseHistory:
    """The phase history of the scene along the measured file's track, in its band."""
    measured = history(data, name)
    where = devices.resolve_device(device)
    load_kernels(where)
    with tempfile.TemporaryDirectory() as folder:
        scene = scene_of(Path(folder), measured, bodies, name)
        plan = plan_of(scene, scene.views[0], where)
        found = scatterers_of(scene, plan, body_of(scene, spacing_m(plan), where, 0), rays_per_wavelength=rays)
        print(f"{name}: {found.count} scatterers, {len(plan.track)} pulses", file=sys.stderr, flush=True)
        return phase_history(plan, found, ("HH",), where).history("HH")


def chip(seen: PhaseHistory, place: list[float], device: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Power on z = 0 about a place, (n, n), east along rows; and the offsets [m]. The radar is in the east."""
    along = np.arange(-HALF_M, HALF_M + STEP_M / 2, STEP_M)
    points = np.zeros((along.size, along.size, 3))
    points[..., 0], points[..., 1] = place[0] + along[:, None], place[1] + along[None, :]
    (image,) = focus(seen, points, reference_point_m=np.zeros(3), window_range="hann", device=device)
    return np.abs(image.astype(complex)) ** 2, along


def half_power_width(profile: np.ndarray) -> float:
    """Full width at half maximum [m] of a peak sampled in STEP_M, from its largest sample, linear in between."""
    peak = int(np.argmax(profile))
    half = profile[peak] / 2.0
    ends = []
    for side in (profile[peak:], profile[peak::-1]):
        k = int(np.argmax(side < half))
        ends.append(k - 1 + (side[k - 1] - half) / (side[k - 1] - side[k]))
    return float(sum(ends) * STEP_M)


def described(power: np.ndarray, along: np.ndarray, floor: float) -> dict[str, Any]:
    """Energy above a floor, its centroid (east, north) [m], the peak's place [m], and widths through it [m]."""
    over = np.maximum(power - floor, 0.0)
    peak = np.unravel_index(power.argmax(), power.shape)
    total = over.sum()
    return {
        "energy": float(total * STEP_M**2),
        "centroid_m": [float((over.sum(axis=axis) * along).sum() / total) for axis in (1, 0)],
        "peak": float(power.max()),
        "peak_m": [float(along[peak[0]]), float(along[peak[1]])],
        "widths_m": [half_power_width(power[:, peak[1]]), half_power_width(power[peak[0]])],
    }


def compare(data: Path, name: str, device: str | None, rays: float, figures: Path | None) -> list[dict[str, Any]]:
    bodies = targets(data)
    own, other = simulated(data, name, bodies, device, rays), history(data, name).with_autofocus()
    rows, pictures = [], []
    for one in bodies:
        left, along = chip(other, one["place_m"], device)
        right, _ = chip(own, one["place_m"], device)
        floor = float(np.median(left))
        rows.append(
            {
                "view": name,
                "target": one["name"],
                "measured": described(left, along, 2.0 * floor),
                "simulated": described(right, along, 0.0),
                "clutter": floor,
            }
        )
        pictures.append((one["name"], left, right))
    vehicles = [row for row in rows if not row["target"].startswith("reflector")]
    gain = float(np.median([row["measured"]["energy"] / row["simulated"]["energy"] for row in vehicles]))
    for row in rows:
        row["gain"] = gain
    if figures is not None:
        picture(figures / "collection_gotcha.png", pictures, gain)
    return rows


def picture(path: Path, pictures: list[tuple[str, np.ndarray, np.ndarray]], gain: float) -> None:
    """Measured above, simulated below, in dB of the brightest measured pixel of each."""
    figure, axes = new(2.1 * len(pictures), 4.6, nrows=2, ncols=len(pictures))
    for column, (name, left, right) in enumerate(pictures):
        top = left.max()
        for axis, power in zip(np.asarray(axes)[:, column], (left, gain * right), strict=True):
            level = 10.0 * np.log10(np.maximum(power / top, 1e-9))
            axis.imshow(level.T, origin="lower", extent=[-HALF_M, HALF_M] * 2, vmin=-35, vmax=0, cmap="gray")
            axis.tick_params(labelsize=6)
        np.asarray(axes)[0, column].set_title(name, fontsize=8)
    np.asarray(axes)[0, 0].set_ylabel("measured\nnorth [m]", fontsize=7)
    np.asarray(axes)[1, 0].set_ylabel("simulated\nnorth [m]", fontsize=7)
    for axis in np.asarray(axes)[1]:
        axis.set_xlabel("east [m]", fontsize=7)
    save(figure, path)


def line(row: dict[str, Any]) -> tuple[Any, ...]:
    one, other = row["measured"], row["simulated"]
    level = 10.0 * np.log10(row["gain"] * other["energy"] / one["energy"])
    apart = np.subtract(other["centroid_m"], one["centroid_m"])
    peaks = np.subtract(other["peak_m"], one["peak_m"])
    widths = [f"{a:.2f} x {b:.2f}" for a, b in (one["widths_m"], other["widths_m"])]
    return (row["view"], row["target"], f"{apart[0]:+.2f}, {apart[1]:+.2f}", f"{peaks[0]:+.2f}, {peaks[1]:+.2f}",
            *(widths if row["target"].startswith("reflector") else ("", "")), f"{level:+.1f}")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--views", nargs="+", default=["az001"])
    parser.add_argument("--device")
    parser.add_argument("--rays", type=float, default=10.0)
    parser.add_argument("--figures", type=Path)
    tables.add_options(parser)
    options = parser.parse_args()
    if options.source:
        result = tables.stored(options.source)
    else:
        kept = options.out is not None and options.out.exists()
        result = json.loads(options.out.read_text(encoding="utf-8")) if kept else {"rows": []}
        for name in options.views:
            if not any(row["view"] == name for row in result["rows"]):
                figures = options.figures if name == options.views[0] else None
                result["rows"] += compare(options.data, name, options.device, options.rays, figures)
                result |= {"made": tables.made(), "rays_per_wavelength": options.rays}
                tables.save(options.out, result)
    header = ("view", "target", "centroid, simulated - measured: east, north [m]", "peak, the same [m]",
              "widths measured: range, azimuth [m]", "simulated [m]", "energy, simulated / measured [dB]")  # fmt: skip
    body = tables.markdown(header, map(line, result["rows"]))
    tables.publish({"collection.gotcha": body}, result, options.write)


if __name__ == "__main__":
    main()
