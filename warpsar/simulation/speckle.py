"""Speckle on simulated images, and the scene that names them as measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.fft import fft, next_fast_len

from warpsar.effects.base.phase import Response
from warpsar.effects.registry import declared, response_of
from warpsar.errors import InputError
from warpsar.kernels.codes import Polarization
from warpsar.kernels.effects.point_spread import SINC_WIDTH, TAYLOR_WIDTH
from warpsar.scene.scene import Scene
from warpsar.speckle.draws import correlated_power
from warpsar.speckle.law import Law
from warpsar.world.taper import taper

_STREAM = 0x5BEC  # keeps these numbers apart from any others of the same seed


SHARP = Response()
"""A response narrower than a pixel, as far as anybody states."""
_WIDTHS = {"none": float(SINC_WIDTH), "taylor": float(TAYLOR_WIDTH)}  # in cells of the band
_SAMPLES = 1024  # of a band


def responses(scene: Scene) -> dict[str, Response]:
    """The response that the scene's effects ask for in every view, by name."""
    return {view.name: response_of(declared(scene, view)) for view in scene.views}


def speckled(
    beta0: NDArray[np.float32],
    looks: float,
    *,
    seed: int,
    view: int,
    polarization: str,
    response: Response = SHARP,
    spacing_m: tuple[float, float] = (1.0, 1.0),
) -> NDArray[np.float32]:
    """The image times fully developed speckle of `looks` looks, shape (rows, cols), float32.

    Each pixel is multiplied by a gamma variate of shape `looks` and mean one, so its variance is beta0^2 / looks
    (Ulaby, Moore and Fung 1986, section 12). Neighbours share speckle as the `response` makes them: the correlation of
    the power is the square of the response's own autocorrelation (Goodman, Speckle Phenomena in Optics, 2007, section
    4.4). Without a response pixels are independent. The same `seed`, number of the `view` and `polarization` give the
    same image; another of any of them gives an independent one.
    """
    stream = np.random.default_rng([_STREAM, seed, view, Polarization[polarization]])
    if response.width_m == (None, None):
        return (beta0 * stream.gamma(looks, 1.0 / looks, beta0.shape)).astype(np.float32)
    axes = [
        field_amplitudes(width, window, step, count)
        for width, window, step, count in zip(response.width_m, response.taper, spacing_m, beta0.shape, strict=True)
    ]
    power = correlated_power(stream, Law(looks), np.outer(*axes).astype(np.float32))
    return (beta0 * power[: beta0.shape[0], : beta0.shape[1]]).astype(np.float32)


def field_amplitudes(width_m: float | None, taper_name: str | None, step_m: float, count: int) -> NDArray[np.float64]:
    """Roots of the spectrum of a field along an axis of `count` pixels or some more, of mean square 1: all 1 where no
    width is stated. Without the name of a taper the response is a Gaussian, as `point_spread` has it."""
    if width_m is None:
        return np.ones(next_fast_len(count))
    reach = int(np.ceil(4.0 * width_m / step_m))  # beyond it the far side of the image is not the neighbour
    size = next_fast_len(count + reach)
    lags_m = step_m * np.minimum(np.arange(size), size - np.arange(size))
    power = np.maximum(fft(autocorrelation(width_m, taper_name, lags_m)).real, 0.0)
    return np.asarray(np.sqrt(power / power.mean()))


def autocorrelation(width_m: float, taper_name: str | None, lags_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of the field that a system of that half-power width makes of independent scatterers, at `lags_m`, 1 at lag 0.

    A band with the taper w has it as the Fourier transform of w^2. A Gaussian response of power with the standard
    deviation s has a field of sqrt(2) s, whose autocorrelation is as wide as 2 s.
    """
    if taper_name is None:
        s = width_m / np.sqrt(8.0 * np.log(2.0))
        return np.asarray(np.exp(-(lags_m**2) / (8.0 * s**2)))
    cell_m = width_m / _WIDTHS[taper_name]
    position = (np.arange(_SAMPLES) + 0.5) / _SAMPLES - 0.5
    weights = taper(taper_name, position) ** 2
    return np.asarray(np.cos(2.0 * np.pi * np.outer(lags_m / cell_m, position)) @ weights / weights.sum())


def suffix(looks: float) -> str:
    """What the name of a speckled image adds to its view's: "_looks4"."""
    return f"_looks{looks:g}"


def refuse_declaring(scene: Scene, out: Path, looks: float | None) -> None:
    """Raise InputError where `declare` could not do its work, before any other is done."""
    if looks is None:
        raise InputError("--declare: found no --looks; allowed is --looks L, since measured images have speckle")
    if (out / "scene.toml").resolve() == scene.path:
        raise InputError(
            f"--out: found {out}, where the scene file itself lies and --declare would replace it; allowed is another"
        )


def declare(scene: Scene, out: Path, looks: float) -> str:
    """Write `scene.toml` in `out`, in which every view has its speckled EXR as its measured image; the file's name."""
    folder = out.resolve()
    views = []
    for view in scene.views:
        image = folder / f"{view.name}{suffix(looks)}.exr"
        images = dict.fromkeys(scene.radar.polarizations, image)
        views.append(view.model_copy(update={"images": images, "looks": looks}))
    replace(scene, views=views).save(out / "scene.toml")
    return "scene.toml"
