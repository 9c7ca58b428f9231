"""How the images of a batch are shared among processes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
