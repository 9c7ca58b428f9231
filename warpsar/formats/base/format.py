"""What a format of measurements declares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from warpsar.formats.base.data import ImageChip, PhaseHistory, Quantity, RadarAt
from warpsar.products.product import Product
from warpsar.runtime.extra import Extra
from warpsar.world.earth import EarthFrame


@dataclass(frozen=True)
class Stated:
    """What a user states beside a file. A reader takes what its files do not say.

    `quantity`: what real numbers are. `frame`: where the world lies on the earth. `radar_at` and `spacing_m` (range,
    azimuth) [m] are of pictures in the slant plane.
    """

    quantity: Quantity | None = None
    polarization: str | None = None
    frame: EarthFrame | None = None
    radar_at: RadarAt = "top"
    spacing_m: tuple[float, float] | None = None


@dataclass(frozen=True)
class Format:
    """A format of measurements. Each module `warpsar.formats.<name>` holds one, as `FORMAT`.

    What it knows of a file decides when it is asked: its bytes first, then name and bytes, then its name alone.
    """

    name: str
    title: str
    """As its users call it."""
    known_by: str
    """How a file is recognised, for the documentation."""
    gives: str
    """What it holds, for the documentation."""
    read: Callable[[Path, Stated], PhaseHistory | ImageChip] | None
    """Raises InputError, one message that names the file. None for curves, which `warpsar.io.curves` reads."""
    detect: Callable[[Path, bytes], bool] | None = None
    """Whether a file is one, by its first bytes (4096, or all), or by more of it; None: the suffix alone tells."""
    suffixes: tuple[str, ...] = ()
    """One of them must end the file's name, in small letters; without them any name will do."""
    join: Callable[[Sequence[Any]], PhaseHistory | ImageChip] | None = None
    """What `read` gives of several files, as one measurement; None where they cannot be one."""
    write: Callable[..., None] | None = None
    """For `warpsar simulate --product`; None for what is read alone."""
    products: Callable[[Path, str | None], tuple[Product, ...]] | None = None
    """What a file, or a folder, holds as images of the earth with an orbit, of all polarizations or of the one named;
    None for what has no orbit."""
    folder: tuple[str, str] | None = None
    """Of what is handed on as a folder: the folder inside that tells it, and what users call it."""
    no_products: str = "which says no orbit"
    """Why `products` is None, as a clause behind the title."""
    extra: Extra | None = None
    asks: tuple[str, ...] = ()
    """What its files do not say and a user may state: of `quantity`, `radar_at` and `spacing_m`."""

    def named(self, path: Path) -> bool:
        """Whether the suffix of a file is one of the format's."""
        return path.suffix.lower() in self.suffixes

    def fits(self, path: Path, head: bytes) -> bool:
        """Whether a file that begins with `head` is one."""
        return (not self.suffixes or self.named(path)) and (self.detect is None or self.detect(path, head))
