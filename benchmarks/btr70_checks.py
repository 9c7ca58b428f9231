"""What the chips of the BTR-70 say of things that are known: size, roll and pitch, widths, levels (btr70.py)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from btr70_jobs import Job, done
from btr70_measures import SIZE, Chip, best_shift, middle, own_shift, terms
from btr70_model import SPACING_M, fitted, held_out, predicted, regions, thinned, with_body, with_effect
from scipy.ndimage import gaussian_filter

from warpsar.scene.scene import Scene
from warpsar.speckle.compound import MOST, likeliest_order, minus_log_density

CAD_M = (7.65, 2.66, 2.61)  # length, width, height
CAD_SD = 0.10  # of the CAD's size: its prior
HEADER_DEG = {"roll_deg": -1.18, "pitch_deg": -1.42}
HEADER_M = {"range_fwhm_m": 0.3013, "azimuth_fwhm_m": 0.3229}
# Pixels of speckle that share a draw: spacing 0.20 m, widths 0.30 and 0.32 m.
AREA_PX = 2.4
TILTS_DEG = (-4.0, -2.0, 0.0, 2.0, 4.0)
SIZES = (0.85, 0.9, 0.95, 1.0, 1.05, 1.1)
PROFILES: tuple[tuple[str, int | None, tuple[float, ...]], ...] = (
    ("height", 2, SIZES),
    ("pitch_deg", None, TILTS_DEG),
    ("roll_deg", None, TILTS_DEG),
    ("width", 1, SIZES),
    ("length", 0, SIZES),
)
"""Key, axis of the size, and the places of its profile."""
REPLICATES = 40  # of the chips on which the interval of the height is tried
ERROR_DN = 9.75  # rms, the most that the chips' JPEG tables allow (measured.jpeg.read)


def minimum(places: Sequence[float], losses: Sequence[float]) -> float:
    """Where a parabola through the three best of a profile has its least value, inside the profile."""
    at, loss = np.array(places), np.array(losses)
    middle = int(np.clip(np.argmin(loss), 1, len(at) - 2))
    a, b, _ = np.polyfit(at[middle - 1 : middle + 2], loss[middle - 1 : middle + 2], 2)
    return float(np.clip(-b / (2.0 * a), at.min(), at.max())) if a > 0 else float(at[np.argmin(loss)])


def likeliest(places: Sequence[float], scores: np.ndarray, sd: float | None = None) -> tuple[float, float]:
    """Where the chips' mean deviances, (places, chips), are least, and its standard deviation: the chips' jackknife.

    With `sd`, the places are known to be 1 to so much before the images are asked."""
    losses = 0.5 * SIZE**2 / AREA_PX * np.asarray(scores)
    pull = np.zeros(len(places)) if sd is None else 0.5 * ((np.array(places) - 1.0) / sd) ** 2
    whole, n = losses.sum(axis=1), losses.shape[1]
    without = [minimum(places, ((whole - one) * n / (n - 1) + pull).tolist()) for one in losses.T]
    return minimum(places, (whole + pull).tolist()), float(np.std(without) * np.sqrt(n - 1))


def left_out(sources: Sequence[Path], chips: Sequence[Sequence[Chip]], changed: Mapping[str, Any]) -> dict[str, Any]:
    """The scores of the chips that each scene left out, with other values of the vehicle's table."""
    pairs = zip(sources, chips, strict=True)
    return {"scores": [s for source, some in pairs for s in held_out(with_body(Scene.load(source), **changed), some)]}


def shape(sources: Sequence[Path], chips: Sequence[Sequence[Chip]], out: Path, processes: int) -> dict[str, Any]:
    """Size and attitude, one after the other, by the score of the chips that each of `sources` left out.

    Sizes are factors on the CAD, known to 10 %; roll and pitch are said by the images alone. All else stays as fitted.
    """
    pose: dict[str, Any] = {"scale": (1.0, 1.0, 1.0), **HEADER_DEG}
    found: dict[str, Any] = {}
    base = np.array(Job(out / "declared.json", left_out, (sources, chips, {}))()["scores"])
    turned = np.array(Job(out / "turned.json", left_out, (sources, chips, {"heading_deg": 180.0}))()["scores"])
    worse = turned - base
    found["turned"] = {"value": float(worse.mean()), "sd": float(worse.std(ddof=1) / np.sqrt(worse.size))}
    for name, axis, places in PROFILES:
        jobs = [
            Job(out / f"{name}_{k}.json", left_out, (sources, chips, moved(pose, name, axis, p)))
            for k, p in enumerate(places)
        ]
        scores = np.array([one["scores"] for one in done(jobs, processes)])
        best, sd = likeliest(places, scores, None if axis is None else CAD_SD)
        pose = moved(pose, name, axis, round(best, 4))
        found[name] = {"value": best, "sd": sd, "places": list(places), "scores": scores.mean(axis=1).tolist()}
    last = np.array(Job(out / "found.json", left_out, (sources, chips, pose))()["scores"])
    gain = base - last
    error = float(gain.std(ddof=1) / np.sqrt(gain.size))
    stays = bool(gain.mean() > 2.0 * error)
    return {**found, "pose": pose, "gain": float(gain.mean()), "error": error, "stays": stays}


def moved(pose: Mapping[str, Any], name: str, axis: int | None, place: float) -> dict[str, Any]:
    """The pose with one more place: of an angle, or of the size along an axis."""
    if axis is None:
        return {**pose, name: place}
    return {**pose, "scale": tuple(place if k == axis else one for k, one in enumerate(pose["scale"]))}


def speckled(image: np.ndarray, draws: np.random.Generator) -> np.ndarray:
    """A chip as the radar would give it, [DN^2]: speckle of one look, as wide as the header says, 8 bits, clipped."""
    sigma = [np.sqrt(2.0) / 2.3548 * w / s for w, s in zip(HEADER_M.values(), SPACING_M, strict=True)]
    field = [gaussian_filter(draws.standard_normal(image.shape), sigma) for _ in range(2)]
    power = image * sum((one / one.std()) ** 2 for one in field) / 2.0
    return np.asarray(np.clip(np.round(60.0 * np.sqrt(power / np.median(image))), 1.0, 255.0) ** 2)


def coverage(source: Path, train: Sequence[Chip]) -> dict[str, Any]:
    """How often the interval of the height holds the truth, on chips that the model made of the train views."""
    scene, places = Scene.load(source), (0.94, 0.96, 0.98, 1.0, 1.02, 1.04, 1.06)
    (body,) = (one for one in scene.objects if one.name == "btr70")
    along, across, up = body.scales
    images = [predicted(with_body(scene, scale=(along, across, up * place)), train) for place in places]
    draws, found = np.random.default_rng(0), []
    for _ in range(REPLICATES):
        scores = np.empty((len(places), len(train)))
        for k, chip in enumerate(train):
            power = middle(speckled(images[3][chip.name], draws))
            for i, image in enumerate(images):
                # a higher body lies nearer to the radar: the aim point gives way by rows
                scores[i, k] = min(terms(power, middle(image[chip.name], (row, 0))).mean() for row in (-1, 0, 1))
        found.append(likeliest(places, scores, CAD_SD))
    off = np.array([(at - 1.0) / sd for at, sd in found])
    return {
        "replicates": REPLICATES,
        "inside": int((np.abs(off) < 1.96).sum()),
        "bias": float(np.mean([at - 1.0 for at, _ in found])),
        "sd_of_found": float(np.std([at for at, _ in found], ddof=1)),
        "sd_stated": float(np.mean([sd for _, sd in found])),
    }


def size_m(scene: Scene) -> list[float]:
    """Length, width and height of the first object with a mesh, upright [m]."""
    one = next(one for one in scene.objects if one.mesh is not None)
    upright = dict.fromkeys(("heading_deg", "roll_deg", "pitch_deg"), 0.0) | {"position_m": (0.0, 0.0, 0.0)}
    assert scene.assembly is not None
    points = scene.assembly.placed(one.model_copy(update=upright)).vertices
    across, along, up = (points.max(axis=0) - points.min(axis=0)).tolist()
    return [along, across, up]


def widths(source: Path) -> dict[str, Any]:
    """Widths of the point spread without a prior, beside the header's."""
    scene = thinned(Scene.load(source))
    free = with_effect(scene, "point_spread", {**HEADER_M, "window": "taylor"})
    found, loss = fitted(free)
    return {"found": found.effects["point_spread"], "header": HEADER_M, "loss": loss}


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
        both = predicted(with_effect(rough, "multibounce", {"strength": 1.0, "max_bounces": 2}), chips)
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
