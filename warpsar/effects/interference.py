"""Power from another transmitter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import warp as wp

from warpsar.effects.base.effect import Effect
from warpsar.effects.base.parameter import Setting, amount
from warpsar.effects.base.phase import ComplexImage
from warpsar.effects.base.recorder import Recorder
from warpsar.effects.base.signature import SeenImage, Signature, power_in
from warpsar.effects.base.trial import Context, ScoreStep, Trial
from warpsar.kernels.effects import interference as kernels
from warpsar.world.world import World

_MOVES = (-4, -1, 1, 4)  # of an end of a band, in rows
_HEIGHTS_PX = (1, 4, 16)  # of the bands that are tried, at steps of half their height
_KNOWN_PX = 8  # dark pixels from which they say whether a row holds power
# Of a row's mean: a pixel with less holds none. Of one look 2 % have as little.
_HOLDS = 0.02
_ALL = 0.8  # share of a row's dark pixels that hold power, under which something else stands in it


def _bands(value: Any) -> bool:
    """[[first, end], ...] with whole numbers 0 <= first < end."""

    def band(one: Any) -> bool:
        return (
            isinstance(one, list | tuple)
            and len(one) == 2
            and all(isinstance(n, int) and not isinstance(n, bool) for n in one)
            and 0 <= one[0] < one[1]
        )

    return isinstance(value, list | tuple) and all(map(band, value))


def _overlap(band: Sequence[int], others: Sequence[Sequence[int]]) -> bool:
    """Whether a band meets one of the others or the row beside it: then the other one should move instead."""
    return any(band[0] <= end and first <= band[1] for first, end in others)


def _bands_of(rows: np.ndarray) -> list[list[int]]:
    """The rows that are true, as [first, end] bands."""
    steps = np.flatnonzero(np.diff(np.concatenate([[0], rows.astype(int), [0]])))
    return [[int(first), int(end)] for first, end in steps.reshape(-1, 2)]


def _line(settings: Mapping[str, Any], rows: int) -> np.ndarray:
    """1 in the rows of a view that are hit, (rows,), float32."""
    line = np.zeros(rows, np.float32)
    for first, end in settings["rows"] or ():
        line[first:end] = 1.0
    return line


_BANDS = {
    "type": "array",
    "items": {"type": "array", "items": {"type": "integer", "minimum": 0}, "minItems": 2, "maxItems": 2},
}


class Interference(Effect):
    """`level` [beta0] is added to the range lines `rows` of a view, over all of azimuth.

    Both are tables by view name. Rows are lists of [first, end], counted from 0; `end` is not included.
    """

    name = "interference"
    stage = "image"
    acts_on = ("beta0", "slc")
    in_place = "--product slc: its rows are those of an image"
    order = 40
    affine = True
    additive = True
    in_image = True
    summary = "lines of added power in a view"
    example: ClassVar[dict[str, Any]] = {"level": {"v0": 0.02}, "rows": {"v0": [[40, 42], [100, 101]]}}
    rate_case: ClassVar[dict[str, Any]] = {"level": {"v1": 0.02}, "rows": {"v1": [[30, 32]]}}
    parameters = (
        amount("level", "beta0", 1e9, 1e-3, (1e-12, 1e6), "Power added to the rows of a view.", per_view=True),
    )
    settings = (
        Setting(
            "rows",
            {},
            _bands,
            "a list of [first, end] rows, first < end",
            per_view=True,
            description="Bands of rows: the first row, and the first one after the band.",
            schema=_BANDS,
        ),
    )

    def check(self, scene: World, table: Mapping[str, Any]) -> str | None:
        rows = table.get("rows", {})
        for name in table.get("level", {}):
            if not rows.get(name):
                return f".rows.{name}: missing; allowed is a list of [first, end] rows"
        for name, bands in rows.items():
            for first, end in bands:
                if end > scene.grid.shape[0]:
                    return (
                        f".rows.{name}: found [{first}, {end}]; allowed are rows of the image, to {scene.grid.shape[0]}"
                    )
        return None

    def parts(self, image: SeenImage, table: Mapping[str, Any]) -> Mapping[str, np.ndarray]:
        """A row holds the same power from end to end. What lies beside the rows tells what the surface sends."""
        return image.halves() if table.get("rows", {}).get(image.view.name) else {}

    def own_test(self, images: Sequence[SeenImage], table: Mapping[str, Any]) -> Signature:
        """Its rows go on where nothing is lit."""
        masks = [one.dark & (one.with_it > 1.5 * one.without) for one in images]
        return power_in(images, masks, "interference", "in the dark parts of its rows")

    def trials(self, context: Context) -> list[Trial]:
        """One view and one band of rows each; the next turn of the diagnosis finds what remains beside it."""
        scene, size = context.scene, 0.1 * context.level
        found, rows = [], scene.grid.shape[0]
        for view in scene.views:
            if view.role != "train":
                continue
            level = {view.name: size}
            everywhere = {"level": level, "rows": {view.name: [[0, rows]]}}
            for height in _HEIGHTS_PX:
                for first in range(0, rows - height + 1, max(1, height // 2)):
                    end = first + height
                    at = {"level": level, "rows": {view.name: [[first, end]]}}
                    step = ScoreStep("level", size, everywhere, one_sided=True, views=(view.name,), rows=(first, end))
                    found.append(Trial((step,), (at,), f"{view.name}, rows {first} to {end - 1}"))
        return found

    def placed_in_the_dark(
        self, scene: World, table: Mapping[str, Any], power: Mapping[str, np.ndarray]
    ) -> Mapping[str, Any] | None:
        """Rows that hold power from end to end; known rows without it are taken out of the table, which is empty where
        none is left."""
        level, rows = dict(table.get("level", {})), dict(table.get("rows", {}))
        found = False
        for view, image in power.items():
            known = np.isfinite(image).sum(axis=1) >= _KNOWN_PX
            mean = np.array([np.nanmean(row) if k else 0.0 for row, k in zip(image, known, strict=True)])
            with np.errstate(invalid="ignore"):
                share = np.nanmean(np.where(np.isfinite(image), image > _HOLDS * mean[:, None], np.nan)[known], axis=1)
            hit = np.zeros(len(image), bool)
            hit[known] = (share > _ALL) & (mean[known] > 0)
            found |= bool(hit.any())
            stated = np.zeros(len(image), bool)
            for first, end in rows.get(view, []):
                stated[first:end] = True
            bands = _bands_of(np.where(known, hit, stated))
            if bands:
                rows[view] = bands
                if hit.any():
                    level[view] = float(mean[hit].mean())
            else:
                rows.pop(view, None)
                level.pop(view, None)
        if not found and rows == dict(table.get("rows", {})):
            return None
        return {**table, "level": level, "rows": rows} if rows else {}

    def simpler(self, table: Mapping[str, Any]) -> list[Mapping[str, Any]]:
        """Without one band each."""
        rows = table.get("rows", {})
        if sum(map(len, rows.values())) < 2:
            return []
        found: list[Mapping[str, Any]] = []
        for view, bands in rows.items():
            for band in bands:
                rest = {**rows, view: [other for other in bands if other != band]}
                kept = {name: left for name, left in rest.items() if left}
                level = {name: value for name, value in table["level"].items() if name in kept}
                found.append({**table, "level": level, "rows": kept})
        return found

    def refinements(
        self, scene: World, table: Mapping[str, Any], others: Sequence[Mapping[str, Any]]
    ) -> list[tuple[Mapping[str, Any], int]]:
        """Each end of each band moved a little; and one more band that scored, in this view or another."""
        rows = table["rows"]
        found: list[tuple[Mapping[str, Any], int]] = []
        for view, bands in rows.items():
            for index, (first, end) in enumerate(bands):
                rest = [band for k, band in enumerate(bands) if k != index]
                moved = [[first + move, end] for move in _MOVES] + [[first, end + move] for move in _MOVES]
                found += [
                    ({**table, "rows": {**rows, view: sorted([*rest, band])}}, 0)
                    for band in moved
                    if 0 <= band[0] < band[1] <= scene.grid.shape[0] and not _overlap(band, rest)
                ]
        for other, view, band in ((o, v, b) for o in others for v, bands in o["rows"].items() for b in bands):
            if not _overlap(band, rows.get(view, [])):
                added = {
                    "level": {view: other["level"][view], **table["level"]},
                    "rows": {**rows, view: sorted([*rows.get(view, []), list(band)])},
                }
                found.append((added, 1))
        return found

    def samples(
        self, image: ComplexImage, values: np.ndarray, settings: Mapping[str, Any], samples: np.ndarray
    ) -> np.ndarray:
        """Gaussian numbers of the mean power `level`: the other transmitter knows nothing of the radar's pulses."""
        line = _line(settings, samples.shape[0])[:, None]
        added: np.ndarray = samples + np.sqrt(np.float32(values[0])) * line * image.lines()
        return added

    def image(self, render: Recorder, p: wp.array, image: wp.array) -> wp.array:
        rows, cols = render.shape
        line = _line(render.settings[self.name], rows)
        device = render.program.device
        return render.program.mapped(
            kernels.lines_kernel, image, [p, wp.array(line, dtype=float, device=device), cols, image]
        )


EFFECT = Interference()
