"""What a scene makes. The command line reads this file, so it imports no heavy library."""

from __future__ import annotations

from typing import Literal, get_args

Product = Literal["beta0", "slc", "phase-history", "rcs"]
PRODUCTS: tuple[Product, ...] = get_args(Product)
"""An image of power, a complex image, a phase history, a radar cross-section or a curve of it."""
CALLED: dict[Product, str] = {
    "beta0": "an image of power",
    "slc": "a complex image",
    "phase-history": "a phase history",
    "rcs": "a radar cross-section",
}
