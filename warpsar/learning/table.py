"""A material's table of sigma0, learned through the renderer from the measured images.

The table as given is the mean of a Gaussian prior. What the images add to it [dB] is expected to be smooth over
incidence, so that a row which no image has seen follows its neighbours a little way, and stays as given beyond.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.errors import InputError
from warpsar.io.figures import new
from warpsar.learning.device_values import DeviceBlock
from warpsar.learning.term import SEEN, folder_of
from warpsar.runtime import once
from warpsar.scene.beside import file_stem
from warpsar.scene.scene import Scene
from warpsar.world import sigma0_table
from warpsar.world.models import TABLE
from warpsar.world.sigma0_table import LARGEST_DB, ROW_DB, SPREAD_DB, WIDTH_DEG, Sigma0Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DECIMALS = 4  # of a value [dB] in the file


@dataclass(frozen=True)
class LearnedTable:
    """A table and its `file`, beside the one that was `given`; `sd_db`, by learned channel, each (rows,).

    `seen_deg`: the incidences between which images saw the material. `before` and `after`: pooled metrics of the
    `train` views by the fit's own rays, with all tables as given and as learned, and the fit's iterations, `steps`.
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


@dataclass(frozen=True)
class TableToLearn:
    """A table as `given`, and the `file` that the learned one is written to; `channels` are learned."""

    given: Sigma0Table
    file: Path
    channels: Sequence[str]

    def block(self, scene: Scene, material: str) -> DeviceBlock:
        """The values of a scene's material, as a part of x."""
        values = [scene.parameters[f"materials.{material}.{TABLE}[{channel}]"] for channel in self.channels]
        return DeviceBlock.of(values, [self.given.filled(channel) for channel in self.channels])

    def learned(self, where: str, values: np.ndarray, sd: np.ndarray, cosines: np.ndarray, **fit: Any) -> LearnedTable:
        """The table with `values` +- `sd`, (channels, rows), where hits of `cosines` see it; `fit` as `LearnedTable`.

        Raises InputError for values beyond what a table may have; the message begins with `where`.
        """
        values = np.round(values, DECIMALS)
        if not (np.abs(values) <= LARGEST_DB).all():
            raise InputError(
                f"{where}: {TABLE}: the images say {values.flat[np.abs(values).argmax()]:.0f} dB; must be within "
                f"-{LARGEST_DB:g} and {LARGEST_DB:g} dB"
            )
        found = self.given.sigma0_db | dict(zip(self.channels, values, strict=True))
        low, high = np.percentile(np.degrees(np.arccos(np.clip(cosines, 0.0, 1.0))), SEEN)
        known = dict(zip(self.channels, sd, strict=True))
        table = replace(self.given, sigma0_db=found)
        return LearnedTable(self.file, self.given, table, known, (float(low), float(high)), **fit)


def tables_to_learn(scene: Scene, folder: Path | None, loss: str) -> dict[str, TableToLearn]:
    """The tables of the materials that ask for one to be learned, by material.

    Raises InputError without a folder, with a `loss` that is no likelihood, and where a table itself lies in its place.
    """
    found = {}
    channels = [c for c in sigma0_table.CHANNELS if c in {"HV" if p == "VH" else p for p in scene.radar.polarizations}]
    for name, material in scene.materials.items():
        if TABLE not in material.learn or material.sigma0 is None:
            continue
        stem = file_stem(tuple(scene.materials), name, TABLE)
        file = (folder_of(scene, name, TABLE, folder) / f"{stem}.csv").resolve()
        if file == material.sigma0.resolve():
            raise InputError(f"--out: found {file.parent}, where {stem}.csv itself would be replaced")
        found[name] = TableToLearn(sigma0_table.read(Path(material.sigma0)), file, channels)
    if found and loss == "mse":
        raise InputError(
            f'--loss: found mse and learn = ["{TABLE}"]; allowed are gamma and log, because mse is no log-likelihood '
            f"that the table as given could be weighed with"
        )
    return found


def with_tables(scene: Scene, learned: Mapping[str, LearnedTable]) -> Scene:
    """The scene with tables that were learned, which are written, and which all processes then read."""
    for name, one in learned.items():
        once.find(partial(one.found.write, one.file))
        material = scene.materials[name].model_copy(update={TABLE: one.file})
        scene = replace(scene, materials=scene.materials | {name: material})
    return scene


COLOURS = {"HH": "C0", "VV": "C1", "HV": "C2"}
SURE = 1.96  # standard deviations of a 95 % interval


def figure_of_table(name: str, content: Mapping[str, Any]) -> Figure:
    """Each learned channel as given (dashed) and as learned, with 95 % intervals; grey is the incidence seen.

    `content` is what learn.json says of the table (`LearnedTable.content`).
    """
    figure, axis = new(7.0, 4.4)
    incidence = np.asarray(content["incidence_deg"])
    for channel, sd in content["sd_db"].items():
        colour, learned, half = COLOURS[channel], np.asarray(content["learned_db"][channel]), SURE * np.asarray(sd)
        axis.fill_between(incidence, learned - half, learned + half, color=colour, alpha=0.18, lw=0)
        axis.plot(incidence, content["given_db"][channel], "--", color=colour, lw=1.2, label=f"{channel} as given")
        axis.plot(incidence, learned, ".-", color=colour, label=f"{channel} learned, 95 %")
    axis.axvspan(*content["incidence_seen_deg"], color="0.9", lw=0, zorder=0, label="seen by the train views")
    axis.set(xlabel="local incidence [deg]", ylabel="sigma0 [dB]", xlim=(incidence[0], incidence[-1]), title=name)
    axis.grid(alpha=0.3, lw=0.4)
    figure.legend(loc="outside lower center", frameon=False, fontsize=8, ncols=len(content["sd_db"]) + 1)
    return figure
