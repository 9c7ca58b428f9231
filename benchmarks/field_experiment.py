"""Fields of h, l and eps_r of a painted building from one to six of six views: the paper's figures 12, 13, 14, 16."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import tables
from references import DATA, KEYS, changed, clean_images, logs, measured, trained_on, with_rays

from warpsar.io.figures import new, save
from warpsar.io.images import read_channel, write_exr
from warpsar.learning.command import Learned, LearnOptions, learn
from warpsar.learning.metrics import pooled_metrics
from warpsar.learning.problem import FitProblem
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.surface.surface import KINDS

MODELS = {"SPM": 0.0, "KA": 1.0, "KA+SPM": 0.5}  # tau of the fit; the reference has 0.5
# Everywhere. Geometric optics starts steeper: with the other slopes a roof at 79 degrees is 900 dB dark.
START = {"SPM": (4.0, 0.0006, 0.0035), "KA": (4.0, 0.0020, 0.0024), "KA+SPM": (4.0, 0.0006, 0.0035)}
LOOKS = 16.0
TOTAL_VARIATION = dict.fromkeys(KEYS, 5.0)
HEXAGON = ("az000", "az180", "az120", "az300", "az240", "az060")  # in the order in which they are added
ADJACENT = ("az000", "az060", "az120")
BETWEEN = tuple(f"az{azimuth:03d}" for azimuth in range(30, 360, 60))  # seen by no fit
TEXTURE = "site"


@dataclass
class FieldFit:
    """A fit, its errors per iteration, and what it is worth on views that it has not seen."""

    model: str
    train: tuple[str, ...]
    polarizations: tuple[str, ...]
    found: Learned
    curves: dict[str, list[float]]
    between: dict[str, float]
    parameters: dict[str, float]

    @property
    def row(self) -> dict[str, Any]:
        last = {key: values[-1] for key, values in self.curves.items() if values}
        return {
            "model": self.model,
            "train": list(self.train),
            "polarizations": list(self.polarizations),
            "iterations": self.curves["iteration"][-1],
            "errors": last,
            "between": self.between,
            "parameters": self.parameters,
            "curves": self.curves,
        }


class Experiment:
    """The painted building, its reference images with 16 looks, and fits of them from uniform fields."""

    def __init__(
        self,
        out: Path,
        device: str | None,
        *,
        iterations: int,
        rays: float = 1.0,
        polarizations: tuple[str, ...] = ("HH",),
        looks: float = LOOKS,
    ) -> None:
        scene = with_rays(Scene.load(DATA / "fields" / "scene.toml"), rays)
        self.true = Scene.load(DATA / "fields" / "scene.toml")
        radar = scene.radar.model_copy(update={"polarizations": polarizations})
        scene = replace(scene, radar=radar)
        self.device, self.iterations, self.polarizations = device, iterations, polarizations
        self.folder = out / "fields" / "".join(polarizations)
        click.echo(f"fields: references in {'+'.join(polarizations)} ...", err=True)
        self.clean = clean_images(scene)
        observed = measured(scene, self.clean, self.folder / "reference", looks, seed=0)
        shape = self.true.field(TEXTURE, "eps_r").shape
        self.starts = {}
        for model, tau in MODELS.items():
            begun = {}
            for key, value in zip(KEYS, START[model], strict=True):
                path = self.folder / "start" / model / f"{key}.exr"
                write_exr(path, {key: np.full(shape, value, np.float32)})
                begun[key] = str(path.resolve())
            self.starts[model] = changed(observed, TEXTURE, specular_fraction=tau, **begun)
        self.observed = observed
        # by which every RMSE is divided: of all twelve views, so that errors compare between them
        self.largest = max(float(np.nanmax(observed.measured(v, p))) for v in observed.views for p in polarizations)

    def fit(
        self, model: str, train: Sequence[str], *, loss: str = "gamma", variation: dict[str, float] | None = None
    ) -> FieldFit:
        seen = f"{len(train)} views ({', '.join(train)}), {'+'.join(self.polarizations)}"
        click.echo(f"fields: {model} from {seen} ...", err=True)
        rest = [name for name in HEXAGON if name not in train]
        start = self.starts[model]
        options = LearnOptions(
            loss=loss,
            iterations=self.iterations,
            total_variation=TOTAL_VARIATION if variation is None else variation,
        )
        found = learn(trained_on(start, train, rest), device=self.device, options=options)
        curves: dict[str, list[float]] = {"iteration": [row["iteration"] for row in found.history]}
        for role in ("train", "test"):
            for key, scale in (("rmse", 1.0 / self.largest), ("deviance", 1.0), ("rmse_db", 1.0)):
                stated = [row.get(f"{role}_{key}") for row in found.history]
                curves[f"{role}_{key}"] = [] if None in stated else [scale * value for value in stated]
        return FieldFit(
            model,
            tuple(train),
            self.polarizations,
            found,
            curves,
            self.unseen(found, start),
            self.parameter_errors(found),
        )

    def unseen(self, found: Learned, start: Scene) -> dict[str, float]:
        """Errors on the views half-way between; `clean_db` against the reference without speckle."""
        problem = self.problem(found, start, BETWEEN)
        errors = pooled_metrics(problem, found.x)
        squares = [
            (10.0 * np.log10(mu / self.clean[seen.view.name][seen.polarization].ravel()[seen.pixels])) ** 2
            for seen, mu in zip(problem.observations, problem.modelled(found.x), strict=True)
        ]
        return {
            "rmse": errors["rmse"] / self.largest,
            "deviance": errors["deviance"],
            "rmse_db": errors["rmse_db"],
            "clean_db": float(np.sqrt(np.mean(np.concatenate(squares)))),
        }

    def problem(self, found: Learned, start: Scene, names: Sequence[str]) -> FitProblem:
        scene = trained_on(start, names)
        device = found.problem.device
        rays = Rays(Stage.of(scene, device), found.density.rays_per_m2, scene.sampling.seed)
        return FitProblem(scene, device, rays=rays)

    def maps(self, found: Learned) -> np.ndarray:
        """Learned eps_r, h, l, shape (3, rows, cols)."""
        nodes = found.problem.nodes(found.x)
        return np.array([found.problem.surface.values(TEXTURE, key, nodes) for key in KEYS])

    def truth(self) -> np.ndarray:
        return np.array([self.true.field(TEXTURE, key) for key in KEYS], float)

    def views_of_texels(self, found: Learned) -> np.ndarray:
        """In how many of the fit's views a texel is seen, shape (rows, cols)."""
        from warpsar.learning.fields import field_uncertainty

        folder = self.folder / "uncertainty"
        folder.mkdir(parents=True, exist_ok=True)
        for one in field_uncertainty(found.problem, found.x).values():
            one.write(folder)
        return np.asarray(read_channel(folder / f"{TEXTURE}_{KEYS[0]}_sd.exr", "views"))

    def parameter_errors(self, found: Learned) -> dict[str, float]:
        """Median |ln(learned / truth)| of eps_r - 1, h, l and h l over the texels that the fit saw."""
        seen = self.views_of_texels(found) > 0
        learned, true = (logs([m[seen] for m in maps]) for maps in (self.maps(found), self.truth()))
        difference = learned - true
        errors = np.abs(np.vstack([difference, difference[1] + difference[2], difference[1] - difference[2]]))
        names = ("eps_r - 1", "h", "l", "h l", "h / l")
        return {name: float(value) for name, value in zip(names, np.median(errors, axis=1), strict=True)}

    def floor(self, names: Sequence[str]) -> float:
        """RMSE / max that the speckle alone leaves."""
        squares = []
        for view in self.observed.views:
            if view.name in names:
                for p in self.polarizations:
                    clean = self.clean[view.name][p]
                    squares.append(((self.observed.measured(view, p) - clean)[clean > 0]) ** 2)
        return float(np.sqrt(np.mean(np.concatenate(squares)))) / self.largest


def run(out: Path, device: str | None, *, iterations: int, rays: float) -> dict[str, Any]:
    """All fits, and their figures; returns what fields.json holds."""
    hh = Experiment(out, device, iterations=iterations, rays=rays)
    fits = [hh.fit(model, HEXAGON[:count]) for model in MODELS for count in range(1, 7)]
    beside = [hh.fit("KA+SPM", ADJACENT[:2]), hh.fit("KA+SPM", ADJACENT)]
    spread = [hh.fit("KA+SPM", ("az000", "az120", "az240"))]
    both = Experiment(out, device, iterations=iterations, rays=rays, polarizations=("HH", "VV"))
    best = both.fit("KA+SPM", HEXAGON)
    mixed = [fit for fit in fits if fit.model == "KA+SPM"]
    draw_iterations(out / "experiment_fields_iterations.png", mixed)
    draw_views(out / "experiment_fields_views.png", fits, beside + spread, hh.floor(BETWEEN))
    draw_images(out / "experiment_fields_images.png", hh, [fit for fit in fits if len(fit.train) == 3])
    draw_maps(out / "experiment_fields_maps.png", hh, mixed[-1], both, best)
    return {"floor": hh.floor(BETWEEN), "fits": [fit.row for fit in [*fits, *beside, *spread, best]]}


def table(content: dict[str, Any]) -> str:
    """Errors of every fit, from what fields.json holds."""
    rows = []
    for fit in content["fits"]:
        last = fit["errors"]
        rows.append(
            [
                f"{fit['model']}, {'+'.join(fit['polarizations'])}",
                " ".join(name.removeprefix("az") for name in sorted(fit["train"])),
                f"{last['train_rmse']:.4f}",
                f"{last['test_rmse']:.4f}" if "test_rmse" in last else "",
                f"{fit['between']['rmse']:.4f}",
                f"{last['train_deviance']:.3g}",
                f"{last['test_deviance']:.3g}" if "test_deviance" in last else "",
                f"{fit['between']['deviance']:.3g}",
                f"{fit['between']['clean_db']:.2f}",
                *(f"{fit['parameters'][name]:.2f}" for name in ("eps_r - 1", "h", "l", "h l", "h / l")),
            ]
        )
    header = ["model", "azimuths [deg]", "RMSE/max train", "rest", "between", "deviance train", "rest", "between"]
    header += ["between, no speckle [dB]", "eps_r - 1", "h", "l", "h l", "h / l"]
    floor = f"RMSE / max that speckle alone leaves, views between: {content['floor']:.4f}"
    return f"{tables.markdown(header, rows)}\n\n{floor}"


def draw_iterations(path: Path, fits: Sequence[FieldFit]) -> None:
    figure, axes = new(9.0, 4.2, ncols=2)
    for axis, key, label in zip(
        axes, ("rmse", "deviance"), ("RMSE / largest measured value", "deviance / speckle floor"), strict=True
    ):
        for index, fit in enumerate(fits):
            colour = f"C{index}"
            axis.plot(fit.curves["iteration"], fit.curves[f"train_{key}"], colour, label=f"{len(fit.train)}")
            if fit.curves[f"test_{key}"]:
                axis.plot(fit.curves["iteration"], fit.curves[f"test_{key}"], colour, ls="--")
        axis.set(xlabel="iteration", ylabel=label, yscale="log")
        axis.grid(alpha=0.3, which="both", lw=0.4)
    axes[1].axhline(1.0, color="0.6", lw=0.8)
    axes[0].legend(
        fontsize=8, frameon=False, title="views (solid: train, dashed: rest of the six)", ncols=2, title_fontsize=8
    )
    save(figure, path)


def draw_views(path: Path, fits: Sequence[FieldFit], others: Sequence[FieldFit], floor: float) -> None:
    """Errors on the views between, which no fit saw, against how many views were learned from."""
    figure, axes = new(9.0, 4.2, ncols=2)
    for axis, key in zip(axes, ("rmse", "clean_db"), strict=True):
        for index, model in enumerate(MODELS):
            mine = [fit for fit in fits if fit.model == model]
            count = [len(fit.train) for fit in mine]
            axis.plot(count, [fit.between[key] for fit in mine], f"C{index}o-", ms=4, label=f"{model}, unseen")
            if key == "rmse":
                train = [fit.curves["train_rmse"][-1] for fit in mine]
                axis.plot(count, train, f"C{index}.:", label=f"{model}, train")
        for fit in others:
            name = "adjacent" if fit.train in (ADJACENT[:2], ADJACENT) else "120 deg apart"
            label = f"KA+SPM, unseen; {name}" if len(fit.train) == 3 else None
            axis.plot(len(fit.train), fit.between[key], "kx" if name == "adjacent" else "k+", ms=8, label=label)
        axis.set(xlabel="views learned from", yscale="log")
        axis.grid(alpha=0.3, which="both", lw=0.4)
    axes[0].axhline(floor, color="0.6", lw=0.8)
    axes[0].set_ylabel("RMSE / largest measured value (grey: speckle alone)")
    axes[1].set_ylabel("rms error against images without speckle [dB]")
    axes[1].legend(*axes[0].get_legend_handles_labels(), fontsize=7, frameon=False, ncols=2, loc="upper right")
    axes[1].set_ylim(top=100.0)
    save(figure, path)


def draw_images(path: Path, experiment: Experiment, fits: Sequence[FieldFit]) -> None:
    """A view that no fit saw: measured, and what each model makes of it."""
    name = "az030"
    view = next(v for v in experiment.observed.views if v.name == name)
    images = {"reference, 16 looks": experiment.observed.measured(view, "HH")}
    for fit in fits:
        problem = experiment.problem(fit.found, experiment.starts[fit.model], [name])
        problem.modelled(fit.found.x)
        image = problem.views[0].render.images["HH"].numpy().reshape(experiment.observed.grid.shape)
        images[f"{fit.model}, from {len(fit.train)} others"] = image
    high = 10.0 * np.log10(np.percentile(images["reference, 16 looks"], 99.8))
    figure, axes = new(11.0, 2.9, ncols=len(images))
    rows, cols = experiment.observed.grid.shape
    dr, du = experiment.observed.grid.spacing_m
    extent = (-cols * du / 2, cols * du / 2, rows * dr / 2, -rows * dr / 2)
    for axis, (title, image) in zip(axes, images.items(), strict=True):
        decibel = 10.0 * np.log10(np.maximum(image, 1e-12))
        shown = axis.imshow(decibel, cmap="gray", vmin=high - 40.0, vmax=high, extent=extent)
        axis.set_title(title, fontsize=9)
        axis.set_xlabel("azimuth [m]")
    axes[0].set_ylabel("slant range [m]")
    figure.colorbar(shown, ax=list(axes), label="beta0, HH [dB]", shrink=0.8)
    save(figure, path)


def draw_maps(path: Path, hh: Experiment, first: FieldFit, both: Experiment, second: FieldFit) -> None:
    """Truth, and what six views of HH and of HH+VV make of it; texels that no view sees are left grey."""
    columns = {"truth": hh.truth(), "learned, 6 views, HH": hh.maps(first.found)}
    columns["learned, 6 views, HH+VV"] = both.maps(second.found)
    seen = hh.views_of_texels(first.found) > 0
    figure, axes = new(8.5, 7.6, nrows=3, ncols=3)
    names = (r"$\varepsilon_r - 1$", "h [mm]", "l [mm]")
    for row, (kind, name) in enumerate(zip(KINDS[:3], names, strict=True)):
        scale, shift = (1.0, 1.0) if kind.key == "eps_r" else (1e3, 0.0)
        true = np.log10((columns["truth"][row] - shift) * scale)
        low, high = true.min() - 0.15, true.max() + 0.15
        for axis, (title, maps) in zip(axes[row], columns.items(), strict=True):
            values = np.where(seen, np.log10((maps[row] - shift) * scale), np.nan)
            shown = axis.imshow(values, vmin=low, vmax=high, cmap="viridis", interpolation="nearest")
            axis.set_facecolor("0.8")
            axis.set_xticks([])
            axis.set_yticks([])
            if row == 0:
                axis.set_title(title, fontsize=9)
        bar = figure.colorbar(shown, ax=list(axes[row]), label=name)
        ticks = np.linspace(low, high, 5)
        bar.set_ticks(ticks.tolist(), labels=[f"{10**t:.2g}" for t in ticks])
    save(figure, path)
