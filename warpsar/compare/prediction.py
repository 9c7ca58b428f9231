"""How well a scene predicts views that no fit has seen, beside rivals that need no physics.

For measured images of one target whose aim point is not known (`[effects.aim_point] reach_m`): each view is predicted
at its angles, and compared at the best shift (aim.py). The correlation is that of fourth roots of smoothed power. A
model has the shift that its own likelihood chooses, a rival the shift that the correlation likes best.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import warp as wp

from warpsar.compare.aim import (
    EXPECTED,
    Reach,
    Shift,
    best_shift,
    correlation,
    mean_deviance,
    own_shift,
    reach_m,
    roots,
    without_aims,
)
from warpsar.compare.rivals import Seen, rivals, turn_deg
from warpsar.effects.registry import declared
from warpsar.render.render import ViewRender
from warpsar.runtime import threads
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import trace_view, view_seed
from warpsar.surface.stage import Stage
from warpsar.world.tables import View

FAR_DEG = 5.0
"""A view farther than this in azimuth from every train view is of an unseen sector."""
SAME_DEG = 1.0  # of incidence: views that differ by less are reported together
PICTURES = ("nearest", "smoothed", "mirrored", "mean")  # rivals that need no physics
BOX = "box"  # a rival that needs no mesh
THEN = "then"  # the model as it was when it met the box last
SURE = 2.0  # standard errors by which a model must predict better than the best rival


@dataclass(frozen=True)
class Agreement:
    """How near one prediction of one image is: `correlation` at the shift `at`, `best`, that at the shift which it
    likes best, and the mean `deviance` of one look over that of speckle, at `at`."""

    correlation: float
    best: float
    deviance: float
    at: Shift


@dataclass(frozen=True)
class PredictedImage:
    """One measured image and all predictions of it, by name: `model`, `before`, and the rivals."""

    view: View
    polarization: str
    in_sector: bool
    predictions: Mapping[str, Agreement]


@dataclass(frozen=True)
class Summary:
    """Means of one prediction over `views` images: of unseen sectors, or between train views, at one incidence."""

    in_sector: bool
    incidence_deg: float
    views: int
    prediction: str
    correlation: float
    best: float
    deviance: float


def predictable(scene: Scene) -> bool:
    """Whether the scene says that aim points are to be found, and has test views for it."""
    return bool(reach_m(scene)) and any(view.images and view.role == "test" for view in scene.views)


def measured_of(scene: Scene, view: View, polarization: str) -> np.ndarray:
    """Measured power (rows, cols), NaN where it is masked."""
    found = np.asarray(scene.measured(view, polarization), float)
    mask = scene.mask(view)
    return found if mask is None else np.where(mask, found, np.nan)


def predicted(
    scene: Scene, views: Sequence[View], device: wp.Device, *, coarse: bool = False
) -> list[dict[str, np.ndarray]]:
    """beta0 of each view by polarization, with no aim point of its own, as rays of the declared density have it.
    `coarse` as in `Hits`."""
    bare = without_aims(scene)
    stage, density = Stage.of(bare, device), bare.sampling.density_per_m2(bare.grid)

    def image(view: View, index: int) -> dict[str, np.ndarray]:
        effects, seed = declared(bare, view), view_seed(bare.sampling.seed, index)
        hits = trace_view(bare, stage, view, seed=seed, effects=effects, rays_per_m2=density)
        hits = replace(hits, coarse=coarse)
        render = ViewRender(stage, view, hits, bare.grid.shape, bare.radar.polarizations, effects)
        return {pol: np.asarray(plane, float) for pol, plane in render.forward().items()}

    return list(threads.ordered([partial(image, view, k) for k, view in enumerate(views)], device))


def agreement(measured: np.ndarray, image: np.ndarray, reach: Reach, *, own: bool) -> Agreement:
    """How near a prediction is; `own`: at the shift that its likelihood chooses, else at that of the correlation."""
    best, liked = best_shift(measured, image, reach)
    at = own_shift(measured, image, reach) if own else liked
    a, b = reach.window(measured), reach.window(image, at)
    found = correlation(reach.window(roots(measured)), reach.window(roots(image), at))
    return Agreement(found, best, mean_deviance(a, b) / EXPECTED, at)


def compared(
    seen: Seen,
    planes: Mapping[str, np.ndarray],
    train: Sequence[Seen],
    spacing_m: tuple[float, float],
    reach: Reach,
) -> dict[str, Agreement]:
    """How near models' `planes` are to a measured image, and the rivals that train images make."""
    found = {name: agreement(seen.power, plane, reach, own=True) for name, plane in planes.items()}
    others = rivals(seen, train, spacing_m) if train else {}
    return found | {name: agreement(seen.power, plane, reach, own=False) for name, plane in others.items()}


def in_sector(view: View, train: Sequence[View]) -> bool:
    """Whether a view is of a sector of azimuth that no train view is near."""
    return all(abs(turn_deg(view.azimuth_deg, one.azimuth_deg)) > FAR_DEG for one in train)


def predictions(
    scenes: Mapping[str, Scene], device: wp.Device, progress: Callable[[], object] | None = None
) -> list[PredictedImage]:
    """All measured test images of the first scene beside what each scene predicts, and beside the rivals.

    `scenes` by the name of the prediction, all of the same measured images. `progress` is called for each image.
    """
    first = next(iter(scenes.values()))
    reach = Reach.of(first)
    tests = [view for view in first.views if view.images and view.role == "test"]
    train = [view for view in first.views if view.images and view.role == "train"]
    images = {name: predicted(scene, tests, device) for name, scene in scenes.items()}
    known = {
        pol: [
            Seen(v.name, v.azimuth_deg, v.incidence_deg, measured_of(first, v, pol)) for v in train if pol in v.images
        ]
        for pol in first.radar.polarizations
    }
    found = []
    for number, view in enumerate(tests):
        for pol in view.images:
            measured = measured_of(first, view, pol)
            seen = Seen(view.name, view.azimuth_deg, view.incidence_deg, measured)
            planes = {name: each[number][pol] for name, each in images.items()}
            beside = compared(seen, planes, known[pol], first.grid.spacing_m, reach)
            found.append(PredictedImage(view, pol, in_sector(view, train), beside))
            if progress is not None:
                progress()
    return found


def summaries(images: Sequence[PredictedImage]) -> list[Summary]:
    """Means by set and incidence: unseen sectors first, larger incidences last."""
    rows = []
    for sector in (True, False):
        mine = [image for image in images if image.in_sector is sector]
        for group in _by_incidence(mine):
            for name in group[0].predictions:
                each = [image.predictions[name] for image in group]
                means = [
                    float(np.mean([getattr(one, key) for one in each])) for key in ("correlation", "best", "deviance")
                ]
                incidence = float(np.mean([image.view.incidence_deg for image in group]))
                rows.append(Summary(sector, incidence, len(group), name, *means))
    return rows


def _by_incidence(images: Sequence[PredictedImage]) -> list[list[PredictedImage]]:
    groups: list[list[PredictedImage]] = []
    for image in sorted(images, key=lambda one: one.view.incidence_deg):
        if groups and image.view.incidence_deg - groups[-1][-1].view.incidence_deg < SAME_DEG:
            groups[-1].append(image)
        else:
            groups.append([image])
    return groups


@dataclass(frozen=True)
class Advantage:
    """By how much a model's correlation is above that of the best `rival`, with its standard error over the images,
    and the same of the deviance, below that of the rival of least deviance. `sector`: whether over unseen sectors
    alone."""

    rival: str
    correlation: float
    error: float
    deviance: float
    sector: bool
    images: int
    deviance_error: float = 0.0

    @property
    def ahead(self) -> bool:
        """Whether the model surely predicts better than any of the rivals does."""
        return self.correlation > SURE * self.error and self.deviance > 0.0

    @property
    def open(self) -> bool:
        """Whether the two measures disagree, and the deviance may be wrong: the model correlates surely better, and is
        behind in deviance by no more than its error."""
        behind = -self.deviance
        return self.correlation > SURE * self.error and 0.0 <= behind <= SURE * self.deviance_error

    @property
    def words(self) -> str:
        where = "of unseen sectors" if self.sector else "between train views"
        what = "a box of its size" if self.rival == BOX else f"the best rival ({self.rival})"
        beside = (
            f"correlation {self.correlation:+.3f} +- {self.error:.3f}, deviance {-self.deviance:+.3f} +- "
            f"{self.deviance_error:.3f}, beside {what}"
        )
        if self.ahead:
            return f"{self.images} test images {where}: {beside}"
        if self.open:
            return (
                f"{self.images} test images {where}: {beside}; by correlation the model predicts better, by deviance "
                "that is not told"
            )
        rival = "by a box of its size" if self.rival == BOX else "by a picture of other measured images"
        sentence = f"{self.images} test images {where} are predicted no better than {rival} ({beside})"
        if not self.sector:
            return f"{sentence}: a neighbour has the glints of the view, so the body itself is not judged"
        return f"not this body, or not its model: {sentence}"


def advantage(
    images: Sequence[PredictedImage], name: str = "model", rivals: Sequence[str] = PICTURES
) -> Advantage | None:
    """How far ahead of the rivals a prediction is, over unseen sectors, or over all where there are none; None where
    the images have none of these rivals."""
    sector = any(image.in_sector for image in images)
    mine = [image for image in images if image.in_sector is sector]
    others = [key for key in rivals if mine and key in mine[0].predictions]
    if not others:
        return None
    rival = max(others, key=lambda key: np.mean([image.predictions[key].correlation for image in mine]))
    deviances = {key: np.array([image.predictions[key].deviance for image in mine]) for key in (*others, name)}
    below = deviances[min(others, key=lambda key: deviances[key].mean())] - deviances[name]
    gain = np.array([i.predictions[name].correlation - i.predictions[rival].correlation for i in mine])
    error, of_deviance = (
        float(one.std(ddof=1) / np.sqrt(one.size)) if one.size > 1 else float("inf") for one in (gain, below)
    )
    return Advantage(rival, float(gain.mean()), error, float(below.mean()), sector, len(mine), of_deviance)
