"""The loop on measured RCS of exactly known bodies: what a model of single bounces lacks, and what its dimensions are.

    python benchmarks/rcs.py DATA -o out/ [--jobs N] [--write]

DATA is the folder of measured data (with austin_rcs/ in it), or austin_rcs itself. `out/rcs.json` holds for every body
the verdict, a row for each curve and sector, and what was learned; out/*.png the figures. Amplitudes are kept in
out/cache, so a run that was interrupted goes on where it was; a change of the engine's sources makes them anew. Curves
at 2.56 and 5.12 GHz of the first measurement are train; all others, also such as are put into the folder later, are
tests with rows of their own.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import rcs_bodies as bodies
import rcs_figures as figures
import rcs_learned as learned
import tables
from numpy.typing import NDArray
from rcs_curves import BODIES, OTHER_DB, PER_DIRECTION, Body, Measured, Work, find, measured

from warpsar.curves import metrics, rivals, sectors
from warpsar.curves.noise import fit, of_repeats
from warpsar.curves.observed import ObservedCurve
from warpsar.curves.search import DECLARED, TermSearch
from warpsar.simulation.outputs import plain

ROOT = Path(__file__).resolve().parent.parent


class Model:
    """What is believed of a body in the end:

    Terms, levels without phase, and the noise in front of an aperture and elsewhere.
    """

    def __init__(self, work: Work, final: Sequence[ObservedCurve], found: Mapping[str, TermSearch]) -> None:
        self.work = work
        self.terms = tuple(dict.fromkeys(term for one in found.values() for term in one.terms))
        self.level_only = {effect for one in found.values() for effect in one.level_only}
        train = [self.levelled(one) for one in final if one.role == "train"]
        self.noise = {}
        for seen in (False, True):
            some = [
                one.where(self.seen(one) == seen).thinned(PER_DIRECTION)
                for one in train
                if (self.seen(one) == seen).any()
            ]
            if some:
                self.noise[seen] = fit(some, self.terms).noise

    def seen(self, one: ObservedCurve) -> NDArray[np.bool_]:
        """Directions that see an aperture, (n,)."""
        return ~self.work.sector(one, "away") if len(self.work.normals) else np.zeros(len(one.azimuth_deg), bool)

    def levelled(self, one: ObservedCurve) -> ObservedCurve:
        """The curve with the mean power of the terms that tell the level alone, where the aperture is seen."""
        if "multibounce" not in self.level_only:
            return one
        seen, power = self.seen(one), np.abs(one.amplitude(["multibounce"])) ** 2
        return replace(one, level_m2=np.where(seen, power[seen].mean(), 0.0))

    def predict(self, one: ObservedCurve) -> NDArray[np.float64]:
        """The power that is expected, (n,): the model's, the levels', and the background's."""
        background = np.zeros(len(one.azimuth_deg))
        for seen, noise in self.noise.items():
            background[self.seen(one) == seen] = noise[one.polarization].background_m2
        found: NDArray[np.float64] = np.abs(one.amplitude(self.terms)) ** 2 + background + self.levelled(one).level_m2
        return found

    def content(self) -> dict[str, Any]:
        """The noise, for JSON."""
        return {
            f"{pol}{', aperture seen' if seen else ''}": {
                "background_dbsm": float(metrics.decibels(np.array(one.background_m2))),
                "error_db": one.error_db,
            }
            for seen, noise in self.noise.items()
            for pol, one in noise.items()
        }


def rows(model: Model, final: Sequence[ObservedCurve]) -> list[dict[str, Any]]:
    """A row for each curve and sector:

    Mean abs(dB) and correlation of the declared and the final model, and of no physics.
    """
    work, made = model.work, []
    for declared, one in zip(work.curves, final, strict=True):
        predicted = model.predict(one)
        low = float(metrics.decibels(declared.measured_m2).max()) - work.low_db
        for sector in sectors.NAMES if len(work.normals) else ("all",):
            inside = work.sector(one, sector)
            if inside.sum() < 3:
                continue
            old, new = declared.where(inside), one.where(inside)
            models = {
                "declared": np.abs(old.amplitude(DECLARED)) ** 2,
                "final": predicted[inside],
                "amplitude": np.abs(new.amplitude(model.terms)) ** 2,
                "null": rivals.constant([new]).model_m2[0],
                "smooth": rivals.smooth([new]).model_m2[0],
            }
            made.append(
                {
                    "file": one.name,
                    "frequency_hz": one.frequency_hz,
                    "polarization": one.polarization,
                    "role": one.role,
                    "sector": sector,
                    "angles": int(inside.sum()),
                    "independent_angles": float(new.weight.sum()),
                    "error_db": {k: metrics.error_db(new.measured_m2, m, low) for k, m in models.items()},
                    "correlation": {k: metrics.correlation(new.measured_m2, m, low) for k, m in models.items()},
                    "level_db": metrics.level_db(new.measured_m2, models["final"]),
                }
            )
    return made


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    default = Path(os.environ.get("WARPSAR_MEASURED") or ROOT.parent / "shared" / "data")
    parser.add_argument("data", type=Path, nargs="?", default=default, help="the folder of measured data")
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder for rcs.json, figures and the cache")
    parser.add_argument(
        "--only", choices=[one.key for one in BODIES], help="one body; the others keep what rcs.json has"
    )
    parser.add_argument("--device", metavar="cpu|cuda", help="device to work on")
    parser.add_argument("--jobs", type=int, default=1, help="processes that sweep a duct's shapes side by side")
    tables.add_write(parser)
    options = parser.parse_args()
    data = options.data / "austin_rcs" if (options.data / "austin_rcs").is_dir() else options.data
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "rcs.json"
    result = json.loads(path.read_text()) if options.only and path.exists() else {"bodies": {}}
    result["made"] = tables.made()
    files = measured(data)
    for body in BODIES:
        mine = [one for one in files if one.body == body.code and one.size == body.size]
        if mine and options.only in (None, body.key):
            print(f"{body.key}: {len(mine)} curves", file=sys.stderr)
            result["bodies"][body.key] = plain(one_body(body, mine, data, options, result["bodies"]))
            path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    known = {(body.code, body.size) for body in BODIES}
    for one in files:
        if (one.body, one.size) not in known:
            key = f"{one.body}.{one.size}".rstrip(".")
            entry = result["bodies"].setdefault(key, {"verdict": [], "rows": [], "learned": {}, "note": UNKNOWN})
            entry["rows"] = [row for row in entry["rows"] if row["file"] != one.path.name] + [unknown_row(one)]
    path.write_text(json.dumps(plain(result), indent=1) + "\n", encoding="utf-8")
    tables.publish(figures.tables_of(result), result, options.write)
    return 0


UNKNOWN = "a body of which there is no model here: only what needs no physics can be said"


def unknown_row(one: Measured) -> dict[str, Any]:
    """A curve of a body without a model: what a constant level leaves."""
    power = one.table.rcs_m2[np.isfinite(one.table.rcs_m2)]
    level = np.full(len(power), 10 ** (np.median(metrics.decibels(power)) / 10))
    low = float(metrics.decibels(power).max()) - OTHER_DB
    nothing = {"declared": None, "final": None}
    return {
        "file": one.path.name,
        "frequency_hz": float(one.table.frequency_hz[0]),
        "polarization": one.table.polarization[0],
        "role": "test",
        "sector": "all",
        "angles": len(power),
        "error_db": {**nothing, "null": metrics.error_db(power, level, low)},
        "correlation": {**nothing, "null": None},
        "note": UNKNOWN,
    }


def one_body(
    body: Body, files: Sequence[Measured], data: Path, options: argparse.Namespace, others: Mapping[str, Any]
) -> dict[str, Any]:
    """Everything about one body, as rcs.json has it."""
    work = Work(body, files, data, options.out / "cache", options.device, options.jobs)
    found = find(work)
    names = tuple(dict.fromkeys(term for one in found.values() for term in one.terms))
    what: dict[str, Any] = {}
    final = work.curves
    if body.key == "box_cylinder" and "multibounce" in names:
        what, duct = learned.duct(work, names, options.out / "cache", options.device)
        mesh = bodies.cylinder_box(duct)
        final = [work.observed(one, mesh) for one in files]
    elif body.key == "dielectric_plate":
        what, final = learned.dielectric(work, others.get("pec_plate", {}).get("learned", {}))
        found = {"all": found["all"], "all, learned plate": find(work, final)["all"]}
        names = found["all, learned plate"].terms
    elif body.key == "box_closed":
        what = {"offered": learned.offered_duct(work, data, names)}
    model = Model(work, final, found)
    what["noise"] = model.content()
    if body.key == "pec_plate":
        what |= learned.calibration(final, names)
    if body.saturated:
        what["saturation_db"] = learned.saturation(work, names)
    what |= learned.named(work, final, model.predict)
    what |= repeats(files)
    verdict = list(dict.fromkeys(effect for one in found.values() for effect in one.verdict))
    level_only = list(dict.fromkeys(effect for one in found.values() for effect in one.level_only))
    figures.body(options.out, work, final, model.predict)
    return {
        "verdict": verdict,
        "level_only": level_only,
        "rows": rows(model, final),
        "learned": what,
        "asked": {sector: [asdict(each) for each in one.asked] for sector, one in found.items()},
    }


def repeats(files: Sequence[Measured]) -> dict[str, Any]:
    """The noise that two measurements of one curve tell, where there are two."""

    def kind(one: Measured) -> tuple[float, str]:
        return round(one.table.frequencies_hz()[0] / 1e9, 2), one.table.polarization[0]

    first = {kind(one): one for one in sorted(files, key=lambda one: one.first)}
    found = {}
    for one in files:
        other = first[kind(one)]
        if other.path == one.path:
            continue
        _, here, there = np.intersect1d(
            one.table.azimuth_deg.round(4), other.table.azimuth_deg.round(4), return_indices=True
        )
        if len(here) > 10:
            pair = one.table.rcs_m2[here], other.table.rcs_m2[there]
            noise = of_repeats(*pair)
            found[one.path.name] = {
                "beside": other.path.name,
                "mean_abs_db": metrics.error_db(*pair),
                "background_dbsm": float(metrics.decibels(np.array(noise.background_m2))),
                "error_db": noise.error_db,
            }
    return {"repeats": found} if found else {}


if __name__ == "__main__":
    raise SystemExit(main())
