"""What may move places: causes of the offset of found from expected ones, along azimuth or slant range [m]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.causes import ALL, LEAST_SPAN_DEG, LEAST_SPAN_YEARS, Cause, Situation
from warpsar.calibration.differences import Differences
from warpsar.calibration.measure import FEWEST_PIXELS, ReflectorObservation

F64 = NDArray[np.float64]
LEAST_SCATTER_M = 0.02
"""From date to date; a choice. Some 0.01 m was reached, with all corrections (Eineder et al., IEEE TGRS 49, 2011)."""
FARTHEST_M = 1e4


def offsets(observations: Sequence[ReflectorObservation], axis: int, allowance_m: float) -> Differences:
    """Of reflectors that are seen, stand, and are surveyed; `axis` is 0 for azimuth, 1 for slant range.

    Places scatter by sqrt(1/3) of what was searched at most: so do peaks that lie anywhere in it.
    """
    used = [one for one in observations if one.offset_m is not None and one.stands and one.site.for_place]
    used = [one for one in used if one.point is not None and one.point.seen and one.expected is not None]
    spacings = [one.spacing_m[axis] for one in used if one.spacing_m is not None]
    searched = max(allowance_m, FEWEST_PIXELS * max(spacings, default=0.0))
    values = [(one.offset_m[axis], one.point.position_sd_m[axis]) for one in used if one.offset_m and one.point]
    return Differences.between(used, values, LEAST_SCATTER_M, searched / np.sqrt(3.0))


def place_causes(data: Differences, axis: int) -> list[Cause]:
    """All that these data could speak of."""
    found = [
        Cause(
            "timing", "the image's timing is off", ("offset [m]",), lambda x, d: np.full(len(d), x[0]), (0.0,),
            (-FARTHEST_M,), (FARTHEST_M,), lambda x, s: float(x[0]), level=ALL,
        )
    ]  # fmt: skip
    if axis == 1 and np.ptp(data.incidence_deg) > LEAST_SPAN_DEG:
        found.append(
            Cause(
                "atmosphere", "the path through the atmosphere is longer", ("at zenith [m]",),
                lambda x, d: x[0] / np.cos(np.deg2rad(d.incidence_deg)), (0.0,), (0.0,), (100.0,),
                lambda x, s: float(x[0] / np.cos(np.deg2rad(s.incidence_deg))),
            )
        )  # fmt: skip
    if np.ptp(data.years) > LEAST_SPAN_YEARS and len(data) > 4:
        middle = float(data.years.mean())
        found.append(
            Cause(
                "timing drift", "the image's timing drifts", ("offset [m]", "drift [m/year]"),
                lambda x, d: x[0] + x[1] * (d.years - middle), (0.0, 0.0), (-FARTHEST_M, -FARTHEST_M),
                (FARTHEST_M, FARTHEST_M), lambda x, s: float(x[0] + x[1] * (s.years - middle)), level=ALL,
            )
        )  # fmt: skip
    return found + [_place(i, name) for i, name in enumerate(data.names)]


def _place(i: int, name: str) -> Cause:
    return Cause(
        f"place of {name}", f"{name} is not where it was surveyed", ("offset [m]",),
        lambda x, d: np.where(d.site == i, x[0], 0.0), (0.0,), (-FARTHEST_M,), (FARTHEST_M,),
        lambda x, s: float(x[0]) if s.site == name and not s.attitude_surveyed else 0.0, level=(f"site {i}", 0),
    )  # fmt: skip


def place_situations(data: Differences) -> list[Situation]:
    """What could be measured next."""
    now, angle, look = float(data.years.max()), float(data.incidence_deg.mean()), data.look[-1]
    found = [
        Situation("another surveyed reflector in the same image", None, angle, now, look),
        Situation("another surveyed reflector, at an incidence 8 degrees higher", None, angle + 8.0, now, look),
        Situation("another surveyed reflector, in an image of a year later", None, angle, now + 1.0, look),
    ]
    return found + [
        Situation(f"{name} surveyed anew", name, angle, now, look, attitude_surveyed=True) for name in data.names
    ]
