"""What differs between measured pixels and the simulated ones, as hypotheses with intervals.

Cells of pixels (`comparison.py`) hold measured power y beside the model

    mu = c [ sum over surfaces k of a_k S_k  +  b N ]

S_k: simulated beta0 of the surface, at places that may be moved; N: the annotation's noise. Each factor and each move
is a hypothesis. They are chosen one after the other by scores of a gamma likelihood in half of the squares of a
checkerboard, and each has to predict the other half better (its deviance, two standard errors above 0).
Neighbouring cells are alike in real fields (`scatter.py`), so chances and intervals follow from the variance of sums
over cells that have much in common (the sandwich of Liang and Zeger 1986, Biometrika 73). Where cells of one declared
surface are off together, they are a hypothesis, too (`parts.py`). A trend over the image
that needs no physics is a hypothesis like the others. A level within what the library grants its surfaces has no name.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, label
from scipy.special import chdtrc

from warpsar.terrain.comparison import LEAST_CELLS, SQUARE, averaged_in_bands, cell_of, line_length_m, slant_step_m
from warpsar.terrain.parts import part_in, refined
from warpsar.terrain.result import SimulatedProduct
from warpsar.terrain.scatter import CellBlocks, CellScatter, robust_variance, weights_of
from warpsar.terrain.scenery import ANGLES_DEG, surface_sigma0
from warpsar.world.library.surfaces import SURFACES

F64 = NDArray[np.float64]
CHANCE = 0.01
"""Of all hypotheses of a step together: a score beyond it is tried on the other half."""
FITTED = 6
"""Hypotheses of a step that are fitted: those of the least chance."""
CONFIRMED = 2.0
"""Standard errors of the gain on the other half."""
LEAST_SQUARES = 12
"""In each half: fewer do not tell what squares have in common."""
LEAST_TOUCHED = 2
"""Squares of the other half in which a hypothesis must do something."""
LEAST_REGION = 3 * SQUARE**2 // 2
"""Cells of a part of the land cover that is asked for itself."""
MOST_REGIONS = 30
MOST_PARTS = 12
"""Parts that are tried: those of the land cover that no region is."""
WHOLE = 0.8
"""Share of one surface in a cell that belongs to a region."""
TIED = 0.95
"""Correlation of two scores."""
STEPS = 12
FARTHEST = 8
"""Cells along a line and across, over which a moved image is looked for."""
QUARTERS = (-0.75, -0.5, -0.25, 0.0, 0.25, 0.5, 0.75)
"""Of a cell, about the best whole one."""
PLACED = 0.04
"""Standard deviation [pixels] that a move has beside what cells say: an image between its pixels is taken for linear,
and over hills places were up to 0.07 pixel off, where nothing else was."""
PLACE_ALLOWANCE_M = 4.0
"""Slant range that atmosphere, tides and a product's own timing may take (Schubert et al. 2015, Remote Sens. 7)."""
NORMAL_95 = 1.96
DB = 10.0 / np.log(10.0)
TREND = ("trend along lines", "trend along pixels")
MOVES = RANGE, AZIMUTH, HEIGHT = "range timing", "azimuth timing", "height of the elevation model"


@dataclass(frozen=True)
class TerrainDifference:
    """One hypothesis that the other half confirmed. `value` and its 95 % interval: dB of a factor, metres of a move."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    gain: float
    """2 ln L, by the dispersion, in the squares that decided nothing."""
    tied: tuple[str, ...]
    """Hypotheses that the same pixels cannot tell from this one."""
    granted: float | None
    """What needs no name: spread of the library's levels [dB], allowance of places [m]."""
    named: bool
    words: str


@dataclass(frozen=True)
class TerrainDifferences:
    """`before_db`, `after_db`: measured less modelled, (rows, columns) of cells, without the differences and with."""

    cell: tuple[int, int]
    """Lines and pixels averaged."""
    found: tuple[TerrainDifference, ...]
    asked: tuple[str, ...]
    squares: int
    deviance: tuple[float, float]
    """Mean over cells of the other half, before and after, by the dispersion after."""
    words: tuple[str, ...]
    before_db: F64
    after_db: F64

    def content(self) -> dict[str, Any]:
        return {
            "found": [asdict(one) for one in self.found],
            "asked": list(self.asked),
            "squares": self.squares,
            "deviance": list(self.deviance),
            "words": list(self.words),
        }


def differences(found: SimulatedProduct) -> TerrainDifferences | str | None:
    """None for a product without pixels; words where there is too little to say anything."""
    if not found.measured:
        return None
    cells = _Cells(found)
    squares = [np.unique(cells.square[cells.blocks(k).where]).size for k in (0, 1)]
    if cells.usable.sum() < LEAST_CELLS or min(squares) < LEAST_SQUARES:
        return (
            f"{int(cells.usable.sum())} cells in {sum(squares)} squares: too few to ask what differs; must be "
            f"{LEAST_CELLS} cells in {2 * LEAST_SQUARES} squares"
        )
    asked = cells.hypotheses()
    chosen: list[str] = []
    gains: list[float] = []
    refused: set[str] = set()
    ties: dict[str, tuple[str, ...]] = {}
    x = np.zeros(0)
    while True:
        over = refused.union(chosen, *ties.values())
        left = [name for name in asked if name not in over]
        parts = cells.parts_off(chosen, x)
        left += parts
        if not left:
            break
        statistics, close = _screened(cells, chosen, x, left, cells.blocks(0))
        # a part could have been found in many places
        trials = np.array([cells.places if name in parts else len(left) for name in left])
        likely = [int(k) for k in np.argsort(-statistics)[:FITTED] if chdtrc(1.0, statistics[k]) * trials[k] <= CHANCE]
        # a score knows of moves less than a hill is wide
        starts = cells.starts(chosen, x)
        likely += [k for k, name in enumerate(left) if starts.get(name) and k not in likely]
        if not likely:
            break
        # a score says what a small change gains: what a whole change gains is found by a fit
        fits = {
            k: _fitted(cells, [*chosen, left[k]], np.append(x, starts.get(left[k], 0.0)), cells.blocks(0))
            for k in likely
        }
        best = max(fits, key=lambda k: _gain(cells, (chosen, x), ([*chosen, left[k]], fits[k]), cells.blocks(0))[0])
        name, more = left[best], fits[best]
        gain, error = _gain(cells, (chosen, x), ([*chosen, name], more), cells.blocks(1))
        sd = _standard_deviations(cells, [*chosen, name], more, cells.blocks(0))[-1]
        if gain < CONFIRMED * error or abs(more[-1]) < CONFIRMED * sd:  # a factor that runs off to 0 has no value
            refused.add(name)
            cells.keep(name, parts)
            continue
        ties[name] = tuple(other for k, other in enumerate(left) if k != best and abs(close[best, k]) > TIED)
        cells.keep(name, parts)
        if name in parts:
            cells.refine(name, chosen, x)
            more = _fitted(cells, [*chosen, name], more, cells.blocks(0))
        chosen.append(name)
        gains.append(gain)
        x = more
    everywhere = cells.blocks(None)
    for name in cells.as_declared(found.product.frequency_hz, chosen, x):
        out = chosen.index(name)
        del chosen[out], gains[out]
        x = np.delete(x, out)
    while True:
        final = _fitted(cells, chosen, x, everywhere)
        deviations = _standard_deviations(cells, chosen, final, everywhere)
        apart = np.abs(final) / deviations
        if not chosen or apart.min() >= NORMAL_95:
            break
        # what stood in for a cause that was found later is nothing beside it
        out = int(np.argmin(apart))
        del chosen[out], gains[out]
        x = np.delete(final, out)
    for k, name in enumerate(chosen):
        if name in MOVES:
            deviations[k] = np.hypot(deviations[k], PLACED / cells.steps_per_metre(name))
    sentences = tuple(
        _difference(found, cells, name, float(final[k]), float(deviations[k]), gains[k], ties[name])
        for k, name in enumerate(chosen)
    )
    bare, after = cells.model([], np.zeros(0)).power, cells.model(chosen, x).power
    other = cells.blocks(1)
    y = cells.measured[other.where]
    scatter = CellScatter.of(y / after[other.where] - 1.0, other)
    left_over = tuple(
        float(np.average(_deviance(y, power[other.where]), weights=scatter.weights) / scatter.variance)
        for power in (bare, after)
    )
    with np.errstate(all="ignore"):
        pictures = [
            np.where(cells.usable, DB * np.log(cells.measured / power), np.nan)
            for power in (bare, cells.model(chosen, final).power)
        ]
    words = [one.words for one in sentences] or ["of all that is asked, these pixels confirm nothing"]
    words.append(_farthest(found, cells, pictures[1]))
    return TerrainDifferences(
        cells.cell, sentences, (*asked, *cells.parts_asked), sum(squares), (left_over[0], left_over[1]), tuple(words),
        pictures[0], pictures[1],
    )  # fmt: skip


@dataclass(frozen=True)
class _Modelled:
    """Power of cells (rows, columns), and its logarithm's derivatives by hypotheses."""

    power: F64
    by: dict[str, F64]


class _Cells:
    """Pixels in cells, and the model there."""

    def __init__(self, found: SimulatedProduct) -> None:
        self.found, self.cell = found, cell_of(found)
        self.surfaces = found.scenery.surfaces
        self.has_noise = "noise" in found.image
        self.measured, self.noise, self.latitude, self.longitude, self.incidence, tilt = averaged_in_bands(
            found, self.cell, self._as_they_are
        )
        step = slant_step_m(found)
        line_m = line_length_m(found)
        self.lines_per_metre = {RANGE: 0.0, AZIMUTH: 1.0 / line_m, HEIGHT: 0.0}
        self.pixels_per_metre: dict[str, F64 | float] = {RANGE: 1.0 / step, AZIMUTH: 0.0, HEIGHT: -tilt / step}
        """Lines and pixels, of cells, by which the scene moves for a metre."""
        self.tilt = float(np.nanmean(tilt))
        row, column = np.indices(self.measured.shape)
        across = -(-self.measured.shape[1] // SQUARE)
        self.square = row // SQUARE * across + column // SQUARE
        self._checker = (row // SQUARE + column // SQUARE) % 2
        self.trend = [2.0 * at / max(n - 1, 1) - 1.0 for at, n in zip((row, column), self.measured.shape, strict=True)]
        self._placed: dict[tuple[float, ...], tuple[list[F64], list[F64], list[F64]]] = {}
        parts, _, _ = self.parts((0.0, 0.0, 0.0))
        total = sum(parts) + self.noise
        middle = float(np.nanmedian(total))
        self.usable = np.isfinite(self.measured) & (self.measured > 0.0) & (total > 0.03 * middle)
        """Cells that are darker than everything else have no level to compare where no noise is annotated."""
        self._blocks: dict[int | None, CellBlocks] = {}
        self._covers: list[NDArray[np.bool_]] = []
        """Cells that one declared surface fills, by surface."""
        self._tried: list[str] = []
        self.regions = self._regions(parts)

    def _band(self, name: str, rows: slice) -> F64:
        return np.asarray(self.found.image[name][rows], np.float64)

    def _known(self, rows: slice) -> NDArray[np.bool_]:
        image = self.found.image
        return np.isfinite(image["beta0"][rows]) & np.isfinite(image["measured"][rows])

    def _as_they_are(self, rows: slice) -> list[F64]:
        known = self._known(rows)
        values = [self._band("measured", rows)]
        values.append(self._band("noise", rows) if self.has_noise else np.zeros(known.shape))
        values += [self._band(name, rows) for name in ("latitude", "longitude", "incidence")]
        values.append(np.cos(np.deg2rad(self._band("ellipsoid_incidence", rows))))
        return [np.where(known, each, np.nan) for each in values]

    def blocks(self, half: int | None) -> CellBlocks:
        """Of the usable cells in a half of the checkerboard, or in both."""
        if half not in self._blocks:
            self._blocks[half] = CellBlocks.of(self.usable if half is None else self.usable & (self._checker == half))
        return self._blocks[half]

    @property
    def places(self) -> int:
        """Where a part could be, by surface."""
        return int(self.blocks(0).where.sum()) // LEAST_REGION * len(self.surfaces)

    @property
    def parts_asked(self) -> list[str]:
        return [f"parts of {self.surfaces[k]}" for k, cover in enumerate(self._covers) if cover.any()]

    def parts_off(self, chosen: list[str], x: F64) -> list[str]:
        """Names of parts of the land cover that are off in the first half: of each surface the one that is most.

        They are among `regions` until `keep` says which of them stays. Those that stayed are not asked again.
        """
        if not self._covers or len(self._tried) >= MOST_PARTS:
            return []
        ratio = self._log_ratio(chosen, x)
        before = np.zeros(self.usable.shape, bool)
        for name in self._tried:
            before |= self.regions[name][1]
        made = []
        half = self.blocks(0)
        scatter = CellScatter.of(ratio[half.where], half)
        for k, cover in enumerate(self._covers):
            part = part_in(ratio, half.where, cover & self.usable & ~before, scatter)
            if part is not None:
                made.append(f"part {len(self._tried) + 1} of {self.surfaces[k]}")
                self.regions[made[-1]] = k, part
        return made

    def keep(self, name: str, parts: list[str]) -> None:
        """Of the parts that were off now, the one that was tried, if it is one."""
        for one in parts:
            if one != name:
                del self.regions[one]
        if name in parts:
            self._tried.append(name)

    def as_declared(self, hertz: float, chosen: list[str], x: F64) -> list[str]:
        """Parts of a region that is off which themselves are not: they leave it, and are no difference."""
        at = dict(zip(chosen, x.tolist(), strict=True))
        out = []
        for name in set(chosen).intersection(self._tried):
            of, part = self.regions[name]
            for other in set(chosen).intersection(self.regions) - {name}:
                k, where = self.regions[other]
                inside = k == of and (where & part).sum() > 0.5 * part.sum()
                if inside and DB * abs(at[name] + at[other]) < NORMAL_95 * SURFACES[self.surfaces[k]].spread_at(hertz):
                    self.regions[other] = k, where & ~binary_dilation(part, iterations=2)
                    out.append(name)
                    break
        return out

    def refine(self, name: str, chosen: list[str], x: F64) -> None:
        """Let all cells say where a part ends; those on its border are of two surfaces and are left out."""
        k, part = self.regions[name]
        found = refined(self._log_ratio(chosen, x), self.usable, self._covers[k] & self.usable, part)
        if found is not None:
            self.regions[name] = k, found[0]
            self.usable &= ~found[1]
            self._blocks.clear()

    def _log_ratio(self, chosen: list[str], x: F64) -> F64:
        with np.errstate(all="ignore"):
            ratio = np.log(self.measured / self.model(chosen, x).power)
        return np.where(self.usable, ratio, 0.0)

    def parts(self, moves: tuple[float, float, float]) -> tuple[list[F64], list[F64], list[F64]]:
        """beta0 of each surface in cells, and its slopes by a line and by a pixel, after moves [m] in range, azimuth
        and height."""
        if moves not in self._placed:
            count = len(self.surfaces)
            means = averaged_in_bands(self.found, self.cell, lambda rows: self._moved(moves, rows))
            found = means[:count], means[count : 2 * count], means[2 * count :]
            self._placed = {(0.0, 0.0, 0.0): self._placed.get((0.0, 0.0, 0.0), found), moves: found}
        return self._placed[moves]

    def _moved(self, moves: tuple[float, float, float], rows: slice) -> list[F64]:
        """The same of rows of the window: beta0 of all surfaces, then slopes by a line, then those by a pixel."""
        known = self._known(rows)
        # slopes are differences of neighbours: a row more on both sides, where there is one
        wide = slice(max(rows.start - 1, 0), min(rows.stop + 1, self.found.window.shape[0]))
        image, cover = self._beside(moves, wide)
        inner = slice(rows.start - wide.start, rows.stop - wide.start)
        fields = [each[inner] for each in (image, *np.gradient(image))]
        made: list[F64] = []
        for values in fields:
            for k in range(len(self.surfaces)):
                mine = known if cover is None else known & (cover[inner] == k)
                made.append(np.where(known, np.where(mine, values, 0.0), np.nan))
        return made

    def _beside(self, moves: tuple[float, float, float], rows: slice) -> tuple[F64, F64 | None]:
        """Simulated beta0 and surfaces of rows after moves, linear between pixels; beyond the image as at its edge."""
        shape = self.found.window.shape
        several = len(self.surfaces) > 1
        if not any(moves):
            cover = self._band("cover", rows) if several else None
            return np.nan_to_num(self._band("beta0", rows)), cover
        step = slant_step_m(self.found)
        by = dict(zip(MOVES, moves, strict=True))
        down = by[AZIMUTH] * self.lines_per_metre[AZIMUTH]
        height = np.nan_to_num(np.cos(np.deg2rad(self._band("ellipsoid_incidence", rows)))) * by[HEIGHT]
        column = np.arange(shape[1]) - (by[RANGE] - height) / step
        whole = int(np.floor(-down))
        below = -down - whole
        left = np.floor(column)
        beside = column - left

        def row_of(name: str, more: int) -> F64:
            at = np.clip(np.arange(rows.start, rows.stop) + more, 0, shape[0] - 1)
            return np.nan_to_num(self._band(name, slice(int(at[0]), int(at[-1]) + 1))[at - at[0]])

        def along(values: F64, at: F64) -> F64:
            return np.take_along_axis(values, np.clip(at, 0, shape[1] - 1).astype(np.intp), axis=1)

        image = (1.0 - below) * row_of("beta0", whole) + below * row_of("beta0", whole + 1)
        image = (1.0 - beside) * along(image, left) + beside * along(image, left + 1)
        cover = along(row_of("cover", int(np.floor(0.5 - down))), np.floor(column + 0.5)) if several else None
        return image, cover

    def _regions(self, parts: list[F64]) -> dict[str, tuple[int, NDArray[np.bool_]]]:
        """Parts of the land cover that hang together, by name: the surface, and the cells."""
        if len(parts) < 2:
            return {}
        made: list[tuple[int, int, NDArray[np.bool_]]] = []
        share = averaged_in_bands(
            self.found, self.cell,
            lambda rows: [
                np.where(self._known(rows), 1.0 * (self._band("cover", rows) == k), np.nan) for k in range(len(parts))
            ],
        )  # fmt: skip
        for k in range(len(parts)):
            mine = (share[k] > WHOLE) & self.usable
            self._covers.append(mine)
            numbered, count = label(mine)
            sizes = np.bincount(numbered.ravel(), minlength=count + 1)[1:]
            for number in np.flatnonzero((sizes >= LEAST_REGION) & (sizes < 0.7 * mine.sum())) + 1:
                made.append((int(sizes[number - 1]), k, numbered == number))
        made.sort(key=lambda one: -one[0])
        return {
            f"region {n} of {self.surfaces[k]}": (k, where) for n, (_, k, where) in enumerate(made[:MOST_REGIONS], 1)
        }

    def hypotheses(self) -> list[str]:
        """Names of all that is asked."""
        lit = [k for k, part in enumerate(self.parts((0.0, 0.0, 0.0))[0]) if part[self.usable].sum() > 0.0]
        names = ["calibration", *(["noise"] if self.has_noise else [])]
        names += [f"level of {self.surfaces[k]}" for k in lit] if len(lit) > 1 else []
        return [*names, *self.regions, *MOVES, *TREND]

    def starts(self, chosen: list[str], x: F64) -> dict[str, float]:
        """Moves [m] of at least a cell after which the first half agrees best with the model; 0 where none is better.

        By the correlation of logarithms; a move that was found is not looked for again.
        """
        if set(MOVES).intersection(chosen):
            return {}
        half = self.blocks(0).where
        with np.errstate(all="ignore"):
            y, power = np.log(self.measured), np.log(self.model(chosen, x).power)
        power = np.where(np.isfinite(power), power, np.nanmedian(power[half]))

        def best_of(tries: list[float], images: Iterable[F64]) -> float:
            alike = [float(np.corrcoef(image[half], y[half])[0, 1]) for image in images]
            return tries[int(np.argmax(alike))] if np.isfinite(alike).all() else 0.0

        found = {}
        cells = [float(k) for k in sorted(range(-FARTHEST, FARTHEST + 1), key=abs)]
        for axis, name in ((0, AZIMUTH), (1, RANGE)):
            found[name] = 0.0
            whole = best_of(cells, (np.roll(power, int(k), axis) for k in cells))
            if whole != 0.0:
                per_metre = self.lines_per_metre[name] if axis == 0 else float(np.nanmean(self.pixels_per_metre[name]))
                metres = [(whole + part) * self.cell[axis] / per_metre for part in QUARTERS]
                found[name] = best_of(metres, (self._log_after(chosen, x, name, by) for by in metres))
        found[HEIGHT] = -found[RANGE] / self.tilt
        return found

    def _log_after(self, chosen: list[str], x: F64, name: str, by_m: float) -> F64:
        with np.errstate(all="ignore"):
            return np.asarray(np.nan_to_num(np.log(self.model([*chosen, name], np.append(x, by_m)).power)))

    def longest_step(self, name: str) -> float:
        """Of a fit: the logarithm of a factor, or metres of a move that slopes foretell."""
        if name not in MOVES:
            return 1.5
        return 2.0 / self.steps_per_metre(name)

    def steps_per_metre(self, name: str) -> float:
        """Lines or pixels by which a move of a metre takes the image."""
        return max(self.lines_per_metre[name], float(np.nanmax(np.abs(self.pixels_per_metre[name]))))

    def model(self, names: list[str], x: F64, also: list[str] | None = None) -> _Modelled:
        """With hypotheses at values x; derivatives by them and by others at 0."""
        at = dict(zip(names, map(float, x), strict=True))
        moves = tuple(at.get(name, 0.0) for name in MOVES)
        parts, down, along = self.parts((moves[0], moves[1], moves[2]))
        factor = np.full(self.measured.shape, at.get("calibration", 0.0))
        for name, t in zip(TREND, self.trend, strict=True):
            factor = factor + at.get(name, 0.0) * t
        whole, noise = np.exp(factor), np.exp(at.get("noise", 0.0)) * self.noise
        scaled, grown = [], []
        for k, surface in enumerate(self.surfaces):
            level = np.full(self.measured.shape, at.get(f"level of {surface}", 0.0))
            for name, (of, where) in self.regions.items():
                if of == k and name in at:
                    level = level + np.where(where, at[name], 0.0)
            scaled.append(whole * np.exp(level))
            grown.append(scaled[k] * parts[k])
        noise = whole * noise
        power = sum(grown) + noise
        by: dict[str, F64] = {}
        for name in [*names, *(also or [])]:
            by[name] = self._slope(name, power, noise, scaled, grown, down, along) / power
        return _Modelled(power, by)

    def _slope(
        self, name: str, power: F64, noise: F64, scaled: list[F64], grown: list[F64], down: list[F64], along: list[F64]
    ) -> F64:
        if name == "calibration":
            return power
        if name == "noise":
            return noise
        if name in TREND:
            return power * self.trend[TREND.index(name)]
        if name in self.regions:
            of, where = self.regions[name]
            return np.where(where, grown[of], 0.0)
        if name in MOVES:
            lines, pixels = self.lines_per_metre[name], np.nan_to_num(self.pixels_per_metre[name])
            found = [
                f * (lines * np.nan_to_num(d) + pixels * np.nan_to_num(a))
                for f, d, a in zip(scaled, down, along, strict=True)
            ]
            return -np.sum(found, axis=0)
        return grown[self.surfaces.index(name.removeprefix("level of "))]


def _deviance(y: F64, mu: F64) -> F64:
    ratio = y / mu
    return np.asarray(2.0 * (ratio - 1.0 - np.log(ratio)))


def _slopes(made: _Modelled, names: list[str], where: NDArray[np.bool_]) -> F64:
    count = int(where.sum())
    return np.stack([made.by[name][where] for name in names], axis=-1) if names else np.zeros((count, 0))


def _screened(cells: _Cells, chosen: list[str], x: F64, left: list[str], blocks: CellBlocks) -> tuple[F64, F64]:
    """Chi squared of each score beside the fitted model, and the correlations of the directions themselves.

    Residuals are roots of the deviance: a field that is 10 dB darker is as far off as one that is 10 dB brighter. What
    a hypothesis explains is none of the scatter that its score is held against.
    """
    made = cells.model(chosen, x, left)
    y, mu = cells.measured[blocks.where], made.power[blocks.where]
    residual = np.sign(y - mu) * np.sqrt(_deviance(y, mu))
    had, more = _slopes(made, chosen, blocks.where), _slopes(made, left, blocks.where)
    w = weights_of(residual)[:, None]
    free = more - had @ np.linalg.lstsq(had.T @ (w * had), had.T @ (w * more), rcond=None)[0]
    information, norms = free.T @ (w * free), (w * more * more).sum(axis=0)
    score = (w * free).T @ residual
    own = np.diag(information)
    alive = own > 1e-6 * norms
    statistic = np.zeros(len(left))
    for k in np.flatnonzero(alive):
        scatter = CellScatter.of(residual - free[:, k] * (score[k] / own[k]), blocks)
        statistic[k] = score[k] ** 2 / float(scatter.covariance(free[:, k : k + 1])[0, 0])
    seen = np.sqrt(np.where(alive, own, 1.0))
    return statistic, information / np.outer(seen, seen) * np.outer(alive, alive)


def _fitted(cells: _Cells, names: list[str], x: F64, blocks: CellBlocks) -> F64:
    """Values of the hypotheses: Gauss-Newton on weighted scores, halved where the deviance grows."""
    if not names:
        return x
    where = blocks.where
    y, made = cells.measured[where], cells.model(names, x)
    for _ in range(STEPS):
        residual = y / made.power[where] - 1.0
        slopes, w = _slopes(made, names, where), weights_of(residual)
        information = slopes.T @ (w[:, None] * slopes)
        step = np.linalg.lstsq(information, slopes.T @ (w * residual), rcond=None)[0]
        limit = np.array([cells.longest_step(name) for name in names])
        step *= min(1.0, float(np.min(limit / np.maximum(np.abs(step), 1e-300))))
        now = (w * _deviance(y, made.power[where])).sum()
        for _ in range(6):
            trial = cells.model(names, x + step)
            gained = now - (w * _deviance(y, trial.power[where])).sum()
            if gained >= 0.0:
                break
            step = 0.5 * step
        else:
            return x
        x, made = x + step, trial
        if gained < 1e-3 * robust_variance(residual):
            break
    return x


def _gain(
    cells: _Cells, before: tuple[list[str], F64], after: tuple[list[str], F64], blocks: CellBlocks
) -> tuple[float, float]:
    """Deviance by the variance of cells, less with the last hypothesis than without; and its standard error.

    Of a residual e about the better model mu', a cell gains 2 [(1 + e) (mu' / mu - 1) - ln (mu' / mu)].
    """
    where, made = blocks.where, cells.model(*after)
    powers = [cells.model(*before).power[where], made.power[where]]
    y = cells.measured[where]
    scatter = CellScatter.of(y / powers[1] - 1.0, blocks)
    less, more = (scatter.weights * _deviance(y, power) for power in powers)
    total = float((less - more).sum()) / scatter.variance
    touched = np.unique(cells.square[where][np.abs(made.by[after[0][-1]][where]) > 0.0])
    if touched.size < LEAST_TOUCHED:
        return total, np.inf
    by_residual = 2.0 * (powers[1] / powers[0] - 1.0)[:, None]
    return total, float(np.sqrt(scatter.covariance(by_residual)[0, 0])) / scatter.variance


def _standard_deviations(cells: _Cells, names: list[str], x: F64, blocks: CellBlocks) -> F64:
    if not names:
        return np.zeros(0)
    made = cells.model(names, x)
    where = blocks.where
    scatter = CellScatter.of(cells.measured[where] / made.power[where] - 1.0, blocks)
    slopes = _slopes(made, names, where)
    bread = np.linalg.pinv(slopes.T @ (scatter.weights[:, None] * slopes))
    variance = np.diag(bread @ scatter.covariance(slopes) @ bread)
    return np.sqrt(np.where(variance > 0.0, variance, np.inf))  # rounding may leave what is not determined below 0


def _difference(
    found: SimulatedProduct, cells: _Cells, name: str, value: float, sd: float, gain: float, tied: tuple[str, ...]
) -> TerrainDifference:
    unit = "m" if name in MOVES else "dB"
    scale = 1.0 if unit == "m" else DB
    at, reach = scale * value, scale * NORMAL_95 * sd
    granted = _granted(found.product.frequency_hz, cells, name, tied)
    beyond = granted is None or abs(at) - reach > granted
    made = TerrainDifference(name, at, at - reach, at + reach, unit, gain, tied, granted, beyond, "")
    return replace(made, words=_words(found, cells, made))


def _granted(hertz: float, cells: _Cells, name: str, tied: tuple[str, ...]) -> float | None:
    """What needs no name: levels of the library within their spread, places within what orbits allow."""
    spreads = {surface: NORMAL_95 * SURFACES[surface].spread_at(hertz) for surface in cells.surfaces}
    if name == "calibration":
        # the surfaces' own levels may all lie off together by chance
        return float(np.sqrt(np.sum(np.square([*spreads.values()]))) / len(spreads))
    if name in cells.regions:
        return spreads[cells.surfaces[cells.regions[name][0]]]
    if name.startswith("level of "):
        return spreads[name.removeprefix("level of ")]
    if name == AZIMUTH:
        return None
    if name in MOVES:
        tells = 1.0
        if name == HEIGHT:
            if RANGE not in tied:
                return None
            tells = cells.tilt
        return PLACE_ALLOWANCE_M / tells
    return None


def _words(found: SimulatedProduct, cells: _Cells, one: TerrainDifference) -> str:
    amount = f"{one.value:+.2f} {one.unit} ({one.low:+.2f} to {one.high:+.2f})"
    readings = {
        "calibration": f"all power is {amount} of the simulated: the calibration, or the levels of all surfaces",
        "noise": f"noise is {amount} of what the annotation says",
        RANGE: f"the scene lies {amount} farther in slant range than simulated",
        AZIMUTH: f"the scene lies {amount} later along the flight than simulated",
        HEIGHT: f"the elevation model is to be raised by {amount}",
        TREND[0]: f"power grows by {amount} from the middle of the lines to the last: no cause is known here",
        TREND[1]: f"power grows by {amount} from the middle of the pixels to the last: the antenna pattern, or no "
        "cause that is known here",
    }
    words = readings.get(one.name)
    if words is None and one.name in cells.regions:
        of, where = cells.regions[one.name]
        latitude, longitude, like = _place_and_surfaces(found, cells, where, of, one.value)
        words = f"{one.name}, about {latitude:.4f} {longitude:.4f}, is {amount} of its surface"
        if one.named:
            words += f": other land cover ({like})"
    elif words is None:
        words = f"the {one.name} is {amount} of the library's"
    if not one.named:
        kind = "surfaces" if one.unit == "dB" else "orbits and atmosphere"
        words += f"; within what {kind} may do ({one.granted:.1f} {one.unit})"
    if one.tied:
        words += f"; not to be told from {', '.join(one.tied)}"
    return words


def _place_and_surfaces(
    found: SimulatedProduct, cells: _Cells, where: NDArray[np.bool_], of: int, value_db: float
) -> tuple[float, float, str]:
    """The middle of a region, and the library's surfaces whose level there is that of the region."""
    latitude, longitude, angle = (
        float(np.nanmedian(each[where])) for each in (cells.latitude, cells.longitude, cells.incidence)
    )
    level = {
        name: DB * float(np.log(np.interp(angle, ANGLES_DEG, surface_sigma0(name, found.product)))) for name in SURFACES
    }
    wanted = level[cells.surfaces[of]] + value_db
    hertz = found.product.frequency_hz
    near = sorted((abs(at - wanted) / SURFACES[name].spread_at(hertz), name) for name, at in level.items())
    like = [name for off, name in near if off < 1.0 and name != cells.surfaces[of]][:3]
    return latitude, longitude, f"its level is that of {', '.join(like)}" if like else "of no level in the library"


def _farthest(found: SimulatedProduct, cells: _Cells, left_db: F64) -> str:
    """The square that the model, as it ends, describes worst."""
    where = np.isfinite(left_db)
    _, which = np.unique(cells.square[where], return_inverse=True)
    count = np.bincount(which)
    mean = np.where(count >= SQUARE**2 // 2, np.bincount(which, left_db[where]) / count, 0.0)
    worst = int(np.argmax(np.abs(mean)))
    row, column = (float(np.mean(each[which == worst])) for each in np.nonzero(where))
    at = int((row + 0.5) * cells.cell[0]), int((column + 0.5) * cells.cell[1])
    latitude, longitude = (found.image[name][at] for name in ("latitude", "longitude"))
    return (
        f"the largest difference that is left is {mean[worst]:+.1f} dB, over {SQUARE} x {SQUARE} cells about line "
        f"{found.window.lines[0] + at[0]}, pixel {found.window.pixels[0] + at[1]} ({latitude:.4f} {longitude:.4f})"
    )
