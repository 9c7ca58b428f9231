"""One scene of a batch: which of its images are there, and how the others are made."""

from __future__ import annotations

import hashlib
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import warp as wp

from warpsar.effects.registry import get
from warpsar.errors import InputError
from warpsar.io.images import write_exr
from warpsar.runtime import console
from warpsar.scene.scene import Scene
from warpsar.simulation.checks import grid_warnings
from warpsar.simulation.command import Simulation
from warpsar.simulation.index import Index, Row
from warpsar.simulation.outputs import refuse_unlikely_size
from warpsar.simulation.view import SimulatedView
from warpsar.surface.stage import Stage
from warpsar.version import __version__
from warpsar.world.tables import View
from warpsar.world.world import refuse_without_views

PER_FOLDER = 1000
OUTCOMES = ("made", "kept", "other_inputs", "damaged")
"""What may become of an image; the last two are made again."""


@dataclass(frozen=True)
class ImageOptions:
    """How images are made: the options of `Simulation`."""

    seed: int | None
    layers: bool
    variance: bool
    merge: bool
    max_memory_gib: float

    def __str__(self) -> str:
        """What the images depend on; the memory changes none of them."""
        return str(sorted((name, value) for name, value in asdict(self).items() if name != "max_memory_gib"))


class Maker:
    """One scene of a batch. `label` is its folder; `made` are the views to make in place of the scene's own. `yes`
    takes a mesh whose size is unlikely.

    Raises InputError for a scene that cannot be read, and for effects whose values belong to views that are not made.
    """

    def __init__(
        self,
        path: Path,
        label: str,
        made: list[View] | None,
        device: wp.Device,
        options: ImageOptions,
        index: Index,
        yes: bool = False,
    ) -> None:
        self.path, self.label, self.device, self.options, self.index = path, label, device, options, index
        self.scene = Scene.load(path)
        refuse_without_views(self.scene)
        refuse_unlikely_size(self.scene, yes)
        console.warn(self.scene.warnings)
        self._warned = False
        self.fresh = made is not None
        self.views = self.scene.views if made is None else made
        if self.fresh:
            self._refuse_values_per_view()
        self._inputs = f"{__version__} {self.scene.input_hash} {label} {options}"

    def _refuse_values_per_view(self) -> None:
        for name, table in self.scene.effects.items():
            per_view = [each.name for each in get(name).parameters if each.per_view]
            per_view += [each.name for each in get(name).settings if each.per_view]
            for key in per_view:
                if isinstance(table.get(key), dict):
                    raise InputError(
                        f"{self.path}: effects.{name}.{key}: found values of single views, and --azimuths makes "
                        f"views of its own; allowed is an effect without"
                    )

    @cached_property
    def stage(self) -> Stage:
        """The mesh on the device: uploaded when the first image is missing."""
        return Stage.of(self.scene, self.device)

    def image(self, number: int) -> tuple[str, Callable[[], None] | None]:
        """Make image `number` unless it is there.

        Returns one of `OUTCOMES`, and what writes the file and its row; None where there is nothing to write.
        """
        view = self.views[number]
        name = f"{self.label}/{view.name}"
        inputs = hashlib.sha256(f"{self._inputs} {view!r} {self._seed(number)}".encode()).hexdigest()
        row, outcome = self.index.rows.get(name), "made"
        if row is not None:
            if row["inputs"] != inputs:
                outcome = "other_inputs"
            elif sha256(self.index.out / row["file"]) != row["sha256"]:
                outcome = "damaged"
            else:
                return "kept", None
        file = f"{self.label}/{number // PER_FOLDER:03d}/{view.name}.exr" if row is None else row["file"]
        new = {
            "name": name,
            "scene": str(self.path),
            "azimuth_deg": repr(view.azimuth_deg),
            "incidence_deg": repr(view.incidence_deg),
            "frequency_hz": repr(view.frequency_hz or self.scene.radar.frequency_hz),
            "file": file,
            "inputs": inputs,
        }
        return outcome, partial(self._write, self._make(view, number), new)

    def _seed(self, number: int) -> int:
        """The number that the view's jitter is drawn for.

        A view at given angles takes it from its name, so that it stays the same in a longer list of angles.
        """
        return zlib.crc32(self.views[number].name.encode()) if self.fresh else number

    def _make(self, view: View, number: int) -> SimulatedView:
        scene = replace(self.scene, views=[view]) if self.fresh else self.scene
        simulation = Simulation(scene, self.stage, tells=not self._warned, **asdict(self.options))
        made = simulation.view(view, self._seed(number))
        if not self._warned:  # of the first image of a scene: the others would say the same
            self._warned = True
            found = grid_warnings(scene, self.stage, [view]) + simulation.findings.warnings(scene)
            console.warn(f"{self.path}: {warning}" for warning in found)
        return made

    def _write(self, image: SimulatedView, row: Row) -> None:
        path = self.index.out / row["file"]
        write_exr(path, image.beta0 | image.channels(), image.metadata)
        self.index.add({**row, "sha256": sha256(path) or ""})


def sha256(path: Path) -> str | None:
    """SHA-256 of a file's bytes, in hexadecimal; None where there is no file."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except FileNotFoundError:
        return None
