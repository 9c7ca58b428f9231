"""How far a model of a measured vehicle may go between its train views, and what a measured neighbour owes to speckle.

    cd FOLDER  # a copy of examples/measured/btr70, after all commands of its README
    python benchmarks/measured_ceiling.py FOLDER/diagnosed/scene.toml [--write]

Views of unseen sectors are not looked at. Two chips that are taken from nearly the same azimuth, in one pass, share a
part of their aperture and so their speckle: the grass tells how much. Chips farther apart have speckle of their own.
Two of these that correlate by c, each with the same mean and speckle of its own, correlate with the mean by the root of
c; where their means differ, too, by more. So a model without speckle may reach that root at least.
"""

from __future__ import annotations

from itertools import combinations, pairwise
from typing import Any

import numpy as np
import tables
from scipy.ndimage import binary_dilation

from warpsar import Scene
from warpsar.compare.aim import Reach, best_shift, correlation, roots
from warpsar.compare.prediction import SAME_DEG, in_sector, measured_of, predicted, predictions
from warpsar.compare.rivals import Seen, turn_deg, turned
from warpsar.runtime import devices
from warpsar.world.tables import View

GAPS_DEG = (0.0, 1.5, 3.0, 5.0)  # to the nearest train view
PAIRS_DEG = (0.5, 1.5, 2.5, 3.5, 5.0, 7.0, 9.0)
ON_BODY, SHADOW, AROUND_PX = 3.0, 0.5, 4  # over the median of the model; what is farther is grass


def gap_deg(one: View, other: View) -> float:
    return abs(turn_deg(one.azimuth_deg, other.azimuth_deg))


def of_one_pass(one: View, other: View) -> bool:
    return abs(one.incidence_deg - other.incidence_deg) < SAME_DEG


def by_gap(scene: Scene) -> list[list[Any]]:
    """The model and the neighbours, by how far the nearest train view is and whether it is of the same pass."""
    train = [view for view in scene.views if view.images and view.role == "train"]
    seen = [one for one in predictions({"model": scene}, devices.resolve_device("cpu")) if not one.in_sector]
    rows = []
    for low, high in pairwise(GAPS_DEG):
        for same in (True, False):
            mine = []
            for one in seen:
                near = min(train, key=lambda v: (round(gap_deg(v, one.view), 1), not of_one_pass(v, one.view)))
                if low <= gap_deg(near, one.view) < high + 1e-9 and of_one_pass(near, one.view) is same:
                    mine.append([one.predictions["model"].correlation])
                    mine[-1] += [one.predictions[name].best for name in ("nearest", "smoothed")]
            if len(mine) > 1:
                found = np.array(mine)
                lead = found[:, 0] - found[:, 2]
                error = lead.std(ddof=1) / np.sqrt(len(mine))
                means = (f"{one:.3f}" for one in found.mean(axis=0))
                passes = "the same" if same else "the other"
                rows.append([f"{low:g} to {high:g}", passes, len(mine), *means, f"{lead.mean():+.3f} ± {error:.3f}"])
    return rows


def by_pair(scene: Scene) -> list[list[Any]]:
    """How pairs of chips of one pass correlate, as a whole and where there is grass alone, by how far apart they are.

    Each chip is moved to where the model has the vehicle.
    """
    train = [view for view in scene.views if view.images and view.role == "train"]
    views = [view for view in scene.views if view.images and (view.role == "train" or not in_sector(view, train))]
    reach, spacing, pol = Reach.of(scene), scene.grid.spacing_m, scene.radar.polarizations[0]
    placed: dict[str, Seen] = {}
    grass: dict[str, np.ndarray] = {}
    for view, planes in zip(views, predicted(scene, views, devices.resolve_device("cpu")), strict=True):
        model, power = planes[pol], measured_of(scene, view, pol)
        power = np.nan_to_num(power, nan=float(np.nanmedian(power)))
        back = best_shift(power, model, reach)[1]
        moved = np.roll(power, [-by for by in back], (0, 1))
        placed[view.name] = Seen(view.name, view.azimuth_deg, view.incidence_deg, moved)
        other = (model > ON_BODY * np.median(model)) | (model < SHADOW * np.median(model))
        grass[view.name] = ~binary_dilation(other, iterations=AROUND_PX)

    found: list[tuple[float, float, float]] = []
    for one, two in combinations(views, 2):
        gap = gap_deg(one, two)
        if of_one_pass(one, two) and PAIRS_DEG[0] <= gap < PAIRS_DEG[-1]:
            a, b = placed[one.name], turned(placed[two.name], one.azimuth_deg, spacing)
            lies = Seen("", two.azimuth_deg, two.incidence_deg, grass[two.name] + 1e-9)
            both = grass[one.name] & (turned(lies, one.azimuth_deg, spacing) > 0.9)
            alone = correlation(roots(a.power)[both], roots(b)[both])
            found.append((gap, best_shift(a.power, b, reach)[0], alone))
    numbers = np.array(found)
    rows = []
    for low, high in pairwise(PAIRS_DEG):
        whole, alone = numbers[(numbers[:, 0] >= low) & (numbers[:, 0] < high), 1:].T
        cells = f"{whole.mean():.3f}", f"{alone.mean():.2f}", f"{np.sqrt(whole.mean()):.3f}"
        rows.append([f"{low:g} to {high:g}", whole.size, *cells])
    return rows


def main() -> None:
    parser = tables.parser(__doc__, stored=False)
    parser.add_argument("scene", help="what `diagnose` wrote")
    options = parser.parse_args()
    scene = Scene.load(options.scene)
    gaps = ("nearest train view [deg]", "its pass", "views", "model", "nearest", "the same, smoothed", "over it")
    pairs = ("apart [deg]", "pairs", "correlation", "of grass alone", "its root")
    bodies = {
        "measured_gaps": tables.markdown(gaps, by_gap(scene)),
        "measured_pairs": tables.markdown(pairs, by_pair(scene)),
    }
    tables.publish(bodies, {"made": tables.made()}, options.write)


if __name__ == "__main__":
    main()
