"""What the residual follows: measured over simulated [dB] against incidence, range, azimuth, brightness, material."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.special import gammainc

from warpsar.compare.comparison import Comparison
from warpsar.io.figures import new
from warpsar.speckle.likelihood import log_bias

if TYPE_CHECKING:
    from matplotlib.figure import Figure


FEWEST = 30  # pixels of a bin: with fewer its 16 and 84 % points say nothing
BINS = 24  # over the length of an axis
PERCENTILES = (16.0, 50.0, 84.0)
DECIBEL = 10.0 / np.log(10.0)


@dataclass(frozen=True)
class FactorProfile:
    """The residual [dB] against one factor: `rows` of {"low", "high" or "name", "pixels", "p16_db", "median_db",
    "p84_db"}; `label` names the factor with its unit."""

    label: str
    rows: list[dict[str, Any]]


def residual_db(image: Comparison) -> np.ndarray:
    """10 log10(measured / simulated) of the interior, shape (n,), less the mean that speckle of its looks has there
    (10 / ln 10) (psi(L) - ln L): zero on average for a true model."""
    ratio = image.seen.values / image.simulated[image.interior]
    return DECIBEL * (np.log(ratio) - log_bias(image.seen.looks))


def expected_db(images: Sequence[Comparison]) -> dict[str, float]:
    """Percentiles [dB] of `residual_db` over all images' interiors if there is nothing but speckle, gamma of their
    looks."""
    db = np.linspace(-60.0, 30.0, 9001)
    share = np.zeros_like(db)
    for image in images:
        looks = image.seen.looks
        power = np.exp(db / DECIBEL + log_bias(looks))
        share += image.interior.sum() * gammainc(looks, power * looks)
    found = np.interp(np.array(PERCENTILES) / 100.0, share / share[-1], db)
    return dict(zip(("p16", "median", "p84"), found.tolist(), strict=True))


def profiles(images: Sequence[Comparison], materials: Sequence[str]) -> dict[str, FactorProfile]:
    """The residual of all images' interiors against each factor; bins of fewer than 30 pixels are left out."""
    residual = np.concatenate([residual_db(i) for i in images])

    def gather(plane: Callable[[Comparison], np.ndarray]) -> np.ndarray:
        return np.concatenate([np.broadcast_to(plane(i), i.interior.shape)[i.interior] for i in images])

    brightness = 10.0 * np.log10(gather(lambda i: i.simulated))
    start, stop = np.floor(np.percentile(brightness, [0.5, 99.5]))
    first = images[0]
    found = {
        "incidence_deg": (
            "incidence angle on the surface [deg]",
            gather(lambda i: i.incidence_deg),
            np.arange(0, 91, 5),
        ),
        "range_m": ("slant range about the reference point [m]", gather(lambda i: i.range_m[:, None]), first.range_m),
        "azimuth_m": ("azimuth about the reference point [m]", gather(lambda i: i.azimuth_m), first.azimuth_m),
        "brightness_db": ("modelled beta0 [dB]", brightness, np.arange(start, stop + 2.0, 1.0)),
    }
    result = {}
    for name, (label, at, edges) in found.items():
        if name.endswith("_m"):
            half = (edges[1] - edges[0]) / 2.0 if edges.size > 1 else 0.5
            edges = np.linspace(edges[0] - half, edges[-1] + half, min(BINS, edges.size) + 1)
        bins = np.digitize(at, edges) - 1
        rows = [{"low": float(edges[k]), "high": float(edges[k + 1])} for k in range(edges.size - 1)]
        result[name] = FactorProfile(label, _filled(rows, bins, residual))
    result["material"] = FactorProfile(
        "material", _filled([{"name": name} for name in materials], gather(lambda i: i.material), residual)
    )
    return result


def _filled(rows: list[dict[str, Any]], bins: np.ndarray, residual: np.ndarray) -> list[dict[str, Any]]:
    """`rows` with the residual's percentiles in their bins, where those hold enough pixels."""
    found = []
    for k, row in enumerate(rows):
        inside = residual[bins == k]
        if inside.size >= FEWEST:
            low, median, high = np.percentile(inside, PERCENTILES)
            found.append({**row, "pixels": inside.size, "p16_db": low, "median_db": median, "p84_db": high})
    return found


def profile_figure(profile: FactorProfile, expected: dict[str, float]) -> Figure:
    """Median and 16 to 84 % of the residual against the factor; grey: what speckle alone gives."""
    figure, axis = new(4.4, 3.0)
    axis.axhspan(expected["p16"], expected["p84"], color="0.88", zorder=0, label="speckle alone, 16 to 84 %")
    axis.axhline(expected["median"], color="0.55", lw=0.8, zorder=1)
    rows = profile.rows
    median, low, high = (np.array([row[k] for row in rows]) for k in ("median_db", "p16_db", "p84_db"))
    if rows and "name" in rows[0]:
        at = np.arange(len(rows))
        axis.errorbar(
            at, median, [median - low, high - median], fmt="o", color="C0", capsize=3, label="median, 16 to 84 %"
        )
        names = [row["name"] for row in rows]
        slanted = sum(map(len, names)) > 30
        axis.set_xticks(at, names, rotation=30 if slanted else 0, ha="right" if slanted else "center")
        axis.set_xlim(-0.6, len(rows) - 0.4)
    else:
        at = np.array([(row["low"] + row["high"]) / 2.0 for row in rows])
        axis.fill_between(at, low, high, color="C0", alpha=0.25, lw=0)
        axis.plot(at, median, "o-", ms=3, color="C0", label="median, 16 to 84 %")
    reach = 1.5 * max([abs(v) for v in (*low, *high, *expected.values())], default=1.0)
    axis.set_ylim(-reach, reach)
    axis.set_xlabel(profile.label)
    axis.set_ylabel("measured / simulated [dB]")
    axis.grid(alpha=0.3, lw=0.4)
    axis.legend(frameon=False, fontsize=7, loc="upper right")
    return figure
