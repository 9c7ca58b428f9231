"""A recogniser trained on made images alone, and tested on measured chips: does the loop make better training data?

    python benchmarks/btr70_classes.py DATA -o OUT [--jobs N] [--write]

OUT is the folder of btr70.py, whose scenes it needs. Images of the vehicle are made at every `STEP_DEG` of azimuth and
two depressions, by the declared model and by the final one. They are the templates of a matcher. It is asked for the
azimuth of every measured test chip, and for the side that faces the radar. btr70_classes.json has it all.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parent))

import tables
from btr70 import TRAIN, chips_of
from btr70_jobs import Job, done
from btr70_measures import SIZE, SMOOTH, Chip, middle, roots, turn_deg
from btr70_model import predicted
from measured_loop import written

from warpsar.runtime.threads import thread_count
from warpsar.scene.scene import Scene

STEP_DEG = 3.0
DEPRESSIONS_DEG = (15.0, 17.0)
REACH_PX = 8  # by which a target may lie off the middle of its chip, in both directions
POOL = 2  # pixels of a feature
Image = NDArray[np.float64]


def made(scene: Path, azimuths_deg: Sequence[float], to: Path) -> dict[str, Any]:
    """Images of a scene at these azimuths and both depressions, in a file of their own."""
    empty = np.zeros((128, 128))
    asked = [Chip(f"a{a:g}_{d:g}", a, d, empty) for a in azimuths_deg for d in DEPRESSIONS_DEG]
    images = predicted(Scene.load(scene), asked)
    to.parent.mkdir(parents=True, exist_ok=True)
    np.savez(to, azimuth=[c.azimuth_deg for c in asked], image=np.stack([images[c.name] for c in asked]))
    return {"file": str(to)}


def feature(power: Image, shift: tuple[int, int] = (0, 0)) -> Image:
    """Fourth roots of smoothed power in the middle of a chip, pooled, of mean 0 and norm 1; shape (n,)."""
    found = middle(roots(power, SMOOTH[0]), shift)
    pooled = found.reshape(SIZE // POOL, POOL, SIZE // POOL, POOL).mean(axis=(1, 3)).ravel()
    pooled = pooled - pooled.mean()
    return np.asarray(pooled / np.linalg.norm(pooled))


def matched(images: Image, azimuths_deg: Image, asked: Image) -> Image:
    """Azimuth [deg] of the template that correlates best with each feature of `asked`, over all shifts."""
    steps = range(-REACH_PX, REACH_PX + 1, POOL)
    scores = [
        np.max(asked @ np.array([feature(image, (i, j)) for i in steps for j in steps]).T, axis=1) for image in images
    ]
    return np.asarray(azimuths_deg[np.argmax(scores, axis=0)])


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
        content["trained_on"][name] = marks(matched(images, angles, asked), test)
    images, angles = np.array([chip.power for chip in train]), np.array([chip.azimuth_deg for chip in train])
    content["trained_on"]["30 measured chips"] = marks(matched(images, angles, asked), test)
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
    parser.add_argument("--jobs", type=int, default=thread_count(), help="processes side by side; all cores")
    tables.add_write(parser)
    given = parser.parse_args(arguments)
    content = run(given.data, given.out, given.jobs)
    found = tables_of(content)
    written(given.out, "btr70_classes", json.loads(json.dumps(content)), found)
    tables.publish(found, content, given.write)


if __name__ == "__main__":
    main()
