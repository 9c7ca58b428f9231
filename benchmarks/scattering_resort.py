"""The last resort of diagnose, in a case where nothing named explains the images, and in one where something does.

python benchmarks/scattering_resort.py [--device cpu] [--out FILE] [--figure FILE] [--write]

Both on the ground of data/in_domain seen at five incidences, HH and VV, four looks, with `ka_spm` declared. In `table`
the images are those of a table over incidence (model "facet"): a slope, with 3 dB more in HH and 3 dB less in VV about
40 degrees. In `saturation` they are those of the declared surface by a compressed receiver. A sixth view at 45 degrees
tests.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tables
import warp as wp
from references import clean_images, measured

from warpsar import Material, Scene, diagnose
from warpsar.diagnosis.result import Diagnosed
from warpsar.effects.learned_scattering import shape_db
from warpsar.io.figures import new, save
from warpsar.simulation.materials import sigma0_db

DATA = Path(__file__).resolve().parent.parent / "data" / "in_domain" / "spm.toml"
INCIDENCES = (28.0, 34.0, 40.0, 46.0, 52.0, 45.0)  # the last one tests
LOOKS = 4.0
ANGLES = np.arange(0.0, 91.0, 2.5)
COMPRESSED = {"saturation": {"exponent": 0.8}}


def table_db(angles: np.ndarray) -> dict[str, np.ndarray]:
    """sigma0 of the case `table` [dB]."""
    bend = 3.0 * np.exp(-(((angles - 40.0) / 10.0) ** 2) / 2)
    return {"HH": -8.0 - 0.25 * angles + bend, "VV": -7.0 - 0.22 * angles - bend}


def declared() -> Scene:
    scene = Scene.load(DATA)
    first = scene.views[0]
    views = [
        first.model_copy(update={"name": f"v{k}", "azimuth_deg": 75.0 * k, "incidence_deg": incidence})
        for k, incidence in enumerate(INCIDENCES)
    ]
    return replace(scene, views=views)


def truth_of(case: str, folder: Path) -> Scene:
    scene = declared()
    if case == "saturation":
        return replace(scene, effects=COMPRESSED)
    columns = table_db(ANGLES)
    rows = [f"{a:g},{hh:.4f},{vv:.4f}" for a, hh, vv in zip(ANGLES, columns["HH"], columns["VV"], strict=True)]
    (folder / "surface.csv").write_text("\n".join(["incidence_deg,HH,VV", *rows]) + "\n")
    return replace(scene, materials={"soil": Material(model="facet", sigma0=folder / "surface.csv")})


def diagnosed(case: str, device: str | None) -> Diagnosed:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = measured(declared(), clean_images(truth_of(case, folder)), folder, LOOKS, 0)
        last = scene.views[-1].model_copy(update={"role": "test"})
        return diagnose(replace(scene, views=[*scene.views[:-1], last]), device=device)


def content_of(case: str, done: Diagnosed) -> dict[str, Any]:
    found = done.diagnosis
    pairs = {"before": done.before, "after": done.after}
    return {
        "case": case,
        "verdict": list(done.verdict),
        "unexplained": bool(done.unexplained),
        "deviance": {
            when: {role: None if one is None else one["deviance"] for role, one in pooled.items()}
            for when, pooled in pairs.items()
        },
        "effects": found.final.scene.effects,
    }


def draw(done: Diagnosed, path: Path) -> None:
    """sigma0 of the surface, of the declared model and with the law, and the law itself, over incidence."""
    found = done.diagnosis
    law = found.final.scene.effects["learned_scattering"]
    figure, axes = new(8.0, 3.4, ncols=2)
    angles = np.arange(20.0, 66.0)
    frequency = found.scene.radar.frequency_hz
    for channel, colour in (("HH", "tab:blue"), ("VV", "tab:orange")):
        fits = [
            sigma0_db(model.scene.materials["soil"], channel, frequency, angles)
            for model in (found.declared, found.final)
        ]
        learned = shape_db(law, channel, angles)
        axes[0].plot(angles, table_db(angles)[channel], color=colour, label=f"{channel}, the surface")
        axes[0].plot(angles, fits[0], ":", color=colour, label=f"{channel}, ka_spm alone")
        axes[0].plot(angles, fits[1] + learned, "--", color=colour, label=f"{channel}, with the law")
        axes[1].plot(angles, learned, color=colour, label=channel)
    axes[0].set(xlabel="local incidence [deg]", ylabel="sigma0 [dB]")
    axes[1].set(xlabel="local incidence [deg]", ylabel="learned factor on sigma0 [dB]")
    axes[1].axhline(0.0, color="0.6", linewidth=0.8)
    for axis in axes:
        axis.axvspan(min(INCIDENCES), max(INCIDENCES), color="0.95", zorder=0)
        axis.legend(fontsize="small")
    save(figure, path)


def table_of(result: dict[str, Any]) -> str:
    rows = []
    for one in result["cases"]:
        pairs = [
            " → ".join(f"{one['deviance'][when][role]:.3f}" for when in ("before", "after"))
            for role in ("train", "test")
        ]
        rows.append(
            [one["case"], ", ".join(one["verdict"]) or "nothing", *pairs, "yes" if one["unexplained"] else "no"]
        )
    head = ["images of", "diagnose names", "deviance, train", "deviance, test", "something is left unexplained"]
    return tables.markdown(head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device")
    parser.add_argument("--figure", type=Path, help="where the drawing of the law goes (PNG)")
    parser.add_argument("--out", type=Path, help="JSON file")
    tables.add_write(parser)
    given = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    done = {case: diagnosed(case, given.device) for case in ("table", "saturation")}
    result = {"made": tables.made(), "cases": [content_of(case, one) for case, one in done.items()]}
    if given.figure is not None:
        draw(done["table"], given.figure)
    tables.save(given.out, result)
    tables.publish({"scattering.resort": table_of(result)}, result, given.write)


if __name__ == "__main__":
    main()
