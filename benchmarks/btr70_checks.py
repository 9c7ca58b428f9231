"""What the chips of the BTR-70 say of things that are known: size, roll and pitch, widths, levels (btr70.py)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from btr70_jobs import Job, done
from btr70_measures import Chip, best_shift, middle, own_shift, terms
from btr70_model import SPACING_M, fitted, predicted, regions, thinned, with_body, with_effect
from scipy.ndimage import gaussian_filter

from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.speckle.compound import MOST, likeliest_order, minus_log_density

CAD_M = (7.65, 2.66, 2.61)  # length, width, height
CAD_SD = 0.10  # of the CAD's size: its prior
HEADER_DEG = {"roll_deg": -1.18, "pitch_deg": -1.42}
HEADER_M = {"range_fwhm_m": 0.3013, "azimuth_fwhm_m": 0.3229}
# Pixels of speckle that share a draw: spacing 0.20 m, widths 0.30 and 0.32 m.
AREA_PX = 2.4
PROFILED = 10  # train views of a profile
TILTS_DEG = (-4.0, -2.0, 0.0, 2.0, 4.0)
HEIGHTS = (0.8, 0.85, 0.9, 0.95, 1.0)
REPLICATES = 12  # of the chips on which the interval of the height is tried
ERROR_DN = 9.75  # rms, the most that the chips' JPEG tables allow (measured.jpeg.read)
STEPS = 3  # iterations of a fit where one number of the geometry moved


def minimum(places: Sequence[float], losses: Sequence[float]) -> tuple[float, float]:
    """Where a parabola through the three best of a profile has its least value, and its standard deviation."""
    at, loss = np.array(places), np.array(losses)
    middle = int(np.clip(np.argmin(loss), 1, len(at) - 2))
    a, b, _ = np.polyfit(at[middle - 1 : middle + 2], loss[middle - 1 : middle + 2], 2)
    if a <= 0:
        return float(at[np.argmin(loss)]), float("nan")
    return float(np.clip(-b / (2.0 * a), at.min(), at.max())), float(np.sqrt(AREA_PX / (2.0 * a)))


def at_place(source: Path, changed: dict[str, Any], views: int, images: Path | None = None) -> dict[str, Any]:
    """The loss where keys of the vehicle have other values, all else fitted again on some of the views."""
    scene = thinned(Scene.load(source), views)
    if images is not None:
        scene = with_images(scene, images)
    return {"loss": fitted(with_body(scene, **changed), STEPS)[1]}


def profile(
    source: Path, key: str, places: Sequence[Any], out: Path, processes: int, pose: Mapping[str, Any] | None = None
) -> list[float]:
    """The loss at each place of one key of the vehicle; `pose` says where its other keys are."""
    jobs = [
        Job(out / f"{key}_{k}.json", at_place, (source, {**(pose or {}), key: place}, PROFILED))
        for k, place in enumerate(places)
    ]
    return [one["loss"] for one in done(jobs, processes)]


def likeliest(places: Sequence[float], losses: Sequence[float], sd: float | None = None) -> tuple[float, float]:
    """Where a profile is least, and its standard deviation; about 1 to `sd` before the images, if that is given."""
    if sd is not None:
        pull = [AREA_PX * 0.5 * ((place - 1.0) / sd) ** 2 for place in places]
        losses = [loss + one for loss, one in zip(losses, pull, strict=True)]
    return minimum(places, losses)


def size(source: Path, pose: Mapping[str, Any], out: Path, processes: int) -> dict[str, Any]:
    """Factors on the CAD's size along, across and up, one after the other, with the CAD to 10 % as their prior."""
    scale, found = [1.0, 1.0, 1.0], {}
    for axis, name in ((2, "height"), (1, "width"), (0, "length")):
        places = HEIGHTS if axis == 2 else (0.94, 1.0, 1.06)
        trials = [(*scale[:axis], place, *scale[axis + 1 :]) for place in places]
        losses = profile(source, "scale", trials, out / name, processes, pose)
        at, sd = likeliest(places, losses, CAD_SD)
        scale[axis] = round(at, 4)
        metres = {"value_m": at * CAD_M[axis], "sd_m": sd * CAD_M[axis]}
        found[name] = metres | {"places": list(places), "losses": losses}
    return {"scale": scale, **found}


def attitude(source: Path, out: Path, processes: int) -> dict[str, Any]:
    """Roll and pitch by the images alone, beside the header's: pitch first, and roll at the pitch that was found."""
    found: dict[str, Any] = {}
    pose: dict[str, float] = {}
    for key in ("pitch_deg", "roll_deg"):
        losses = profile(source, key, TILTS_DEG, out, processes, pose)
        at, sd = minimum(TILTS_DEG, losses)
        pose[key] = round(at, 3)
        found[key] = {"value": at, "sd": sd, "header": HEADER_DEG[key], "places": list(TILTS_DEG), "losses": losses}
    return found


def simulated(source: Path, seed: int, folder: Path) -> None:
    """Chips that the model itself makes, of the views of a profile: speckle of one look, 8 bits, clipped as measured.

    Speckle is correlated from pixel to pixel as the widths of the header make it."""
    scene = thinned(Scene.load(source), PROFILED)
    draws = np.random.default_rng(seed)
    sigma = [np.sqrt(2.0) / 2.3548 * w / s for w, s in zip(HEADER_M.values(), SPACING_M, strict=True)]
    folder.mkdir(parents=True, exist_ok=True)
    for view, image in zip(scene.views, simulate(scene, device="cpu"), strict=True):
        mu = image.beta0["HH"].astype(float)
        field = [gaussian_filter(draws.standard_normal(mu.shape), sigma) for _ in range(2)]
        speckle = sum((one / one.std()) ** 2 for one in field) / 2.0
        measured = scene.measured(view, "HH")
        gain = np.median(measured[:4]) / np.median((mu * speckle)[:4])  # grass
        levels = np.clip(np.round(np.sqrt(gain * mu * speckle)), 1.0, 255.0)
        np.save(folder / f"{view.name}.npy", (levels**2).astype(np.float32))


def with_images(scene: Scene, folder: Path) -> Scene:
    """The scene with the chips of a folder in place of the measured ones."""
    views = [view.model_copy(update={"images": {"HH": np.load(folder / f"{view.name}.npy")}}) for view in scene.views]
    return replace(scene, views=views)


def replicate(source: Path, seed: int, folder: Path) -> dict[str, Any]:
    """The height that chips of a known height give back, as a factor on the model's own."""
    simulated(source, seed, folder)
    (body,) = (one for one in Scene.load(source).objects if one.name == "btr70")
    along, across, up = body.scales
    places = [round(factor, 4) for factor in (0.95, 1.0, 1.05)]
    losses = [at_place(source, {"scale": (along, across, up * place)}, PROFILED, folder)["loss"] for place in places]
    at, sd = likeliest(places, losses, CAD_SD)
    return {"found": at, "sd": sd, "losses": losses}


def coverage(source: Path, out: Path, processes: int) -> dict[str, Any]:
    """How often the interval of the height holds the truth, on chips that the model made."""
    jobs = [Job(out / f"{seed}.json", replicate, (source, seed, out / f"chips{seed}")) for seed in range(REPLICATES)]
    found = done(jobs, processes)
    off = np.array([(one["found"] - 1.0) / one["sd"] for one in found])
    return {
        "replicates": REPLICATES,
        "inside": int((np.abs(off) < 1.96).sum()),
        "bias": float(np.mean([one["found"] - 1.0 for one in found])),
        "sd_of_found": float(np.std([one["found"] for one in found], ddof=1)),
        "sd_stated": float(np.mean([one["sd"] for one in found])),
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
