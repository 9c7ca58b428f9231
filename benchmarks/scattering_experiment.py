"""Images made with one backscatter model, learned with another: what bias the wrong model has, and what says so.

    python benchmarks/scattering_experiment.py [--seeds 3] [--device cpu] [--out FILE] [--from FILE] [--write]
    python benchmarks/scattering_experiment.py --diagnose [--device cpu] [--out FILE] [--write]

The ground of data/in_domain (rolling, three views at 30, 40 and 50 degrees, HH and VV), 16 looks of speckle. The images
are those of `i2em` surfaces with an exponential spectrum, l = 10 h, eps 9. They are learned with `ka_spm` and `i2em`.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tables
import warp as wp
from references import changed, clean_images, logs, measured

from warpsar import LearnOptions, Material, Scene, diagnose, learn

DATA = Path(__file__).resolve().parent.parent / "data" / "in_domain" / "spm.toml"
HEIGHTS_M = (0.0005, 0.0015, 0.003, 0.005)  # kh 0.10, 0.30, 0.60 and 1.01
KEYS = ("eps_r", "rms_height_m", "correlation_length_m")
LOOKS = 16.0


def truth_of(height_m: float) -> tuple[float, float, float]:
    return 9.0, height_m, 10.0 * height_m


def scene_with(model: str, values: Sequence[float]) -> Scene:
    scene = Scene.load(DATA)
    soil = Material(**dict(zip(KEYS, values, strict=True)), model=model, spectrum="exponential")  # type: ignore[arg-type]
    return replace(scene, materials={"soil": soil})


def case(height_m: float, seeds: int, device: str | None) -> dict[str, Any]:
    """Fits of both models to the same images: errors and sd of ln(eps_r - 1), ln h and ln l, and the verdicts."""
    truth = truth_of(height_m)
    images = clean_images(scene_with("i2em", truth))
    found: dict[str, Any] = {"truth": list(truth)}
    for model in ("ka_spm", "i2em"):
        fits = []
        for seed in range(seeds):
            with tempfile.TemporaryDirectory() as folder:
                observed = measured(scene_with(model, truth), images, Path(folder), LOOKS, seed)
                begin = dict(zip(KEYS, (6.0, 1.3 * truth[1], 0.8 * truth[2]), strict=True))
                fit = learn(changed(observed, "soil", **begin), device=device, options=LearnOptions())
            assert fit.identified is not None
            values = [float(getattr(fit.scene.materials["soil"], key)) for key in KEYS]
            sd = [float(s) if np.isfinite(s) else None for s in fit.identified.sd]
            verdict = fit.verdicts["train"]
            fits.append(
                {
                    "learned": values,
                    "error": (logs(values) - logs(truth)).tolist(),
                    "sd": sd,
                    "deviance": verdict.deviance,
                    "deviance_error": verdict.deviance_error,
                    "wrong": bool(verdict.wrong),
                    "doubts": fit.doubts,
                }
            )
        found[model] = fits
    return found


def diagnosed(height_m: float, device: str | None) -> dict[str, Any]:
    """What `diagnose` says of one draw of the images, where the scene declares `ka_spm`."""
    truth = truth_of(height_m)
    images = clean_images(scene_with("i2em", truth))
    with tempfile.TemporaryDirectory() as folder:
        observed = measured(scene_with("ka_spm", truth), images, Path(folder), LOOKS, 0)
        found = diagnose(observed, device=device)
    return {"height_m": height_m, "verdict": list(found.verdict), "unexplained": bool(found.unexplained)}


def diagnosed_table(result: dict[str, Any]) -> str:
    rows = [
        [
            f"{one['height_m'] * 201.2:.2f}",
            ", ".join(one["verdict"]) or "nothing",
            "yes" if one["unexplained"] else "no",
        ]
        for one in result["diagnosed"]
    ]
    return tables.markdown(["kh", "diagnose names", "something is left unexplained"], rows)


def table_of(result: dict[str, Any]) -> str:
    rows = []
    for one in result["cases"]:
        for model in ("i2em", "ka_spm"):
            fits = one[model]
            cells = []
            for k in range(3):
                ratio = np.median([fit["learned"][k] / one["truth"][k] for fit in fits])
                sds = [fit["sd"][k] for fit in fits]
                held = sum(s is None or abs(f["error"][k]) <= 1.96 * s for f, s in zip(fits, sds, strict=True))
                known = [s for s in sds if s is not None]
                width = f"{100 * np.median(known):.1f} %" if known else "none"
                cells.append(f"{100 * (ratio - 1):+.1f} %, sd {width}, {held} of {len(fits)}")
            deviance = np.median([fit["deviance"] for fit in fits])
            said = sum(fit["wrong"] for fit in fits)
            rows.append(
                [f"{one['truth'][1] * 201.2:.2f}", f"`{model}`", *cells, f"{deviance:.3f}", f"{said} of {len(fits)}"]
            )
    head = ["kh", "learned with", "eps_r", "h", "l", "deviance", "verdict says wrong"]
    return tables.markdown(head, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3, help="draws of speckle of each case")
    parser.add_argument("--device")
    parser.add_argument("--diagnose", action="store_true", help="what diagnose says of the images instead")
    tables.add_options(parser)
    given = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    if given.diagnose:
        said = [diagnosed(height, given.device) for height in HEIGHTS_M]
        result = {"made": tables.made(), "diagnosed": said}
        tables.save(given.out, result)
        tables.publish({"scattering.diagnosed": diagnosed_table(result)}, result, given.write)
        return
    if given.source is not None:
        result = tables.stored(given.source)
    else:
        cases = [case(height, given.seeds, given.device) for height in HEIGHTS_M]
        result = {"made": tables.made(), "cases": cases}
        tables.save(given.out, result)
    tables.publish({"scattering.experiment": table_of(result)}, result, given.write)


if __name__ == "__main__":
    main()
