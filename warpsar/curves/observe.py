"""The curves that a scene declares, each beside the terms of the scene's model: the engine's amplitudes, kept on disk.

A duct's sweep takes a minute, and a fit asks for many.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
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
from warpsar.curves.angles import independent_deg, width_m
from warpsar.curves.metrics import decibels
from warpsar.curves.noise import share_of
from warpsar.curves.observed import ObservedCurve
from warpsar.io.images import replacing
from warpsar.kernels import coherent as kernels_of_coherent
from warpsar.version import __version__
from warpsar.world.curve import Curve
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.mesh import read_mesh
from warpsar.world.world import World

PER_DIRECTION = 8.0
"""Rows used for an independent direction: more say nothing new."""


def observe(
    world: World,
    *,
    cache: Path | None = None,
    device: str | None = None,
    thin: bool = True,
    per_direction: float = PER_DIRECTION,
) -> list[ObservedCurve]:
    """Every curve of a scene with the engine's terms, in the scene's order.

    `thin` leaves out rows that say nothing new: about `per_direction` stay for an independent direction.
    """
    swept = _Swept(cache, device)
    seen = [_observe(world, curve, swept, per_direction if thin else None) for curve in world.curves]
    return _leveled(seen, world)


class _Swept:
    """Sweeps of one scene. Curves of the same body, directions and frequency share one: it has every polarization."""

    def __init__(self, cache: Path | None, device: str | None) -> None:
        self._cache, self._device = cache, device
        self._made: dict[tuple[Any, ...], Amplitudes] = {}

    def amplitudes(
        self,
        world: World,
        azimuth_deg: NDArray[np.float64],
        incidence_deg: float,
        frequency_hz: float,
        bandwidth_hz: float,
        mesh: Path | None,
    ) -> Amplitudes:
        """As the function of this name; `mesh` is the file of the body, None of the scene's own."""
        key = mesh, azimuth_deg.tobytes(), incidence_deg, frequency_hz, bandwidth_hz
        if key not in self._made:
            self._made[key] = amplitudes(
                world,
                azimuth_deg,
                incidence_deg,
                frequency_hz,
                cache=self._cache,
                device=self._device,
                bandwidth_hz=bandwidth_hz,
            )
        return self._made[key]


def _leveled(seen: list[ObservedCurve], world: World) -> list[ObservedCurve]:
    """Curves without an absolute level times one factor: the median of model over measurement on the train curves."""
    known = [curve.profiles is None for curve in world.curves]
    loose = [one for one, absolute in zip(seen, known, strict=True) if not absolute]
    if not loose:
        return seen
    fitted = [one for one in loose if one.role == "train"] or loose
    ratio = [decibels(np.abs(one.amplitude(world.radar.terms)) ** 2) - decibels(one.measured_m2) for one in fitted]
    level = float(np.median(np.concatenate(ratio)))
    return [
        one if absolute else replace(one, measured_m2=one.measured_m2 * 10.0 ** (level / 10.0), fitted_level_db=level)
        for one, absolute in zip(seen, known, strict=True)
    ]


def _observe(world: World, curve: Curve, swept: _Swept, most: float | None) -> ObservedCurve:
    table = curve.rows()
    if curve.mesh is not None:
        mesh = read_mesh(curve.mesh)
        world = replace(world, mesh=mesh, materials={name: world.materials[name] for name in mesh.materials})
    used = table.used(curve.mask)
    azimuth, incidence = table.azimuth_deg[used], table.incidence_deg[used]
    frequency, pol = float(np.median(table.frequency_hz)), table.polarization[0]
    step = independent_deg(width_m(world.mesh, azimuth, incidence), frequency)
    bare = ObservedCurve(
        name=f"{curve.file.stem} {frequency / 1e9:.4g} GHz {pol}",
        frequency_hz=frequency,
        polarization=pol,
        role=curve.role,
        azimuth_deg=azimuth,
        incidence_deg=incidence,
        measured_m2=table.rcs_m2[used],
        terms={},
        step_deg=step,
        background_m2=None if curve.background_dbsm is None else 10.0 ** (curve.background_dbsm / 10.0),
        share=None if curve.error_db is None else share_of(curve.error_db),
    )
    bare = bare if most is None else bare.thinned(most)
    bandwidth = 0.0 if curve.profiles is None else curve.profiles.bandwidth_hz
    return bare.beside(_terms(world, bare, swept, bandwidth, curve.mesh))


def _terms(
    world: World, one: ObservedCurve, swept: _Swept, bandwidth_hz: float, mesh: Path | None
) -> dict[str, NDArray[np.complex128]]:
    """The terms in the curve's directions; those of one incidence are found together."""
    found: dict[str, NDArray[np.complex128]] = {}
    for incidence in np.unique(one.incidence_deg):
        rows = np.flatnonzero(one.incidence_deg == incidence)
        azimuth, place = np.unique((one.azimuth_deg[rows] + 180.0) % 360.0 - 180.0, return_inverse=True)
        made = swept.amplitudes(world, azimuth, float(incidence), one.frequency_hz, bandwidth_hz, mesh)
        for name, term in made.of(one.polarization).items():
            found.setdefault(name, np.zeros(len(one.azimuth_deg), np.complex128))[rows] = term[place]
    return found


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
