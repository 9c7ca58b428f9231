"""The learned term of sigma0: physics x exp(g), g a small network of radial units. It stands in a JSON file.

g = sum over places j of weight_j exp(-|(f - f_j) / width|^2 / 2) for each polarization, with f = (cos theta, ln kh,
ln kl, ln(eps_r - 1)). It is smooth, leaves sigma0 positive, and goes to 0 with its gradient away from the places it has
learned at. HV and VH share one column: it is reciprocal.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.io import input_file
from warpsar.io.images import replacing

LARGEST_FILE = 2**24
LARGEST_WEIGHT = 1e4
"""Neighbours have weights of both signs, whose sum is small."""
CHANNELS = ("HH", "VV", "HV")
FEATURES = ("cos_incidence", "ln_kh", "ln_kl", "ln_contrast")
DB = 10.0 / np.log(10.0)


@dataclass(frozen=True)
class ScatteringTerm:
    """`places`, (n, 4); `width`, (4,), both in the features; `weights`, by polarization, each (n,), natural logarithm.

    `model` is the physics that it was learned for. `spread_db` and `noise_db` are what was expected of the term before
    any table, and of the table's values; `used`, by polarization, (n,), says which places the table had.
    """

    model: str
    places: NDArray[np.float64]
    width: NDArray[np.float64]
    weights: Mapping[str, NDArray[np.float64]]
    spread_db: float
    noise_db: float
    used: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)

    def units(self, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """The places' units at further places, (m, n)."""
        apart = (np.asarray(at, float)[:, None] - self.places[None]) / self.width
        return np.asarray(np.exp(-0.5 * (apart**2).sum(axis=-1)))

    def prior_root(self) -> NDArray[np.float64]:
        """A root of the covariance that is expected of a polarization's weights before any image, (n, n)."""
        known = self.units(self.places) + (self.noise_db / self.spread_db) ** 2 * np.eye(len(self.places))
        return np.asarray(np.linalg.inv(np.linalg.cholesky(known)).T * (self.spread_db / DB))

    def db(self, polarization: str, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """g in decibels at places (m, 4); 0 for a polarization that was not learned."""
        weights = self.weights.get("HV" if polarization == "VH" else polarization)
        if weights is None:
            return np.zeros(len(at))
        return np.asarray(self.units(at) @ weights * DB)

    def sd_db(self, polarization: str, at: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation of g at places (m, 4): `noise_db` where it has learned, `spread_db` far from there."""
        used = self.used.get("HV" if polarization == "VH" else polarization)
        if used is None or not used.any():
            return np.full(len(at), self.spread_db)
        known, seen = self.units(self.places[used])[:, used], self.units(at)[:, used]
        known[np.diag_indices_from(known)] += (self.noise_db / self.spread_db) ** 2
        left = 1.0 - (seen * np.linalg.solve(known, seen.T).T).sum(axis=1)
        return np.asarray(np.hypot(self.spread_db * np.sqrt(np.maximum(left, 0.0)), self.noise_db))

    def save(self, path: Path | str) -> None:
        """Write it as JSON."""
        data = {
            "model": self.model,
            "features": list(FEATURES),
            "width": self.width.tolist(),
            "spread_db": self.spread_db,
            "noise_db": self.noise_db,
            "places": self.places.tolist(),
            "weights": {name: one.tolist() for name, one in self.weights.items()},
            "used": {name: one.tolist() for name, one in self.used.items()},
        }
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def read(path: Path | str) -> ScatteringTerm:
    """Read a term. Raises InputError for a file that is none."""
    raw = input_file.read_bytes(Path(path), "a learned term of sigma0", LARGEST_FILE)
    try:
        data = json.loads(raw)
        if data["features"] != list(FEATURES):
            raise ValueError(f"features: found {data['features']}; must be {list(FEATURES)}")
        places, width = np.array(data["places"], float), np.array(data["width"], float)
        weights = {str(name): np.array(one, float) for name, one in data["weights"].items()}
        used = {str(name): np.array(one, bool) for name, one in data["used"].items()}
        scale = float(data["spread_db"]), float(data["noise_db"])
        _refuse(places, width, weights, used, scale)
        return ScatteringTerm(str(data["model"]), places, width, weights, *scale, used)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path}: {type(error).__name__}: {error}; must be a learned term of sigma0") from None


def _refuse(places: Any, width: Any, weights: Any, used: Any, scale: tuple[float, float]) -> None:
    if places.ndim != 2 or places.shape[1] != len(FEATURES) or not np.isfinite(places).all() or not len(places):
        raise ValueError(f"places: found the shape {places.shape}; must be finite rows of {len(FEATURES)} numbers")
    if width.shape != (len(FEATURES),) or not ((width > 0) & np.isfinite(width)).all():
        raise ValueError(f"width: must be {len(FEATURES)} numbers above 0")
    if not all(0 < one < np.inf for one in scale):
        raise ValueError("spread_db, noise_db: must be above 0")
    for name, one in [*weights.items(), *used.items()]:
        if name not in CHANNELS or one.shape != (len(places),):
            raise ValueError(f"{name}: must be one of {', '.join(CHANNELS)}, with a value for each place")
    if not all((np.abs(one) <= LARGEST_WEIGHT).all() for one in weights.values()):
        raise ValueError(f"weights: must be numbers within -{LARGEST_WEIGHT:g} and {LARGEST_WEIGHT:g}")


def learned(
    model: str,
    places: NDArray[np.float64],
    off_db: Mapping[str, NDArray[np.float64]],
    *,
    width: tuple[float, float, float, float] = (0.1, 1.0, 1.0, 1.0),
    spread_db: float = 3.0,
    noise_db: float = 0.25,
) -> ScatteringTerm:
    """The term that a table teaches: by polarization, truth minus `model` [dB] at places (n, 4); NaN where not known.

    Least squares with the weights' own expected size (Gaussian process regression: Rasmussen and Williams 2006,
    equation 2.25), which is what keeps the term at 0 where the table has nothing.
    """
    places = np.asarray(places, float)
    term = ScatteringTerm(model, places, np.array(width, float), {}, spread_db, noise_db)
    units, weights, used = term.units(places), {}, {}
    for name, off in off_db.items():
        known = used[name] = np.isfinite(off)
        inner = units[np.ix_(known, known)] + (noise_db / spread_db) ** 2 * np.eye(int(known.sum()))
        weights[name] = np.zeros(len(places))
        weights[name][known] = np.linalg.solve(inner, np.asarray(off)[known]) / DB
    return ScatteringTerm(model, places, term.width, weights, spread_db, noise_db, used)
