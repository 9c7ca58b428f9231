"""Speckle on simulated images, and the scene that names them as measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.kernels.codes import Polarization
from warpsar.scene.scene import Scene

_STREAM = 0x5BEC  # keeps these numbers apart from any others of the same seed


def speckled(
    beta0: NDArray[np.float32], looks: float, *, seed: int, view: int, polarization: str
) -> NDArray[np.float32]:
    """The image times fully developed speckle of `looks` looks, shape (rows, cols), float32.

    Each pixel is multiplied by a gamma variate of shape `looks` and mean one, so its variance is beta0^2 / looks
    (Ulaby, Moore and Fung 1986, section 12). Pixels are independent (white). The same `seed`, number of the `view` and
    `polarization` give the same image; another of any of them gives an independent one.
    """
    stream = np.random.default_rng([_STREAM, seed, view, Polarization[polarization]])
    return (beta0 * stream.gamma(looks, 1.0 / looks, beta0.shape)).astype(np.float32)


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
