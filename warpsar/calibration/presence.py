"""Whether a reflector stands at each date, and where one is whose place is not known.

A place is sought by a step of power that lasts. Clutter at a place has an exponential power, of `looks` averaged ones a
gamma; its level differs from place to place, as an inverse gamma whose width the image itself shows. The mean of later
dates over the level that earlier dates and the image make likely is then F distributed (Smyth 2004, Statistical
Applications in Genetics and Molecular Biology 3(1), 3, for variances).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import shift
from scipy.optimize import brentq
from scipy.special import digamma, fdtrc, polygamma, stdtr, stdtrit

from warpsar.calibration.differences import SAME_PASS
from warpsar.calibration.measure import ReflectorObservation, responses
from warpsar.calibration.sites import VALID_PLACE, ReflectorSite
from warpsar.errors import InputError
from warpsar.products.product import ImagedPoint, Product, Radiometry, to_beta0

F64 = NDArray[np.float64]
FALSE_RATE = 0.01
"""Chance that clutter alone shows such a change somewhere among all places and dates that are tried."""
CONFIDENCE = 0.9
MOST_PIXELS = 4_000_000
MOST_FREEDOM = 200.0
"""Of clutter's level: more is one level for all."""


@dataclass(frozen=True)
class Change:
    """Power that rises once and stays: `first` is the earliest date after it."""

    first: int
    ratio: float
    """Mean power after over mean power before."""
    likely: tuple[int, int]
    """The least and the largest `first` of the set that holds the true one in 90 %."""


def step_of(power: F64, looks: float) -> Change:
    """The most likely rise of a series of powers (n,), n >= 2.

    With m0 and m1 the means before and after, m that of all, n0 and n1 their numbers, a step has the log-likelihood
    looks (n ln m - n0 ln m0 - n1 ln m1) over none: gamma distributions of unknown means.
    """
    count = power.size
    before = np.arange(1, count)
    total = np.cumsum(np.maximum(power, 1e-300))
    early, late = total[:-1] / before, (total[-1] - total[:-1]) / (count - before)
    late = np.maximum(late, 1e-300)
    gain = looks * (count * np.log(total[-1] / count) - before * np.log(early) - (count - before) * np.log(late))
    gain = np.where(late > early, gain, -np.inf)
    if not np.isfinite(gain).any():
        return Change(1, float(late[0] / early[0]), (1, count - 1))
    posterior = np.exp(gain - gain.max())
    order = np.argsort(posterior)[::-1]
    held = np.cumsum(posterior[order]) / posterior.sum()
    kept = order[: int(np.searchsorted(held, CONFIDENCE)) + 1] + 1
    first = int(gain.argmax()) + 1
    return Change(first, float(late[first - 1] / early[first - 1]), (int(kept.min()), int(kept.max())))


def levels(mean: F64, looks: float) -> tuple[float, float]:
    """Degrees of freedom and scale of clutter's level over an image, of its mean over dates, of so many looks each.

    The spread of the logarithm beyond that of the looks is trigamma(freedom / 2). Quartiles are used, so that bright
    targets count little.
    """
    low, middle, high = np.percentile(np.log(np.maximum(mean, 1e-300)), [25.0, 50.0, 75.0])
    beyond = ((high - low) / 1.349) ** 2 - float(polygamma(1, looks))
    freedom = MOST_FREEDOM
    if beyond > float(polygamma(1, 0.5 * MOST_FREEDOM)):
        freedom = 2.0 * float(brentq(lambda half: float(polygamma(1, half)) - beyond, 1e-3, 0.5 * MOST_FREEDOM))
    half = 0.5 * freedom
    return freedom, float(np.exp(middle - (digamma(looks) - np.log(looks)) + digamma(half) - np.log(half)))


def rise(power: F64, looks: float, tried: float) -> tuple[int, Change, float]:
    """The place of the most significant rise in series (n, m), n >= 2, and the chance that clutter has it.

    `tried`: how many of the m places are independent.
    """
    count = power.shape[0]
    freedom, scale = levels(power.mean(axis=0), looks * count)
    total = np.cumsum(power, axis=0)
    best = (0, 1.0)
    for before in range(1, count):
        own = 2.0 * looks * before
        level = (freedom * scale + own * total[before - 1] / before) / (freedom + own)
        ratio = (total[-1] - total[before - 1]) / (count - before) / level
        place = int(ratio.argmax())
        chance = float(fdtrc(2.0 * looks * (count - before), own + freedom, ratio[place]))
        if chance < best[1] or before == 1:
            best = place, chance
    return best[0], step_of(power[:, best[0]], looks), min(1.0, best[1] * (count - 1) * tried)


# ---- a place that is not known ----


@dataclass(frozen=True)
class FoundPlace:
    """Where a reflector of unknown place was found, and since when it is there."""

    site: ReflectorSite
    """At the place that was found; with `start` or `end` where a change found it."""
    change: Change | None
    """None where nothing changes, and the brightest point that lasts was taken."""
    chance: float
    after: np.datetime64 | None
    """Last date before the change, by the interval's early end."""
    before: np.datetime64 | None
    words: str
    error_m: tuple[float, float] | None = None
    """Half of the 90 % interval of the place, in azimuth and slant range, by the dates at which it is measured."""

    def content(self) -> dict[str, object]:
        """For JSON."""
        site = self.site
        return {
            "id": site.name,
            "latitude_deg": site.latitude_deg,
            "longitude_deg": site.longitude_deg,
            "height_m": site.height_m,
            "azimuth_error_m": None if self.error_m is None else self.error_m[0],
            "range_error_m": None if self.error_m is None else self.error_m[1],
            "chance": self.chance,
            "after": None if self.after is None else str(self.after),
            "not_later_than": None if self.before is None else str(self.before),
            "words": self.words,
        }


@dataclass(frozen=True)
class _Cut:
    """A box of an image about a place: power (lines, pixels), and the place within it."""

    power: F64
    date: np.datetime64
    at: tuple[float, float]
    product: Product
    point: ImagedPoint
    origin: tuple[int, int]


def find_place(
    products: Sequence[Product], site: ReflectorSite, radiometry: Radiometry | None
) -> tuple[FoundPlace | None, str]:
    """Look for a reflector within `site.search_m` of where the table has it, in azimuth and slant range.

    A step of power that lasts is sought first, in each pass by itself. Without one, the brightest point of the mean
    over dates is taken if clutter alone would not have it. None, with the reason, where nothing stands out.
    """
    cuts, refused = [], []
    for product in products:
        try:
            cut = _cut(product, site, radiometry)
        except InputError as error:  # out of the orbit's reach, or a file that was cut off
            refused.append(str(error))
            continue
        cuts += [] if cut is None else [cut]
    cuts.sort(key=lambda cut: cut.date)
    groups: list[list[_Cut]] = []
    for cut in cuts:
        same = [g for g in groups if g[0].point.toward_radar @ cut.point.toward_radar > SAME_PASS]
        same = [g for g in same if g[0].product.polarization == cut.product.polarization]
        if not same:
            groups.append([])
            same = [groups[-1]]
        same[0].append(cut)
    found = [one for group in groups if (one := _in_pass(group, site)) is not None]
    if not cuts:
        return None, f"{site.name}: no image shows the box that is searched" + (f": {refused[0]}" if refused else "")
    if not found:
        return None, f"{site.name}: nothing within {site.search_m:g} m changes or stands out more than clutter does"
    best = min(found, key=lambda one: (one.change is None, one.chance))
    return best, best.words


def _cut(product: Product, site: ReflectorSite, radiometry: Radiometry | None) -> _Cut | None:
    assert site.search_m is not None
    date = product.date(product.grid.middle_s)
    if product.orbit is None or product.samples is None:
        return None
    point = product.to_image(site.geodetic(date))
    spacing = product.spacing_m(point)
    shape = (product.grid.lines, product.grid.pixels)
    ends = []
    for at, step, count in zip((point.line, point.pixel), spacing, shape, strict=True):
        reach = site.search_m / step
        ends.append((max(int(at - reach), 0), min(int(np.ceil(at + reach)) + 1, count)))
    (top, bottom), (left, right) = ends
    if bottom - top < 3 or right - left < 3 or (bottom - top) * (right - left) > MOST_PIXELS:
        return None
    raw = np.asarray(product.samples[slice(top, bottom), slice(left, right)])
    power = np.abs(raw.astype(np.complex128)) ** 2 if np.iscomplexobj(raw) else raw.astype(np.float64)
    if product.quantity == "amplitude":
        power = power**2
    if product.gain is not None:
        power = power * product.gain(np.arange(top, bottom)[:, None], np.arange(left, right))
    factor = float(to_beta0(product.radiometry or radiometry, point.incidence_deg))
    power = np.where(np.isfinite(power), power, 0.0) * factor
    return _Cut(power, date, (point.line - top, point.pixel - left), product, point, (top, left))


def _in_pass(cuts: Sequence[_Cut], site: ReflectorSite) -> FoundPlace | None:
    """Of one pass: all its images moved onto the first, by orbit and survey."""
    first = cuts[0]
    stack = [first.power]
    for other in cuts[1:]:
        move = [a - b for a, b in zip(first.at, other.at, strict=True)]
        moved = shift(other.power, move, order=1, mode="nearest")
        stack.append(_fitted(moved, first.power.shape))
    power = np.stack(stack)
    spacing = first.product.spacing_m(first.point)
    axes = responses(first.product, spacing)
    whole = first.product.quantity != "complex"
    cells = [axis.cell_m * axis.looks for axis in axes]  # of one look
    inside = [max(step / cell, 1.0) if whole else 1.0 for step, cell in zip(spacing, cells, strict=True)]
    looks = float(np.prod(inside) * np.prod([axis.looks for axis in axes]))
    lengths = [max(cell, step) for cell, step in zip(cells, spacing, strict=True)]
    tried = max(power[0].size * spacing[0] * spacing[1] / (lengths[0] * lengths[1]), 1.0)
    flat = power.reshape(len(cuts), -1)
    if len(cuts) > 1:
        place, change, chance = rise(flat, looks, tried)
        if chance < FALSE_RATE:
            return _found(cuts, site, divmod(place, power.shape[2]), change, chance)
    mean, count = flat.mean(axis=0), looks * len(cuts)
    freedom, scale = levels(mean, count)
    place = int(mean.argmax())
    chance = min(1.0, tried * float(fdtrc(2.0 * count, freedom, mean[place] / scale)))
    if chance < FALSE_RATE:
        return _found(cuts, site, divmod(place, power.shape[2]), None, chance)
    return None


def _fitted(image: F64, shape: tuple[int, ...]) -> F64:
    """Cut, or filled with its own mean, to a shape: boxes of the dates may differ by a line or pixel."""
    found = np.full(shape, float(image.mean()))
    rows, columns = min(shape[0], image.shape[0]), min(shape[1], image.shape[1])
    found[:rows, :columns] = image[:rows, :columns]
    return found


def _found(
    cuts: Sequence[_Cut], site: ReflectorSite, place: tuple[int, int], change: Change | None, chance: float
) -> FoundPlace:
    first = cuts[0]
    line, pixel = place[0] + first.origin[0], place[1] + first.origin[1]
    latitude, longitude, height = first.product.to_ground(line, pixel, site.height_m)
    dates = [cut.date for cut in cuts]
    start, after, before = site.start, None, None
    words = f"{site.name}: found at {latitude:.6f}, {longitude:.6f} for a height of {site.height_m:g} m"
    if change is None:
        words += ": the brightest point that lasts over all dates"
    else:
        after, before = dates[change.likely[0] - 1], dates[change.likely[1]]
        start = np.datetime64(_day(dates[change.first]), "us") if site.start is None else site.start
        words += (
            f": put up after {_day(after)} and not later than {_day(before)}, {10 * np.log10(change.ratio):.0f} dB "
            "brighter since then"
        )
    words += f"; clutter alone would show it in {_share(chance)}"
    at = replace(
        site, latitude_deg=float(latitude), longitude_deg=float(longitude), height_m=float(height), start=start,
        search_m=None, validity=site.validity & ~VALID_PLACE,
    )  # fmt: skip
    return FoundPlace(at, change, chance, after, before, words)


def settled(
    found: FoundPlace, observations: Sequence[ReflectorObservation], products: dict[str, Product]
) -> FoundPlace:
    """With the place that the dates have on average at which it is measured, and its interval."""
    seen = [one for one in observations if one.point and one.point.seen and one.expected]
    used = [one for one in seen if one.status in ("measured", "no calibration") and one.stands]
    if not used:
        return found
    same = [one for one in used if _look(one) @ _look(used[0]) > SAME_PASS]
    points = [(one, one.point) for one in same if one.point is not None]
    places = np.array(
        [products[one.source].to_ground(point.line, point.pixel, found.site.height_m) for one, point in points]
    )
    offsets = np.array([one.offset_m for one in same], np.float64)
    bound = np.array([point.position_sd_m for _, point in points])
    error = np.sqrt(np.maximum((bound**2).mean(axis=0), offsets.var(axis=0, ddof=1) if len(same) > 2 else 0.0))
    reach = float(stdtrit(max(len(same) - 1, 2), 0.5 + 0.5 * CONFIDENCE)) / np.sqrt(len(same))
    half = float(error[0] * reach), float(error[1] * reach)
    latitude, longitude = places[:, :2].mean(axis=0).tolist()
    site = replace(found.site, latitude_deg=latitude, longitude_deg=longitude)
    words = found.words.replace(
        f"{found.site.latitude_deg:.6f}, {found.site.longitude_deg:.6f}",
        f"{latitude:.6f}, {longitude:.6f} (± {half[0]:.2f} m in azimuth, ± {half[1]:.2f} m in slant range)",
    )
    return replace(found, site=site, words=words, error_m=half)


def standing(observations: Sequence[ReflectorObservation], found: Sequence[Presence]) -> list[ReflectorObservation]:
    """Observations, of which those before a set-up and after a removal that were found do not stand.

    A table of sites that states dates is believed.
    """
    first = {one.site: one.since[1] for one in found if one.since is not None}
    last = {one.site: one.until[0] for one in found if one.until is not None}
    made = []
    for one in observations:
        name, day = one.site.name, _day(one.date)
        early = one.site.start is None and name in first and day < first[name]
        late = one.site.end is None and name in last and day > last[name]
        made.append(replace(one, stands=False) if early or late else one)
    return made


def _look(one: ReflectorObservation) -> F64:
    assert one.expected is not None
    return one.expected.toward_radar


def _day(date: np.datetime64) -> str:
    return str(date)[:10]


def _share(chance: float) -> str:
    return "under 1 case in 1,000,000" if chance < 1e-6 else f"1 case in {1.0 / max(chance, 1e-6):,.0f}"


# ---- dates at which it stands ----


@dataclass(frozen=True)
class Presence:
    """What the dates of a reflector say of its standing there, in one pass."""

    site: str
    words: str
    since: tuple[str, str] | None = None
    """Put up after the first date, and not later than the second (90 %)."""
    until: tuple[str, str] | None = None
    """Taken away or fallen after the first date, and not later than the second."""
    moved_m: tuple[float, float] | None = None
    """In azimuth and slant range, where it moved between both dates of `moved`."""
    moved: tuple[str, str] | None = None

    def content(self) -> dict[str, object]:
        """For JSON."""
        return {
            "id": self.site, "words": self.words, "since": self.since, "until": self.until, "moved_m": self.moved_m,
            "moved": self.moved,
        }  # fmt: skip


def presences(observations: Sequence[ReflectorObservation]) -> list[Presence]:
    """Set-up, removal and moves of each reflector, by the dates of a pass; nothing that clutter could be."""
    groups: dict[tuple[str, str | None], list[list[ReflectorObservation]]] = {}
    for one in observations:
        if one.point is None or one.expected is None or not one.calibrated:
            continue
        passes = groups.setdefault((one.site.name, one.polarization), [])
        look = one.expected.toward_radar
        same = [g for g in passes if _look(g[0]) @ look > SAME_PASS]
        if not same:
            passes.append([])
            same = [passes[-1]]
        same[0].append(one)
    tried = sum(len(passes) for passes in groups.values())
    found: list[Presence] = []
    for passes in groups.values():
        for some in passes:
            some.sort(key=lambda one: one.date)
            found += [each for each in (_standing(some), _moved(some, tried)) if each is not None]
    return found


def _standing(some: Sequence[ReflectorObservation]) -> Presence | None:
    """Between which dates it came and went: those at which it is seen, and those at which it would be, and is not."""
    seen = np.array([one.status == "measured" for one in some])
    if seen.all() or not seen.any() or not _certain(some, int(seen.size)):
        return None
    least = min(one.point.low_m2 for one in some if one.status == "measured" and one.point is not None)
    gone = np.array([one.status == "not seen" and one.point is not None and one.point.high_m2 < least for one in some])
    name, days = some[0].site.name, [_day(one.date) for one in some]
    first, last = np.flatnonzero(seen)[[0, -1]].tolist()
    since = until = None
    words = []
    site = some[0].site  # what the table says is not said again
    if (before := np.flatnonzero(gone[:first])).size and (site.start is None or days[first] < _day(site.start)):
        since = days[before[-1]], days[first]
        words.append(f"put up after {since[0]} and not later than {since[1]}")
    if (after := np.flatnonzero(gone[last:])).size and (site.end is None or days[last] > _day(site.end)):
        until = days[last], days[last + after[0]]
        words.append(f"gone after {until[0]}, at the latest by {until[1]}: taken away, fallen, or turned off")
    gaps = [k for k in np.flatnonzero(gone).tolist() if first < k < last and some[k].stands]
    if gaps:
        words.append(f"absent or covered at {', '.join(days[k] for k in gaps)}, and there before and after")
    return Presence(name, f"{name}: {'; '.join(words)}", since, until) if words else None


def _certain(some: Sequence[ReflectorObservation], dates: int) -> bool:
    """Whether the brightest date is no clutter: one peak in all boxes of all dates, of a thousand cells each."""
    peak = max(one.point.scr + 1.0 for one in some if one.status == "measured" and one.point is not None)
    return bool(1e3 * dates * np.exp(-min(peak, 700.0)) < FALSE_RATE)


def _moved(some: Sequence[ReflectorObservation], tried: int) -> Presence | None:
    """One step of its place, by the likelihood of two means over one, each axis with its own scatter."""
    used = [one for one in some if one.status == "measured" and one.offset_m is not None and one.point is not None]
    if len(used) < 6:
        return None
    offsets = np.array([one.offset_m for one in used], np.float64)
    bound = np.array([one.point.position_sd_m for one in used if one.point is not None])
    best: tuple[float, int, F64] | None = None
    for first in range(2, len(used) - 1):
        early, late = offsets[:first], offsets[first:]
        rest = np.concatenate([early - early.mean(axis=0), late - late.mean(axis=0)])
        freedom = len(used) - 2
        spread = np.sqrt(np.maximum((rest**2).sum(axis=0) / freedom, (bound**2).mean(axis=0)))
        step = late.mean(axis=0) - early.mean(axis=0)
        deviations = np.abs(step) / (spread * np.sqrt(1.0 / first + 1.0 / (len(used) - first)))
        chance = float((2.0 * stdtr(freedom, -deviations)).min()) * 2.0 * (len(used) - 3) * tried
        if best is None or chance < best[0]:
            best = chance, first, step
    if best is None or best[0] >= FALSE_RATE:
        return None
    name, days = used[0].site.name, [_day(one.date) for one in used]
    moved = days[best[1] - 1], days[best[1]]
    words = (
        f"{name}: moved by {best[2][0]:+.2f} m in azimuth and {best[2][1]:+.2f} m in slant range between {moved[0]} "
        f"and {moved[1]}"
    )
    return Presence(name, words, moved_m=(float(best[2][0]), float(best[2][1])), moved=moved)
