"""What the chips of the BTR-70 say of things that are known: widths, levels, bounces, orders (btr70.py)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from btr70_measures import Chip, best_shift, middle, own_shift, terms
from btr70_model import HEADER_M, SPACING_M, fitted, predicted, regions, thinned, with_effect
from btr70_speckle import width_m

from warpsar.scene.scene import Scene
from warpsar.speckle.compound import MOST, likeliest_order, minus_log_density

ERROR_DN = 9.75  # rms, the most that the chips' JPEG tables allow (formats.jpeg.levels)


def size_m(scene: Scene) -> list[float]:
    """Length, width and height of the first object with a mesh, upright [m]."""
    one = next(one for one in scene.objects if one.mesh is not None)
    upright = dict.fromkeys(("heading_deg", "roll_deg", "pitch_deg"), 0.0) | {"position_m": (0.0, 0.0, 0.0)}
    assert scene.assembly is not None
    points = scene.assembly.placed(one.model_copy(update=upright)).vertices
    across, along, up = (points.max(axis=0) - points.min(axis=0)).tolist()
    return [along, across, up]


def widths(source: Path, train: Sequence[Chip]) -> dict[str, Any]:
    """Widths of the point spread, beside the header's: from the grass's speckle, which no model enters, and as the
    model's fit has them without a prior."""
    axes = zip(HEADER_M, SPACING_M, strict=True)
    speckle = {key: width_m(train, axis, spacing) for axis, (key, spacing) in enumerate(axes)}
    scene = thinned(Scene.load(source))
    free = with_effect(scene, "point_spread", {**HEADER_M, "window": "taylor"})
    found, loss = fitted(free)
    return {"speckle": speckle, "freed": found.effects["point_spread"], "header": HEADER_M, "loss": loss}


def levels(source: Path, train: Sequence[Chip]) -> dict[str, Any]:
    """Share of clipped pixels; how far the noise floor of the model lies under its grass, in dB."""
    scene = Scene.load(source)
    clipped = [float(np.mean(chip.power >= 255.0**2)) for chip in train]
    floor = float(scene.effects.get("noise_floor", {}).get("level", 0.0))
    some = list(train[:3])
    grass = float(np.median([image[:4].mean() - floor for image in predicted(scene, some).values()]))
    return {
        "clipped_share": float(np.mean(clipped)),
        "clipped_range": [min(clipped), max(clipped)],
        "floor_below_grass_db": 10.0 * float(np.log10(grass / floor)) if floor > 0.0 else None,
    }


def bounces(source: Path, chips: Sequence[Chip]) -> dict[str, Any]:
    """Why bounces hurt: images of the held-out chips with the paths of two bounces added, by strength, over a ground
    that is a mirror as its backscatter says, and over one that mirrors nothing, as grass of some centimetres."""
    scene = Scene.load(source)

    def without(one: Scene) -> Scene:
        return replace(one, effects={name: t for name, t in one.effects.items() if name != "multibounce"})

    base = predicted(without(scene), chips)
    found = []
    for ground, height_m in (("as declared", None), ("grass: 30 mm", 0.03)):
        rough = without(scene)
        if height_m is not None:
            rougher = rough.materials["ground"].model_copy(update={"rms_height_m": height_m})
            rough = replace(rough, materials={**rough.materials, "ground": rougher})
        alone = predicted(rough, chips)
        both = predicted(
            with_effect(rough, "multibounce", {"strength": 1.0, "max_bounces": 2, "reflection": "lobe"}), chips
        )
        extra = {name: np.maximum(both[name] - alone[name], 0.0) for name in base}
        share = float(np.mean([extra[name].sum() / base[name].sum() for name in base]))
        for strength in (0.0, 0.01, 0.1, 1.0):
            scores = [best_shift(c.power, base[c.name] + strength * extra[c.name])[0] for c in chips]
            found.append(
                {"ground": ground, "power": share, "strength": strength, "correlation": float(np.mean(scores))}
            )
    return {"found": found}


def orders(source: Path, train: Sequence[Chip], held: Sequence[Chip]) -> dict[str, Any]:
    """The order of the G0 law by region, fitted on train chips, and the log score of held-out ones per pixel: plain
    speckle less compound. Looks are 1, at which the orders are a lower bound."""
    scene = Scene.load(source)

    def pixels(chips: Sequence[Chip]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        images, masks = predicted(scene, chips), regions(scene, chips)
        taken: dict[str, list[np.ndarray]] = {name: [] for name in ("body", "shadow", "ground")}
        for chip in chips:
            at = own_shift(chip.power, images[chip.name])
            power, model = np.maximum(middle(chip.power), 1.0), middle(images[chip.name], at)
            model = model * float(np.median(power / model) / np.log(2.0))
            for name, values in taken.items():
                mask = middle(masks[chip.name][name], at)
                values.append(np.stack([power[mask], model[mask]]))
        return {name: tuple(np.concatenate(values, axis=1)) for name, values in taken.items()}

    seen, unseen, found = pixels(train), pixels(held), {}
    for name in seen:
        order, factor = likeliest_order(*seen[name], 1.0)
        level = float(np.mean(seen[name][0] / seen[name][1]))
        power, model = unseen[name]
        plain = minus_log_density(power, level * model, 1.0, MOST)
        compound = minus_log_density(power, factor * model, 1.0, order)
        found[name] = {"order": order, "gain_per_pixel": float((plain - compound).mean()), "pixels": power.size}
    return found


def rounding(source: Path, train: Sequence[Chip], held: Sequence[Chip]) -> dict[str, Any]:
    """What the JPEG's own error does to the score of held-out chips. It is as large in every chip, while the grass is
    not: so it is no floor of the scene. The model's floor gives way to a floor and the file's error, on train chips."""
    scene = Scene.load(source)
    floor = float(scene.effects.get("noise_floor", {}).get("level", 0.0))

    def pixels(chips: Sequence[Chip]) -> list[tuple[np.ndarray, np.ndarray, float]]:
        images, found = predicted(scene, chips), []
        for chip in chips:
            at = own_shift(chip.power, images[chip.name])
            model = middle(images[chip.name], at)
            per_level = float(np.median(model) / (np.median(middle(chip.power)) / np.log(2.0)))
            found.append((middle(chip.power), model - floor, ERROR_DN**2 * per_level))
        return found

    def scores(taken: Sequence[tuple[np.ndarray, np.ndarray, float]], own: float, share: float) -> np.ndarray:
        return np.array([terms(power, rest + own * floor + share * error).mean() for power, rest, error in taken])

    seen, unseen = pixels(train), pixels(held)
    tried = [(own, share) for share in (0.0, 0.25, 0.5, 0.75, 1.0) for own in (0.0, 0.25, 0.5, 0.75, 1.0, 1.25)]
    alone = min((one for one in tried if one[1] == 0.0), key=lambda one: scores(seen, *one).mean())
    best = min(tried, key=lambda one: scores(seen, *one).mean())
    gain = scores(unseen, *alone) - scores(unseen, *best)
    return {
        "floor": best[0],
        "share": best[1],
        "gain": float(gain.mean()),
        "error": float(gain.std(ddof=1) / np.sqrt(gain.size)),
        "grass_dn": [float(np.sqrt(np.median(power) / np.log(2.0))) for power, _, _ in (*seen, *unseen)],
    }
