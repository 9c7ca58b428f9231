"""Which measured pixels are compared with a model, and how their speckle is distributed (docs/diagnosis-method.md)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from scipy.ndimage import distance_transform_edt, minimum_filter

from warpsar.errors import InputError, NothingLitError
from warpsar.kernels.loss import DARKEST, ObservedPixels
from warpsar.runtime.structs import fill
from warpsar.scene.scene import Scene
from warpsar.speckle.law import Law
from warpsar.speckle.looks import equivalent_looks
from warpsar.world.tables import View

BORDER = 2  # pixels at the image's edge that are left out
FAINT = 1e-4  # of the median of `Observation.least`: some 60 dB under the lit pixels
NOTHING = 1e-6  # of the interior's median: under it, 60 dB, power in the dark is none
TRACE = 0.1  # of the median beta0: less is a border pixel's share of light
FAR = 6  # pixels from any lit one: from here on nothing but additive effects can be seen


@dataclass(frozen=True)
class Observation:
    """One measured image, and which of its pixels are used; arrays of shape (rows, cols).

    `interior`: covered by the declared model's surface with all eight neighbours, off the image's edge, unmasked,
    finite and positive. `silent`: the same, but exactly 0, which the gamma likelihood does not allow. `dark`: far from
    everything lit, off the edge, unmasked and finite; zeros are included. `measured` is 0 there, too, where it is less
    than `NOTHING` of the interior's median.
    `least` [beta0 before any gain], if given, is a lower bound of the modelled beta0 of each pixel that is not `dark`:
    a model's rays can miss so much. `faint` is that of a dark pixel.
    `looks`: mean^2 / variance of a pixel about its mean. Where the view has `texture`, the shape of its gamma law,
    these are fewer than the looks of the speckle.
    """

    view: View
    polarization: str
    measured: np.ndarray
    interior: np.ndarray
    silent: np.ndarray
    dark: np.ndarray
    looks: float
    looks_estimated: bool
    least: np.ndarray | None = None
    faint: float = 0.0
    texture: float = math.inf

    @property
    def law(self) -> Law:
        """How a pixel scatters about its mean."""
        return Law.of_equivalent(self.looks, self.texture)

    @property
    def top(self) -> float:
        """Power from which a pixel was clipped; infinite where none was."""
        return math.inf if self.view.clipped_at is None else self.view.clipped_at

    @property
    def zeros(self) -> int:
        return int(self.silent.sum())

    @cached_property
    def count(self) -> int:
        """Pixels of the interior."""
        return int(self.interior.sum())

    @property
    def left_out(self) -> int:
        return int(self.interior.size - self.interior.sum())

    def with_dark(self) -> Observation:
        """The same with the positive dark pixels in the interior too: additive effects are fitted on them.

        Where the model has nothing, `faint` stands in for it. With less, one such pixel that measures power would hide
        what all others say, in the rounding of its own likelihood.
        """
        lit = self.interior & ~self.dark
        faint = FAINT * float(np.median(self.least[lit])) if self.least is not None and lit.any() else 0.0
        return replace(self, interior=self.interior | (self.dark & (np.nan_to_num(self.measured) > 0)), faint=faint)

    @cached_property
    def pixels(self) -> np.ndarray:
        """Flat indices of the interior, shape (n,), int32; it cannot be written to."""
        return _held(np.flatnonzero(self.interior).astype(np.int32))

    @cached_property
    def darkest(self) -> np.ndarray:
        """The lower bound of modelled beta0: one for all pixels, shape (1,), or shape (n,), float32; it cannot be
        written to."""
        if self.least is None:
            return _held(np.array([DARKEST], np.float32))
        least = np.where(self.dark, self.faint, self.least)[self.interior]
        return _held(np.maximum(least, DARKEST).astype(np.float32))

    @cached_property
    def values(self) -> np.ndarray:
        """Measured beta0 of the interior, shape (n,), float64; it cannot be written to."""
        return _held(self.measured[self.interior].astype(float))

    def on(self, device: wp.Device) -> Any:
        """The interior's pixels as kernels take them; kept, for many models are compared with one observation."""
        if device.alias not in self._on:
            arrays = {"pixel": self.pixels, "measured": self.values.astype(np.float32), "darkest": self.darkest}
            placed: dict[str, wp.array] = {name: wp.array(values, device=device) for name, values in arrays.items()}
            self._on[device.alias] = fill(ObservedPixels, **placed)
        return self._on[device.alias]

    @cached_property
    def _on(self) -> dict[str, Any]:
        return {}


def _held(found: np.ndarray) -> np.ndarray:
    found.flags.writeable = False
    return found


def estimated_looks(scene: Scene, view: View, measured: np.ndarray) -> float:
    """The looks of an image that does not declare them; `measured` is NaN where it is not used.

    Raises InputError where there is no homogeneous ground to estimate them on.
    """
    looks = equivalent_looks(measured)
    if looks is None:
        raise InputError(
            f"{scene.name}: views {view.name}: looks are not given, and no homogeneous ground was found to estimate "
            f"them on; give `looks`"
        )
    return float(looks)


def declared_looks(view: View) -> float | None:
    """Mean^2 / variance of a pixel by the looks and the texture that a view declares; None without looks."""
    if view.looks is None:
        return None
    return Law(view.looks, view.texture or math.inf).equivalent_looks


def looks_of(scene: Scene, view: View) -> float:
    """`declared_looks` of a view, or an estimate from its first image."""
    declared = declared_looks(view)
    if declared is not None:
        return declared
    return estimated_looks(scene, view, scene.measured(view, next(iter(view.images))))


def usable_pixels(scene: Scene, view: View, measured: np.ndarray) -> np.ndarray:
    """Pixels that are finite, unmasked and off the image's edge, (rows, cols) bool."""
    usable = np.isfinite(measured)
    mask = scene.mask(view)
    if mask is not None:
        usable &= mask
    usable[:BORDER] = usable[-BORDER:] = False
    usable[:, :BORDER] = usable[:, -BORDER:] = False
    return usable


def observe(scene: Scene, view: View, polarization: str, lit: np.ndarray) -> Observation:
    """The measured image of a view with its masks; `lit`, (rows, cols) bool: what the declared model's surface covers.

    Looks that are not declared are estimated from the image. Raises InputError where they cannot be, and
    NothingLitError where no pixel is left.
    """
    measured = scene.measured(view, polarization)
    usable = usable_pixels(scene, view, measured)
    inner = minimum_filter(lit.astype(np.uint8), size=3, mode="constant") > 0
    positive = np.where(np.isfinite(measured), measured, 0) > 0
    interior = usable & inner & positive
    if not interior.any():
        raise NothingLitError(
            f"{scene.name}: views {view.name}: no pixel of {polarization} is lit by the model, unmasked and "
            f"positive at once; the image and the mesh do not meet, or sigma0 is 0 at the declared parameters"
        )
    distance = distance_transform_edt(~lit) if lit.any() else np.full(lit.shape, np.inf)
    dark = usable & (distance > FAR)
    # the far tails of a response are no power that a model lacks
    measured = np.where(dark & positive & (measured < NOTHING * np.median(measured[interior])), 0.0, measured)
    looks, estimated = declared_looks(view), view.looks is None or view.looks_estimated
    if looks is None:
        looks = estimated_looks(scene, view, np.where(interior, measured, np.nan))
    return Observation(
        view,
        polarization,
        measured,
        interior,
        usable & inner & ~positive,
        dark,
        float(looks),
        estimated,
        texture=view.texture or math.inf,
    )
