"""Which measurement would tell two explanations apart that fit the data alike."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import warp as wp

from warpsar.effects.registry import declared, get
from warpsar.scene.scene import Scene
from warpsar.simulation.command import view_render
from warpsar.simulation.rays import trace_view, view_seed
from warpsar.surface.stage import Stage
from warpsar.world.tables import Sampling, View

TURNED_DEG = 10.0  # of incidence, beyond the views that there are
INCIDENCES_DEG = (15.0, 75.0)  # that an extra view may have
RAYS_PER_PIXEL = 64.0  # the same rays for both models, so that their sampling noise cancels
DECIDED = 16.0  # 2 ln L at which a difference, whose standard deviation is 2 sqrt(2 ln L), is two of them above 0


@dataclass(frozen=True)
class Deciding:
    """Which extra measurement would tell most. `distance`: 2 ln L by which the two models are expected to differ there;
    `decides`: whether that is enough; `all` has the distance of every measurement that was looked at; `sentence` says
    it to people."""

    measurement: str
    distance: float
    decides: bool
    all: dict[str, float]
    sentence: str

    def content(self) -> dict[str, Any]:
        """For the JSON."""
        return asdict(self)


def deciding(a: Scene, b: Scene, looks: float, device: wp.Device) -> Deciding:
    """The extra measurement that tells two fitted models of one scene apart best.

    `a` and `b` hold the fitted materials and effects; `looks` are those of an extra image. The distance is sum(looks
    (d - mean d)^2) over the pixels that both models light, d being the difference of ln(beta0): 2 ln L to second order,
    after a free gain. Both models stay as they are fitted, so it is an upper bound. A date of its own shows whether
    values of single views come again.
    """
    distances = {name: _distance(a, b, views, polarization, looks, device) for name, views, polarization in _extra(a)}
    if _only_per_view(a) != _only_per_view(b):
        single = a if _only_per_view(a) else b
        distances["the same views on another date"] = _of_another_date(single, looks, device)
    best = max(distances, key=lambda name: distances[name])
    decides = distances[best] > DECIDED
    return Deciding(best, distances[best], decides, distances, _sentence(a, b, best, distances[best], looks, decides))


def _sentence(a: Scene, b: Scene, best: str, distance: float, looks: float, decides: bool) -> str:
    alone = [" + ".join(n for n in one.effects if n not in other.effects) for one, other in ((a, b), (b, a))]
    names = " from ".join(name or "the model without it" for name in alone)
    would = "would tell" if decides else "would help most, but is not expected to tell"
    number = f"{looks:g} look{'' if looks == 1 else 's'}"
    return f"{best} {would} {names}: the two differ there by {distance:.0f} of 2 ln L at {number}"


def _extra(scene: Scene) -> Iterator[tuple[str, list[View], str]]:
    """Hypothetical views: what to call them, the views, and their polarization."""
    train = sorted((v for v in scene.views if v.role == "train"), key=lambda view: view.incidence_deg)
    polarization = scene.radar.polarizations[0]
    middle = train[len(train) // 2]
    for view, turned in ((train[0], -TURNED_DEG), (train[-1], TURNED_DEG)):
        at = float(np.clip(view.incidence_deg + turned, *INCIDENCES_DEG))
        yield f"a view at {at:.0f} degrees of incidence", [_moved(view, view.azimuth_deg, at)], polarization
    azimuth = _between([view.azimuth_deg for view in train])
    yield f"a view from {azimuth:.0f} degrees of azimuth", [_moved(middle, azimuth, middle.incidence_deg)], polarization
    if "VV" not in scene.radar.polarizations:
        yield "VV polarization", [_moved(view, view.azimuth_deg, view.incidence_deg) for view in train], "VV"


def _moved(view: View, azimuth_deg: float, incidence_deg: float) -> View:
    return View(
        name=f"extra_{view.name}"[:50],
        azimuth_deg=azimuth_deg,
        incidence_deg=incidence_deg,
        frequency_hz=view.frequency_hz,
        slant_range_m=view.slant_range_m,
    )


def _between(azimuths_deg: list[float]) -> float:
    """The middle of the widest gap between azimuths [deg]."""
    at = np.sort(np.mod(azimuths_deg, 360.0))
    gaps = np.diff([*at, at[0] + 360.0])
    widest = int(np.argmax(gaps))
    return float((at[widest] + gaps[widest] / 2.0) % 360.0)


def _distance(a: Scene, b: Scene, views: list[View], polarization: str, looks: float, device: wp.Device) -> float:
    images = [_images(one, views, polarization, device) for one in (a, b)]
    differences = [_log_ratio(one, other) for one, other in zip(*images, strict=True)]
    return float(looks * sum(((d - d.mean()) ** 2).sum() for d in differences if d.size))


def _of_another_date(scene: Scene, looks: float, device: wp.Device) -> float:
    """The distance if values of single views do not come again; one free gain for all views."""
    train = [view for view in scene.views if view.role == "train"]
    without = {n: t for n, t in scene.effects.items() if not _is_per_view(n)}
    polarization = scene.radar.polarizations[0]
    images = [_images(one, train, polarization, device) for one in (scene, replace(scene, effects=without))]
    d = np.concatenate([_log_ratio(one, other) for one, other in zip(*images, strict=True)])
    return float(looks * ((d - d.mean()) ** 2).sum())


def _log_ratio(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    lit = (one > 0) & (other > 0)
    return np.asarray(np.log(one[lit].astype(float) / other[lit]))


def _images(scene: Scene, views: list[View], polarization: str, device: wp.Device) -> list[np.ndarray]:
    names = {view.name for view in views}
    effects = {name: _for_views(name, table, names) for name, table in scene.effects.items()}
    changed = replace(
        scene,
        views=views,
        effects=effects,
        radar=scene.radar.model_copy(update={"polarizations": (polarization,)}),
        sampling=Sampling(rays_per_pixel=RAYS_PER_PIXEL),
    )
    stage = Stage.of(changed, device)
    found = []
    for index, view in enumerate(views):
        hits = trace_view(changed, stage, view, seed=view_seed(0, index), effects=declared(changed, view))
        found.append(view_render(changed, stage, view, hits).forward()[polarization])
    return found


def _for_views(name: str, table: Mapping[str, Any], views: set[str]) -> dict[str, Any]:
    """An effect's table with values for these views alone; the others' are at their defaults."""
    effect = get(name)
    per_view = {p.name for p in effect.parameters if p.per_view} | {s.name for s in effect.settings if s.per_view}
    return {
        key: {view: one for view, one in value.items() if view in views} if key in per_view else value
        for key, value in table.items()
    }


def _is_per_view(name: str) -> bool:
    return all(parameter.per_view for parameter in get(name).parameters)


def _only_per_view(scene: Scene) -> bool:
    """Whether one of its effects has nothing but values of single views."""
    return any(_is_per_view(name) for name in scene.effects)
