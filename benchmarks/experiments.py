"""The paper's experiments again, on scenes whose truth is known: tables III, IV and VI, surfaces inside the models'
domains, parameter fields, and a case of an independent renderer. docs/experiments.md has the results.

    python benchmarks/experiments.py table3 -o out/experiments

Each command prints its table (Markdown) and leaves NAME.json, the references and their scene files in the folder.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))  # so that `import experiments` from a test finds its neighbours
from references import NO_SPECKLE_LOOKS, changed, clean_images, measured, with_rays

from warpsar.io.images import replacing
from warpsar.learning.command import Learned, LearnOptions, learn
from warpsar.scene.scene import Scene
from warpsar.world.tables import Sampling

DATA = Path(__file__).parent.parent / "data"
KEYS = ("eps_r", "rms_height_m", "correlation_length_m")
OTHER_STARTS_SD = 0.7  # of ln(eps_r - 1), ln h and ln l, about the paper's start


@dataclass(frozen=True)
class Run:
    """One fit of table III or IV: what the radar measures, and which equations both images come from."""

    name: str
    polarizations: tuple[str, ...]
    tau: float = 0.0
    as_printed: bool = True


RUNS = (
    Run("SPM, HH, as printed", ("HH",)),
    Run("KA, HH, as printed", ("HH",), tau=1.0),
    Run("KA+SPM, tau 0.5 known, HH, as printed", ("HH",), tau=0.5),
    Run("SPM, HH", ("HH",), as_printed=False),
    Run("SPM, HH+VV", ("HH", "VV"), as_printed=False),
)


def say(name: str) -> None:
    click.echo(f"{name} ...", err=True)


def write(out: Path, name: str, content: Any) -> None:
    with replacing(out / f"{name}.json") as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    click.echo("| " + " | ".join(header) + " |\n|" + "---|" * len(header))
    for row in rows:
        click.echo("| " + " | ".join(row) + " |")


def values_of(found: Learned, material: str) -> list[float]:
    """eps_r, h [m] and l [m] of a uniform material after a fit."""
    return [float(getattr(found.scene.materials[material], key)) for key in KEYS]


def logs(values: Sequence[float]) -> np.ndarray:
    """ln(eps_r - 1), ln h, ln l."""
    eps_r, h, length = values
    return np.log([eps_r - 1.0, h, length])


def surface(values: Sequence[float]) -> list[str]:
    """Table cells of eps_r, h [mm], l [mm], h l [mm^2], h / l."""
    eps_r, h, length = values
    numbers = (eps_r, h * 1e3, length * 1e3, h * length * 1e6, h / length)
    return [f"{number:.4g}" for number in numbers]


def between(runs: Sequence[Sequence[float]]) -> list[str]:
    """The same cells, each the smallest and the largest over several fits."""
    columns = zip(*(surface(values) for values in runs), strict=True)
    pairs = [(min(c, key=float), max(c, key=float)) for c in columns]
    return [low if low == high else f"{low} to {high}" for low, high in pairs]


def starts(first: Sequence[float], count: int, seed: int = 0) -> list[list[float]]:
    """The given start, and others drawn about it in log coordinates."""
    found = [list(first)]
    for one in np.random.default_rng(seed).normal(0.0, OTHER_STARTS_SD, (count - 1, 3)):
        eps, h, length = np.exp(logs(first) + one)
        found.append([1.0 + eps, h, length])
    return found


def recover(
    name: str,
    material: str,
    start: Sequence[float],
    out: Path,
    device: str | None,
    *,
    runs: Sequence[Run] = RUNS,
    count: int = 5,
    rays: float = 1.0,
) -> dict[str, Any]:
    """Fits of one uniform material to noise-free references of data/NAME, from `start` and others about it.

    `rays` multiplies the scene's rays. A start "arrives" where its rms error in dB is within 10 % of the best one's:
    between those the data do not choose.
    """
    scene = with_rays(Scene.load(DATA / name / "scene.toml"), rays)
    truth = [float(getattr(scene.materials[material], key)) for key in KEYS]
    results = []
    for run in runs:
        say(f"{name}: {run.name}")
        printed = {"variant": "as_printed", "polarization_basis": "local"} if run.as_printed else {}
        radar = scene.radar.model_copy(update={"polarizations": run.polarizations, **printed})
        true_scene = changed(replace(scene, radar=radar), material, specular_fraction=run.tau)
        folder = out / name / run.name.replace(" ", "_").replace(",", "")
        observed = measured(true_scene, clean_images(true_scene), folder, NO_SPECKLE_LOOKS)
        fits = []
        for values in starts(start, count):
            begun = changed(observed, material, **dict(zip(KEYS, values, strict=True)))
            if not fits:
                begun.save(folder / "scene.toml")
            found = learn(begun, device=device, options=LearnOptions(starts=1))
            assert found.identified is not None
            fits.append(
                {
                    "start": values,
                    "learned": values_of(found, material),
                    "rms_db": found.train["rmse_db"],
                    "iterations": len(found.history),
                    "words": found.identified.words,
                    "sd": found.identified.sd.tolist(),
                }
            )
        best = min(fit["rms_db"] for fit in fits)
        for fit in fits:
            fit["arrived"] = fit["rms_db"] < 1.1 * best
        results.append({"run": run.name, "fits": fits})
    content = {"truth": truth, "start": list(start), "runs": results}
    write(out, name, content)
    return content


def print_recovered(content: dict[str, Any], paper: Sequence[str]) -> None:
    rows = [
        ["truth", *surface(content["truth"]), "", ""],
        ["start", *surface(content["start"]), "", ""],
        ["paper, SPM, HH", *paper, "", ""],
    ]
    for result in content["runs"]:
        fit = result["fits"][0]
        words = fit["words"][0].split(": ", 1)[1]
        rows.append([result["run"], *surface(fit["learned"]), f"{fit['rms_db']:.2g}", words])
    table(("", "eps_r", "h [mm]", "l [mm]", "h l [mm^2]", "h / l", "rms [dB]", "determined, to one sd"), rows)
    click.echo()
    rows = []
    for result in content["runs"]:
        arrived = [fit["learned"] for fit in result["fits"] if fit["arrived"]]
        rows.append([result["run"], f"{len(arrived)} of {len(result['fits'])}", *between(arrived)])
    table(("", "starts that arrived", "eps_r", "h [mm]", "l [mm]", "h l [mm^2]", "h / l"), rows)


def in_domain_case(
    model: str, start: Sequence[float], out: Path, device: str | None, *, seeds: int, looks: float = 16.0
) -> dict[str, Any]:
    """Fits of data/in_domain/MODEL.toml to `seeds` draws of speckle: error and interval of ln(eps_r - 1), ln h, ln l
    and ln(h / l). Where a parameter is not identifiable its standard deviation is infinite."""
    scene = Scene.load(DATA / "in_domain" / f"{model}.toml")
    truth = [float(getattr(scene.materials["soil"], key)) for key in KEYS]
    images = clean_images(scene)
    combine = np.vstack([np.eye(3), [0.0, 1.0, -1.0]])
    fits = []
    for seed in range(seeds):
        say(f"in_domain: {model}, seed {seed}")
        observed = measured(scene, images, out / "in_domain" / model, looks, seed)
        found = learn(
            changed(observed, "soil", **dict(zip(KEYS, start, strict=True))), device=device, options=LearnOptions()
        )
        assert found.identified is not None
        known = found.identified
        # of the speckle alone: the pseudo-inverse holds on what is seen, so that h / l has a variance where h has none
        covariance = np.linalg.pinv(known.information, rcond=1e-9)
        sd = np.append(known.sd, np.sqrt(combine[3] @ covariance @ combine[3]))
        fits.append(
            {
                "learned": values_of(found, "soil"),
                "error": (combine @ (logs(values_of(found, "soil")) - logs(truth))).tolist(),
                "sd": [float(s) if np.isfinite(s) else None for s in sd],
                "deviance": found.train["deviance"],
                "words": known.words,
            }
        )
    return {"model": model, "truth": truth, "start": list(start), "looks": looks, "fits": fits}


def print_in_domain(results: Sequence[dict[str, Any]]) -> None:
    rows = []
    for result in results:
        for index, symbol in enumerate(("eps_r", "h", "l", "h / l")):
            errors = np.array([fit["error"][index] for fit in result["fits"]])
            sds = [fit["sd"][index] for fit in result["fits"]]
            if None in sds:
                rows.append([result["model"].upper(), symbol, "not identifiable", "", ""])
                continue
            sd = np.array(sds)
            relative = np.abs(np.expm1(errors))
            if index == 0:
                true = result["truth"][0]
                relative = np.abs([fit["learned"][0] / true - 1.0 for fit in result["fits"]])
            inside = int((np.abs(errors) <= 1.96 * sd).sum())
            rows.append(
                [
                    result["model"].upper(),
                    symbol,
                    f"{100 * np.median(relative):.2f} %",
                    f"{100 * np.median(sd):.2f} %",
                    f"{inside} of {len(errors)}",
                ]
            )
    table(("truth in the domain of", "", "median error", "median sd of its log", "95 % interval holds truth"), rows)


SAMPLES = (8, 16, 32, 64, 128, 256)


def sampling_error(
    out: Path, device: str | None, *, samples: Sequence[int] = SAMPLES, seeds: int = 5, reference_rays: float = 2048.0
) -> list[dict[str, Any]]:
    """Table VI: what is left after convergence, against rays per pixel, for rays that fall into one pixel (`nearest`,
    the paper's) and rays spread over the pixels that they cover (`footprint`, the default here).

    Table IV's scene in HH as printed; the reference has many rays that fall into one pixel each, free of bias.
    """
    scene = Scene.load(DATA / "table4" / "scene.toml")
    radar = scene.radar.model_copy(update={"variant": "as_printed", "polarization_basis": "local"})
    scene = replace(scene, radar=radar)
    truth = [float(getattr(scene.materials["building"], key)) for key in KEYS]
    exact = Sampling(rays_per_pixel=reference_rays / 4.0, deposit="nearest")
    observed = measured(scene, clean_images(replace(scene, sampling=exact)), out / "table6", NO_SPECKLE_LOOKS)
    largest = max(float(np.nanmax(observed.measured(v, "HH"))) for v in observed.views)
    start = dict(zip(KEYS, (1.5, 1e-4, 1e-4), strict=True))
    rows = []
    for deposit in ("nearest", "footprint"):
        for count in samples:
            say(f"table6: {deposit}, {count} rays per pixel")
            for seed in range(seeds):
                sampling = Sampling(rays_per_pixel=float(count), deposit=deposit, seed=seed)
                begun = changed(replace(observed, sampling=sampling), "building", **start)
                found = learn(begun, device=device, options=LearnOptions(starts=1))
                errors = logs(values_of(found, "building")) - logs(truth)
                rows.append(
                    {
                        "deposit": deposit,
                        "rays_per_pixel": count,
                        "seed": seed,
                        "parameter_error": float(np.sqrt(np.mean(errors**2))),
                        "rmse": found.train["rmse"] / largest,
                        "rms_db": found.train["rmse_db"],
                    }
                )
    return rows


def print_sampling(rows: Sequence[dict[str, Any]]) -> None:
    def cell(deposit: str, count: int, key: str, scale: float) -> str:
        found = [scale * r[key] for r in rows if r["deposit"] == deposit and r["rays_per_pixel"] == count]
        return f"{np.mean(found):.3g} ± {np.std(found, ddof=1):.2g}"

    counts = sorted({row["rays_per_pixel"] for row in rows})
    body = [
        [str(n)]
        + [
            cell(deposit, n, key, scale)
            for deposit in ("nearest", "footprint")
            for key, scale in (("parameter_error", 100.0), ("rmse", 1e3), ("rms_db", 1.0))
        ]
        for n in counts
    ]
    header = ["rays per pixel"]
    for deposit in ("nearest", "footprint"):
        header += [f"{deposit}: parameters [%]", "RMSE / max [1e-3]", "rms [dB]"]
    table(header, body)


def case_result(folder: Path, out: Path, device: str | None) -> dict[str, Any]:
    """`warpsar learn` on a case with truth.json beside it: is the truth in the intervals of what is identifiable?"""
    from warpsar.learning.command import run

    content = run(folder / "scene.toml", out / folder.name, device=device)
    truth = json.loads((folder / "truth.json").read_text())["materials"]
    rows = []
    for name, values in truth.items():
        for key, true in zip(KEYS, values, strict=False):
            entry = content["materials"][name][key]
            low, high = entry["interval_95"]
            rows.append(
                {
                    "parameter": f"{name}.{key}",
                    "truth": true,
                    "learned": entry["value"],
                    "interval_95": [low, high],
                    "identifiable": bool(entry["sd_log"] < 0.5),
                    "inside": bool(low <= true <= high),
                }
            )
    return {
        "train": content["train"],
        "test": content["test"],
        "words": content["identifiability"]["words"],
        "parameters": rows,
    }


def print_case(result: dict[str, Any]) -> None:
    rows = [
        [
            row["parameter"],
            f"{row['truth']:.4g}",
            f"{row['learned']:.4g}",
            f"{row['interval_95'][0]:.4g} to {row['interval_95'][1]:.4g}",
            "yes" if row["inside"] else "no",
            "yes" if row["identifiable"] else "no",
        ]
        for row in result["parameters"]
    ]
    table(("parameter", "truth", "learned", "95 % interval", "holds truth", "identifiable alone"), rows)
    click.echo(f"\ndeviance: train {result['train']['deviance']:.4f}, test {result['test']['deviance']:.4f}\n")
    for sentence in result["words"]:
        click.echo(f"- {sentence}")


@click.group()
def main() -> None:
    """Experiments of the paper, and checks beyond it; see docs/experiments.md."""


OUT = click.option("-o", "--out", type=click.Path(path_type=Path, file_okay=False), default=Path("out/experiments"))
DEVICE = click.option("--device", default=None, help="cpu, cuda or cuda:N.")


@main.command("table3")
@OUT
@DEVICE
def table3_command(out: Path, device: str | None) -> None:
    """Cube on a plane, 9.6 GHz."""
    content = recover("table3", "cube", (25.0, 0.005, 0.010), out, device)
    print_recovered(content, ("not in our notes", "2.09", "1.04", "2.174", "2.01"))


@main.command("table4")
@OUT
@DEVICE
def table4_command(out: Path, device: str | None) -> None:
    """Simplified building, 9.6 GHz, from eps_r 1.5 for the dead point 1."""
    content = recover("table4", "building", (1.5, 1e-4, 1e-4), out, device)
    print_recovered(content, ("7.42", "19", "9", "171", "2.111"))


@main.command("in_domain")
@OUT
@DEVICE
@click.option("--seeds", type=click.IntRange(min=2), default=20, show_default=True)
def in_domain_command(out: Path, device: str | None, seeds: int) -> None:
    """Surfaces inside the domains of the models, HH+VV, 16 looks."""
    results = [
        in_domain_case("spm", (4.0, 0.001, 0.006), out, device, seeds=seeds),
        in_domain_case("ka", (4.0, 0.030, 0.200), out, device, seeds=seeds),
    ]
    write(out, "in_domain", results)
    print_in_domain(results)


@main.command("table6")
@OUT
@DEVICE
@click.option("--seeds", type=click.IntRange(min=2), default=5, show_default=True)
def table6_command(out: Path, device: str | None, seeds: int) -> None:
    """Error after convergence against rays per pixel."""
    rows = sampling_error(out, device, seeds=seeds)
    write(out, "table6", rows)
    print_sampling(rows)


@main.command("case")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False, exists=True))
@OUT
@DEVICE
def case_command(folder: Path, out: Path, device: str | None) -> None:
    """A case of an independent renderer, with its truth.json."""
    result = case_result(folder, out, device)
    write(out, f"case_{folder.name}", result)
    print_case(result)


@main.command("fields")
@OUT
@DEVICE
@click.option("--iterations", type=click.IntRange(min=2), default=300, show_default=True, help="Of Adam, per fit.")
@click.option("--full", is_flag=True, help="Four times the rays and five times the iterations: for a GPU.")
def fields_command(out: Path, device: str | None, iterations: int, full: bool) -> None:
    """Parameter fields of a painted building, 15.2 GHz, from one to six views."""
    import field_experiment

    field_experiment.run(out, device, iterations=iterations * (5 if full else 1), rays=4.0 if full else 1.0)


if __name__ == "__main__":
    main()
