"""A car's brightest place beside its body: a mirror, a wheel arch or a windscreen's corner that the primitive lacks.

Three numbers of a point are told by images of one incidence: where it lies in range and in azimuth, and its power. A
glint is a small box with these. It stands above the car's roof, where nothing hides it, so its ground position says
where it is seen, not where it is. A car has one where the images gain more by it than its three numbers cost.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from gotcha_cars import GLINT, Seen, kind_of, seen_in

from warpsar.scene.placing import with_objects
from warpsar.scene.scene import Scene
from warpsar.world.objects.table import Object
from warpsar.world.world import geometry_of

SIZE_M, ABOVE_M = (0.3, 0.3, 0.1), 1.7
REACH_M, STEP_M = 3.0, 0.5  # about a car's middle
AROUND = 2  # pixels about a point that are compared
LEVELS = (0.1, 0.3, 1.0, 3.0, 10.0)  # of a tried point, against the brightest modelled pixel about it
LEAST = 3.0  # gain in ln L: one for each number


def gain_at(scene: Scene, seen: Sequence[Seen], place: np.ndarray, shared: float) -> float:
    """What a point of the best of `LEVELS`, seen at `place` on z = 0, gains in ln L; 0 at the image's edge."""
    spread, spacing, shape = scene.effects["point_spread"], scene.grid.spacing_m, scene.grid.shape
    width = (float(spread["range_fwhm_m"]), float(spread["azimuth_fwhm_m"]))
    parts = []
    for each in seen:
        geometry = geometry_of(scene, each.view)
        axes = zip((geometry.d, geometry.u), spacing, shape, strict=True)
        at = [place @ axis / s + n / 2.0 - 0.5 for axis, s, n in axes]
        middle = [round(float(a)) for a in at]
        if any(not AROUND < m < n - 1 - AROUND for m, n in zip(middle, shape, strict=True)):
            return 0.0
        window = np.ix_(*(np.arange(m - AROUND, m + AROUND + 1) for m in middle))
        row, col = (((i - a) * s / w) ** 2 for i, a, s, w in zip(window, at, spacing, width, strict=True))
        point = np.exp(-4.0 * math.log(2.0) * (row + col))
        parts.append((each, window, point))
    best, top = 0.0, max(float(each.model[window].max()) for each, window, _ in parts)
    for level in LEVELS:
        gain = 0.0
        for each, window, point in parts:
            usable, old, measured = each.usable[window], each.model[window], each.measured[window]
            new = old + level * top * point
            gain += each.looks / shared * float((np.log(old / new) + measured / old - measured / new)[usable].sum())
        best = max(best, gain)
    return best


def with_glints(scene: Scene, views: Sequence[str], shared: float = 1.0) -> Scene:
    """The scene with a glint for each car where the residual of the views has one."""
    seen = seen_in(scene, views)
    d = geometry_of(scene, seen[0].view).d
    away = ABOVE_M * -d[2] / float(d[:2] @ d[:2]) * d[:2]  # what stands this high is seen nearer to the radar
    offsets = np.arange(-REACH_M, REACH_M + STEP_M / 2.0, STEP_M)
    glints, materials = [], dict(scene.materials)
    for one in scene.objects:
        if kind_of(one) != "car":
            continue
        places = [np.add(one.position_m, (e, n, 0.0)) for e, n in itertools.product(offsets, offsets)]
        gains = [gain_at(scene, seen, place, shared) for place in places]
        best = int(np.argmax(gains))
        if gains[best] > LEAST:
            east, north = places[best][:2] + away
            name = f"{GLINT}{str(one.name).removeprefix('car')}"
            position = (float(east), float(north), ABOVE_M)
            glints.append(Object(name=name, primitive="box", size_m=SIZE_M, position_m=position, material=name))
            materials[name] = scene.materials[str(one.material)]
    return with_objects(scene, [*scene.objects, *glints], materials)
