"""Is anything left beside speckle? One judgement of a model against its images, for `learn`, `evaluate` and `diagnose`.

Five things are asked of the images of one role. Each says how small a departure matters, so that many pixels do not
condemn what is right to a few percent.

structure  the strongest window of the residual, on all usable pixels, edges and shadows among them
           the profiles of rows and columns (`profiles.py`)
edges      how far outlines lie off (`edges.py`)
speckle    how the power of even ground scatters (`speckle.facts`): looks, texture, or neither
level      whether the deviance of the lit interior is that of even ground, and that of the declared speckle
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from scipy.special import erfc, erfcinv, gammaincc

from warpsar.compare.comparison import LARGEST, SCATTERS, Comparison
from warpsar.compare.edges import EdgeDisplacements, displaced, edges_of
from warpsar.compare.profiles import AxisProfile, Profiles
from warpsar.runtime import threads
from warpsar.speckle.draws import Speckle
from warpsar.speckle.even import EvenGround, even_ground
from warpsar.speckle.facts import MATTERS, Scatter, SpeckleFact, speckle_fact
from warpsar.speckle.law import Law
from warpsar.speckle.likelihood import scaled_deviance
from warpsar.speckle.own import Patch, own_autocovariance
from warpsar.speckle.scan import Scan, Spot, surest
from warpsar.speckle.scan import Window as Size
from warpsar.speckle.tail import FIRST, SURE, Tail, Tails

ERROR_RATE = 0.005  # chance that a right model is called anything else
SHARE = ERROR_RATE / 4  # of it, for each of windows, profiles, edges and level
LINE = 33  # pixels along a line: a smear, a sidelobe, a wall
SIZES: tuple[Size, ...] = ((1, 1), (3, 3), (5, 5), (9, 9), (17, 17), (3, LINE), (LINE, 3))
WINDOW_DB = 0.2  # by which a window's power, or that of rows and columns, may be off
LEVEL_MATTERS = 0.05  # of the mean deviance, beyond what even ground scatters by; beyond 1 it is `MATTERS`
WIDEST = 0.1  # standard deviation of the mean deviance beyond which nothing can be told
DRAWN, MOST_DRAWS, FEWEST_DRAWS = 2e7, 1000, 200  # pixels drawn altogether, and draws
BATCH = 2e6  # pixels drawn at once
SAMPLE, TILE = 200_000, 256  # pixels that are drawn; beyond them tiles stand for the whole
SEED = 20  # of the draws

Finding = Literal["speckle", "structure", "edges", "looks", "texture", "distribution", "level", "cannot be told"]


@dataclass(frozen=True)
class Window:
    """A window of `rows` x `columns` pixels about (`row`, `col`): (`range_m`, `azimuth_m`) from the reference point.

    `ratio_db`: measured over modelled power of its usable pixels [dB]; infinite where the model has none. `z`: the mean
    residual beyond what is granted, over the standard deviation that speckle gives it.
    """

    view: str
    polarization: str
    row: int
    col: int
    rows: int
    columns: int
    range_m: float
    azimuth_m: float
    ratio_db: float
    z: float


@dataclass(frozen=True)
class Judgement:
    """What is left of the images of one role.

    `findings`: what departs from speckle, the chief one first; empty where nothing does. `deviance`: mean of d / E[d]
    over the interior without edges; `own_deviance`: what the scatter of even ground makes of it; `deviance_error`: how
    far the deviance would scatter about that by speckle. `p_level`, `p_window`, `p_profile`: chances of a
    deviance so far from it, of a window so strong and of rows or columns that vary so much, by speckle alone. `window`,
    `profile`: the strongest, whatever their chance. `looks_estimated`:
    whether the looks are the images' own, so that they are not tested. `sharing`: pixels that share one speckle.
    """

    findings: list[Finding]
    deviance: float
    own_deviance: float
    deviance_error: float
    p_level: float
    p_window: float
    p_profile: float
    pixels: int
    window: Window
    profile: AxisProfile
    edges: EdgeDisplacements
    speckle: SpeckleFact
    looks_estimated: bool
    sharing: float

    @property
    def finding(self) -> Finding:
        """The chief finding; "speckle" where nothing else is left, "cannot be told" from too few pixels."""
        if self.findings:
            return self.findings[0]
        return "cannot be told" if self.deviance_error > WIDEST else "speckle"

    @property
    def wrong(self) -> bool:
        """Whether anything departs from the model with its declared speckle."""
        return bool(self.findings)

    @property
    def words(self) -> str:
        """What was found, and the deviance."""
        sentences = [_WORDS[one](self) for one in self.findings]
        if not sentences and self.finding == "cannot be told":
            sentences = [f"cannot be told from {self.pixels} pixels"]
        elif not sentences:
            sentences = ["nothing but speckle is found"]
        own = f"{self.own_deviance:.3f} +- {self.deviance_error:.3f}"
        if math.isfinite(self.deviance_error):
            sentences += [f"deviance away from edges {self.deviance:.3f}, where speckle leaves {own}"]
        if self.looks_estimated:
            sentences += ["the looks were estimated from the images, so they are not tested"]
        if "edges" not in self.findings:
            sentences += [self.edges.words]
        return "; ".join(sentences)

    def content(self) -> dict[str, Any]:
        """For the JSON files."""
        about = {key: value for key, value in asdict(self).items() if key not in ("edges", "speckle")}
        return {
            "finding": self.finding,
            **about,
            "deviance_error": self.deviance_error if math.isfinite(self.deviance_error) else None,
            "edges": self.edges.content(),
            "speckle": asdict(self.speckle),
            "error_rate": ERROR_RATE,
            "words": self.words,
        }


def _structure_words(found: Judgement) -> str:
    if found.p_window >= SHARE:
        return f"structure is left ({_p(found.p_profile)}): {found.profile.words}"
    w = found.window
    size = "is one pixel" if w.rows * w.columns == 1 else f"has {w.rows} x {w.columns} pixels"
    power = f"{w.ratio_db:+.1f} dB" if np.isfinite(w.ratio_db) else "power where the model has none"
    return (
        f"structure is left ({_p(found.p_window)}): the strongest window {size}, in {w.view} {w.polarization} at "
        f"range {w.range_m:.1f} m, azimuth {w.azimuth_m:.1f} m, {power}"
    )


def _edges_words(found: Judgement) -> str:
    off = found.edges.off(SHARE)
    each = ", ".join(f"{one.displacement_m:.2g} m or more in {one.image}" for one in off[:3])
    rest = f" and {len(off) - 3} more" if len(off) > 3 else ""
    return (
        f"edges do not agree ({_p(off[0].p)}): as if outlines lay off by {each}{rest}, where {off[0].allowed_m:.2g} m "
        f"are granted"
    )


def _speckle_words(found: Judgement) -> str:
    return found.speckle.words


def _level_words(found: Judgement) -> str:
    return (
        f"the level is off ({_p(found.p_level)}): {found.deviance:.3f}, where declared speckle leaves 1, and that of "
        f"even ground {found.own_deviance:.3f}"
    )


_WORDS = {
    "structure": _structure_words,
    "edges": _edges_words,
    "looks": _speckle_words,
    "texture": _speckle_words,
    "distribution": _speckle_words,
    "level": _level_words,
}


def _p(chance: float) -> str:
    return f"p {chance:.1g}" if chance >= 1e-6 else "p < 1e-6"


def judge(images: Sequence[Comparison]) -> Judgement:
    """The judgement of measured images beside one model's.

    Draws of speckle calibrate the scan and the level. They have the residual's own correlation, and the scatter that it
    shows where this is more than declared: wrong looks alone are no structure.
    """
    sample, share = _sample(images)
    correlation, variance = own_autocovariance([_patch(image) for image in sample])
    shown = max(variance, 1.0)
    profiles = Profiles(sample, shown * correlation, parts=share < 1.0)
    scan = Scan([_of_usable(image) for image in images], correlation, windows=SIZES)
    granted = 10.0 ** (WINDOW_DB / 10.0) - 1.0
    spots, strength = scan.strongest(
        [image.residual[image.usable] for image in images],
        [granted * (image.simulated / image.sd)[image.usable] for image in images],
    )
    profile = profiles.strongest([i.residual[i.usable] for i in sample], granted)

    edges = edges_of(images, shown, correlation)
    grounds = [_ground(image, correlation) for image in images]
    speckle = _speckle(images, grounds)
    counts = np.array([image.seen.count for image in images])
    even = np.array([int(image.even.sum()) for image in images])
    mean = float(sum(image.scaled_deviance[image.even[image.interior]].sum() for image in images) / max(even.sum(), 1))
    own, own_error = _own_level(images, grounds, speckle, even / max(even.sum(), 1))
    noise = max(image.sampling_noise for image in images)
    estimated = any(image.seen.looks_estimated for image in images)

    def off(drawn: _Drawn) -> tuple[float, float]:
        """By how many standard errors the level is off, and the error."""
        speckle_error = float(drawn.levels.std() * np.sqrt(share))
        if not even.any() or speckle_error == 0.0:  # all pixels lie at edges: there is no level to be told
            return 0.0, math.inf
        error = float(np.hypot(speckle_error, own_error))
        asked = [(own, LEVEL_MATTERS, error)]
        if not (estimated or speckle.departs):
            asked.append((1.0, MATTERS, speckle_error))
        away = [
            max(abs(mean - at) - matters - (noise if mean > at else 0.0), 0.0) / scatter
            for at, matters, scatter in asked
        ]
        return max(away), error

    def decided(drawn: _Drawn) -> bool:
        """Whether more draws would change no finding."""
        limits = -np.log(SHARE * share), -np.log(SHARE)
        windows, lines = Tails.of(drawn.windows), Tail.of(drawn.profiles)
        ends = windows.interval(strength), lines.interval(profile.surprise)
        sure = [low > limit or high < limit for limit, (low, high) in zip(limits, ends, strict=True)]
        away = np.sqrt(2.0) * erfcinv(SHARE)
        return all(sure) and abs(off(drawn)[0] / away - 1.0) > SURE / np.sqrt(2.0 * drawn.levels.size)

    drawn = _drawn(sample, profiles, correlation, shown, decided)
    spot, surprise = surest(spots, strength, Tails.of(drawn.windows))
    in_sample = min(np.exp(-surprise), 1.0 - 1e-9)
    p_window = float(-np.expm1(np.log1p(-in_sample) / share))
    p_profile = float(np.exp(-float(Tail.of(drawn.profiles)(profile.surprise))))
    level_off, error = off(drawn)
    p_level = float(erfc(level_off / np.sqrt(2.0)))

    findings: list[Finding] = []
    if min(p_window, p_profile) < SHARE:
        findings.append("structure")
    if edges.off(SHARE):
        findings.append("edges")
    if speckle.departs:
        findings.append(_kind(speckle))
    if p_level < SHARE:
        findings.append("level")
    pixels, window = int(counts.sum()), _window(images[spot.observation], spot)
    return Judgement(
        findings,
        mean,
        own,
        error,
        p_level,
        p_window,
        p_profile,
        pixels,
        window,
        profile,
        edges,
        speckle,
        estimated,
        float(correlation.sum()),
    )


@dataclass(frozen=True)
class Level:
    """The mean of d / E[d] over a part of the images, what speckle makes of it, and the chance that speckle alone makes
    as much, beyond what is granted."""

    deviance: float
    expected: float
    p: float


def level_within(images: Sequence[Comparison], inside: Sequence[np.ndarray], found: Judgement) -> Level | None:
    """The level of the even pixels in masks (rows, cols), one for each image, beside what was `found` of all images.
    None where there is none to be told.

    A gamma law has the mean and the variance of the sum: a deviance's tail falls off as its own does.
    """
    masks = [image.even & mask for image, mask in zip(images, inside, strict=True)]
    counts = np.array([int(mask.sum()) for mask in masks])
    if not counts.any() or not math.isfinite(found.deviance_error):
        return None
    total = sum(image.scaled_deviance[mask[image.interior]].sum() for image, mask in zip(images, masks, strict=True))
    relative = np.array([image.seen.law.deviance_variance / image.seen.law.expected_deviance**2 for image in images])
    speckle = float(counts @ relative) / counts.sum() ** 2 * max(found.sharing, 1.0)
    mean, granted = float(total / counts.sum()), found.own_deviance + LEVEL_MATTERS
    shape = granted**2 / (speckle * found.own_deviance**2 + found.deviance_error**2)
    return Level(mean, found.own_deviance, float(gammaincc(shape, shape * mean / granted)))


def speckle_of(images: Sequence[Comparison]) -> SpeckleFact:
    """What even ground says of the speckle that the views declare; a part of `judge`."""
    correlation, _ = own_autocovariance([_patch(image) for image in _sample(images)[0]])
    return _speckle(images, [_ground(image, correlation) for image in images])


def _speckle(images: Sequence[Comparison], grounds: Sequence[EvenGround | None]) -> SpeckleFact:
    with_laws = [(image.name, image.seen.law, image.seen.looks_estimated) for image in images]
    return speckle_fact(
        [
            Scatter(name, None if estimated else law.looks, law.texture, ground)
            for (name, law, estimated), ground in zip(with_laws, grounds, strict=True)
        ]
    )


def _kind(speckle: SpeckleFact) -> Finding:
    if speckle.kind == "looks":
        return "looks"
    return "distribution" if speckle.kind == "none of them" else "texture"


def _patch(image: Comparison) -> Patch:
    """Measured over modelled power where nothing but speckle should be."""
    even = image.even & (np.nan_to_num(image.measured) > 0)
    ratio = np.ones(image.simulated.shape)
    ratio[even] = image.measured[even] / image.simulated[even]
    return Patch(even, ratio, image.seen.law)


def _of_usable(image: Comparison, mask: np.ndarray | None = None) -> Patch:
    """Usable pixels, or others, as scan and draws take them."""
    return Patch(image.usable if mask is None else mask, image.simulated, image.seen.law)


def _sample(images: Sequence[Comparison]) -> tuple[list[Comparison], float]:
    """What is drawn, and its share of all pixels that scatter: everything, or tiles of it taken at random."""
    total = sum(int(image.scatters.sum()) for image in images)
    if total <= SAMPLE:
        return list(images), 1.0
    tiles = [
        (image, slice(row, row + TILE), slice(col, col + TILE))
        for image in images
        for row in range(0, image.usable.shape[0], TILE)
        for col in range(0, image.usable.shape[1], TILE)
    ]
    found: list[Comparison] = []
    taken = 0
    for k in np.random.default_rng(SEED).permutation(len(tiles)):
        image, rows, cols = tiles[k]
        count = int(image.scatters[rows, cols].sum())
        if taken < SAMPLE and image.interior[rows, cols].any():
            found.append(image.part(rows, cols))
            taken += count
    return found, taken / total


@dataclass(frozen=True)
class _Drawn:
    """Of draws of speckle: the strongest windows (`Scan.largest`), shape (2, draws); the most surprising profile and
    the mean deviance, shape (draws,)."""

    windows: np.ndarray
    profiles: np.ndarray
    levels: np.ndarray


def _drawn(
    sample: Sequence[Comparison],
    profiles: Profiles,
    correlation: np.ndarray,
    shown: float,
    decided: Callable[[_Drawn], bool],
) -> _Drawn:
    """Draws with outlines displaced as is granted: `FIRST` of them, and more where these do not decide. `shown`: the
    variance of the residual over that of the declared law."""
    laws = [Law.of_equivalent(i.seen.looks / shown, i.seen.texture) for i in sample]
    patches = [Patch(i.scatters, i.simulated, law) for i, law in zip(sample, laws, strict=True)]
    counts = [int(p.interior.sum()) for p in patches]
    speckle, scan = Speckle(patches, correlation), Scan([_of_usable(i) for i in sample], correlation, windows=SIZES)
    draws = int(np.clip(DRAWN / sum(counts), FEWEST_DRAWS, MOST_DRAWS))
    size = int(np.clip(BATCH / sum(counts), 1, 25))
    interior = max(sum(int((i.even & i.scatters).sum()) for i in sample), 1)

    def batch(sequence: np.random.SeedSequence) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        random = np.random.default_rng(sequence)
        parts = np.split(speckle(random, size), np.cumsum(counts)[:-1])
        residuals, total = [], np.zeros(size)
        for image, patch, law, part in zip(sample, patches, laws, parts, strict=True):
            ratio = np.maximum(1.0 + part / np.float32(np.sqrt(patch.looks)), np.float32(1e-12))
            total += scaled_deviance(ratio[image.even[patch.interior]], np.ones(()), law).sum(axis=0)
            power = image.simulated[patch.interior][:, None]
            away = power * (ratio - 1.0)
            at_edges = image.at_edges[patch.interior]
            away[at_edges] = displaced(image, random, size) * ratio[at_edges] - power[at_edges]
            unsure = np.flatnonzero(image.by_rays[patch.interior] > SCATTERS * image.sd[patch.interior] ** 2)
            error = np.sqrt(image.by_rays[patch.interior][unsure])[:, None]
            away[unsure] += error * random.normal(size=(unsure.size, size)) * ratio[unsure]
            residual = np.zeros((int(image.usable.sum()), size), np.float32)
            limit = image.sd[patch.interior][:, None]
            residual[patch.interior[image.usable]] = np.clip(away / limit, -LARGEST, LARGEST)
            residuals.append(residual)
        return scan.largest(residuals), profiles.largest(residuals), total / interior

    def run(some: Sequence[np.random.SeedSequence]) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        return list(threads.in_threads(partial(batch, one) for one in some))

    seeds = np.random.SeedSequence(SEED).spawn(-(-draws // size))
    first = min(-(-FIRST // size), len(seeds))
    batches = run(seeds[:first])
    found = _joined(batches)
    if first == len(seeds) or decided(found):
        return found
    return _joined([*batches, *run(seeds[first:])])


def _joined(batches: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> _Drawn:
    return _Drawn(*(np.concatenate(some, axis=-1) for some in zip(*batches, strict=True)))


def _own_level(
    images: Sequence[Comparison], grounds: Sequence[EvenGround | None], speckle: SpeckleFact, shares: np.ndarray
) -> tuple[float, float]:
    """The mean deviance that the scatter of even ground makes of the interior, and its standard error; 1 in images
    without even ground. Which law scatters so is what was found of the `speckle`, or declared."""
    levels, errors = [], []
    for image, ground in zip(images, grounds, strict=True):
        if ground is None:
            levels.append(1.0)
            errors.append(0.0)
            continue
        declared = image.seen.law
        texture = declared.texture if speckle.texture is None else speckle.texture.value
        own = Law.of_second_cumulant(ground.second, texture)
        levels.append(own.log_mean / declared.log_mean)
        errors.append(levels[-1] * ground.looks_error)
    return float(shares @ levels), float(np.linalg.norm(shares * errors))


def _ground(image: Comparison, correlation: np.ndarray) -> EvenGround | None:
    patch = _patch(image)
    return even_ground(patch.ratio, patch.interior, max(float(correlation.sum()), 1.0))


def _window(image: Comparison, spot: Spot) -> Window:
    at = (spot.row, spot.col)
    around = tuple(slice(max(k - n // 2, 0), k + n // 2 + 1) for k, n in zip(at, spot.window, strict=True))
    counted = image.usable[around]
    with np.errstate(divide="ignore", invalid="ignore"):
        measured = np.nan_to_num(image.measured[around][counted]).sum()
        ratio_db = 10.0 * np.log10(measured / image.simulated[around][counted].sum())
    place = float(image.range_m[spot.row]), float(image.azimuth_m[spot.col])
    return Window(image.view.name, image.polarization, *at, *spot.window, *place, float(ratio_db), spot.z)
