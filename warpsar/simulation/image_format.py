"""What a format of simulated images declares."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from warpsar.runtime.extra import Extra
from warpsar.simulation.ground import MapGround
from warpsar.simulation.view import SimulatedView

Parts = Iterator[tuple[str, str, Callable[[Path], None]]]
"""Files of a view: what each is ("" for the image itself), its name, and how it is written."""


@dataclass(frozen=True)
class ImageFormat:
    """A format of simulated images. Each module `warpsar.simulation.formats.<name>` holds one, as `FORMAT`."""

    name: str
    title: str
    """As its users call it."""
    files: str
    """What is written of a view, for the documentation."""
    opens_in: str
    """The same: what reads it."""
    parts: Callable[[SimulatedView, str, MapGround | None], Parts]
    """The files of a view, whose names begin with the name given; the ground is None where it is not known."""
    extra: Extra | None = None
    on_ground: bool = False
    """Whether an image on the ground is among them, where it is known."""
