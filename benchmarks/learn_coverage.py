"""How honest the intervals of `warpsar learn` are: one scene, many draws of the speckle, how often they hold the truth.

    python benchmarks/learn_coverage.py --out coverage.json [--write]
    python benchmarks/learn_coverage.py --repeats 30 --case hh_incidences

A cube on a plane, both within the domain of small perturbation. Images are drawn with other rays than the fit's, and
four times as many. Without --case all four rows of the table are made.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import tables

from warpsar.learning.command import LearnOptions, learn
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Grid, Material, Radar, Sampling, View

LOOKS = 16.0
RAYS_PER_PIXEL = 64.0
KEYS = ("eps_r", "rms_height_m", "correlation_length_m")
TRUTH = {"ground": (6.0, 0.0008, 0.008), "cube": (10.0, 0.0010, 0.006)}
START = {"ground": (4.5, 0.0010, 0.007), "cube": (14.0, 0.0008, 0.0075)}
# Polarizations, then (azimuth, incidence) [deg] of the views.
CASES = {
    "hh_vv": (("HH", "VV"), ((20.0, 35.0), (140.0, 50.0))),
    "hh_incidences": (("HH",), ((10.0, 25.0), (80.0, 35.0), (150.0, 45.0), (220.0, 55.0), (290.0, 65.0))),
}


def mesh() -> Mesh:
    """A cube of 5 m on a plane of 24 m."""
    import trimesh

    cube = trimesh.creation.box(bounds=((-2.5, -2.5, 0.0), (2.5, 2.5, 5.0)))
    plane = np.array([[-12.0, -12.0, 0.0], [12.0, -12.0, 0.0], [12.0, 12.0, 0.0], [-12.0, 12.0, 0.0]])
    faces = np.concatenate([[[0, 1, 2], [0, 2, 3]], np.asarray(cube.faces) + 4])
    material = np.repeat([0, 1], [2, len(cube.faces)])
    vertices = np.concatenate([plane, np.asarray(cube.vertices)])
    return Mesh(vertices, faces.astype(np.int32), material.astype(np.int32), ("ground", "cube"))


def materials(values: dict[str, tuple[float, ...]]) -> dict[str, Material]:
    return {name: Material(**dict(zip(KEYS, numbers, strict=True))) for name, numbers in values.items()}


def scene_of(case: str) -> Scene:
    polarizations, angles = CASES[case]
    return Scene(
        mesh=mesh(),
        radar=Radar(frequency_hz=9.6e9, polarizations=polarizations),
        grid=Grid(shape=(48, 48), spacing_m=(0.5, 0.5)),
        materials=materials(TRUTH),
        views=[View(name=f"v{i}", azimuth_deg=a, incidence_deg=b, looks=LOOKS) for i, (a, b) in enumerate(angles)],
        sampling=Sampling(rays_per_pixel=RAYS_PER_PIXEL),
    )


def white(random: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    """Gamma speckle of mean 1, independent from pixel to pixel."""
    return random.gamma(LOOKS, 1.0 / LOOKS, shape)


def blurred(random: np.random.Generator, shape: tuple[int, ...], width: float = 1.2) -> np.ndarray:
    """Speckle of a Gaussian point-spread function, `width` pixels (standard deviation of the field's), mean 1."""
    from scipy.ndimage import gaussian_filter

    impulse = np.zeros(shape)
    impulse[0, 0] = 1.0
    power = float((gaussian_filter(impulse, width, mode="wrap") ** 2).sum())
    fields = (gaussian_filter(part, width, mode="wrap") for part in random.normal(size=(2 * int(LOOKS), *shape)))
    return sum((field**2 for field in fields), np.zeros(shape)) / (2 * int(LOOKS) * power)


SPECKLE = {"white": white, "blurred": blurred}
ROWS = (  # case, loss, speckle
    ("hh_vv", "gamma", "white"),
    ("hh_incidences", "gamma", "white"),
    ("hh_vv", "mse", "white"),
    ("hh_vv", "gamma", "blurred"),
)


def with_speckle(start: Scene, clean: list[Any], draw: Callable[[tuple[int, ...]], np.ndarray]) -> Scene:
    """The scene with the clean images times one draw of speckle as its measured ones."""
    views = []
    for view, images in zip(start.views, clean, strict=True):
        seen = {channel: (image * draw(image.shape)).astype(np.float32) for channel, image in images.items()}
        views.append(view.model_copy(update={"images": seen}))
    return replace(start, views=views)


def coverage(
    case: str,
    repeats: int,
    *,
    device: str | None = None,
    loss: str = "gamma",
    seed: int = 0,
    speckle: Callable[[np.random.Generator, tuple[int, ...]], np.ndarray] = white,
) -> dict[str, Any]:
    """Share of 95 % intervals that hold the truth, pooled over the parameters that each fit calls identifiable."""
    truth = scene_of(case)
    density = Sampling(rays_per_pixel=4.0 * RAYS_PER_PIXEL, seed=1)
    clean = [one.beta0 for one in simulate(replace(truth, sampling=density), device=device)]
    start = replace(truth, materials=materials(START))
    true = np.concatenate([[np.log(eps - 1), np.log(h), np.log(length)] for eps, h, length in TRUTH.values()])
    held, errors, deviations, iterations = [], [], [], []
    for repeat in range(repeats):
        random = np.random.default_rng([seed, repeat])
        drawn = with_speckle(start, clean, partial(speckle, random))
        found = learn(drawn, device=device, options=LearnOptions(starts=1, loss=loss))
        assert found.identified is not None
        sd, error = found.identified.sd, found.x - true
        usable = np.array(found.identified.summary()["identifiable"])
        held.append(np.where(usable, np.abs(error) <= 1.96 * sd, np.nan))
        errors.append(error)
        deviations.append(sd)
        iterations.append(len(found.history))
    table = np.array(held, float)
    return {
        "case": case,
        "loss": loss,
        "repeats": repeats,
        "looks": LOOKS,
        "intervals": int(np.isfinite(table).sum()),
        "held_percent": round(100.0 * float(np.nanmean(table)), 2),
        "parameters": {
            label: {
                "identifiable_in": int(np.isfinite(column).sum()),
                "held_percent": round(100.0 * float(np.nanmean(column)), 1) if np.isfinite(column).any() else None,
                "sd_of_errors": round(float(np.std(e)), 4),
                "median_sd_said": round(float(np.median(s)), 4),
                "median_relative_error": round(float(np.median(np.abs(np.expm1(e)))), 4),
            }
            for label, column, e, s in zip(
                found.labels, table.T, np.array(errors).T, np.array(deviations).T, strict=True
            )
        },
        "median_iterations": float(np.median(iterations)),
    }


def table(result: dict[str, Any]) -> str:
    rows = []
    for found in result["runs"]:
        errors = [f"{100 * one['median_relative_error']:.2g}" for one in found["parameters"].values()]
        held = f"{found['held_percent']} % of {found['intervals']}"
        rows.append([found["case"], found["loss"], found["speckle"], held])
        rows[-1] += [", ".join(errors[i : i + 3]) for i in range(0, len(errors), 3)]
    header = ["case", "loss", "speckle", "95 % intervals that hold the truth"]
    header += [f"{name}: median error of eps_r - 1, h, l [%]" for name in TRUTH]
    return tables.markdown(header, rows)


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--case", choices=list(CASES), help="only this one, with --loss and --speckle")
    parser.add_argument("--loss", default="gamma")
    parser.add_argument("--speckle", choices=list(SPECKLE), default="white")
    parser.add_argument("--device")
    options = parser.parse_args()
    if options.case and options.write:
        parser.error("--write is for the whole table: leave --case out")
    if options.source:
        result = tables.stored(options.source)
    else:
        result = {"made": tables.made(), "runs": []}
        for case, loss, speckle in [(options.case, options.loss, options.speckle)] if options.case else ROWS:
            print(f"{case}, {loss}, {speckle}", file=sys.stderr)
            found = coverage(case, options.repeats, device=options.device, loss=loss, speckle=SPECKLE[speckle])
            result["runs"].append(found | {"speckle": speckle})
            tables.save(options.out, result)
    tables.publish({"coverage": table(result)}, result, options.write)


if __name__ == "__main__":
    main()
