"""Which pixels a diagnosis compares: frozen once, by the declared model, for all that follows."""

from __future__ import annotations

from dataclasses import replace

from warpsar.compare.modelled import known_by_rays
from warpsar.compare.observation import Observation
from warpsar.diagnosis.models.fit_setup import FitSetup, image_of
from warpsar.effects.registry import get
from warpsar.runtime import once
from warpsar.scene.scene import Scene

SLIVER = 0.25  # of a ray's share of a pixel: darker than this no pixel is called that was lit


def frozen(one: FitSetup, other: FitSetup, scene: Scene) -> dict[str, list[Observation]]:
    """Masks from the declared model, the same for all that follows; by view name.

    A pixel counts as lit if both sets of rays light it and its neighbours. Where one of them misses, the pixel's share
    of light is sampling noise. Where an effect has moved the light, a pixel may hold a sliver that no ray meets. Its
    model is then at least `SLIVER` of one ray's share of its declared beta0. A share of any brighter pixel would take
    dim surfaces for dark. Ways over several surfaces get few rays: pixels whose power the two sets leave open beside
    speckle are left out.
    """
    problems = once.agree(lambda: [setup.problem(scene, dark=False) for setup in (one, other)])
    followed = any(get(name).follows_rays for name in scene.effects)
    for problem in problems if followed else problems[:1]:
        problem.modelled_as_declared()
    density = one.rays.rays_per_m2 or scene.sampling.density_per_m2(scene.grid)
    rays_per_pixel = density * scene.grid.pixel_area_m2
    found: dict[str, list[Observation]] = {}
    for a, b in zip(*(problem.views for problem in problems), strict=True):
        for mine, theirs in zip(a.observations, b.observations, strict=True):
            masks = once.decide([mine.interior & theirs.interior, mine.silent, mine.dark & theirs.dark]) > 0
            image = image_of(a, mine.polarization)
            looks = float(once.decide(mine.looks))
            interior, silent, dark = masks
            if followed:
                interior &= once.decide(known_by_rays(image, image_of(b, mine.polarization), looks)) > 0
            interior &= ~dark  # additive effects that are declared had them in it
            least = once.decide(SLIVER / rays_per_pixel * image)
            seen = replace(mine, interior=interior, silent=silent, dark=dark, looks=looks, least=least)
            found.setdefault(a.view.name, []).append(seen)
    return found
