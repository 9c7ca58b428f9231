"""The formats of simulated images by name. A file in this folder is a format."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from warpsar.runtime.plugins import names_in

if TYPE_CHECKING:  # the command line asks for names, and loads no NumPy for them
    from warpsar.simulation.image_format import ImageFormat


def names() -> tuple[str, ...]:
    """All formats; none of them is imported."""
    return names_in(__package__)


def get(name: str) -> ImageFormat:
    """The format called `name`; each module `warpsar.simulation.formats.<name>` holds it as `FORMAT`."""
    found: ImageFormat = import_module(f"warpsar.simulation.formats.{name}").FORMAT
    return found
