"""Many images in one command: many scenes, views at angles, an index, and nothing made twice.

An image is there when its file is whole and its row is in the index. A file is packed and written while the next image
is made.
"""

from __future__ import annotations

import time
import tomllib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from warpsar.errors import InputError, WarpsarError
from warpsar.runtime import console, devices, once
from warpsar.runtime.background import Background
from warpsar.simulation.index import INDEX, Index
from warpsar.simulation.maker import OUTCOMES, ImageOptions, Maker
from warpsar.simulation.naming import angles, labels, views_at
from warpsar.simulation.outputs import make_folder, write_json
from warpsar.trace.hits import DEFAULT_MEMORY_GIB
from warpsar.world.tables import View

AHEAD = 2  # images whose files wait to be written
REPORTED_EVERY = 8  # images, to the progress bar that counts those of all processes


@dataclass
class BatchTally:
    """What became of images: how many by outcome, and by scene or image why the others failed."""

    done: Counter[str] = field(default_factory=Counter)
    failures: dict[str, str] = field(default_factory=dict)

    def finish(self, what: str, outcome: str, write: Callable[[], None]) -> None:
        """Write an image, and count it."""
        try:
            write()
        except WarpsarError as error:
            self.failures[what] = str(error)
        else:
            self.done[outcome] += 1

    def of_all(self) -> BatchTally:
        """The tallies of all processes together."""
        everything = once.gather(self)
        return BatchTally(
            sum((Counter(one.done) for one in everything), Counter()),
            {name: text for one in everything for name, text in one.failures.items()},
        )


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
    yes: bool = False,
) -> dict[str, Any]:
    """`warpsar simulate` of several scenes, or at angles: images, index.csv and simulate.json in `out`.

    An image's file is `<scene>/<number // 1000>/<view>.exr`; `layers` and `variance` add channels to it. Images that
    are there, whole and of the same inputs, stay as they are. `yes` takes meshes whose size is unlikely. Returns the
    JSON's content. Raises InputError for scenes that cannot be read, after all others are made.
    """
    started = time.perf_counter()
    made = _views_made(azimuths, incidences)
    names = labels(scenes)
    out = Path(out)
    where = devices.resolve_device(device)
    once.join(where)
    make_folder(out)
    console.say_device(where)
    index = Index(out)
    options = ImageOptions(seed, layers, variance, not per_ray, max_memory_gib or DEFAULT_MEMORY_GIB)

    def maker(scene: int) -> Maker:
        return Maker(scenes[scene], names[scene], made, where, options, index, yes)

    counts = [len(made) if made is not None else _views_in(path) for path in scenes]
    tally = _make(scenes, counts, maker)
    index.close()
    tally = tally.of_all()
    content = {
        "images": sum(tally.done.values()),
        **{outcome: tally.done[outcome] for outcome in OUTCOMES},
        "failed": tally.failures,
        "scenes": [str(path) for path in scenes],
        "azimuths": azimuths,
        "incidences": incidences,
        "processes": once.processes(),
    }
    content = once.write(lambda: write_json(out / "simulate.json", None, where, seed, started, content)) or content
    _report(tally, out)
    return content


def _views_made(azimuths: str | None, incidences: str | None) -> list[View] | None:
    """The views that the angles ask for; None for the scenes' own."""
    if azimuths is None and incidences is None:
        return None
    if azimuths is None or incidences is None:
        raise InputError("--azimuths, --incidences: found one of them; allowed are both, or neither")
    return views_at(angles(azimuths, "--azimuths", -360.0, 360.0 + 1e-9), angles(incidences, "--incidences", 0.0, 90.0))


def _make(scenes: Sequence[Path], counts: Sequence[int], open_scene: Callable[[int], Maker]) -> BatchTally:
    """Make this process's part of the images; `counts`: how many views each scene has."""
    tally = BatchTally()
    maker: Maker | None = None
    bar = console.progress(sum(counts), "images", "image")
    dealt = shares(counts, once.processes())
    taken, finished = once.counter(), once.counter()
    with Background(AHEAD) as beside:
        while (turn := taken(1)) < len(dealt):
            share = dealt[turn]
            path = scenes[share.scene]
            if str(path) in tally.failures:
                continue
            try:
                if maker is None or maker.path != path:
                    maker = open_scene(share.scene)
            except WarpsarError as error:
                tally.failures[str(path)] = str(error)
                continue
            numbers = range(share.part, len(maker.views), share.of)
            for start in range(0, len(numbers), REPORTED_EVERY):
                some = numbers[start : start + REPORTED_EVERY]
                for number in some:
                    _make_one(maker, number, tally, beside)
                bar.update(finished(len(some)) + len(some) - bar.n)
    bar.close()
    return tally


def _make_one(maker: Maker, number: int, tally: BatchTally, beside: Background) -> None:
    """Make one image unless it is there; its file is written beside."""
    what = f"{maker.path}, view {maker.views[number].name}"
    try:
        outcome, write = maker.image(number)
    except WarpsarError as error:
        tally.failures[what] = str(error)
        return
    if write is None:
        tally.done[outcome] += 1
    else:
        beside.put(partial(tally.finish, what, outcome, write))


def _report(tally: BatchTally, out: Path) -> None:
    """Say how many images were made; raise InputError where some failed."""
    done, failures = tally.done, tally.failures
    again = done["other_inputs"] + done["damaged"]
    console.say(
        f"{sum(done.values())} images: {done['made']} made, {done['kept']} were there"
        + (f", {again} made again ({done['other_inputs']} of other inputs, {done['damaged']} damaged)" if again else "")
    )
    if failures:
        many = "\n  ".join(failures.values())
        raise once.refusal(
            InputError(f"{len(failures)} failed; everything else is made, and {out / INDEX} lists it:\n  {many}")
        )


def _views_in(path: Path) -> int:
    """How many views a scene file has, without reading the files that it names; 1 where that cannot be told."""
    try:
        return max(1, len(tomllib.loads(path.read_text(encoding="utf-8-sig"))["views"]))
    except (OSError, ValueError, KeyError, TypeError, RecursionError):  # refused with its reason when it is loaded
        return 1


# ---- how the images of a batch are shared among processes


EACH = 8  # shares of a process: few, so that a scene is seldom loaded; enough for all processes to end together
FINE = 128  # the same for a single scene, which every process loads anyway


@dataclass(frozen=True)
class ViewShare:
    """Views of one scene that one process makes: every `of`-th, from number `part` on."""

    scene: int
    part: int
    of: int


def shares(views: Sequence[int], processes: int) -> list[ViewShare]:
    """What is dealt out, one after the other, to whichever process is free; `views`: how many each scene has.

    Scenes stay whole where there are enough of them for all processes, since loading a scene takes time.
    """
    whole = len(views) >= EACH * processes or processes == 1
    each = FINE if len(views) == 1 else EACH
    size = max(1, -(-sum(views) // (each * processes)))
    found = []
    for scene, count in enumerate(views):
        parts = 1 if whole else max(1, -(-count // size))
        found += [ViewShare(scene, part, parts) for part in range(parts)]
    return found
