"""Widths of a system's response to a point, as the header of a complex image declares them."""

from __future__ import annotations

from dataclasses import dataclass

UNIFORM = 0.886
"""Half-power width of an unweighted band, in cells of the band: no weights make a narrower one."""
WIDTHS = {"UNIFORM": UNIFORM, "HAMMING": 1.303, "HANNING": 1.441, "HANN": 1.441}
"""Of windows without a parameter (Harris, Proc. IEEE 66(1), 1978, table 1)."""
_AGREE = 0.1


@dataclass(frozen=True)
class Declared:
    """Half-power widths along the image's rows and columns [m], bands there [1/m], and names of their weights."""

    width_m: tuple[float, float]
    band: tuple[float, float]
    window: tuple[str | None, str | None]

    def contradictions(self, source: str) -> list[str]:
        """Where a width is not that of its band and weights."""
        found = []
        for name, width, band, window in zip(("Row", "Col"), self.width_m, self.band, self.window, strict=True):
            cells, least = width * band, UNIFORM * (1.0 - _AGREE)
            known = WIDTHS.get((window or "").upper())
            if known is not None and abs(cells / known - 1.0) > _AGREE:
                found.append(
                    f"{source}: Grid.{name}.ImpRespWid = {width:.4g} m contradicts ImpRespBW = {band:.4g} 1/m with "
                    f"{window} weights, which give {known / band:.4g} m"
                )
            elif cells < least:
                found.append(
                    f"{source}: Grid.{name}.ImpRespWid = {width:.4g} m contradicts ImpRespBW = {band:.4g} 1/m, which "
                    f"holds {UNIFORM / band:.4g} m at best"
                )
        return found
