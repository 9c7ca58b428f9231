"""What the chips of the BTR-70 say of things that are known: size, roll and pitch, widths, levels (btr70.py)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from btr70_measures import Chip
from btr70_model import fitted, thinned, with_body, with_effect

from warpsar.scene.scene import Scene

CAD_M = (7.65, 2.66, 2.61)  # length, width, height
CAD_SD = 0.10  # of the CAD's size: its prior
HEADER_DEG = {"roll_deg": -1.18, "pitch_deg": -1.42}
HEADER_M = {"range_fwhm_m": 0.3013, "azimuth_fwhm_m": 0.3229}
# Pixels of speckle that share a draw: spacing 0.20 m, widths 0.30 and 0.32 m.
AREA_PX = 2.4
STEPS = 4  # iterations of a fit where one number of the geometry moved


def minimum(places: Sequence[float], losses: Sequence[float]) -> tuple[float, float]:
    """Where a parabola through the three best of a profile has its least value, and its standard deviation."""
    at, loss = np.array(places), np.array(losses)
    middle = int(np.clip(np.argmin(loss), 1, len(at) - 2))
    a, b, _ = np.polyfit(at[middle - 1 : middle + 2], loss[middle - 1 : middle + 2], 2)
    if a <= 0:
        return float(at[np.argmin(loss)]), float("nan")
    return float(np.clip(-b / (2.0 * a), at.min(), at.max())), float(np.sqrt(AREA_PX / (2.0 * a)))


def profile(scene: Scene, key: str, places: Sequence[Any]) -> list[float]:
    """The loss at each place of one key of the vehicle, all else fitted."""
    return [fitted(with_body(scene, **{key: place}), STEPS)[1] for place in places]


def size(scene: Scene) -> dict[str, Any]:
    """Factors on the CAD's size along, across and up, one after the other, with the CAD to 10 % as their prior."""
    scene = thinned(scene)
    scale, found = [1.0, 1.0, 1.0], {}
    for axis, name in ((2, "height"), (1, "width"), (0, "length")):
        places = (0.82, 0.86, 0.90, 0.95, 1.0) if axis == 2 else (0.94, 1.0, 1.06)
        trials = [(*scale[:axis], place, *scale[axis + 1 :]) for place in places]
        losses = profile(scene, "scale", trials)
        known = [loss + AREA_PX * 0.5 * ((p - 1.0) / CAD_SD) ** 2 for p, loss in zip(places, losses, strict=True)]
        at, sd = minimum(places, known)
        scale[axis] = round(at, 4)
        metres = {"value_m": at * CAD_M[axis], "sd_m": sd * CAD_M[axis]}
        found[name] = metres | {"places": list(places), "losses": losses}
    return {"scale": scale, **found}


def attitude(scene: Scene) -> dict[str, Any]:
    """Roll and pitch by the images alone, beside the header's."""
    scene, found = thinned(scene), {}
    for key, header in HEADER_DEG.items():
        places = (-3.0, -1.5, 0.0, 1.5, 3.0)
        losses = profile(scene, key, places)
        at, sd = minimum(places, losses)
        found[key] = {"value": at, "sd": sd, "header": header, "places": list(places), "losses": losses}
    return found


def widths(scene: Scene) -> dict[str, Any]:
    """Widths of the point spread without a prior, beside the header's."""
    scene = thinned(scene)
    free = with_effect(scene, "point_spread", {**HEADER_M, "window": "taylor"})
    found, loss = fitted(free)
    return {"found": found.effects["point_spread"], "header": HEADER_M, "loss": loss}


def levels(scene: Scene, train: Sequence[Chip]) -> dict[str, Any]:
    """Share of clipped pixels; how far the darkest tenth of the middle lies under the median of the edge, in dB."""
    clipped = [float(np.mean(chip.power >= 255.0**2)) for chip in train]
    below = []
    for chip in train:
        border = np.concatenate([chip.power[:20].ravel(), chip.power[-20:].ravel()])
        blocks = chip.power[24:104, 24:104].reshape(20, 4, 20, 4).mean(axis=(1, 3))
        below.append(10.0 * np.log10(border.mean() / np.percentile(blocks, 5)))
    return {
        "clipped_share": float(np.mean(clipped)),
        "clipped_range": [min(clipped), max(clipped)],
        "shadow_below_grass_db": float(np.median(below)),
        "noise_floor": dict(scene.effects.get("noise_floor", {})),
    }
