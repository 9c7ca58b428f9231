"""Causes of a difference between measured and predicted RCS, and what each makes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.attitude import Facing, trihedral_rcs_m2
from warpsar.calibration.differences import Differences, pass_numbers

F64 = NDArray[np.float64]
MOST_TURN_DEG = 25.0
TURNS_DEG = np.linspace(-MOST_TURN_DEG, MOST_TURN_DEG, 17)
LEAST_SPAN_DEG, LEAST_SPAN_YEARS = 0.5, 0.05
"""Of incidence and of time, for what changes with them."""


@dataclass(frozen=True)
class Situation:
    """A measurement that could be made next, of which each cause says what it would show."""

    words: str
    site: str | None
    """The reflector that is measured; None: another one, of surveyed size and attitude."""
    incidence_deg: float
    years: float
    look: F64
    cleaned: bool = False
    leg_surveyed: bool = False
    attitude_surveyed: bool = False


Curve = Callable[[F64, Differences], F64]
"""Of parameters: the difference that a cause makes [dB], (n,)."""


@dataclass(frozen=True)
class Cause:
    """A cause, and what it makes of the difference for any value of its parameters."""

    name: str
    title: str
    parameters: tuple[str, ...]
    """With their units."""
    curve: Curve
    start: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    at: Callable[[F64, Situation], float]
    """What it predicts of a measurement that could be made [dB]."""
    physical: bool = True
    level: tuple[str, int] | None = None
    """What its parameter of this number shifts as a whole: "all", or "site 3". Of two causes one can say it."""
    linear: bool = True
    """In its parameters."""
    grid: tuple[tuple[float, ...], ...] = ()
    """Parameters among which a fit finds its start, of a curve with several hills."""
    places: tuple[float, ...] = ()
    """Of the last parameter, which is held: all values among which it was found."""


ALL = ("all", 0)


def _of_site(i: int) -> tuple[str, int]:
    return f"site {i}", 0


def causes(data: Differences) -> list[Cause]:
    """All that these data could speak of."""
    found = [_constant(), _none(), _levels(data)]
    if np.ptp(data.incidence_deg) > LEAST_SPAN_DEG:
        found.append(_pattern(float(data.incidence_deg.mean())))
    if np.ptp(data.years) > LEAST_SPAN_YEARS and len(data) > 4:
        found.append(_drift(float(data.years.mean())))
    for i, name in enumerate(data.names):
        here = data.site == i
        if not here.any():
            continue
        found += [_loss(i, name), _size(i, name, data), _attitude(i, name, data), *_over_time(i, name, data)]
    return found


def changes(data: Differences) -> list[Cause]:
    """Those that need no prediction: levels, and what changes them with time."""
    found = [_levels(data)]
    for i, name in enumerate(data.names):
        found += _over_time(i, name, data)
    return found


def _over_time(i: int, name: str, data: Differences) -> list[Cause]:
    here = data.site == i
    if here.sum() <= 4 or np.ptp(data.years[here]) <= LEAST_SPAN_YEARS:
        return []
    return [_decay(i, name, data), _step(i, name, data)]


def _none() -> Cause:
    return Cause(
        "none", "nothing: prediction and image agree", (), lambda x, data: np.zeros(len(data)), (), (), (),
        lambda x, s: 0.0, physical=False,
    )  # fmt: skip


def _levels(data: Differences) -> Cause:
    """The rival that knows no physics."""
    looks = data.looks
    count = len(looks)

    def curve(x: F64, d: Differences) -> F64:
        which = pass_numbers(looks, d)
        return np.where(which < 0, x.mean(), x[which])

    return Cause(
        "levels",
        "no cause: a level of its own for each reflector and pass",
        tuple(f"level {k + 1} [dB]" for k in range(count)),
        curve,
        (0.0,) * count,
        (-200.0,) * count,
        (200.0,) * count,
        lambda x, s: float(x.mean()),
        physical=False,
    )


def _constant() -> Cause:
    return Cause(
        "calibration constant",
        "the image's calibration constant is off",
        ("constant [dB]",),
        lambda x, data: np.full(len(data), x[0]),
        (0.0,),
        (-200.0,),
        (200.0,),
        lambda x, s: float(x[0]),
        level=ALL,
    )


def _pattern(middle: float) -> Cause:
    return Cause(
        "antenna pattern",
        "the antenna's pattern over range is not the one that was corrected",
        ("constant [dB]", "slope [dB/deg]"),
        lambda x, data: x[0] + x[1] * (data.incidence_deg - middle),
        (0.0, 0.0),
        (-200.0, -20.0),
        (200.0, 20.0),
        lambda x, s: float(x[0] + x[1] * (s.incidence_deg - middle)),
        level=ALL,
    )


def _drift(middle: float) -> Cause:
    return Cause(
        "gain drift",
        "the radar's gain drifts",
        ("constant [dB]", "drift [dB/year]"),
        lambda x, data: x[0] + x[1] * (data.years - middle),
        (0.0, 0.0),
        (-200.0, -100.0),
        (200.0, 100.0),
        lambda x, s: float(x[0] + x[1] * (s.years - middle)),
        level=ALL,
    )


def _loss(i: int, name: str) -> Cause:
    return Cause(
        f"loss at {name}",
        f"water, dirt or a bent plate take power from {name}",
        ("loss [dB]",),
        lambda x, data: np.where(data.site == i, -x[0], 0.0),
        (0.1,),
        (0.0,),
        (60.0,),
        lambda x, s: -float(x[0]) if s.site == name and not s.cleaned else 0.0,
        level=_of_site(i),
    )


def _leg(data: Differences, i: int) -> float:
    one = data.observations[int(np.flatnonzero(data.site == i)[0])]
    assert one.site.leg_m is not None
    return one.site.leg_m


def _size(i: int, name: str, data: Differences) -> Cause:
    leg = _leg(data, i)
    return Cause(
        f"size of {name}",
        f"the legs of {name} are not {leg:g} m long",
        ("leg [m]",),
        lambda x, d: np.where(d.site == i, 40.0 * np.log10(x[0] / leg), 0.0),
        (leg,),
        (0.3 * leg,),
        (3.0 * leg,),
        lambda x, s: float(40.0 * np.log10(x[0] / leg)) if s.site == name and not s.leg_surveyed else 0.0,
        level=_of_site(i),
        linear=False,
    )


def _attitude(i: int, name: str, data: Differences) -> Cause:
    """The device turned and tilted as a whole: what raises one facing lowers the one that looks the other way."""
    first = data.observations[int(np.flatnonzero(data.site == i)[0])]
    assert first.facing is not None
    front, shape = first.facing.azimuth_deg, first.site.shape

    def turned(x: F64, facing: Facing) -> Facing:
        share = float(np.cos(np.deg2rad(facing.azimuth_deg - front)))
        return Facing(facing.azimuth_deg + x[0], facing.tilt_deg + share * x[1], facing.flipped)

    def change(x: F64, facing: Facing, looks: F64) -> F64:
        areas = [trihedral_rcs_m2(shape, 1.0, one, looks, 1.0) for one in (turned(x, facing), facing)]
        return np.asarray(10.0 * np.log10(np.maximum(areas[0], 1e-9) / np.maximum(areas[1], 1e-9)))

    known: dict[int, tuple[Differences, list[tuple[Facing, NDArray[np.int64]]]]] = {}

    def groups(d: Differences) -> list[tuple[Facing, NDArray[np.int64]]]:
        """Facings of this reflector, and the values that each has."""
        if id(d) not in known:
            found: dict[Facing, list[int]] = {}
            for k in np.flatnonzero(d.site == i).tolist():
                facing = d.observations[k].facing
                assert facing is not None
                found.setdefault(facing, []).append(k)
            known[id(d)] = d, [(facing, np.array(ks)) for facing, ks in found.items()]
        return known[id(d)][1]

    def curve(x: F64, d: Differences) -> F64:
        found = np.zeros(len(d))
        for facing, ks in groups(d):
            found[ks] = change(x, facing, d.look[ks])
        return found

    def at(x: F64, s: Situation) -> float:
        if s.site != name or s.attitude_surveyed:
            return 0.0
        facing = first.site.facing(s.look) or first.facing
        assert facing is not None
        return float(change(x, facing, s.look))

    return Cause(
        f"attitude of {name}",
        f"{name} does not stand as it was surveyed",
        ("turn in azimuth [deg]", "tilt [deg]"),
        curve,
        (0.1, 0.1),
        (-MOST_TURN_DEG, -MOST_TURN_DEG),
        (MOST_TURN_DEG, MOST_TURN_DEG),
        at,
        linear=False,
        grid=tuple((float(a), float(b)) for a in TURNS_DEG for b in TURNS_DEG),
    )


def _decay(i: int, name: str, data: Differences) -> Cause:
    start = float(data.years[data.site == i].min())
    return Cause(
        f"fading of {name}",
        f"{name} loses power with time: dirt, a slow turn or tilt",
        ("constant [dB]", "change [dB/year]"),
        lambda x, d: np.where(d.site == i, x[0] + x[1] * (d.years - start), 0.0),
        (0.0, 0.0),
        (-60.0, -500.0),
        (60.0, 500.0),
        lambda x, s: float(x[0] + x[1] * (s.years - start)) if s.site == name and not s.cleaned else 0.0,
        level=_of_site(i),
    )


def _step(i: int, name: str, data: Differences) -> Cause:
    """The best place of the step is found within the curve: it costs a parameter, as the two levels do."""
    years = np.unique(data.years[data.site == i])
    middles = 0.5 * (years[1:] + years[:-1])

    def curve(x: F64, d: Differences) -> F64:
        return np.where(d.site == i, np.where(d.years > x[2], x[1], x[0]), 0.0)

    best, lowest = float(middles[0]), np.inf
    here = data.site == i
    weights = 1.0 / (data.sd[here] ** 2 + data.least_scatter**2)
    for middle in middles.tolist():
        left = 0.0
        for side in (data.years[here] <= middle, data.years[here] > middle):
            mean = np.average(data.value[here][side], weights=weights[side])
            left += float((weights[side] * (data.value[here][side] - mean) ** 2).sum())
        if left < lowest:
            best, lowest = middle, left
    before, after = data.days[here & (data.years <= best)].max(), data.days[here & (data.years > best)].min()
    return Cause(
        f"step of {name}",
        f"{name} was moved, damaged or repaired once, after {before} and not later than {after}",
        ("before [dB]", "after [dB]", "year of the step, from the first date"),
        curve,
        (0.0, 0.0, best),
        (-60.0, -60.0, best),
        (60.0, 60.0, best),
        lambda x, s: float(x[1]) if s.site == name else 0.0,
        level=_of_site(i),
        places=tuple(middles.tolist()),
    )
