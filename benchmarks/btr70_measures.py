"""How near a prediction of a chip is, by model or by another chip: benchmarks/btr70.py.

A chip is its power, shape (128, 128), [DN^2], radar on top. A prediction has the same pixels. `SIZE` x `SIZE` pixels in
the middle are compared. The correlation is that of the fourth root of power that was smoothed by a Gaussian of `SMOOTH`
pixels. With 1.5 it gives two chips of one azimuth at 15 and 17 degrees 0.883 to 0.89, as the figures did that set the
bar; 1 is given beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter, rotate, shift
from scipy.signal import fftconvolve

SIZE = 80
REACH = 9  # pixels of shift
SMOOTH = (1.5, 1.0)
EXPECTED = 2.0 * 0.5772156649015329  # mean deviance of one look
BOUND = 20.0  # of a pixel's loss, where a shift or a gain is sought
FAINTEST = 1e-3  # of a prediction's median: no pixel counts as darker


@dataclass(frozen=True)
class Chip:
    """A chip and where it was taken from."""

    name: str
    azimuth_deg: float
    depression_deg: float
    power: np.ndarray


def turn_deg(a: float, b: float) -> float:
    """a - b, -180 to 180 degrees."""
    return (a - b + 180.0) % 360.0 - 180.0


def middle(image: np.ndarray, moved: tuple[int, int] = (0, 0), size: int = SIZE) -> np.ndarray:
    """The middle of an image that is `moved` by (rows, columns)."""
    row, col = ((n - size) // 2 - s for n, s in zip(image.shape, moved, strict=True))
    return image[row : row + size, col : col + size]


def roots(power: np.ndarray, smooth: float) -> np.ndarray:
    return np.asarray(gaussian_filter(power, smooth) ** 0.25)


def correlation(a: np.ndarray, b: np.ndarray, where: np.ndarray | None = None) -> float:
    x, y = (a.ravel(), b.ravel()) if where is None else (a[where], b[where])
    return float(np.corrcoef(x, y)[0, 1]) if x.size > 9 else float("nan")


def shifts() -> list[tuple[int, int]]:
    return [(i, j) for i in range(-REACH, REACH + 1) for j in range(-REACH, REACH + 1)]


def correlations(a: np.ndarray, wide: np.ndarray) -> np.ndarray:
    """The correlation of `a`, shape (n, n), with every window of its size in `wide`, (n + 2 r, n + 2 r), by a Fourier
    transform; shape (2 r + 1, 2 r + 1)."""
    wide = wide - wide.mean()  # the less there is to subtract below
    own = a - a.mean()
    total, squares = (
        sliding_window_view(np.pad(one.cumsum(0).cumsum(1), ((1, 0), (1, 0))), [n + 1 for n in a.shape])
        for one in (wide, wide**2)
    )
    sums, powers = (w[..., -1, -1] - w[..., 0, -1] - w[..., -1, 0] + w[..., 0, 0] for w in (total, squares))
    spread = powers - sums**2 / a.size
    return np.asarray(fftconvolve(wide, own[::-1, ::-1], mode="valid") / np.sqrt(spread * (own**2).sum()))


def best_shift(chip: np.ndarray, prediction: np.ndarray, smooth: float = SMOOTH[0]) -> tuple[float, tuple[int, int]]:
    """The largest correlation over all shifts of the prediction, and its shift: what the measure likes best."""
    a, b = middle(roots(chip, smooth)), roots(prediction, smooth)
    found = correlations(a, middle(b, size=SIZE + 2 * REACH))
    row, col = np.unravel_index(found.argmax(), found.shape)
    return float(found[row, col]), (REACH - int(row), REACH - int(col))


def terms(chip: np.ndarray, prediction: np.ndarray) -> np.ndarray:
    """Gamma deviance of one look per pixel, at the best gain; shape of the two."""
    mu = np.maximum(prediction, FAINTEST * np.median(prediction))
    ratio = np.maximum(chip, 1.0) / mu
    gain = float(np.median(ratio))
    logarithm = np.log(ratio)
    for _ in range(12):
        half = ratio / gain - 1.0 - logarithm + np.log(gain)
        weights = 1.0 / (1.0 + half / BOUND)
        before, gain = gain, float((weights * ratio).sum() / weights.sum())
        if abs(gain / before - 1.0) < 1e-9:
            break
    return np.asarray(2.0 * (ratio / gain - 1.0 - logarithm + np.log(gain)))


def own_shift(chip: np.ndarray, prediction: np.ndarray) -> tuple[int, int]:
    """The aim point that the likelihood chooses: the shift of least bounded gamma loss, by pixels."""
    power = middle(chip)

    def loss(at: tuple[int, int]) -> float:
        return float(np.log1p(0.5 * terms(power, middle(prediction, at)) / BOUND).sum())

    coarse = min(((i, j) for i, j in shifts() if i % 3 == 0 and j % 3 == 0), key=loss)
    near = [at for at in shifts() if max(abs(at[0] - coarse[0]), abs(at[1] - coarse[1])) <= 2]
    return min(near, key=loss)


def aimed(power: np.ndarray, prediction: np.ndarray, near: tuple[int, int] | None = None) -> float:
    """Mean deviance at the model's best aim point, between the pixels: where parabolas through the best shift and its
    neighbours have their least value. By whole pixels a profile would have steps, and its least value a bias.

    The search begins at the shift `near`; by default where the correlation is best."""
    at, known = near or best_shift(power, prediction)[1], {}
    chip = middle(power)

    def score(one: tuple[int, int]) -> float:
        if one not in known:
            known[one] = float(terms(chip, middle(prediction, one)).mean())
        return known[one]

    cross = [(0, 0), (-1, 0), (1, 0), (0, -1), (0, 1)]
    while (better := min(((at[0] + i, at[1] + j) for i, j in cross), key=score)) != at and max(
        map(abs, better)
    ) < REACH:
        at = better
    here, up, down, left, right = (score((at[0] + i, at[1] + j)) for i, j in cross)
    step = [
        (before - after) / (2.0 * (before + after - 2.0 * here)) if before + after > 2.0 * here else 0.0
        for before, after in ((up, down), (left, right))
    ]
    between = shift(middle(prediction, at, SIZE + 8), np.clip(step, -0.5, 0.5), mode="nearest")
    return min(here, float(terms(chip, middle(between)).mean()))


def lit_edge(power: np.ndarray, body: np.ndarray) -> float:
    """Median row at which a column of the body first reaches half way, in decibels, from the ground to its top."""
    level = 10.0 * np.log10(gaussian_filter(power, 1.0) + 1e-30)
    ground, rows = float(np.median(level)), []
    for col in np.flatnonzero(body.any(axis=0)):
        first, last = np.flatnonzero(body[:, col])[[0, -1]]
        line = level[max(first - 6, 0) : last + 1, col]
        if line.max() > ground:  # a column in the body's own shadow has no edge
            above = np.flatnonzero(line > 0.5 * (ground + line.max()))
            rows.append(max(first - 6, 0) + int(above[0]))
    return float(np.median(rows)) if rows else float("nan")


def judged(
    chip: Chip, prediction: np.ndarray, regions: Mapping[str, np.ndarray], *, own: bool = True
) -> dict[str, float | dict[str, float] | list[int]]:
    """All measures of one prediction. `regions`: masks of the prediction's pixels. `own`: at the shift that the
    likelihood chooses; otherwise at that of the measure."""
    top, best = best_shift(chip.power, prediction)
    at = own_shift(chip.power, prediction) if own else best
    a, b = middle(chip.power), middle(prediction, at)
    deviance = terms(a, b) / EXPECTED
    found: dict[str, float | dict[str, float] | list[int]] = {
        "correlation": correlation(middle(roots(chip.power, SMOOTH[0])), middle(roots(prediction, SMOOTH[0]), at)),
        "best_shift": top,
        "one_pixel": best_shift(chip.power, prediction, SMOOTH[1])[0],
        "deviance": float(deviance.mean()),
        "shift": list(at),
        "measures_shift": list(best),
    }
    x, y = roots(a, SMOOTH[0]), roots(b, SMOOTH[0])
    moved = {name: middle(mask, at) for name, mask in regions.items()}
    for name, mask in moved.items():
        found[name] = {"correlation": correlation(x, y, mask), "deviance": float(deviance[mask].mean())}
    if "body" in moved:
        found["lit_edge_rows"] = lit_edge(a, moved["body"]) - lit_edge(b, moved["body"])
    return found


def turned(chip: Chip, azimuth_deg: float, *, mirror: bool = False) -> np.ndarray:
    """A chip turned to another aspect as a picture; `mirror`: of the vehicle's other side."""
    roots_of = chip.power**0.25
    own = chip.azimuth_deg
    if mirror:
        roots_of, own = roots_of[:, ::-1], -own
    return np.asarray(rotate(roots_of, turn_deg(azimuth_deg, own), reshape=False, order=1, mode="nearest") ** 4)


def rivals(chip: Chip, train: Sequence[Chip], mean: np.ndarray) -> dict[str, np.ndarray]:
    """Predictions that need no physics: the nearest measured train view, the nearest mirrored one, the mean of all."""
    near = min(train, key=lambda one: abs(turn_deg(chip.azimuth_deg, one.azimuth_deg)))
    other = min(train, key=lambda one: abs(turn_deg(chip.azimuth_deg, -one.azimuth_deg)))
    return {
        "nearest": turned(near, chip.azimuth_deg),
        "mirrored": turned(other, chip.azimuth_deg, mirror=True),
        "mean": mean,
    }
