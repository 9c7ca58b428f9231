"""A material's table of sigma0, learned through the renderer from the measured images.

The table as given is the mean of a Gaussian prior. What the images add to it [dB] is expected to be smooth over
incidence, so that a row which no image has seen follows its neighbours a little way, and stays as given beyond.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from scipy.linalg import block_diag

from warpsar.errors import InputError
from warpsar.io.figures import new
from warpsar.learning.device_values import SEEN, DeviceBlock, most_likely, put, refuse_run, seen_cosines
from warpsar.learning.identify import information_of
from warpsar.learning.metrics import pooled_metrics
from warpsar.learning.problem import FitProblem
from warpsar.learning.term import Prepared
from warpsar.scene.beside import file_stem
from warpsar.scene.scene import Scene
from warpsar.world import sigma0_table
from warpsar.world.models import TABLE
from warpsar.world.sigma0_table import LARGEST_DB, Sigma0Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SPREAD_DB = 3.0  # expected of a value about the table as given
WIDTH_DEG = 10.0  # over which the differences from it are alike
ROW_DB = 0.25  # by which a row differs from what is smooth
STEP_DB = 0.1  # up and down, of differences of images: they are right to 1e-4
DECIMALS = 4  # of a value [dB] in the file


@dataclass(frozen=True)
class LearnedTable:
    """A table and its `file`, beside the one that was `given`; `sd_db`, by learned channel, each (rows,).

    `seen_deg`: the incidences between which images saw the material. `before` and `after`: pooled metrics of the
    `train` views by the fit's own rays, with all tables as given and as learned, and the `steps` that it took.
    """

    file: Path
    given: Sigma0Table
    found: Sigma0Table
    sd_db: dict[str, np.ndarray]
    seen_deg: tuple[float, float]
    before: dict[str, float]
    after: dict[str, float]
    steps: int

    @property
    def words(self) -> str:
        """What is known, in short."""
        low, high = self.seen_deg
        best = ", ".join(f"{channel} to {sd.min():.2g} dB" for channel, sd in self.sd_db.items())
        return f"sigma0 seen from {low:.1f} to {high:.1f} degrees, known at best: {best}"

    def content(self) -> dict[str, Any]:
        """What learn.json says of it."""
        return {
            "file": self.file.name,
            "prior": {"spread_db": SPREAD_DB, "width_deg": WIDTH_DEG, "row_db": ROW_DB},
            "incidence_seen_deg": list(self.seen_deg),
            "incidence_deg": self.given.incidence_deg,
            "given_db": {channel: self.given.sigma0_db[channel] for channel in self.sd_db},
            "learned_db": {channel: self.found.sigma0_db[channel] for channel in self.sd_db},
            "sd_db": self.sd_db,
            "before": self.before,
            "after": self.after,
            "steps": self.steps,
        }


def with_learned_tables(
    scene: Scene, folder: Path | None, prepared: Prepared, loss: str
) -> tuple[Scene, dict[str, LearnedTable]]:
    """The scene with the learned tables of the materials that ask for it, and what was found; all tables at once.

    Numbers of other materials and of effects move along, and fields are held as they are declared. Files go into
    `folder`, after the fit. Raises InputError without a folder, with several processes, with a `loss` that is no
    likelihood, where a table itself lies in its place, where no view sees a material, and for images that no table
    explains.
    """
    files = {}
    for name, material in scene.materials.items():
        if TABLE not in material.learn or material.sigma0 is None:
            continue
        stem = file_stem(tuple(scene.materials), name, TABLE)
        files[name] = (refuse_run(scene, name, TABLE, folder) / f"{stem}.csv").resolve()
        if files[name] == material.sigma0.resolve():
            raise InputError(f"--out: found {files[name].parent}, where {stem}.csv itself would be replaced")
    if not files:
        return scene, {}
    if loss == "mse":
        raise InputError(
            f'--loss: found mse and learn = ["{TABLE}"]; allowed are gamma and log, because mse is no log-likelihood '
            f"that the table as given could be weighed with"
        )
    found = _learned(prepared(scene), files)
    for name, one in found.items():
        one.found.write(one.file)
        material = scene.materials[name].model_copy(update={TABLE: one.file})
        scene = replace(scene, materials=scene.materials | {name: material})
    return scene, found


def _learned(problem: FitProblem, files: dict[str, Path]) -> dict[str, LearnedTable]:
    tables = problem.stage.tables
    assert tables is not None
    angles = {n: np.degrees(np.arccos(np.clip(seen_cosines(problem, n, TABLE), 0.0, 1.0))) for n in files}
    given = {name: sigma0_table.read(Path(str(problem.scene.materials[name].sigma0))) for name in files}
    polarizations = problem.scene.radar.polarizations
    channels = [c for c in sigma0_table.CHANNELS if c in polarizations or (c == "HV" and "VH" in polarizations)]
    blocks = [
        _block(one, channels, tables.rows.numpy()[problem.surface.materials.index(n)]) for n, one in given.items()
    ]
    before = pooled_metrics(problem, problem.x0)
    values, x, steps = most_likely(problem, tables.sigma0_db, blocks)
    values = [np.round(one, DECIMALS) for one in values]
    for name, its in zip(files, values, strict=True):
        if not (np.abs(its) <= LARGEST_DB).all():
            raise InputError(
                f"{problem.scene.name}: materials.{name}.learn: {TABLE}: the images say "
                f"{its.flat[np.abs(its).argmax()]:.0f} dB; must be within -{LARGEST_DB:g} and {LARGEST_DB:g} dB"
            )
    put(tables.sigma0_db, blocks, values)
    after = pooled_metrics(problem, x)
    seen = [_seen_rows(one.incidence_deg, angles[name]) for name, one in given.items()]
    deviations = _deviations(problem, tables.sigma0_db, blocks, values, seen)
    found = {}
    for (name, one), its, sd in zip(given.items(), values, deviations, strict=True):
        learned = replace(one, sigma0_db=one.sigma0_db | dict(zip(channels, its, strict=True)))
        low, high = np.percentile(angles[name], SEEN)
        known = dict(zip(channels, sd, strict=True))
        found[name] = LearnedTable(files[name], one, learned, known, (float(low), float(high)), before, after, steps)
    return found


def _block(given: Sigma0Table, channels: Sequence[str], rows: np.ndarray) -> DeviceBlock:
    """The values of a table, which has the (first, count) `rows` on the device, with what is expected of them.

    The covariance is SPREAD^2 exp(-(difference of incidence / WIDTH)^2 / 2), and ROW^2 of each row alone.
    """
    apart = (given.incidence_deg[:, None] - given.incidence_deg) / WIDTH_DEG
    covariance = SPREAD_DB**2 * np.exp(-0.5 * apart**2) + ROW_DB**2 * np.eye(len(apart))
    columns = [given.filled(channel) for channel in channels]
    start = np.stack([given.sigma0_db[channel] for channel in channels])
    return DeviceBlock(slice(int(rows[0]), int(rows.sum())), columns, start, np.linalg.cholesky(covariance))


def _seen_rows(incidence_deg: np.ndarray, seen_deg: np.ndarray) -> np.ndarray:
    """Whether a hit lies between a row and its neighbour, (rows,)."""
    below = np.clip(np.searchsorted(incidence_deg, seen_deg, side="right") - 1, 0, incidence_deg.size - 2)
    seen = np.zeros(incidence_deg.size, bool)
    seen[below] = seen[below + 1] = True
    return seen


def _deviations(
    problem: FitProblem,
    array: wp.array,
    blocks: Sequence[DeviceBlock],
    values: list[np.ndarray],
    seen: list[np.ndarray],
) -> list[np.ndarray]:
    """Standard deviations [dB] of each block's values, (channels, rows), which stand in the array.

    The covariance is that of `identify`, F^-1 S F^-1, where the prior counts as one more measurement in both.
    """
    moved = np.flatnonzero(np.concatenate([np.tile(rows, len(one)) for rows, one in zip(seen, values, strict=True)]))
    unit = block_diag(*(block.unit for block in blocks for _ in block.columns))
    modelled = problem.modelled_as_declared()
    slopes = _slopes(problem, array, blocks, values, moved)
    if not problem.scene.grid.calibrated:
        weights = [c.weight for c in problem.curvatures(modelled)]
        slopes = (j - np.average(j, axis=0, weights=w) for j, w in zip(slopes, weights, strict=True))
    parts = information_of(problem, modelled, slopes, moved.size)
    information, products = (unit[moved].T @ part @ unit[moved] + np.eye(len(unit)) for part in parts)
    inverse = np.linalg.inv(information)
    sd = np.sqrt(np.diag(unit @ inverse @ products @ inverse @ unit.T))
    ends = np.cumsum([one.size for one in values])
    return [part.reshape(one.shape) for part, one in zip(np.split(sd, ends[:-1]), values, strict=True)]


def _slopes(
    problem: FitProblem, array: wp.array, blocks: Sequence[DeviceBlock], values: list[np.ndarray], moved: np.ndarray
) -> Iterator[np.ndarray]:
    """d ln(beta0) / d value [1 / dB] of each observation, (pixels, moved): central differences of the images."""
    flat, ends = np.concatenate([one.ravel() for one in values]), np.cumsum([one.size for one in values])
    for view in problem.views:
        columns = []
        for place in moved:
            images = []
            for step in (STEP_DB, -STEP_DB):
                at = flat.copy()
                at[place] += step
                parts = np.split(at, ends[:-1])
                put(array, blocks, [part.reshape(one.shape) for part, one in zip(parts, values, strict=True)])
                view.run_images()
                images.append(view.modelled())
            columns.append([np.log(up / down) / (2.0 * STEP_DB) for up, down in zip(*images, strict=True)])
        yield from (np.stack(each, axis=1) for each in zip(*columns, strict=True))


COLOURS = {"HH": "C0", "VV": "C1", "HV": "C2"}
SURE = 1.96  # standard deviations of a 95 % interval


def figure_of_table(name: str, told: Mapping[str, Any]) -> Figure:
    """Each learned channel as given (dashed) and as learned, with 95 % intervals; grey is the incidence seen.

    `told` is what learn.json says of the table (`LearnedTable.content`).
    """
    figure, axis = new(7.0, 4.4)
    incidence = np.asarray(told["incidence_deg"])
    for channel, sd in told["sd_db"].items():
        colour, learned, half = COLOURS[channel], np.asarray(told["learned_db"][channel]), SURE * np.asarray(sd)
        axis.fill_between(incidence, learned - half, learned + half, color=colour, alpha=0.18, lw=0)
        axis.plot(incidence, told["given_db"][channel], "--", color=colour, lw=1.2, label=f"{channel} as given")
        axis.plot(incidence, learned, ".-", color=colour, label=f"{channel} learned, 95 %")
    axis.axvspan(*told["incidence_seen_deg"], color="0.9", lw=0, zorder=0, label="seen by the train views")
    axis.set(xlabel="local incidence [deg]", ylabel="sigma0 [dB]", xlim=(incidence[0], incidence[-1]), title=name)
    axis.grid(alpha=0.3, lw=0.4)
    figure.legend(loc="outside lower center", frameon=False, fontsize=8, ncols=len(told["sd_db"]) + 1)
    return figure
