"""What the fitted objects of the Gotcha scene say: where they stand, how well that is told, and the survey."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from gotcha_cars import KNOWN, SURFACE, THING, Fitted, Seen, value, with_values

from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Object
from warpsar.world.world import geometry_of

LAGS = 2  # pixels within which speckle is correlated: the point response is no wider
TOLD = 0.5  # of what was known before, below which the images have told a number
TRADES = 0.7  # correlation from which two numbers trade
LINE_M, ALONG_M = 0.34, 0.8
"""Standard deviations of what the straight car cannot say, beside those of its fit. Across: 0.25 m, since its side may
shine anywhere between sill and window line, on ground that need not be at z = 0; and 0.23 m, by which cars fitted to
az001 alone and to az002 alone lie apart beyond what the fits say. Along: a side that bows shines where it faces the
radar, up to 2 m from its middle."""
FOUND_M = 4.0  # between the middles of an object and a surveyed vehicle, at most


def near_side(one: Object, towards: np.ndarray) -> np.ndarray:
    """Ends of the footprint's edge that faces the radar most squarely, (2, 2), east and north [m].

    `towards`: horizontal unit vector to the radar, (2,)."""
    assert one.size_m is not None
    length, width, _ = one.size_m
    heading = math.radians(one.heading_deg)
    front, right = np.array([[math.sin(heading), math.cos(heading)], [math.cos(heading), -math.sin(heading)]])
    sides = [(right, width, front, length), (-right, width, front, length)]
    sides += [(front, length, right, width), (-front, length, right, width)]
    normal, deep, along, wide = max(sides, key=lambda side: float(side[0] @ towards))
    middle = np.array(one.position_m[:2]) + normal * deep / 2.0
    return np.array([middle - along * wide / 2.0, middle + along * wide / 2.0])


def towards_radar(scene: Scene) -> np.ndarray:
    """Horizontal unit vector from the scene to the radar, the mean of the train views, (2,)."""
    mean = -np.mean([geometry_of(scene, view).d[:2] for view in scene.views if view.role == "train"], axis=0)
    return np.asarray(mean / np.linalg.norm(mean))


def correlation_area(seen: Sequence[Seen]) -> float:
    """How many pixels share one speckle: the sum of the residuals' autocorrelation over `LAGS` pixels."""
    sums = []
    for each in seen:
        residual = np.where(each.usable, np.minimum(each.measured / each.model, 10.0), np.nan)
        residual = residual - np.nanmean(residual)
        rows, cols = residual.shape
        total = 0.0
        for i in range(-LAGS, LAGS + 1):
            for j in range(-LAGS, LAGS + 1):
                a = residual[LAGS : rows - LAGS, LAGS : cols - LAGS]
                b = residual[LAGS + i : rows - LAGS + i, LAGS + j : cols - LAGS + j]
                total += float(np.nanmean(a * b) / np.nanmean(residual**2))
        sums.append(total)
    return max(1.0, float(np.mean(sums)))


def covariance(found: Fitted, spread: float) -> tuple[np.ndarray, np.ndarray]:
    """Of the fitted numbers, with what was known before, and that knowledge's standard deviations.

    Information is divided by the pixels that share one speckle, and by the residuals' scatter: what speckle does not
    explain widens the intervals."""
    known = KNOWN if found.object.primitive == "car" else KNOWN | THING
    sd = np.array([known[key] for key in found.keys])
    information = found.information / (spread * max(1.0, found.scatter))
    return np.linalg.inv(information + np.diag(1.0 / sd**2)), sd


def described(found: Fitted, towards: np.ndarray, spread: float) -> dict[str, Any]:
    """An object's entry in gotcha.json; `spread`: pixels that share one speckle."""
    one, keys = found.object, found.keys
    assert one.size_m is not None
    cov, known = covariance(found, spread)
    sd = np.sqrt(np.diag(cov))
    by_key = dict(zip(keys, sd, strict=True))
    side = near_side(one, towards)
    along = (side[1] - side[0]) / np.linalg.norm(side[1] - side[0])
    normal = np.array([along[1], -along[0]])
    ways = np.zeros((len(keys), 2))
    values = {key: value(one, key) for key in keys if key not in SURFACE}
    for k, key in enumerate(values):
        if key in ("heading", "side_curvature"):
            continue  # about the middle of the line, neither moves it to first order
        moved = near_side(with_values(one, {key: values[key] + 1e-3}), towards)
        ways[k] = (moved - side).mean(axis=0) / 1e-3
    line, end = (float(np.sqrt(w @ cov @ w)) for w in (ways @ normal, ways @ along))
    correlation = cov / np.outer(sd, sd)
    return {
        "name": one.name,
        "primitive": one.primitive,
        "position_m": [round(float(p), 3) for p in one.position_m],
        "position_sd_m": [round(float(by_key.get(k, 0.0)), 3) for k in ("east", "north")],
        "heading_deg": round(one.heading_deg, 2),
        "heading_sd_deg": round(float(by_key.get("heading", KNOWN["heading"])), 2) if one.primitive == "car" else None,
        "size_m": [round(float(s), 3) for s in one.size_m],
        "size_sd_m": [
            round(float(s * by_key[k]), 3) if k in by_key else None
            for k, s in zip(("length", "width", "height"), one.size_m, strict=True)
        ],
        "side_curvature": one.side_curvature,
        "near_side_m": [[round(float(c), 3) for c in end] for end in side],
        "near_side_sd_m": round(math.hypot(line, LINE_M), 3),
        "along_sd_m": round(math.hypot(end, ALONG_M), 3),
        "told": [key for key, now, before in zip(keys, sd, known, strict=True) if now < TOLD * before],
        "not_told": [key for key, now, before in zip(keys, sd, known, strict=True) if now >= TOLD * before],
        "trade": [
            [keys[i], keys[j], round(float(correlation[i, j]), 2)]
            for i in range(len(keys))
            for j in range(i)
            if abs(correlation[i, j]) > TRADES
        ],
    }


def turned(degrees: float) -> float:
    """An angle between two lines, from -90 to 90 degrees."""
    return (degrees + 90.0) % 180.0 - 90.0


def beside(truth: Object, said: Mapping[str, Any], towards: np.ndarray) -> dict[str, Any]:
    """What was said of an object less the truth: its near side's line, its place along that, its heading; with the
    standard deviations that were said."""
    theirs, mine = near_side(truth, towards), np.array(said["near_side_m"])
    along = (theirs[1] - theirs[0]) / np.linalg.norm(theirs[1] - theirs[0])
    offset, normal = mine.mean(axis=0) - theirs.mean(axis=0), np.array([along[1], -along[0]])
    return {
        "line_off_m": float(offset @ normal * np.sign(normal @ towards)),
        "line_sd_m": said["near_side_sd_m"],
        "along_off_m": float(offset @ along),
        "along_sd_m": said["along_sd_m"],
        "heading_off_deg": turned(said["heading_deg"] - truth.heading_deg),
        "heading_sd_deg": said["heading_sd_deg"],
    }


def surveyed(path: Path, objects: Sequence[Mapping[str, Any]], towards: np.ndarray) -> list[dict[str, Any]]:
    """Each surveyed vehicle beside the nearest object: the near side's line, and the heading. [] without a file."""
    if not path.exists():
        return []
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    rows = []
    for vehicle in csv.DictReader(lines):
        place = np.array([float(vehicle["x_m"]), float(vehicle["y_m"])])
        truth = Object(
            primitive="box",
            size_m=(float(vehicle["length_m"]), float(vehicle["width_m"]), 1.0),
            position_m=(place[0], place[1], 0.0),
            heading_deg=-turned(float(vehicle["heading_ccw_deg"])),
        )
        nearest = min(objects, key=lambda one: float(np.linalg.norm(np.array(one["position_m"][:2]) - place)))
        apart = float(np.linalg.norm(np.array(nearest["position_m"][:2]) - place))
        row: dict[str, Any] = {"vehicle": vehicle["name"], "object": nearest["name"] if apart < FOUND_M else None}
        if apart < FOUND_M:
            row |= beside(truth, nearest, towards)
        rows.append(row)
    return rows
