"""A measured flight's geometry over its DEM.

python benchmarks/uavsar_dem.py DATA_FOLDER --out docs/figures/uavsar_dem.png

DATA_FOLDER holds winnipeg.h5 (NASA UAVSAR, L band, HH; its orbit gives azimuth, incidence and slant range) and
winnipeg_dem.tif. The soil is assumed; what the picture shows is the relief of the DEM as that radar would see it.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np

from warpsar import simulate
from warpsar.errors import InputError
from warpsar.formats import registry
from warpsar.measured.placed import dem_frame
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.world.mesh import read_mesh
from warpsar.world.tables import Grid, Material, Radar, Sampling, View

SOIL = {"eps_r": 10.0, "rms_height_m": 0.01, "correlation_length_m": 0.08}  # kh = 0.26, kl = 2.1 at 1.243 GHz
SHAPE, SPACING_M = (200, 300), (20.0, 40.0)  # the DEM reaches under the track: stay on the side that is looked at


def dem_scene(folder: Path) -> Scene:
    """12 x 4 km about the DEM's middle, in strip-map from the flight's track as it passes there."""
    mesh = read_mesh(folder / "winnipeg_dem.tif")
    frame = dem_frame(folder / "winnipeg_dem.tif")
    if frame is None:
        raise InputError(f"{folder / 'winnipeg_dem.tif'}: has no coordinate system")
    reference = np.array([0.0, 0.0, float(np.median(mesh.vertices[:, 2]))])
    facts = registry.read([folder / "winnipeg.h5"], polarization="HH", frame=frame).facts(reference)
    assert facts.azimuth_deg is not None
    assert facts.incidence_deg is not None
    assert facts.frequency_hz is not None
    return Scene(
        mesh=mesh,
        radar=Radar(frequency_hz=facts.frequency_hz, polarizations=("HH",), slant_range_m=facts.slant_range_m),
        grid=Grid(shape=SHAPE, spacing_m=SPACING_M),
        materials={"default": Material(**SOIL)},
        views=[View(name="line", azimuth_deg=facts.azimuth_deg, incidence_deg=facts.incidence_deg)],
        sampling=Sampling(rays_per_pixel=64.0),
        reference_point_m=tuple(reference.tolist()),
    )


def figure(scene: Scene, image: object, path: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    from warpsar.io.images import replacing

    beta0 = image.beta0["HH"]  # type: ignore[attr-defined]
    with np.errstate(divide="ignore"):
        decibel = 10 * np.log10(beta0)
        relief = decibel - 10 * np.log10(np.median(beta0, axis=1, keepdims=True))
    x, y, z = scene.mesh.vertices.T
    view = scene.views[0]
    plot, (left, middle, right) = plt.subplots(1, 3, figsize=(9.0, 3.1), layout="constrained", dpi=64)
    cells = [np.linspace(axis.min(), axis.max(), 120) / 1e3 for axis in (x, y)]
    count, _, _ = np.histogram2d(x / 1e3, y / 1e3, bins=cells)
    height = np.histogram2d(x / 1e3, y / 1e3, bins=cells, weights=z)[0] / count
    shown = left.pcolormesh(*cells, height.T, cmap="terrain", rasterized=True)
    azimuth = np.deg2rad(view.azimuth_deg)
    left.annotate(
        "radar", xy=(0, 0), xytext=(4 * np.sin(azimuth), 4 * np.cos(azimuth)), arrowprops={"arrowstyle": "->"}
    )
    left.set(title="DEM, height [m]", xlabel="east [km]", ylabel="north [km]", aspect="equal")
    plot.colorbar(shown, ax=left, shrink=0.8)
    extent = (*(image.azimuth_m[[0, -1]] / 1e3), *(image.range_m[[-1, 0]] / 1e3))  # type: ignore[attr-defined]
    for panel, values, title, limits in (
        (middle, decibel, "beta0 [dB]", tuple(np.percentile(decibel, [1, 99]))),
        (right, relief, "beta0 over its row's median [dB]", (-2.0, 2.0)),
    ):
        shown = panel.imshow(
            values, extent=extent, aspect="auto", vmin=limits[0], vmax=limits[1], cmap="gray", interpolation="nearest"
        )
        panel.set(title=title, xlabel="azimuth [km]", ylabel="slant range [km]")
        plot.colorbar(shown, ax=panel, shrink=0.8)
    with replacing(path) as temporary:
        plot.savefig(temporary)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("uavsar_dem.png"))
    parser.add_argument("--device")
    options = parser.parse_args()
    scene = dem_scene(options.folder)
    device = devices.resolve_device(options.device)
    started = time.perf_counter()
    (image,) = simulate(scene, device=device.alias, layers=True)
    seconds = time.perf_counter() - started
    figure(scene, image, options.out)
    view, beta0 = scene.views[0], image.beta0["HH"]
    lit = beta0 > 0
    print(
        json.dumps(
            {
                "device": device.alias,
                "faces": len(scene.mesh.faces),
                "azimuth_deg": view.azimuth_deg,
                "incidence_deg": view.incidence_deg,
                "slant_range_m": scene.slant_range_m(view),
                "frequency_hz": scene.radar.frequency_hz,
                "rays": image.rays,
                "hits": image.hits,
                "seconds_image_and_layers": round(seconds, 2),
                "lit_fraction": float(lit.mean()),
                "shadow_pixels": int(image.layers["shadow"].sum()),
                "layover_pixels": int((image.layers["layover"] > 1.5).sum()),
                "mean_beta0_db": float(10 * np.log10(beta0[lit].mean(dtype=float))),
                "local_incidence_deg": [float(v) for v in np.nanpercentile(image.layers["incidence_deg"], [1, 50, 99])],
            },
            indent=1,
        )
    )


if __name__ == "__main__":
    main()
