"""An image of a report between its axes, which have units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from html import escape

import numpy as np

from warpsar.io.html import data_uri

MARKS = 4
"""At most so many numbers beside an axis: a small image is 160 pixels wide."""


@dataclass(frozen=True)
class ImageAxis:
    """`label` holds the unit; `start` and `end` are the outer edges of the first and the last pixel."""

    label: str
    start: float
    end: float

    def ticks(self) -> list[float]:
        """Round numbers from end to end."""
        low, high = sorted((self.start, self.end))
        least = (high - low) / MARKS
        decade = 10.0 ** math.floor(math.log10(least))
        step = next(n * decade for n in (1, 2, 5, 10) if n * decade >= least * (1 - 1e-9))
        return [k * step for k in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def image(png: bytes, caption: str, down: ImageAxis, along: ImageAxis) -> str:
    """A PNG of pixels whose rows lie along `down` and whose columns along `along`, in true proportion."""
    aspect = abs(along.end - along.start) / abs(down.end - down.start)
    text = escape(caption, quote=True)
    picture = f'<img class="pixels" style="aspect-ratio: {aspect:.6g}" src="{data_uri(png, "image/png")}" alt="{text}">'
    ends = " ".join(f'data-{name}="{one.start:.9g} {one.end:.9g}"' for name, one in (("down", down), ("along", along)))
    return (
        f'<figure {ends}><div class="plot">{_scale(down, "down", "top")}<div class="box">{picture}</div>'
        f"{_scale(along, 'along', 'left')}</div><figcaption>{escape(caption)}</figcaption></figure>"
    )


def framed(rgb: np.ndarray, box: tuple[int, int, int, int]) -> np.ndarray:
    """A picture, (rows, cols, 3), with a black frame about `box`: first and last row, first and last column, inside.

    The frame is wide enough to be seen where the picture is shown some 200 pixels wide.
    """
    rows, cols = rgb.shape[:2]
    width = -(-max(rows, cols) // 200)
    around, inside = np.zeros((2, rows, cols), bool)
    top, bottom, left, right = box
    around[max(top - 2 * width, 0) : bottom + 2 * width + 1, max(left - 2 * width, 0) : right + 2 * width + 1] = True
    inside[max(top - width, 0) : bottom + width + 1, max(left - width, 0) : right + width + 1] = True
    return np.where((around & ~inside)[..., None], 0.0, rgb)


def _scale(axis: ImageAxis, name: str, side: str) -> str:
    marks = "".join(
        f'<i style="{side}: {100.0 * (at - axis.start) / (axis.end - axis.start):.4g}%">'
        f"{f'{at:.6g}'.replace('-', chr(0x2212))}</i>"
        for at in axis.ticks()
    )
    return f'<div class="{name}"><b>{escape(axis.label)}</b>{marks}</div>'
