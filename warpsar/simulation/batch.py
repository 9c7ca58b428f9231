"""Many images in one command: many scenes, views made on the fly, folders of a thousand, an index, nothing made twice.

An image is there when its file is whole and its line is in the index. Each process adds lines to a part of the index of
its own right after the file; parts are merged when a run begins and when it ends, so that a run that was killed at any
moment is taken up where it stood. A file is packed and written while the next image is made.
"""

from __future__ import annotations

import csv
import hashlib
import math
import os
import re
import time
import tomllib
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal, InvalidOperation
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any, TextIO

from warpsar.effects.registry import get
from warpsar.errors import InputError, WarpsarError
from warpsar.io.images import replacing, write_exr
from warpsar.runtime import console, devices, distributed
from warpsar.runtime.background import Background
from warpsar.runtime.distributed import Ranks
from warpsar.scene.scene import Scene
from warpsar.simulation.checks import grid_warnings
from warpsar.simulation.command import Simulation
from warpsar.simulation.outputs import make_folder, write_json
from warpsar.simulation.view import SimulatedView
from warpsar.surface.stage import Stage
from warpsar.trace.hits import DEFAULT_MEMORY_GIB
from warpsar.version import __version__
from warpsar.world.tables import View

PER_FOLDER = 1000
BLOCKS_PER_RANK = 8  # of views of one scene: few enough to load a scene seldom, many enough to end together
FINE = 128  # the same where every rank loads every scene anyway
AHEAD = 2  # images whose files wait to be written
TOLD_EVERY = 8  # images, to the bar that counts those of all processes
MOST_VIEWS = 10_000_000
INDEX, PARTS = "index.csv", "index.parts"
OUTCOMES = ("made", "kept", "other_inputs", "damaged")
FIELDS = ("name", "scene", "azimuth_deg", "incidence_deg", "frequency_hz", "file", "sha256", "inputs")
_TEMPORARY = re.compile(r"\.[0-9a-f]{32}\.\w+")  # what `images.replacing` leaves when it is killed

Row = dict[str, str]


def angles(text: str, option: str, low: float, high: float) -> list[Decimal]:
    """The angles [deg] of "start:stop:step", the stop left out as in Python's `range`, or of "a,b,c".

    Raises InputError for anything else, and for angles outside (low, high).
    """
    allowed = f"allowed is START:STOP:STEP or A,B,C of angles between {low:g} and {high:g}"
    try:
        parts = [Decimal(part) for part in re.split("[:,]", text)]
        if ":" in text:
            start, stop, step = parts
            count = math.ceil((stop - start) / step) if step > 0 else 0
            if not 0 < count <= MOST_VIEWS:
                raise InputError(f"{option}: found {text!r}; {allowed}, STEP above 0 and STOP above START")
            parts = [start + i * step for i in range(count)]
        outside = [angle for angle in parts if not low < angle < high]
    except (InvalidOperation, ValueError, OverflowError):
        raise InputError(f"{option}: found {text!r}; {allowed}") from None
    if outside:
        raise InputError(f"{option}: found {outside[0]}; {allowed}")
    if len(set(parts)) < len(parts):
        raise InputError(f"{option}: found {text!r}, with an angle twice; allowed is each once")
    return parts


def views_at(azimuths: Sequence[Decimal], incidences: Sequence[Decimal]) -> list[View]:
    """A view at every pair of angles [deg], named after them: az000_inc30, or with as many decimals as they have."""

    def name(values: Sequence[Decimal]) -> Callable[[Decimal], str]:
        decimals = max(0, *(-int(v.normalize().as_tuple().exponent) for v in values))
        width = max(len(f"{v:.{decimals}f}") for v in values)
        return lambda value: f"{value:0{width}.{decimals}f}"

    azimuth, incidence = name(azimuths), name(incidences)
    return [
        View(name=f"az{azimuth(a)}_inc{incidence(i)}", azimuth_deg=float(a), incidence_deg=float(i))
        for a, i in product(azimuths, incidences)
    ]


def labels(paths: Sequence[Path]) -> list[str]:
    """A folder name for each scene file: its stem, or its folder's name, or both, whatever tells them apart."""
    namings: tuple[Callable[[Path], str], ...] = (
        lambda path: path.stem,
        lambda path: path.resolve().parent.name,
        lambda path: f"{path.resolve().parent.name}_{path.stem}",
    )
    for naming in namings:
        found = [re.sub(r"[^\w.+-]", "_", naming(path)) or "scene" for path in paths]
        if len({each.casefold() for each in found}) == len(found):
            return found
    raise InputError(
        "SCENES: found two that have the same name in folders of the same name; allowed are scene files whose folders "
        "or names differ"
    )


@dataclass(frozen=True)
class Block:
    """Views of one scene that one process makes: every `of`-th, from number `part` on."""

    scene: int
    part: int
    of: int


def blocks(views: Sequence[int], ranks: int) -> list[Block]:
    """What is dealt out, one after the other, to whoever is free; `views`: how many each scene has.

    Scenes stay whole where there are enough of them for all, since each costs its loading.
    """
    whole = len(views) >= BLOCKS_PER_RANK * ranks or ranks == 1
    per_rank = FINE if len(views) == 1 else BLOCKS_PER_RANK
    size = max(1, -(-sum(views) // (per_rank * ranks)))
    found = []
    for scene, count in enumerate(views):
        parts = 1 if whole else max(1, -(-count // size))
        found += [Block(scene, part, parts) for part in range(parts)]
    return found


class Index:
    """The rows of `index.csv` in a batch's folder, by image name, and this process's own part."""

    def __init__(self, out: Path, ranks: Ranks) -> None:
        self.out, self.ranks = out, ranks
        if ranks.first:
            self._tidy()
        ranks.barrier()
        self.rows = {row["name"]: row for row in self._read(out / INDEX)}
        self._stream: TextIO | None = None
        self._part = out / PARTS / f"{ranks.rank}.csv"

    def add(self, row: Row) -> None:
        """Add a row, on disk before this returns to its caller."""
        if self._stream is None:
            self._part.parent.mkdir(exist_ok=True)
            self._stream = self._part.open("a", newline="", encoding="utf-8")
        try:
            csv.DictWriter(self._stream, FIELDS).writerow(row)
            self._stream.flush()
        except OSError as error:
            error.filename = str(self._part)
            raise

    def close(self) -> None:
        """Merge what every rank added; called by all of them."""
        if self._stream is not None:
            self._stream.close()
        self.ranks.barrier()
        if self.ranks.first:
            self._merge()

    def _tidy(self) -> None:
        """What a killed run left: its rows, and files that it had not finished."""
        for folder, _, files in os.walk(self.out):
            for name in files:
                if _TEMPORARY.fullmatch(name):
                    (Path(folder) / name).unlink()
        self._merge()

    def _merge(self) -> None:
        parts = sorted((self.out / PARTS).glob("*.csv"))
        if not parts and (self.out / INDEX).exists():
            return
        rows = {row["name"]: row for path in [self.out / INDEX, *parts] for row in self._read(path)}
        with replacing(self.out / INDEX) as temporary, temporary.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, FIELDS)
            writer.writeheader()
            writer.writerows(sorted(rows.values(), key=lambda row: row["file"]))
        for path in parts:
            path.unlink()
        if (self.out / PARTS).is_dir():
            (self.out / PARTS).rmdir()

    @staticmethod
    def _read(path: Path) -> Iterator[Row]:
        """Whole rows; the last line of a killed process may be half a one."""
        if not path.exists():
            return
        with path.open(newline="", encoding="utf-8") as stream:
            lines = (line for line in stream if line.endswith("\n"))
            for fields in csv.reader(lines):
                if len(fields) == len(FIELDS) and tuple(fields) != FIELDS:
                    yield dict(zip(FIELDS, fields, strict=True))


def run(
    scenes: Sequence[Path],
    out: Path | str,
    *,
    azimuths: str | None = None,
    incidences: str | None = None,
    device: str | None = None,
    seed: int | None = None,
    layers: bool = False,
    variance: bool = False,
    per_ray: bool = False,
    max_memory_gib: float | None = None,
) -> dict[str, Any]:
    """`warpsar simulate` of several scenes, or at angles: images, index.csv and simulate.json in `out`.

    An image's file is `<scene>/<number // 1000>/<view>.exr`, with what `layers` and `variance` ask for in further
    channels. Images that are there, whole and of the same inputs are left as they are. Raises InputError, after all
    others are made, for scenes that cannot be read.
    """
    started = time.perf_counter()
    if (azimuths is None) != (incidences is None):
        raise InputError("--azimuths, --incidences: found one of them; allowed are both, or neither")
    made = None
    if azimuths is not None and incidences is not None:
        made = views_at(
            angles(azimuths, "--azimuths", -360.0, 360.0 + 1e-9), angles(incidences, "--incidences", 0.0, 90.0)
        )
    names = labels(scenes)
    out = Path(out)
    where = devices.resolve_device(device)
    ranks = distributed.ranks(where)
    make_folder(out)
    console.say_device(where)
    index = Index(out, ranks)
    options: dict[str, Any] = {"seed": seed, "layers": layers, "variance": variance, "merge": not per_ray}
    options["max_memory_gib"] = max_memory_gib or DEFAULT_MEMORY_GIB
    counts = [len(made) if made is not None else _views_in(path) for path in scenes]
    dealt = blocks(counts, ranks.size)
    bar = console.progress(sum(counts), "images", "image")
    done: Counter[str] = Counter()
    failures: dict[str, str] = {}
    maker: _Maker | None = None
    taken, finished = ranks.counter(), ranks.counter()

    def finish(what: str, outcome: str, write: Callable[[], None]) -> None:
        try:
            write()
        except WarpsarError as error:
            failures[what] = str(error)
        else:
            done[outcome] += 1

    with Background(AHEAD) as beside:
        while (number := taken(1)) < len(dealt):
            block = dealt[number]
            path = scenes[block.scene]
            if str(path) in failures:
                continue
            try:
                if maker is None or maker.path != path:
                    maker = _Maker(path, names[block.scene], made, where, options, index)
            except WarpsarError as error:
                failures[str(path)] = str(error)
                continue
            numbers = range(block.part, len(maker.views), block.of)
            for start in range(0, len(numbers), TOLD_EVERY):
                some = numbers[start : start + TOLD_EVERY]
                for view in some:
                    what = f"{path}, view {maker.views[view].name}"
                    try:
                        outcome, write = maker.image(view)
                    except WarpsarError as error:
                        failures[what] = str(error)
                        continue
                    if write is None:
                        done[outcome] += 1
                    else:
                        beside.put(partial(finish, what, outcome, write))
                bar.update(finished(len(some)) + len(some) - bar.n)
    bar.close()
    index.close()
    everything = ranks.gather([done, failures])
    done = sum((Counter(counted) for counted, _ in everything), Counter())
    failures = {name: text for _, failed in everything for name, text in failed.items()}
    content = {
        "images": sum(done.values()),
        **{outcome: done[outcome] for outcome in OUTCOMES},
        "failed": failures,
        "scenes": [str(path) for path in scenes],
        "azimuths": azimuths,
        "incidences": incidences,
        "processes": ranks.size,
    }
    if ranks.first:
        content = write_json(out / "simulate.json", None, where, seed, started, content)
    again = done["other_inputs"] + done["damaged"]
    console.say(
        f"{sum(done.values())} images: {done['made']} made, {done['kept']} were there"
        + (f", {again} made again ({done['other_inputs']} of other inputs, {done['damaged']} damaged)" if again else "")
    )
    if failures:
        many = "\n  ".join(failures.values())
        refusal = InputError(f"{len(failures)} failed; everything else is made, and {out / INDEX} lists it:\n  {many}")
        refusal.quiet = not ranks.first
        raise refusal
    return content


def _views_in(path: Path) -> int:
    """How many views a scene file has, without a look at the files it names; 1 where that cannot be told."""
    try:
        return max(1, len(tomllib.loads(path.read_text(encoding="utf-8-sig"))["views"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # refused with its reason when it is loaded
        return 1


class _Maker:
    """One scene of a batch: which of its images are there, and how the others are made."""

    def __init__(
        self, path: Path, label: str, made: list[View] | None, device: Any, options: dict[str, Any], index: Index
    ) -> None:
        self.path, self.label, self.device, self.options, self.index = path, label, device, options, index
        self.scene = Scene.load(path)
        for warning in self.scene.warnings:
            console.say(f"warning: {warning}")
        self._told = False
        self.fresh = made is not None
        self.views = self.scene.views if made is None else made
        for name, table in self.scene.effects.items():
            per_view = [each.name for each in get(name).parameters if each.per_view]
            per_view += [each.name for each in get(name).settings if each.per_view]
            for key in per_view:
                if self.fresh and isinstance(table.get(key), dict):
                    raise InputError(
                        f"{path}: effects.{name}.{key}: found values of single views, and --azimuths makes views of "
                        f"its own; allowed is an effect without"
                    )
        shown = {k: v for k, v in options.items() if k != "max_memory_gib"}
        self._inputs = f"{__version__} {self.scene.input_hash} {label} {sorted(shown.items())}"

    @cached_property
    def stage(self) -> Stage:
        """The mesh on the device: uploaded when the first image is missing."""
        return Stage.of(self.scene, self.device)

    def image(self, number: int) -> tuple[str, Callable[[], None] | None]:
        """Make image `number` unless it is there: one of `OUTCOMES`, and what writes the file and its row."""
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
        """Number of the view whose jitter it has: a view made on the fly keeps its own in a longer list of angles."""
        return zlib.crc32(self.views[number].name.encode()) if self.fresh else number

    def _make(self, view: View, number: int) -> SimulatedView:
        scene = replace(self.scene, views=[view]) if self.fresh else self.scene
        simulation = Simulation(scene, self.stage, **self.options)
        made = simulation.view(view, self._seed(number))
        if not self._told:  # of the first image of a scene: the others would say the same
            self._told = True
            for warning in grid_warnings(scene, self.stage, [view]) + simulation.findings.warnings(scene):
                console.say(f"warning: {self.path}: {warning}")
        return made

    def _write(self, image: SimulatedView, row: Row) -> None:
        path = self.index.out / row["file"]
        write_exr(path, image.beta0 | image.channels(), image.metadata)
        self.index.add({**row, "sha256": sha256(path) or ""})


def sha256(path: Path) -> str | None:
    """Of a file's bytes; None where there is no file."""
    try:
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except FileNotFoundError:
        return None
