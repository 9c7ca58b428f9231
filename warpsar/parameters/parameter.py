"""One number of a scene that can change, or an array of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError, shown
from warpsar.world.transform import Transform

Root = Literal["materials", "effects", "objects", "views", "image", "mesh"]
Layout = Literal["number", "vector", "per view", "per material", "vertex", "texture", "table"]
Product = Literal["power", "amplitude"]


@dataclass(frozen=True, eq=False)
class Parameter:
    """A parameter of a scene, in the unit of scene.toml.

    It is called "materials.soil.eps_r", "effects.noise_floor.level", "objects.car.position_m",
    "views.az020.azimuth_deg", "image.range_spacing_m" or "mesh.vertices". "views.azimuth_deg" turns all views by one
    number; its value is 0. A value that an effect has in one view or on
    one material names it, as "effects.aim_point.range_m[north]"; so does a table's column,
    "materials.soil.sigma0[HH]", "materials.soil.learned_term[HH]" or "effects.glints.points[level_dbsm]".
    """

    root: Root
    owner: str
    """The material, effect, object or view that it belongs to; "" of the image and the mesh."""
    key: str
    """The key in scene.toml."""
    unit: str
    """"1" where there is none."""
    low: float
    """The least that it may be."""
    high: float
    """The most that it may be."""
    read: Callable[[], Any] = field(repr=False)
    """Gives the value; it is read when it is asked for."""
    entry: str | None = None
    """The view, material or polarization, where the key has a value for each; or a column of a table."""
    layout: Layout = "number"
    transform: Transform = field(default_factory=Transform)
    """The coordinate that a fit moves."""
    fit_bounds: tuple[float, float] | None = None
    """How far a fit goes, where that is less than what it may be."""
    reach: float = math.inf
    """How far a fit goes from the declared value: so many of its unit to either side, or by this factor where its
    coordinate is a logarithm."""
    freed: bool = False
    """Whether the scene lets a fit change it."""
    known: tuple[tuple[float, float], ...] = ()
    """About which value each of its numbers is known, and to which standard deviation; empty without a tolerance."""
    prior_root: Callable[[], NDArray[np.float64]] | None = field(default=None, repr=False)
    """Of a table's column, whose values a fit expects to be alike: a root of their covariance about the declared ones,
    (n, n)."""
    span: Callable[[], slice] | None = field(default=None, repr=False)
    """Of a field over the mesh's vertices: those of the material's own faces."""
    derivatives: frozenset[Product] = frozenset()
    """The products that have a derivative to it in reverse mode: images of power, complex amplitudes."""

    @property
    def name(self) -> str:
        """The dotted name."""
        entry = "" if self.entry is None else f"[{self.entry}]"
        return ".".join(part for part in (self.root, self.owner, self.key) if part) + entry

    @property
    def old_name(self) -> str:
        """What it was called before there was one tree."""
        return self.name.partition(".")[2]

    @cached_property
    def value(self) -> NDArray[np.float64]:
        """As the scene declares it. Shape () of a number, (3,) of a vector, (n,) over the mesh's vertices for the
        layout "vertex", (n, 3) of the vertices themselves, (rows, cols) for "texture", (rows,) of a table's column.
        Of eps' - j eps'' it is eps', of (lx, ly) it is lx."""
        return np.array(self.read(), float)

    @property
    def fit_ends(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Least and largest value of a fit, each of the value's shape: within `fit_bounds`, and the `reach`."""
        low, high = self.fit_bounds or (-math.inf, math.inf)
        about, reach = self.value, self.reach
        ends = (about / reach, about * reach) if self.transform.kind == "log" else (about - reach, about + reach)
        return np.maximum(ends[0], low), np.minimum(ends[1], high)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.value.shape

    def checked(self, value: Any) -> NDArray[np.float64]:
        """A value that may stand here, float64. Raises InputError for a shape or a number that may not."""
        try:
            found = np.asarray(value, float)
        except (TypeError, ValueError) as error:
            raise InputError(f"{self.name}: found {shown(value)}; must be numbers of shape {self.shape}") from error
        if found.shape != self.shape:
            raise InputError(f"{self.name}: found shape {found.shape}; must be {self.shape}")
        inside = np.atleast_1d(found)[self.used]
        bad = inside[~((inside >= self.low) & (inside <= self.high))]  # NaN is within nothing
        if bad.size:
            raise InputError(f"{self.name}: found {bad.flat[0]:g}; must be from {self.low:g} to {self.high:g}")
        return found

    @cached_property
    def used(self) -> slice:
        """The part of the value that is looked at: all of it, but of a field over vertices."""
        return slice(None) if self.span is None else self.span()
