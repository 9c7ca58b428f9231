"""What the chips of the BTR-70 say of things that are known: size, roll and pitch, widths, levels (btr70.py)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from btr70_measures import Chip, best_shift, middle, own_shift
from btr70_model import fitted, predicted, regions, thinned, with_body, with_effect

from warpsar.scene.scene import Scene
from warpsar.speckle.compound import MOST, likeliest_order, minus_log_density

CAD_M = (7.65, 2.66, 2.61)  # length, width, height
CAD_SD = 0.10  # of the CAD's size: its prior
HEADER_DEG = {"roll_deg": -1.18, "pitch_deg": -1.42}
HEADER_M = {"range_fwhm_m": 0.3013, "azimuth_fwhm_m": 0.3229}
# Pixels of speckle that share a draw: spacing 0.20 m, widths 0.30 and 0.32 m.
AREA_PX = 2.4
PROFILED = 10  # train views of a profile
STEPS = 3  # iterations of a fit where one number of the geometry moved


def minimum(places: Sequence[float], losses: Sequence[float]) -> tuple[float, float]:
    """Where a parabola through the three best of a profile has its least value, and its standard deviation."""
    at, loss = np.array(places), np.array(losses)
    middle = int(np.clip(np.argmin(loss), 1, len(at) - 2))
    a, b, _ = np.polyfit(at[middle - 1 : middle + 2], loss[middle - 1 : middle + 2], 2)
    if a <= 0:
        return float(at[np.argmin(loss)]), float("nan")
    return float(np.clip(-b / (2.0 * a), at.min(), at.max())), float(np.sqrt(AREA_PX / (2.0 * a)))


def profile(scene: Scene, key: str, places: Sequence[Any]) -> list[float]:
    """The loss at each place of one key of the vehicle, all else fitted."""
    return [fitted(with_body(scene, **{key: place}), STEPS)[1] for place in places]


def size(scene: Scene) -> dict[str, Any]:
    """Factors on the CAD's size along, across and up, one after the other, with the CAD to 10 % as their prior."""
    scene = thinned(scene, PROFILED)
    scale, found = [1.0, 1.0, 1.0], {}
    for axis, name in ((2, "height"), (1, "width"), (0, "length")):
        places = (0.85, 0.9, 0.95, 1.0) if axis == 2 else (0.94, 1.0, 1.06)
        trials = [(*scale[:axis], place, *scale[axis + 1 :]) for place in places]
        losses = profile(scene, "scale", trials)
        known = [loss + AREA_PX * 0.5 * ((p - 1.0) / CAD_SD) ** 2 for p, loss in zip(places, losses, strict=True)]
        at, sd = minimum(places, known)
        scale[axis] = round(at, 4)
        metres = {"value_m": at * CAD_M[axis], "sd_m": sd * CAD_M[axis]}
        found[name] = metres | {"places": list(places), "losses": losses}
    return {"scale": scale, **found}


def attitude(scene: Scene) -> dict[str, Any]:
    """Roll and pitch by the images alone, beside the header's."""
    scene, found = thinned(scene, PROFILED), {}
    for key, header in HEADER_DEG.items():
        places = (-3.0, 0.0, 3.0)
        losses = profile(scene, key, places)
        at, sd = minimum(places, losses)
        found[key] = {"value": at, "sd": sd, "header": header, "places": list(places), "losses": losses}
    return found


def widths(scene: Scene) -> dict[str, Any]:
    """Widths of the point spread without a prior, beside the header's."""
    scene = thinned(scene)
    free = with_effect(scene, "point_spread", {**HEADER_M, "window": "taylor"})
    found, loss = fitted(free)
    return {"found": found.effects["point_spread"], "header": HEADER_M, "loss": loss}


def levels(scene: Scene, train: Sequence[Chip]) -> dict[str, Any]:
    """Share of clipped pixels; how far the noise floor of the model lies under its grass, in dB."""
    clipped = [float(np.mean(chip.power >= 255.0**2)) for chip in train]
    floor = float(scene.effects.get("noise_floor", {}).get("level", 0.0))
    some = list(train[:3])
    grass = float(np.median([image[:4].mean() - floor for image in predicted(scene, some).values()]))
    return {
        "clipped_share": float(np.mean(clipped)),
        "clipped_range": [min(clipped), max(clipped)],
        "floor_below_grass_db": 10.0 * float(np.log10(grass / floor)) if floor > 0.0 else None,
    }


def bounces(scene: Scene, chips: Sequence[Chip]) -> list[dict[str, Any]]:
    """Why bounces hurt: images of the held-out chips with the paths of two bounces added, by strength, over a ground
    that is a mirror as its backscatter says, and over one that mirrors nothing, as grass of some centimetres."""

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
        both = predicted(with_effect(rough, "multibounce", {"strength": 1.0, "max_bounces": 2}), chips)
        extra = {name: np.maximum(both[name] - alone[name], 0.0) for name in base}
        share = float(np.mean([extra[name].sum() / base[name].sum() for name in base]))
        for strength in (0.0, 0.01, 0.1, 1.0):
            scores = [best_shift(c.power, base[c.name] + strength * extra[c.name])[0] for c in chips]
            found.append(
                {"ground": ground, "power": share, "strength": strength, "correlation": float(np.mean(scores))}
            )
    return found


def orders(scene: Scene, train: Sequence[Chip], held: Sequence[Chip]) -> dict[str, Any]:
    """The order of the G0 law by region, fitted on train chips, and the log score of held-out ones per pixel: plain
    speckle less compound. Looks are 1, at which the orders are a lower bound."""

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
