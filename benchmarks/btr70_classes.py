"""A recogniser trained on made images alone, and tested on measured chips: does the loop make better training data?

    python benchmarks/btr70_classes.py DATA -o OUT [--jobs N] [--write]

OUT is the folder of btr70.py, whose scenes it needs. Images of the vehicle are made at every `STEP_DEG` of azimuth and
two depressions, by the declared model and by the final one. With speckle and shifts they train a kernel ridge
regression of the aspect. It is asked for the azimuth of every measured test chip, and for the side that faces the
radar. btr70_classes.json has it all.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

sys.path.insert(0, str(Path(__file__).resolve().parent))

import tables
from btr70 import TRAIN, chips_of
from btr70_jobs import Job, done
from btr70_measures import SIZE, SMOOTH, Chip, middle, roots, turn_deg
from btr70_model import SPACING_M, predicted
from measured_loop import written

from warpsar.scene.scene import Scene

STEP_DEG = 3.0
DEPRESSIONS_DEG = (15.0, 17.0)
COPIES = 6  # of each made image, each with its own speckle and shift
SHIFT_PX = ((0, 8), (-4, 2))  # rows and columns by which a chip's target may lie off its middle
POOL = 4  # pixels of a feature
WIDTHS_M = (0.3013, 0.3229)  # of the header: speckle is as wide
RIDGE = 1e-2
Image = NDArray[np.float64]


def made(scene: Path, azimuths_deg: Sequence[float], to: Path) -> dict[str, Any]:
    """Images of a scene at these azimuths and both depressions, in a file of their own."""
    empty = np.zeros((128, 128))
    asked = [Chip(f"a{a:g}_{d:g}", a, d, empty) for a in azimuths_deg for d in DEPRESSIONS_DEG]
    images = predicted(Scene.load(scene), asked)
    to.parent.mkdir(parents=True, exist_ok=True)
    np.savez(to, azimuth=[c.azimuth_deg for c in asked], image=np.stack([images[c.name] for c in asked]))
    return {"file": str(to)}


def speckled(image: Image, draws: np.random.Generator) -> Image:
    """A chip as a radar would give it: speckle of one look, correlated as the widths of the header make it."""
    sigma = [np.sqrt(2.0) / 2.3548 * w / s for w, s in zip(WIDTHS_M, SPACING_M, strict=True)]
    field = [gaussian_filter(draws.standard_normal(image.shape), sigma) for _ in range(2)]
    return np.asarray(image * sum((one / one.std()) ** 2 for one in field) / 2.0)


def feature(power: Image, shift: tuple[int, int] = (0, 0)) -> Image:
    """Fourth roots of smoothed power in the middle of a chip, pooled, without mean and scale; shape (n,)."""
    found = middle(roots(power, SMOOTH[0]), shift)
    pooled = found.reshape(SIZE // POOL, POOL, SIZE // POOL, POOL).mean(axis=(1, 3)).ravel()
    return np.asarray((pooled - pooled.mean()) / pooled.std())


def training_set(images: Image, azimuths_deg: Image, seed: int) -> tuple[Image, Image]:
    """Features of `COPIES` speckled and shifted copies of every image, and their azimuths."""
    draws = np.random.default_rng(seed)
    (top, bottom), (left, right) = SHIFT_PX
    rows = []
    for image in images:
        for _ in range(COPIES):
            shift = (int(draws.integers(top, bottom + 1)), int(draws.integers(left, right + 1)))
            rows.append(feature(speckled(image, draws), shift))
    return np.array(rows), np.repeat(azimuths_deg, COPIES)


def taught(features: Image, azimuths_deg: Image, asked: Image) -> Image:
    """Azimuths [deg] of the features `asked`: kernel ridge regression of the aspect's cosine and sine."""
    aspect = np.radians(azimuths_deg)
    target = np.stack([np.cos(aspect), np.sin(aspect)], axis=1)

    def kernel(a: Image, b: Image) -> Image:
        distance = (a**2).sum(1)[:, None] + (b**2).sum(1) - 2.0 * a @ b.T
        return np.asarray(np.exp(-distance / a.shape[1]))

    weight = np.linalg.solve(kernel(features, features) + RIDGE * np.eye(len(features)), target)
    cosine, sine = (kernel(asked, features) @ weight).T
    return np.asarray(np.degrees(np.arctan2(sine, cosine)))


def marks(found_deg: Image, chips: Sequence[Chip]) -> dict[str, float]:
    """How near azimuths are to the chips' own. Chips within 10 degrees of end-on show no side."""
    off = np.array([abs(turn_deg(a, chip.azimuth_deg)) for a, chip in zip(found_deg, chips, strict=True)])
    side = np.array([np.sin(np.radians(chip.azimuth_deg)) for chip in chips])
    clear = abs(side) > np.sin(np.radians(10.0))
    right = np.sign(np.sin(np.radians(found_deg))) == np.sign(side)
    return {
        "median_error_deg": float(np.median(off)),
        "within_10_deg": float((off < 10.0).mean()),
        "reversed": float((off > 150.0).mean()),
        "side_right": float(right[clear].mean()),
        "chips": len(chips),
    }


def run(data: Path, out: Path, processes: int) -> dict[str, Any]:
    when = tables.made()
    chips = chips_of(data)
    test = [chip for chip in chips if chip.name not in TRAIN]
    train = [chip for chip in chips if chip.name in TRAIN]
    asked = np.array([feature(chip.power) for chip in test])
    content: dict[str, Any] = {"made": when, "trained_on": {}}
    azimuths = np.array_split(np.arange(0.0, 360.0, STEP_DEG), 12)
    for name, scene in (
        ("declared", out / "scene" / "scene.toml"),
        ("final", out / "final" / "scene.toml"),
    ):
        folder = out / "classes" / name
        jobs = [
            Job(folder / f"{k}.json", made, (scene, some.tolist(), folder / f"{k}.npz"))
            for k, some in enumerate(azimuths)
        ]
        done(jobs, processes)
        files = [np.load(folder / f"{k}.npz") for k in range(len(azimuths))]
        images, angles = (np.concatenate([one[key] for one in files]) for key in ("image", "azimuth"))
        content["trained_on"][name] = marks(taught(*training_set(images, angles, 1), asked), test)
    few = np.array([feature(chip.power, (i, j)) for chip in train for i in (-2, 0, 2) for j in (-2, 0, 2)])
    angles = np.repeat([chip.azimuth_deg for chip in train], 9)
    content["trained_on"]["30 measured chips"] = marks(taught(few, angles, asked), test)
    return content


def tables_of(content: dict[str, Any]) -> dict[str, str]:
    head = ("trained on", "median error [deg]", "within 10 deg", "front taken for rear", "side right", "test chips")
    rows = [
        [
            name if name[0].isdigit() else f"images of the {name} model",
            f"{one['median_error_deg']:.1f}",
            *(f"{100.0 * one[key]:.0f} %" for key in ("within_10_deg", "reversed", "side_right")),
            one["chips"],
        ]
        for name, one in content["trained_on"].items()
    ]
    return {"btr70.classes": tables.markdown(head, rows)}


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("data", type=Path, help="folder of public releases")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder of btr70.py")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes side by side; all cores")
    tables.add_write(parser)
    given = parser.parse_args(arguments)
    content = run(given.data, given.out, given.jobs)
    found = tables_of(content)
    written(given.out, "btr70_classes", json.loads(json.dumps(content)), found)
    tables.publish(found, content, given.write)


if __name__ == "__main__":
    main()
