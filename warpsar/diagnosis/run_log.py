"""What a run has found so far, entry after entry, and its checkpoint."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from warpsar.io.checkpoint import Checkpoint

T = TypeVar("T")


class RunLog:
    """Entries in JSON's types, in the order in which a run makes them. What a resumed run takes from them is what it
    would find again, to the bit on the CPU: JSON keeps every digit.

    `tag` names the run (`checkpoint.write`); without a `folder` nothing is stored. `entries` are those of an earlier
    part of the run, which `kept` has stored.
    """

    def __init__(
        self,
        folder: Path | None = None,
        tag: str = "",
        entries: list[Any] | None = None,
        kept: Checkpoint | None = None,
    ) -> None:
        self._kept, self._tag, self.entries = kept or Checkpoint(folder, resume=True), tag, list(entries or [])
        self._told = [json.dumps(entry) for entry in self.entries]  # all of them, after each step, took long
        self._next = 0

    def add(self, entry: Any) -> None:
        """Keep an entry, and store all."""
        self.entries.append(entry)
        self._told.append(json.dumps(entry))
        self._kept.write(lambda: {"told": np.array(f"[{', '.join(self._told)}]")}, self._tag)

    def following(self, run: Callable[[], T], content: Callable[[T], Any], of: Callable[[Any], T]) -> T:
        """What the next step of the run gives: as stored, or by `run`. `content` makes an entry of it, and `of` makes
        it of an entry."""
        self._next += 1
        if self._next <= len(self.entries):
            return of(self.entries[self._next - 1])
        found = run()
        self.add(content(found))
        return found


def open_run_log(folder: Path, tag: str, resume: bool) -> RunLog:
    """The run as it stands: at its beginning, or with `resume` at the checkpoint in `folder`.

    Raises InputError where there is nothing to resume, or what is there belongs to another scene, other options or
    another version. Under torchrun, a job that is started again before its first checkpoint begins anew.
    """
    kept = Checkpoint(folder, resume)
    stored = kept.stored(tag, needed=True)
    return RunLog(folder, tag, None if stored is None else json.loads(str(stored["told"])), kept)
