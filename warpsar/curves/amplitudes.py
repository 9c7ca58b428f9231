"""The engine's amplitudes of a scene, term by term, kept on disk.

A duct's sweep takes a minute, a fit asks for many.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache as once
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar import coherent as room_of_coherent
from warpsar import kernels
from warpsar import world as room_of_world
from warpsar.coherent.rcs import rcs
from warpsar.coherent.sweep import RAYS_PER_WAVELENGTH, TERMS
from warpsar.io.images import replacing
from warpsar.kernels import coherent as kernels_of_coherent
from warpsar.version import __version__
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.world import World

_ROOMS = room_of_coherent, room_of_world, kernels, kernels_of_coherent
ENGINE = tuple(Path(str(room.__file__)).parent for room in _ROOMS)
"""Folders whose sources decide what `warpsar.rcs` returns."""


@dataclass(frozen=True)
class Amplitudes:
    """Of one frequency and incidence. Amplitudes are sqrt(4 pi) A, (directions, polarizations)."""

    terms: dict[str, NDArray[np.complex128]]
    polarizations: tuple[str, ...]
    fresnel_number: NDArray[np.float64]
    """(directions,); NaN where no ray meets the body twice."""
    segments: int

    def of(self, polarization: str) -> dict[str, NDArray[np.complex128]]:
        """The terms of one polarization, (directions,) each."""
        at = self.polarizations.index(polarization)
        return {name: term[:, at] for name, term in self.terms.items()}


def amplitudes(
    world: World,
    azimuth_deg: NDArray[np.float64],
    incidence_deg: float,
    frequency_hz: float,
    *,
    cache: Path | None = None,
    device: str | None = None,
    rays_per_wavelength: float = RAYS_PER_WAVELENGTH,
    bandwidth_hz: float = 0.0,
) -> Amplitudes:
    """All terms of `[radar] terms`, by `warpsar.rcs`; from the folder `cache` where they are there.

    With `bandwidth_hz` they are the mean over a band: the range bin at the reference point, without a window.
    """
    band, path = _band(world, frequency_hz, bandwidth_hz), None
    if cache is not None:
        path = cache / f"{_key(world, azimuth_deg, incidence_deg, band, rays_per_wavelength)}.npz"
        if (found := _read(path)) is not None:
            return found
    made = rcs(world, azimuth_deg, incidence_deg, band, device=device, rays_per_wavelength=rays_per_wavelength)
    root = np.sqrt(4.0 * np.pi)
    terms = {name: root * term[:, 0].mean(axis=1) for name, term in made.terms_m.items()}
    result = Amplitudes(terms, made.polarizations, made.fresnel_number[:, 0, len(band) // 2], made.segments)
    if path is not None:
        _write(path, result)
    return result


def _band(world: World, frequency_hz: float, bandwidth_hz: float) -> list[float]:
    """As many frequencies as tell ranges apart over the body, and two widths of a bin more: the middles of even parts.

    n of them repeat the bin every n widths, c / 2B each.
    """
    if not bandwidth_hz:
        return [frequency_hz]
    extent = float(np.linalg.norm(np.ptp(world.mesh.vertices, axis=0)))
    count = int(np.ceil(2.0 * extent * bandwidth_hz / SPEED_OF_LIGHT)) + 2
    steps = (np.arange(count) + 0.5) / count - 0.5
    return [float(f) for f in frequency_hz + bandwidth_hz * steps]


def _key(world: World, azimuth_deg: NDArray[np.float64], incidence_deg: float, band: list[float], rays: float) -> str:
    """What the amplitudes depend on: mesh, materials, radar, directions, seed, and the sources of the engine."""
    total = hashlib.sha256(engine_digest().encode())
    for array in (world.mesh.vertices, world.mesh.faces, world.mesh.face_material, azimuth_deg):
        total.update(np.ascontiguousarray(array).data)
    materials = [(name, world.materials[name].model_dump()) for name in world.mesh.materials]
    scene = __version__, materials, world.radar.model_dump(), world.reference_point_m, world.sampling.seed
    total.update(repr((*scene, incidence_deg, band, rays)).encode())
    return total.hexdigest()[:32]


@once
def engine_digest() -> str:
    """SHA-256 of the engine's sources, so that no amplitude outlives the code that made it."""
    return sources_digest(ENGINE)


def sources_digest(folders: Iterable[Path]) -> str:
    """SHA-256 of the names and the text of all Python files in some folders, without what lies below them."""
    total = hashlib.sha256()
    for folder in folders:
        for path in sorted(folder.glob("*.py")):
            text = path.read_bytes()
            total.update(f"{folder.name}/{path.name} {len(text)} ".encode())
            total.update(text)
    return total.hexdigest()


def _read(path: Path) -> Amplitudes | None:
    """What a finished run has left; a file that cannot be read is made again."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            terms = {name: stored[name] for name in TERMS if name in stored}
            polarizations = tuple(str(each) for each in stored["polarizations"])
            return Amplitudes(terms, polarizations, stored["fresnel_number"], int(stored["segments"]))
    except (OSError, ValueError, KeyError):
        return None


def _write(path: Path, found: Amplitudes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary, temporary.open("wb") as stream:
        arrays: dict[str, Any] = {"polarizations": np.array(found.polarizations), **found.terms}
        np.savez(stream, fresnel_number=found.fresnel_number, segments=found.segments, **arrays)
