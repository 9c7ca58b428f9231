"""The loop on a measured vehicle of known shape: a BTR-70 from all sides, learned on 30 views, tested on all others.

    python benchmarks/btr70.py DATA -o OUT [--scene FILE] [--write]

DATA is a folder of public releases with mstar_btr70 in it: chips/*.jpeg, views.csv, BTR70.obj. The train chips are
`TRAIN`; every other chip in the folder is a test view. `--scene FILE` learns nothing: it predicts with that scene. OUT
gets all of it; what lies there already is not made again. btr70.json says how near the predictions are, btr70.md the
tables. The steps and their reasons: docs/measured-btr70.md.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import btr70_checks as checks
import tables
from btr70_measures import Chip, best_shift, judged, middle, rivals, terms, turn_deg
from btr70_model import (
    LADDER,
    SPACING_M,
    begun_with,
    fitted,
    predicted,
    regions,
    thinned,
    with_aim_points,
    with_body,
    write_scene,
)
from measured_loop import kept, written

from warpsar.io.images import replacing
from warpsar.measured import jpeg
from warpsar.measured.chips import import_chips
from warpsar.scene.scene import Scene

# 17 degrees of depression, none from the sectors below
TRAIN = tuple(Path(__file__).with_name("btr70_train.txt").read_text(encoding="utf-8").split())
VALIDATION_DEG = ((85.0, 115.0), (205.0, 235.0), (315.0, 345.0))
"""Sectors that no fit sees. What is added must pay here; the sectors that the folder may lack decide nothing."""
MOST_VALIDATION = 24
LAST = 6  # iterations of the final fit, which begins where the last one ended


def chips_of(data: Path) -> list[Chip]:
    """Every chip in the folder that views.csv names, radar on top."""
    folder = data / "mstar_btr70"
    with (folder / "views.csv").open(newline="", encoding="utf-8") as stream:
        rows = {row["chip"]: row for row in csv.DictReader(stream)}
    found = []
    for path in sorted((folder / "chips").glob("*.jpeg")):
        if (row := rows.get(path.stem)) is not None:
            power = jpeg.read(path)[::-1].astype(float) ** 2
            found.append(Chip(path.stem, float(row["azimuth_deg"]), float(row["depression_deg"]), power))
    return found


def set_of(chip: Chip) -> str:
    """Which question a test view answers: `sector` (an azimuth never trained on), `depression`, both, or `between`."""
    inside = any(low <= chip.azimuth_deg % 360.0 <= high for low, high in VALIDATION_DEG)
    far = min(abs(turn_deg(chip.azimuth_deg, one)) for one in TRAINED_DEG) > 6.0
    shallow = chip.depression_deg < 16.0
    if inside or far:
        return "sector_15" if shallow else "sector"
    return "depression" if shallow else "between"


TRAINED_DEG: list[float] = []


def prepare(data: Path, out: Path) -> Path:
    """The scene of the train views, imported as a user would."""
    path = out / "scene" / "scene.toml"
    if not path.exists():
        folder = data / "mstar_btr70"
        fresh = write_scene(path.with_name("begun.toml"), folder / "BTR70.obj")
        import_chips(
            [folder / "chips" / f"{name}.jpeg" for name in TRAIN],
            fresh,
            folder / "views.csv",
            quantity="amplitude",
            radar_at="bottom",
            spacing_m=SPACING_M,
            scale="unknown",
        )
        fresh.rename(path)
    return path


def held_back(chips: Sequence[Chip]) -> list[Chip]:
    """Chips of the validation sectors at 17 degrees: they decide what is added."""
    inside = [c for c in chips if set_of(c) == "sector" and any(a <= c.azimuth_deg <= b for a, b in VALIDATION_DEG)]
    return [inside[int(k)] for k in np.linspace(0, len(inside) - 1, min(MOST_VALIDATION, len(inside)))]


def held_out(scene: Scene, chips: Sequence[Chip]) -> np.ndarray:
    """Mean gamma deviance of each held-out chip at the model's own aim point: the log score, lower is better."""
    images = predicted(scene, chips)
    scores = []
    for chip in chips:
        at = best_shift(chip.power, images[chip.name])[1]
        scores.append(float(terms(middle(chip.power), middle(images[chip.name], at)).mean()))
    return np.array(scores)


def climbed(scene: Scene, validation: Sequence[Chip], out: Path) -> tuple[Scene, list[dict[str, Any]]]:
    """Effects tried one after the other; each stays only if the held-out log score falls by two standard errors.

    Half of the train views are enough to choose; the final fit has all."""
    steps: list[dict[str, Any]] = []
    now, score = scene, held_out(scene, validation)
    for number, (name, table) in enumerate(LADDER):
        folder = out / f"tried{number}_{name}"
        begun = begun_with(now, name, table)

        def make(trial: Scene = begun, folder: Path = folder) -> dict[str, Any]:
            found, loss = fitted(trial)
            found.save(folder / "scene.toml")
            return {"loss": loss, "scores": held_out(found, validation).tolist()}

        made = kept(out / f"tried{number}_{name}.json", make)
        found = Scene.load(folder / "scene.toml")
        gain = score - np.array(made["scores"])
        error = float(gain.std(ddof=1) / np.sqrt(gain.size))
        stays = bool(gain.mean() > 2.0 * error)
        tables_of = {key: value for key, value in found.effects.items() if key != "aim_point"}
        steps.append(
            {
                "tried": name,
                "loss": made["loss"],
                "gain": float(gain.mean()),
                "error": error,
                "stays": stays,
                "parameters": tables_of.get(name, {}),
            }
        )
        print(
            f"{name}: held-out gain {gain.mean():+.4f} +- {error:.4f}: {'stays' if stays else 'goes'}", file=sys.stderr
        )
        if stays:
            now, score = found, np.array(made["scores"])
    return now, steps


def learned(data: Path, out: Path, chips: Sequence[Chip]) -> tuple[Scene, Scene, list[dict[str, Any]], dict[str, Any]]:
    """The declared scene, the final one, the steps between, and what the images say of its size."""
    declared = Scene.load(prepare(data, out))
    train = [chip for chip in chips if chip.name in TRAIN]
    validation = held_back(chips)
    begun = thinned(with_aim_points(declared, train))
    path = out / "begun" / "scene.toml"

    def begin() -> dict[str, Any]:
        found, loss = fitted(begun)
        found.save(path)
        return {"loss": loss}

    kept(out / "begun.json", begin)
    climbing, steps = climbed(Scene.load(path), validation, out)
    size = kept(out / "size.json", lambda: checks.size(climbing))
    final_path = out / "final" / "scene.toml"

    def finish() -> dict[str, Any]:
        sized = with_body(climbing, scale=tuple(size["scale"]))
        every = replace(sized, views=declared.views)
        found, loss = fitted(with_aim_points(every, train), LAST)
        found.save(final_path)
        return {"loss": loss, "scores": held_out(found, validation).tolist()}

    made = kept(out / "final.json", finish)
    final = Scene.load(final_path)
    gain = held_out(climbing, validation) - np.array(made["scores"])
    steps.append({"tried": "size", "gain": float(gain.mean()), "error": float(gain.std() / np.sqrt(gain.size))})
    return declared, final, steps, size


def what_is_known(
    out: Path, final: Scene, size: dict[str, Any], train: Sequence[Chip], validation: Sequence[Chip]
) -> dict[str, Any]:
    """The checks of btr70_checks.py, each made once."""
    return {
        "size": size,
        "bounces": kept(out / "bounces.json", lambda: {"found": checks.bounces(final, validation)}),
        "orders": kept(out / "orders.json", lambda: checks.orders(final, train, validation)),
        "levels": kept(out / "levels.json", lambda: checks.levels(final, train)),
        "widths": kept(out / "widths.json", lambda: checks.widths(final)),
        "attitude": kept(out / "attitude.json", lambda: checks.attitude(final)),
    }


def tested(out: Path, declared: Scene, final: Scene, chips: Sequence[Chip]) -> list[dict[str, Any]]:
    """All measures of every test view, kept view by view."""
    train = [chip for chip in chips if chip.name in TRAIN]
    mean = np.mean([one.power for one in train], axis=0)
    path = out / "views.json"
    done: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    missing = [chip for chip in chips if chip.name not in TRAIN and chip.name not in done]
    for first in range(0, len(missing), 30):
        some = missing[first : first + 30]
        images = {"declared": predicted(declared, some), "final": predicted(final, some)}
        masks = regions(final, some)
        for chip in some:
            measures: dict[str, Any] = {
                name: judged(chip, image[chip.name], masks[chip.name]) for name, image in images.items()
            }
            for name, image in rivals(chip, train, mean).items():
                measures[name] = judged(chip, image, {}, own=False)
            done[chip.name] = measures
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(done), encoding="utf-8")
        print(f"{first + len(some)} of {len(missing)} views", file=sys.stderr)
    content = []
    for chip in chips:
        if chip.name in TRAIN:
            continue
        measures = done[chip.name]
        shallow = [c for c in chips if abs(turn_deg(c.azimuth_deg, chip.azimuth_deg)) < 1.0 and c is not chip]
        shallow = [c for c in shallow if (c.depression_deg < 16.0) != (chip.depression_deg < 16.0)]
        if shallow and "other_depression" not in measures:
            measures["other_depression"] = judged(chip, shallow[0].power, {}, own=False)
        content.append(
            {
                "chip": chip.name,
                "set": set_of(chip),
                "azimuth_deg": chip.azimuth_deg,
                "depression_deg": chip.depression_deg,
                **{key: {n: m[key] for n, m in measures.items()} for key in ("correlation", "best_shift", "deviance")},
                "measures": measures,
            }
        )
    return content


SETS = ("sector", "sector_15", "depression", "between")
PREDICTIONS = ("declared", "final", "nearest", "mirrored", "mean", "other_depression")


def summary(views: Sequence[Mapping[str, Any]]) -> list[list[Any]]:
    """Rows of set, views, prediction and means of its measures."""
    rows = []
    for name in SETS:
        mine = [view for view in views if view["set"] == name]
        for prediction in PREDICTIONS:
            found = [view["measures"][prediction] for view in mine if prediction in view["measures"]]
            if found:
                means = [np.mean([one[key] for one in found]) for key in ("correlation", "best_shift", "one_pixel")]
                deviance = np.mean([one["deviance"] for one in found])
                rows.append([name, len(found), prediction, *(f"{x:.3f}" for x in (*means, deviance))])
    return rows


def by_region(views: Sequence[Mapping[str, Any]]) -> list[list[Any]]:
    rows = []
    for prediction in ("declared", "final"):
        for name in ("body", "shadow", "ground"):
            found = [view["measures"][prediction][name] for view in views if view["set"].startswith("sector")]
            both = [np.nanmean([one[key] for one in found]) for key in ("correlation", "deviance")]
            rows.append([prediction, name, *(f"{x:.3f}" for x in both)])
        edges = [abs(view["measures"][prediction]["lit_edge_rows"]) * SPACING_M[0] for view in views]
        rows.append([prediction, "lit edge, median error [m]", f"{np.median(edges):.2f}", ""])
    return rows


def checked(known: Mapping[str, Any]) -> list[list[Any]]:
    """Rows of what is known: what, found, stated elsewhere."""
    rows: list[list[Any]] = []
    for name, stated in (("height", "2.24 to 2.32"), ("width", "2.80"), ("length", "7.53 to 7.54")):
        one = known["size"][name]
        rows.append(
            [f"{name} [m], the CAD to 10 %", f"{one['value_m']:.2f} +- {one['sd_m']:.2f}", f"{stated}, published"]
        )
    for key, one in known["attitude"].items():
        found = f"{one['value']:+.2f} +- {one['sd']:.2f}"
        rows.append([f"{key.removesuffix('_deg')} [deg], images alone", found, f"{one['header']:+.2f}, header"])
    for key, header in known["widths"]["header"].items():
        found = f"{known['widths']['found'][key]:.3f}"
        rows.append([f"{key.removesuffix('_fwhm_m')} width [m], without a prior", found, f"{header:.3f}, header"])
    levels = known["levels"]
    low, high = (100.0 * share for share in levels["clipped_range"])
    rows.append(["pixels at the top of the scale", f"{low:.1f} to {high:.1f} %", "0.1 to 0.6 %"])
    if levels["floor_below_grass_db"] is not None:
        rows.append(["noise floor under the grass [dB]", f"{levels['floor_below_grass_db']:.1f}", "6 to 15"])
    return rows


def tables_of(content: Mapping[str, Any]) -> dict[str, str]:
    """The tables of the page, by name."""
    head = ("set", "views", "prediction", "correlation", "at best shift", "smoothed by 1", "deviance")
    found = {
        "btr70.sets": tables.markdown(head, summary(content["views"])),
        "btr70.regions": tables.markdown(
            ("prediction", "region", "correlation", "deviance"), by_region(content["views"])
        ),
    }
    if content["steps"]:
        rows = [[s["tried"], f"{s['gain']:+.4f}", f"{s['error']:.4f}", s.get("stays", "")] for s in content["steps"]]
        found["btr70.steps"] = tables.markdown(("tried", "held-out gain", "standard error", "stays"), rows)
        found["btr70.checks"] = tables.markdown(("what", "found", "elsewhere"), checked(content["checks"]))
        bounces = [
            [b["ground"], f"{b['power']:.1f}", b["strength"], f"{b['correlation']:.3f}"]
            for b in content["checks"]["bounces"]["found"]
        ]
        head = ("ground", "power of bounces over all other, strength 1", "strength", "correlation")
        found["btr70.bounces"] = tables.markdown(head, bounces)
        orders = [
            [name, f"{one['order']:.2f}", f"{one['gain_per_pixel']:+.3f}", one["pixels"]]
            for name, one in content["checks"]["orders"].items()
            if name != "cpu_s"
        ]
        head = ("region", "order", "held-out log score per pixel over plain speckle", "pixels")
        found["btr70.orders"] = tables.markdown(head, orders)
    return found


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("data", type=Path, help="folder of public releases")
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--scene", type=Path, help="predict with this scene; learn nothing")
    tables.add_write(parser)
    given = parser.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    made = kept(given.out / "made.json", tables.made)
    chips = chips_of(given.data)
    TRAINED_DEG[:] = [chip.azimuth_deg for chip in chips if chip.name in TRAIN]
    if given.scene is None:
        declared, final, steps, size = learned(given.data, given.out, chips)
        place = given.out / "final" / "scene.toml"
    else:
        declared = Scene.load(prepare(given.data, given.out))
        final, steps, size, place = Scene.load(given.scene), [], {}, given.scene
    views = tested(given.out, declared, final, chips)
    train = [chip for chip in chips if chip.name in TRAIN]
    known = what_is_known(given.out, final, size, train, held_back(chips)) if steps else {}
    (body,) = (one for one in final.objects if one.name == "btr70")
    content = {
        "made": made,
        "views": views,
        "verdict": [step["tried"] for step in steps if step.get("stays")],
        "scene": str(place),
        "pose": {"position_m": body.position_m, "roll_deg": body.roll_deg, "pitch_deg": body.pitch_deg},
        "size_m": [a * b for a, b in zip(body.scales, checks.CAD_M, strict=True)],
        "effects": {key: value for key, value in final.effects.items() if key != "aim_point"},
        "materials": {name: one.model_dump(exclude_unset=True, mode="json") for name, one in final.materials.items()},
        "steps": steps,
        "checks": known,
    }
    bodies = tables_of(content)
    written(given.out, "btr70", json.loads(json.dumps(content, default=float)), bodies)
    tables.publish(bodies, content, given.write)


if __name__ == "__main__":
    main()
