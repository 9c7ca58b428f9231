"""The engine's amplitudes of a scene, term by term, kept on disk.

A duct's sweep takes a minute, a fit asks for many.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.rcs import rcs
from warpsar.coherent.sweep import RAYS_PER_WAVELENGTH, TERMS
from warpsar.io.images import replacing
from warpsar.version import __version__
from warpsar.world.world import World


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
) -> Amplitudes:
    """All terms of `[radar] terms`, by `warpsar.rcs`; from the folder `cache` where they are there."""
    path = None
    if cache is not None:
        path = cache / f"{_key(world, azimuth_deg, incidence_deg, frequency_hz, rays_per_wavelength)}.npz"
        if (found := _read(path)) is not None:
            return found
    made = rcs(
        world, azimuth_deg, incidence_deg, [frequency_hz], device=device, rays_per_wavelength=rays_per_wavelength
    )
    root = np.sqrt(4.0 * np.pi)
    terms = {name: root * term[:, 0, 0] for name, term in made.terms_m.items()}
    result = Amplitudes(terms, made.polarizations, made.fresnel_number[:, 0, 0], made.segments)
    if path is not None:
        _write(path, result)
    return result


def _key(world: World, azimuth_deg: NDArray[np.float64], incidence_deg: float, frequency_hz: float, rays: float) -> str:
    """What the amplitudes depend on: mesh, materials, radar, directions, and the version of the code."""
    total = hashlib.sha256()
    for array in (world.mesh.vertices, world.mesh.faces, world.mesh.face_material, azimuth_deg):
        total.update(np.ascontiguousarray(array).data)
    materials = [(name, world.materials[name].model_dump()) for name in world.mesh.materials]
    radar = world.radar.model_dump()
    total.update(
        repr((__version__, materials, radar, world.reference_point_m, incidence_deg, frequency_hz, rays)).encode()
    )
    return total.hexdigest()[:32]


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
