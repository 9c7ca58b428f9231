"""Values that the scene knows to a tolerance, as a prior on x.

A prior is Gaussian in the value itself, in the key's unit: half of ((value - about) / sd)^2 is added to the loss, which
for gamma and log is a negative log-likelihood. Optimisers move coordinates (ln, logit), so the value is taken at its
coordinate, and derivatives go by the chain rule: d deviation / dx = (d value / dx) / sd. Nothing is linearised. A value
may so be known about a place that has no logarithm, such as a level of 0 +- 1e-4.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
import warp as wp

from warpsar.errors import InputError
from warpsar.kernels import loss as kernels
from warpsar.kernels.codes import Scale
from warpsar.learning.coordinates import DeviceX, SceneCoordinates
from warpsar.learning.geometry import Geometry


@dataclass(frozen=True)
class Known:
    """Element `at` of x is known: its `value` is `about` +- `sd`, in `unit`; `slope` is d value / dx at x.

    `shared`: the name of an error that several elements have in common, and its standard deviation, which `sd` holds.
    """

    label: str
    at: int
    about: float
    sd: float
    unit: str
    value: Callable[[float], Any]
    slope: Callable[[float], Any]
    shared: tuple[str, float] | None = None

    def deviation(self, x: np.ndarray) -> float:
        """How far the value at x lies from what is known, in standard deviations."""
        return (float(self.value(float(x[self.at]))) - self.about) / self.sd


class Beside(Protocol):
    """What was measured beside the images and depends on x too, such as curves of RCS: its negative log-likelihood."""

    def value(self, x: np.ndarray) -> float:
        """The negative log-likelihood at x."""

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """d value / dx, shape (p,)."""

    def information(self, x: np.ndarray) -> np.ndarray:
        """Fisher information, shape (p, p)."""


class Prior:
    """The known elements of an x of `size` elements.

    Elements that share an error are correlated: with it, of standard deviation s, each is known to
    sd^2 = own^2 + s^2, and two of them have the covariance s^2. Deviations are then those of independent numbers
    (`whitening`), so half the sum of their squares stays the prior's negative logarithm.

    Elements at `standard` are expected to have a standard normal distribution: their deviations, behind those of the
    known, are their values. `beside` counts in the value, the gradient and the information.
    """

    def __init__(
        self, known: Sequence[Known], size: int, standard: slice = slice(0, 0), beside: Beside | None = None
    ) -> None:
        self.known, self.size, self.standard, self.beside = tuple(known), size, standard, beside

    @classmethod
    def of(cls, coordinates: SceneCoordinates | None, geometry: Geometry | None = None) -> Prior:
        """What a scene's tables know of its fitted numbers; those of its `geometry` come last. None: they are held."""
        known: list[Known] = []
        size, standard = 0, slice(0, 0)
        if coordinates is not None:
            known, size = list(_of_shading(coordinates)), coordinates.x0.size
            standard = coordinates.of_values
        if geometry is not None:
            known += _of_geometry(geometry, size)
            size += len(geometry.coordinates)
        return cls(known, size, standard)

    @cached_property
    def whitening(self) -> np.ndarray | None:
        """The inverse root of the deviations' correlation, shape (k, k), lower; None where nothing is shared."""
        names = [None if one.shared is None else one.shared[0] for one in self.known]
        if not any(names):
            return None
        shares = np.array([0.0 if one.shared is None else one.shared[1] / one.sd for one in self.known])
        same = np.array([[a is not None and a == b for b in names] for a in names])
        correlation = np.where(same, np.outer(shares, shares), 0.0)
        np.fill_diagonal(correlation, 1.0)
        return np.linalg.inv(np.linalg.cholesky(correlation))

    def deviations(self, x: np.ndarray | DeviceX) -> np.ndarray:
        """(value - about) / sd of every known element, shape (k,); independent of each other."""
        found = np.array([one.deviation(np.asarray(x)) for one in self.known], float)
        found = found if self.whitening is None else self.whitening @ found
        return found if self.standard.start == self.standard.stop else np.append(found, np.asarray(x)[self.standard])

    def slopes(self, x: np.ndarray | DeviceX) -> np.ndarray:
        """d deviations / dx, shape (k, p)."""
        standard = range(self.size)[self.standard]
        found = np.concatenate([self._slopes_of_known(x), np.zeros((len(standard), self.size))])
        found[len(self.known) + np.arange(len(standard)), standard] = 1.0
        return found

    def _slopes_of_known(self, x: np.ndarray | DeviceX) -> np.ndarray:
        """`slopes` of the deviations of known elements, shape (known, p)."""
        found = np.zeros((len(self.known), self.size))
        for row, one in zip(found, self.known, strict=True):
            row[one.at] = float(one.slope(float(np.asarray(x)[one.at]))) / one.sd
        return found if self.whitening is None else self.whitening @ found

    def value(self, x: np.ndarray | DeviceX) -> float:
        """What the prior adds to the loss: half the squared deviations."""
        own = 0.5 * float(np.sum(self.deviations(x) ** 2))
        return own if self.beside is None else own + self.beside.value(np.asarray(x))

    def gradient(self, x: np.ndarray | DeviceX) -> np.ndarray:
        """d value / dx, shape (p,)."""
        deviations, count = self.deviations(x), len(self.known)
        own = deviations[:count] @ self._slopes_of_known(x)
        own[self.standard] += deviations[count:]
        return own if self.beside is None else own + self.beside.gradient(np.asarray(x))

    def information(self, x: np.ndarray | DeviceX, columns: Sequence[int] | None = None) -> np.ndarray:
        """Fisher information of the prior, shape (p, p): its curvature without the bend of the coordinates. `columns`:
        the elements of x that it is asked for, by default all."""
        of = slice(None) if columns is None else np.asarray(columns, int)
        slopes = self.slopes(x)[:, of]
        own = slopes.T @ slopes
        return own if self.beside is None else own + self.beside.information(np.asarray(x))[of][:, of]

    def push(self, x: np.ndarray, places: Sequence[np.ndarray], step: float) -> np.ndarray:
        """The deviations' second derivative along a line, as a force on x, shape (p,); what is `beside` is taken to be
        straight.

        The two `places` lie one and two shares `step` of the line from x.
        """
        ahead, further = map(self.deviations, places)
        bend = (further - 2.0 * ahead + self.deviations(x)) / step**2
        return bend @ self.slopes(x)

    def narrowed(self, moved: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Random moves from x, shape (p,), with those of known elements within their tolerance. Values of tables and
        terms do not move: with all else held they have one minimum, and it is found from anywhere."""
        found = moved.copy()
        found[self.standard] = 0.0
        for one in self.known:
            found[one.at] = moved[one.at] / max(1.0, abs(float(one.slope(float(x[one.at])))) / one.sd)
        return found


def _of_shading(coordinates: SceneCoordinates) -> Iterator[Known]:
    """What is known of surfaces and effects: values that are one number."""
    for at, parameter in coordinates.numbers():
        for about, sd in parameter.known:
            its = parameter.transform
            yield Known(parameter.old_name, at, about, sd, parameter.unit, its.from_coordinate, its.slope)


def _of_geometry(geometry: Geometry, first: int) -> Iterator[Known]:
    for at, (c, (about, sd)) in enumerate(zip(geometry.coordinates, geometry.known, strict=True), first):
        if np.isfinite(sd):
            shared = geometry.shared(c)
            whole = sd if shared is None else float(np.hypot(sd, shared[1]))
            yield Known(c.label, at, about, whole, c.parameter.unit, c.value, c.per_metre, shared)


def refuse_prior(prior: Prior, loss: str, where: str) -> None:
    """Raise InputError for a prior beside a loss that is no log-likelihood; `where` names the scene."""
    if prior.known and loss == "mse":
        raise InputError(
            f"--loss: found mse, and {where} knows {prior.known[0].label} to a tolerance; allowed are gamma and log, "
            f"because mse is no log-likelihood that a tolerance could be weighed with"
        )


class DevicePrior:
    """The known nodes of a surface on a device, for fits that never leave it.

    `loss`, float64, has the terms of the last run. `counts`: whether the prior is
    counted here, as it is once for all views.
    """

    def __init__(self, prior: Prior, coordinates: SceneCoordinates, device: wp.Device, *, counts: bool) -> None:
        mine = [one for one in prior.known if one.at < coordinates.learned.size] if counts else []

        def put(values: list[Any], dtype: type) -> wp.array:
            return wp.array(np.array(values), dtype=dtype, device=device)

        scales = {at: parameter.transform.kind for at, parameter in coordinates.numbers()}
        self.device, self.count = device, len(mine)
        self.loss: wp.array = wp.zeros(self.count, dtype=wp.float64, device=device)
        self._known = [
            put([int(coordinates.learned[one.at]) for one in mine], int),
            put([Scale[scales[one.at].upper()] for one in mine], int),
            put([one.about for one in mine], wp.float64),
            put([one.sd for one in mine], wp.float64),
        ]

    def run(self, nodes: wp.array) -> None:
        """Fill `loss` for the `nodes`, and add to their gradient. A CUDA graph can capture it."""
        if self.count:
            wp.launch(
                kernels.prior_kernel,
                self.count,
                inputs=[*self._known, nodes],
                outputs=[nodes.grad, self.loss],
                device=self.device,
            )
