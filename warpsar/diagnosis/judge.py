"""How far models are from the measured images, all on the same rays and frozen pixels, test views among them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from warpsar.diagnosis.dark.pixels import DarkPixels
from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.models.bench import Bench
from warpsar.diagnosis.models.change import changes
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.refit import narrowed_to
from warpsar.evaluation.image import Metrics
from warpsar.evaluation.metrics import mean_deviance
from warpsar.learning.identify import residual_autocovariance
from warpsar.learning.observation import Observation
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.speckle.likelihood import deviance, expected_deviance, metrics

ROLES = ("train", "test")


@dataclass(frozen=True)
class Judged:
    """One measured image beside a model's: `modelled` is beta0 with its gain, shape (rows, cols); `seen` holds the
    pixels that are compared."""

    role: str
    seen: Observation
    modelled: np.ndarray
    gain: float

    @property
    def name(self) -> str:
        return f"{self.seen.view.name} {self.seen.polarization}"

    @property
    def dark(self) -> DarkPixels:
        """Its pixels far from everything lit."""
        return DarkPixels.of(self.seen, self.modelled)

    @property
    def scaled_deviance(self) -> np.ndarray:
        """d / E[d] of every compared pixel, shape (n,): 1 on average where speckle alone is left."""
        looks = self.seen.looks
        return deviance(self.seen.values, self.modelled[self.seen.interior], looks) / expected_deviance(looks)


class Judge:
    """Judges any model of the diagnosed scene. Masks of the test views are frozen as those of the train views were:
    from the declared model, before anything was fitted. Where the final model has another geometry, both light what is
    compared."""

    def __init__(self, found: Diagnosis) -> None:
        bench = found.bench
        self.benches = {"train": bench}
        if any(view.role == "test" and view.images for view in found.scene.views):
            other = Rays(bench.rays.stage, bench.rays.rays_per_m2, bench.rays.seed + 1)
            scene = turned(found.scene)
            one, two = (
                Bench(bench.device, rays, {}, mesh=bench.mesh, others=bench.others) for rays in (bench.rays, other)
            )
            self.benches["test"] = replace(one, observations=frozen(one, two, scene))
        if changes(found.scene, found.final.scene):
            self._narrow(found.final.scene)

    def _narrow(self, final: Scene) -> None:
        """Judge on the pixels that a final model of another geometry lights, too."""
        for role, bench in self.benches.items():
            problem = bench.problem(final if role == "train" else turned(final), dark=False)
            problem.modelled_as_declared()
            self.benches[role] = narrowed_to(bench, problem)

    def __call__(self, scene: Scene) -> list[Judged]:
        """Every measured image beside `scene`'s, nothing fitted but the gain of images that are not calibrated.
        What an effect holds for each view by itself is at its default in views that the scene's tables do not name."""
        found = []
        for role, bench in self.benches.items():
            problem = bench.problem(scene if role == "train" else turned(scene), dark=False)
            gains = iter(problem.gains(problem.modelled_as_declared()))
            for view in problem.views:
                for seen in view.observations:
                    gain = float(next(gains))
                    image = view.render.images[seen.polarization].numpy().reshape(seen.measured.shape).astype(float)
                    image[seen.interior] = np.maximum(image[seen.interior], seen.darkest)
                    found.append(Judged(role, seen, gain * image, gain))
        return found


def turned(scene: Scene) -> Scene:
    """The scene with train and test views exchanged."""
    other = {"train": "test", "test": "train"}
    return replace(scene, views=[v.model_copy(update={"role": other[v.role]}) for v in scene.views])


class JudgedMetrics(Metrics):
    """Of the compared pixels of several images together; the error includes correlated speckle.

    `dark_pixels` are those far from everything lit, zeros among them. `dark_measured` and `dark_modelled` are their
    mean beta0, None without any. `dark_impossible`: how many measure more than a trace of the lit pixels' median where
    the model has less than a hundredth of it. `dark_deviance`: the mean of d / E[d] over the others that measure power,
    and where the model has a trace; None without any.
    """

    images: int
    dark_pixels: int
    dark_measured: float | None
    dark_modelled: float | None
    dark_impossible: int
    dark_deviance: float | None


def pool(images: Sequence[Judged], role: str) -> JudgedMetrics | None:
    """Metrics over the compared pixels of all images of a role together; None where there are none."""
    mine = [image for image in images if image.role == role]
    if not mine:
        return None
    measured = np.concatenate([image.seen.values for image in mine])
    found = metrics(measured, np.concatenate([i.modelled[i.seen.interior] for i in mine]), 1.0)
    shares = np.array([image.seen.values.size for image in mine]) / measured.size
    means = np.array([mean_deviance(image.seen, image.modelled, image.seen.interior) for image in mine])
    found["deviance"] = float(shares @ means[:, 0])
    found["deviance_error"] = float(np.linalg.norm(shares * means[:, 1]))
    found["pixels"] = int(measured.size)
    found["left_out"] = sum(image.seen.left_out for image in mine)
    found["zeros"] = sum(image.seen.zeros for image in mine)
    return cast(JudgedMetrics, found | {"images": len(mine)} | _in_the_dark([image.dark for image in mine]))


def _in_the_dark(pixels: Sequence[DarkPixels]) -> dict[str, float | int | None]:
    """What `JudgedMetrics` says of dark pixels."""

    def gathered(plane: Callable[[DarkPixels], np.ndarray]) -> np.ndarray:
        return np.concatenate([plane(one)[one.interior] for one in pixels])

    measured, modelled = gathered(lambda one: one.measured), gathered(lambda one: one.modelled)
    deviances = [
        deviance(one.measured[use], one.modelled[use], one.looks) / expected_deviance(one.looks)
        for one in pixels
        for use in [one.powered & (one.measured > 0)]
    ]
    both = np.concatenate(deviances)
    return {
        "dark_pixels": int(measured.size),
        "dark_measured": float(measured.mean()) if measured.size else None,
        "dark_modelled": float(modelled.mean()) if measured.size else None,
        "dark_impossible": sum(int((one.empty & (one.measured > one.allowed)).sum()) for one in pixels),
        "dark_deviance": float(both.mean()) if both.size else None,
    }


def difference(before: Sequence[Judged], after: Sequence[Judged], role: str) -> tuple[float, float] | None:
    """Mean deviance before less that after, pixel by pixel, and its standard error: of the same speckle, so that it is
    known far better than either. None where there are no images of the role."""
    pairs = [(a, b) for a, b in zip(before, after, strict=True) if a.role == role]
    if not pairs:
        return None
    parts = [a.scaled_deviance - b.scaled_deviance for a, b in pairs]
    sizes = np.array([part.size for part in parts])
    errors = [
        np.sqrt(max(float(residual_autocovariance([(a.seen, part - part.mean())]).sum()), 0.0) / part.size)
        for (a, _), part in zip(pairs, parts, strict=True)
    ]
    shares = sizes / sizes.sum()
    return float(np.concatenate(parts).mean()), float(np.linalg.norm(shares * errors))
