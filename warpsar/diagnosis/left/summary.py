"""What is left at the end, in terms that a person can act on: where, how much, of what shape, and how it moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from warpsar.compare.comparison import Comparison
from warpsar.compare.observation import Observation
from warpsar.diagnosis.dark.pixels import NOTHING, DarkPixels, impossible
from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.left.nearest import Near, nearest
from warpsar.diagnosis.left.shape import ResidualShape, ResidualSpectrum, shape_of
from warpsar.diagnosis.models.carried import on_the_surface
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.role_metrics import dark_of
from warpsar.diagnosis.turn.signature import surface_in_pixels
from warpsar.scene.scene import Scene
from warpsar.speckle.own import Patch, own_autocovariance
from warpsar.speckle.scan import Spot

# ---- whether what is left moves with the surface or with the image, from view to view


SMOOTHED = 3  # pixels on a side, over which the other views' residual is averaged
STANDS_OUT = 2.5  # standard deviations of that average, from which it is carried over
MOST = 16.0  # of a squared residual: a few pixels shall not decide
SURE = 4.0  # standard deviations from which the other views are said to show it


@dataclass(frozen=True)
class ResidualMotion:
    """`way`: "surface", "image", "both", "neither" (single views hold it, or it is faint), or "one view" where nothing
    can be compared. `z_surface`, `z_image`: how well the other views' residual predicts a view's own, carried along
    with the surface or left at its place in the image, in standard deviations."""

    way: str
    z_surface: float
    z_image: float


def moves_with(
    setup: FitSetup, scene: Scene, seen: Sequence[Observation], residuals: Sequence[np.ndarray], spread: float
) -> ResidualMotion:
    """`residuals` are images of the standardised residual, 0 where no pixel is compared; `spread` is the variance of
    a sum of them over that of white ones."""
    pairs = [(k, [o for o, other in enumerate(seen) if _comparable(other, mine)]) for k, mine in enumerate(seen)]
    if not any(others for _, others in pairs):
        return ResidualMotion("one view", 0.0, 0.0)
    fields = [_standing_out(residual, spread) for residual in residuals]
    scores, energies = np.zeros(2), np.zeros(2)
    for k, others in pairs:
        mine = seen[k]
        if not others:
            continue
        own = np.minimum(residuals[k] ** 2, MOST)
        here = residuals[k] != 0
        own = np.where(here, own - own[here].mean() if here.any() else 0.0, 0.0)
        carried = np.zeros((2, here.size))
        for o in others:
            carried += on_the_surface(setup, scene, mine.view, seen[o], fields[o])
        by_surface = np.where(carried[1] > 0, carried[0] / np.where(carried[1] > 0, carried[1], 1.0), 0.0)
        by_image = np.mean([fields[o] for o in others], axis=0).ravel()
        for which, field in enumerate((by_surface, by_image)):
            field = np.where(here.ravel(), field, 0.0)
            scores[which] += float(field @ own.ravel())
            energies[which] += float(field @ field) * float(own[here].var()) * spread
    surface, image = scores / np.sqrt(np.maximum(energies, 1e-12))
    way = "neither"
    if max(surface, image) > SURE:
        way = "surface" if surface > image else "image"
        if min(surface, image) > max(SURE, 0.7 * max(surface, image)):
            way = "both"
    return ResidualMotion(way, float(surface), float(image))


def _comparable(other: Observation, mine: Observation) -> bool:
    return other.view.name != mine.view.name and other.polarization == mine.polarization


def _standing_out(residual: np.ndarray, spread: float) -> np.ndarray:
    """Where the residual, averaged over a few pixels, is more than speckle makes, up or down; shape (rows, cols).

    Its size counts, not its sign: what stands on the ground is bright from one side and a shadow from another.
    """
    mask = (residual != 0).astype(float)
    share = uniform_filter(mask, SMOOTHED, mode="constant")
    mean = uniform_filter(residual * mask, SMOOTHED, mode="constant") / np.maximum(share, 1e-6)
    error = np.sqrt(spread / np.maximum(share * SMOOTHED**2, 1.0))
    return np.where((np.abs(mean) > STANDS_OUT * error) & (mask > 0), np.abs(mean), 0.0)


FEWEST = 20  # pixels of a share
ANGLE_DEG = 10.0  # width of a range of incidence
TOP = 1e-3  # below the largest value of an image: what counts as equal to it
PILE, PILE_SHARE = 8, 2e-3  # pixels at the largest value, and their share, from which an image is clipped


@dataclass(frozen=True)
class PowerRatio:
    """Measured over modelled power of some compared pixels [dB], its standard error, and z; `name` says which."""

    name: str
    pixels: int
    ratio_db: float
    error_db: float
    z: float


@dataclass(frozen=True)
class InTheDark:
    """Dark pixels of one image: how many, their mean measured and modelled beta0, and in how many of them the model
    has nothing and the image more than a trace of its lit pixels' median."""

    image: str
    pixels: int
    measured: float
    modelled: float
    impossible: int


@dataclass(frozen=True)
class Left:
    """What the final model leaves of the train images.

    `unexplained`: whether it has to be explained. `where`: "light" or "dark", where it is the strongest. `image`: the
    train image that shows it best, `number` in the order of the train images. `shape`, `spectrum`: of its residual
    there. `ratio_db`: measured over modelled power in the shape's rectangle with its standard error [dB], NaN where the
    model has none. `residuals`: of all train images, in standard deviations, shape (rows, cols), 0 where nothing is
    compared; `masks` say where something is. `spread`: the variance of a sum of them over that of white ones.
    `clipped`: images with a top level, and how many pixels measure it.
    """

    unexplained: bool
    where: str
    image: str
    number: int
    shape: ResidualShape
    spectrum: ResidualSpectrum
    ratio_db: float
    error_db: float
    moves: ResidualMotion
    views: list[PowerRatio]
    surfaces: list[PowerRatio]
    incidences: list[PowerRatio]
    polarizations: list[PowerRatio]
    dark: list[InTheDark]
    clipped: dict[str, int]
    nearest: list[Near]
    residuals: list[np.ndarray]
    masks: list[np.ndarray]
    spread: float


def left_of(diagnosis: Diagnosis, images: Sequence[Comparison], spot: Spot, unexplained: bool) -> Left:
    """What `images`, the final model's, leave; `spot` is the strongest window. Nothing is fitted or decided here."""
    train = [image for image in images if image.role == "train"]
    seen = [now.seen for now in train]
    dark = [dark_of(image) for image in train]
    lit = [
        ((one.interior & image.interior) | (one.silent & (image.simulated > pixels.allowed))) & ~one.dark
        for one, image, pixels in zip(diagnosis.observations, train, dark, strict=True)
    ]
    masks = [(one | (image.scatters & image.usable)) & ~image.seen.dark for one, image in zip(lit, train, strict=True)]
    residuals = [np.where(mask, image.residual, 0.0) for image, mask in zip(train, masks, strict=True)]
    patches = [Patch(mask, _ratio(image, mask), image.seen.law) for image, mask in zip(train, lit, strict=True)]
    autocovariance, _ = own_autocovariance(patches)  # what is left shall not excuse itself
    spread = max(float(autocovariance.sum()), 1e-3)
    last = diagnosis.turns[-1]
    number, in_the_dark = spot.observation, False
    if last.dark is not None and last.dark.minus_log_p > max(last.scan_minus_log_p, last.threshold):
        # the search may have had shadows for dark pixels, which here are pixels as all others
        number, in_the_dark = last.dark.observation, bool(dark[last.dark.observation].interior.any())
    if in_the_dark:
        field, mask = np.zeros_like(residuals[number]), dark[number].interior
        field[mask] = dark[number].residual
        residuals = [_with_dark(one, pixels) for one, pixels in zip(residuals, dark, strict=True)]
    else:
        field, mask = residuals[number], masks[number]
    shape, spectrum = shape_of(field, mask, autocovariance, diagnosis.scene.grid.spacing_m)
    ratio_db, error_db = _in_rectangle(train[number], mask, shape, spread, NOTHING * dark[number].allowed)
    places = [surface_in_pixels(diagnosis.setup, diagnosis.final.scene, one.view) for one in seen]
    materials = diagnosis.final.scene.mesh.materials

    def shares(names: Sequence[str], of: Callable[[int], np.ndarray]) -> list[PowerRatio]:
        """A share for each name; `of` gives its number in every pixel of an image."""
        numbers = [of(k) for k in range(len(train))]
        return [
            one
            for i, name in enumerate(names)
            if (one := _share(name, train, lit, [at == i for at in numbers], spread)) is not None
        ]

    angles = [f"{a:g} to {a + ANGLE_DEG:g} deg" for a in np.arange(0.0, 90.0, ANGLE_DEG)]
    kinds = sorted({one.polarization for one in seen})
    return Left(
        unexplained=unexplained,
        where="dark" if in_the_dark else "light",
        image=train[number].name,
        number=number,
        shape=shape,
        spectrum=spectrum,
        ratio_db=ratio_db,
        error_db=error_db,
        moves=moves_with(diagnosis.setup, diagnosis.final.scene, seen, residuals, spread),
        views=shares([one.name for one in train], lambda k: np.full(lit[k].shape, k)),
        surfaces=shares(materials, lambda k: places[k][0]),
        incidences=shares(angles, lambda k: np.floor(np.nan_to_num(places[k][1], nan=-1.0) / ANGLE_DEG)),
        polarizations=shares(kinds, lambda k: np.full(lit[k].shape, kinds.index(seen[k].polarization))),
        dark=[_in_the_dark(image.name, one) for image, one in zip(train, dark, strict=True) if one.interior.any()],
        clipped={image.name: n for image in train if (n := _clipped(image))},
        nearest=nearest(last, impossible(dark)),
        residuals=residuals,
        masks=[m | pixels.interior for m, pixels in zip(masks, dark, strict=True)] if in_the_dark else masks,
        spread=spread,
    )


def _ratio(image: Comparison, mask: np.ndarray) -> np.ndarray:
    """Measured over modelled power where `mask` holds, 1 elsewhere."""
    found = np.ones(mask.shape)
    found[mask] = image.seen.measured[mask] / image.simulated[mask]
    return found


def _with_dark(residual: np.ndarray, pixels: DarkPixels) -> np.ndarray:
    found = residual.copy()
    found[pixels.interior] = pixels.residual
    return found


def _decibels(ratio: float, error: float) -> tuple[float, float]:
    """A ratio of powers and its standard error in dB."""
    if not ratio > 0:
        return float("nan"), float("nan")
    return float(10.0 * np.log10(ratio)), float(10.0 / np.log(10.0) * error / ratio)


def _share(
    name: str, images: Sequence[Comparison], masks: Sequence[np.ndarray], parts: Sequence[np.ndarray], spread: float
) -> PowerRatio | None:
    """The mean of measured over modelled power of the pixels of `parts`, each weighted by its looks."""
    total, weight, count = 0.0, 0.0, 0
    for image, mask, part in zip(images, masks, parts, strict=True):
        use = mask & part
        looks = image.seen.looks
        total += looks * float((image.seen.measured[use] / image.simulated[use]).sum())
        weight += looks * int(use.sum())
        count += int(use.sum())
    if count < FEWEST:
        return None
    ratio, error = total / weight, float(np.sqrt(spread / weight))
    return PowerRatio(name, count, *_decibels(ratio, error), (ratio - 1.0) / error)


def _in_rectangle(
    image: Comparison, mask: np.ndarray, shape: ResidualShape, spread: float, nothing: float
) -> tuple[float, float]:
    """Measured over modelled power in the shape's rectangle and its standard error [dB]; NaN where the model has no
    more than `nothing` on average."""
    box = np.zeros_like(mask)
    top, left = shape.row - shape.rows // 2, shape.col - shape.cols // 2
    box[max(top, 0) : top + shape.rows, max(left, 0) : left + shape.cols] = True
    use = mask & box
    modelled = float(image.simulated[use].sum())
    if modelled <= nothing * int(use.sum()):
        return float("nan"), float("nan")
    ratio = float(np.nan_to_num(image.seen.measured[use]).sum()) / modelled
    return _decibels(ratio, ratio * float(np.sqrt(spread / (max(int(use.sum()), 1) * image.seen.looks))))


def _in_the_dark(name: str, one: DarkPixels) -> InTheDark:
    inside = one.interior
    impossible = int((one.empty & (one.measured > one.allowed)).sum())
    measured, modelled = (float(plane[inside].mean()) for plane in (one.measured, one.modelled))
    return InTheDark(name, int(inside.sum()), measured, modelled, impossible)


def _clipped(image: Comparison) -> int:
    """How many pixels measure the largest value of an image, where they pile up there; 0 where they do not."""
    values = image.seen.values
    count = int((values >= (1.0 - TOP) * values.max()).sum())
    return count if count >= max(PILE, PILE_SHARE * values.size) else 0
