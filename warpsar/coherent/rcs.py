"""`warpsar.rcs`: radar cross-sections of a scene over directions and frequencies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions
from warpsar.coherent.interval import ends_m2, error_m2
from warpsar.coherent.joints import joints
from warpsar.coherent.left_out import left_out_warning
from warpsar.coherent.rough_models import load
from warpsar.coherent.sides import refuse_inside
from warpsar.coherent.sweep import FACE_BYTES, POLARIZATIONS, RAYS_PER_WAVELENGTH, TERMS, sweep
from warpsar.coherent.traced import HIT_BYTES, RAYS_TOGETHER
from warpsar.errors import InputError, refuse_number, shown
from warpsar.kernels.coherent.rough_models import rough_kernel
from warpsar.runtime import console, devices, threads
from warpsar.runtime.memory import default_gib
from warpsar.scene.scene import scene_or_file
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.world import World

FREQUENCIES_HZ = (1e6, 1e13)
FEW = 1.0
"""Fresnel number below which rays in a duct are no better than a constant level (docs/coherent.md)."""
CALIBRATED = ("single", "multibounce", "edges")
"""Terms with which the interval was found."""
LARGE_DB, WEAK_DB = 1.0, 30.0
"""An error of the spacing that is said, at values that are not so far under the strongest one."""
THICK = 0.05
"""Thickness of a stack on metal over the wavelength, from which on its corners are no edges of a surface impedance
(docs/coherent-checks.md, "Edges of coated metal")."""
NOTHING = 1e-20
"""Power of a polarization that has no return, over that of the strongest one: -200 dB.

Sums of float64 round at 1e-16 in amplitude for each of up to 1e6 tubes, 1e-10 together. No radar tells polarizations
apart by half as many decibels.
"""
_BYTES = 16 * len(POLARIZATIONS)
_TUBE_BYTES = 120
"""Memory for each tube of a direction with its parts; hits go in blocks."""
_ROUGH_BYTES = 130
"""Of a rough place on the device."""
_MOST_GIB = 60.0
"""Of the tubes of a direction: they are numbered in 32 bits."""


@dataclass(frozen=True)
class Rcs:
    """Radar cross-sections. Arrays have the shape (azimuths, incidences, frequencies, polarizations) unless said."""

    azimuth_deg: NDArray[np.float64]
    """(a,) [deg], clockwise from north."""
    incidence_deg: NDArray[np.float64]
    """(i,) [deg], from the zenith."""
    frequency_hz: NDArray[np.float64]
    """(f,) [Hz]."""
    polarizations: tuple[str, ...]
    amplitude_m: NDArray[np.complex128]
    """A [m] of E = A e^{-jkR} / R; its phase is zero at the reference point."""
    terms_m: dict[str, NDArray[np.complex128]]
    """The same of each term by itself."""
    bounces_m: dict[int, NDArray[np.complex128]]
    """The same of each number of bounces, from 2 on, which `multibounce` is the sum of; empty unless asked for."""
    fresnel_number: NDArray[np.float64]
    """(a, i, f): of what the tubes meet after their first hit; NaN where none meets anything."""
    ray_spacing_m: float
    spacing_error_m: NDArray[np.float64]
    """How far tubes of twice the width take the amplitude [m]: about what the spacing leaves open."""
    model_error_m: NDArray[np.float64]
    """What physical optics, edges and rays leave out of the amplitude [m], root mean square (`interval.error_m2`).

    NaN where it is not known: for HV and VH, for a body that is not all of bare metal, and without one of the
    `CALIBRATED` terms.
    """
    refined: NDArray[np.float64]
    """(a, i): share of the tubes that got too wide and were cut."""
    aliased: NDArray[np.float64]
    """(a, i): share of the tubes that alias even so."""
    segments: int
    warnings: tuple[str, ...]

    def __repr__(self) -> str:
        a, i, f, _ = self.amplitude_m.shape
        pols = ", ".join(self.polarizations)
        return f"<Rcs: {a} azimuths, {i} incidences, {f} frequencies, {pols}>"

    @property
    def rcs_m2(self) -> NDArray[np.float64]:
        """Radar cross-section 4 pi abs(A)^2 [m2]."""
        return 4.0 * np.pi * np.abs(self.amplitude_m) ** 2

    @property
    def rcs_dbsm(self) -> NDArray[np.float64]:
        """Decibels over a square metre; -inf where nothing comes back."""
        with np.errstate(divide="ignore"):
            return 10.0 * np.log10(self.rcs_m2)

    @property
    def interval_dbsm(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Ends of the 95 % interval of the RCS by `model_error_m` [dBsm]; NaN where that is not known."""
        low, high = ends_m2(self.rcs_m2, 4.0 * np.pi * self.model_error_m**2)
        with np.errstate(divide="ignore"):
            return 10.0 * np.log10(low), 10.0 * np.log10(high)

    @property
    def spacing_error_db(self) -> NDArray[np.float64]:
        """20 log10(1 + error / abs(A)): how much the spacing may raise the RCS [dB]; NaN where nothing comes back."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return 20.0 * np.log10(1.0 + self.spacing_error_m / np.abs(self.amplitude_m))


def rcs(
    scene: World | PathLike[str] | str,
    azimuths_deg: ArrayLike,
    incidences_deg: ArrayLike = 90.0,
    frequencies_hz: ArrayLike | None = None,
    *,
    device: str | None = None,
    rays_per_wavelength: float = RAYS_PER_WAVELENGTH,
    layers: bool = False,
) -> Rcs:
    """Monostatic radar cross-sections of a scene, or of a scene file, at every pair of angles and every frequency.

    The wave is plane. With `[radar] slant_range_m` it comes from a place at that distance to the reference point.

    `frequencies_hz` ascend; without them it is that of `[radar]`, as are polarizations, `terms` and `max_bounces`. The
    reference point has phase zero. `layers` gives each number of bounces by itself, too. docs/coherent.md says what is
    computed and where it holds.

    Raises InputError for angles and frequencies out of range, and DeviceError.
    """
    scene = scene_or_file(scene)
    asked = RcsRequest.of(scene, azimuths_deg, incidences_deg, frequencies_hz, device, rays_per_wavelength, layers)
    return swept(scene, asked, layers)


@dataclass(frozen=True)
class RcsRequest:
    """What is asked of a scene, checked."""

    azimuths: NDArray[np.float64]
    incidences: NDArray[np.float64]
    frequencies: NDArray[np.float64]
    rays_per_wavelength: float
    body: CoherentBody
    cautions: tuple[str, ...]

    @classmethod
    def of(
        cls,
        scene: World,
        azimuths_deg: ArrayLike,
        incidences_deg: ArrayLike,
        frequencies_hz: ArrayLike | None,
        device: str | None,
        rays_per_wavelength: float,
        layers: bool = False,
        max_memory_gib: float | None = None,
    ) -> RcsRequest:
        """Raises InputError and DeviceError. `max_memory_gib` bounds what the sweep holds."""
        azimuths, incidences = _numbers(azimuths_deg, "azimuths"), _numbers(incidences_deg, "incidences")
        frequencies = _numbers(scene.radar.frequency_hz if frequencies_hz is None else frequencies_hz, "frequencies")
        _refuse(scene, azimuths, incidences, frequencies, rays_per_wavelength)
        where = devices.resolve_device(device)
        kernels = ["tubes", "cells", "radiate", "edges", "edge_waves", "rough", "transmission"]
        kernels += ["free_lanes"] if where.is_cpu else []
        devices.load_kernels(where, *(f"coherent.{name}" for name in kernels))
        there = default_gib(where) if max_memory_gib is None else max_memory_gib
        _refuse_size(azimuths.size * incidences.size, frequencies.size, there, scene.radar.max_bounces * layers)
        body = CoherentBody.of(scene, where)
        if "rough" in scene.radar.terms:
            load(body.patches.kind, rough_kernel, where)
        _refuse_body(scene, body, SPEED_OF_LIGHT / frequencies.max(), rays_per_wavelength, there)
        found = cls(
            azimuths, incidences, frequencies, rays_per_wavelength, body, tuple(cautions(scene, frequencies.max()))
        )
        if max_memory_gib is not None and (needed := working_gib(scene, found, layers)) > max_memory_gib:
            raise InputError(
                f"{scene.name}: rcs: found {needed:.3g} GiB for rough places, the launches of all threads and the "
                f"amplitudes; --max-memory allows {max_memory_gib:.3g} GiB; ask for fewer directions, frequencies or "
                f"max_bounces, or fewer threads (WARPSAR_THREADS)"
            )
        refuse_inside(scene, body, found.directions)
        return found

    @cached_property
    def directions(self) -> Directions:
        """All pairs of angles, incidence by incidence."""
        pairs = np.stack(np.meshgrid(self.azimuths, self.incidences, indexing="ij"), axis=-1).reshape(-1, 2)
        return Directions.of(pairs[:, 0], pairs[:, 1])


def swept(scene: World, asked: RcsRequest, layers: bool = False) -> Rcs:
    """The sweep of `rcs`, once all is checked."""
    azimuths, incidences, frequencies = asked.azimuths, asked.incidences, asked.frequencies
    bar = console.progress(len(asked.directions), "directions", "direction")
    found = sweep(
        asked.body,
        asked.directions,
        frequencies.tolist(),
        terms=scene.radar.terms,
        max_bounces=scene.radar.max_bounces,
        rays_per_wavelength=asked.rays_per_wavelength,
        distance_m=scene.radar.slant_range_m,
        layers=layers,
        compare=True,
        progress=bar,
    )
    bar.close()
    shape = (azimuths.size, incidences.size)
    chosen = [POLARIZATIONS.index(name) for name in scene.radar.polarizations]
    terms = found.amplitude[..., chosen].reshape(*shape, frequencies.size, len(TERMS), len(chosen))
    assert found.spacing_error is not None
    bounces = {}
    if found.bounces is not None:
        each = found.bounces[..., chosen].reshape(*shape, frequencies.size, -1, len(chosen))
        met = np.flatnonzero(each.any(axis=(0, 1, 2, 4)))
        bounces = {int(b) + 2: each[:, :, :, b] for b in met}
    # (frequencies,) [m2]: of all four polarizations, whether they are asked for or not
    strongest = 4.0 * np.pi * (np.abs(found.amplitude.sum(axis=-2)) ** 2).max(axis=(0, -1))
    made = Rcs(
        azimuths,
        incidences,
        frequencies,
        tuple(scene.radar.polarizations),
        terms.sum(axis=3),
        {name: terms[:, :, :, i] for i, name in enumerate(TERMS) if name in scene.radar.terms},
        bounces,
        found.fresnel_number.reshape(*shape, -1),
        found.spacing_m,
        found.spacing_error[..., chosen].reshape(*shape, frequencies.size, len(chosen)),
        np.full((*shape, frequencies.size, len(chosen)), np.nan),
        found.refined.reshape(shape),
        found.aliased.reshape(shape),
        found.segments,
        asked.cautions,
    )
    used = [scene.materials[name] for name in scene.mesh.materials]
    metal = all(one.bare for one in used)
    if metal and set(CALIBRATED) <= set(scene.radar.terms):
        made = replace(made, model_error_m=_model_error_m(made))
    return replace(made, warnings=(*asked.cautions, *_warnings(scene, made, strongest)))


def _model_error_m(made: Rcs) -> NDArray[np.float64]:
    wavelength = (SPEED_OF_LIGHT / made.frequency_hz)[:, None]
    four_pi = 4.0 * np.pi
    edges, bounced = (four_pi * np.abs(made.terms_m[name]) ** 2 for name in ("edges", "multibounce"))
    error = error_m2(wavelength, edges, bounced, made.fresnel_number[..., None])
    same = np.array([name[0] == name[1] for name in made.polarizations])
    return np.where(same, np.sqrt(error / four_pi), np.nan)


def _numbers(given: ArrayLike, where: str) -> NDArray[np.float64]:
    try:
        return np.atleast_1d(np.asarray(given, np.float64))
    except (TypeError, ValueError):
        raise InputError(f"{where}: found {shown(given)}; must be one or more numbers") from None


def _refuse(
    scene: World,
    azimuths: NDArray[np.float64],
    incidences: NDArray[np.float64],
    frequencies: NDArray[np.float64],
    rays_per_wavelength: float,
) -> None:
    """One message for everything that is no angle, no frequency, or no material."""
    problems = []
    bounds = {"azimuths": (azimuths, -360.0, 360.0), "incidences": (incidences, 0.0, 180.0)}
    bounds["frequencies"] = (frequencies, *FREQUENCIES_HZ)
    for name, (values, low, high) in bounds.items():
        bad = ~((values >= low) & (values <= high))  # NaN is between nothing
        if values.ndim != 1 or not values.size:
            problems.append(f"{name}: found an array of shape {values.shape}; must be one or more numbers")
        elif bad.any():
            problems.append(f"{name}: found {values[bad][0]:g}; must be from {low:g} to {high:g}")
    if frequencies.ndim == 1 and (np.diff(frequencies) <= 0.0).any():
        problems.append("frequencies: found a value that is not above the one before it; must ascend")
    refuse_number(rays_per_wavelength, "rays_per_wavelength")
    if not 4.0 <= rays_per_wavelength <= 100.0:
        problems.append(f"rays_per_wavelength: found {rays_per_wavelength:g}; must be from 4 to 100")
    for name, material in scene.materials.items():
        if material.layout != "uniform" and any(isinstance(getattr(material, key), str) for key in ("eps_r",)):
            problems.append(f'materials.{name}.layout: found "{material.layout}"; must be "uniform" for an RCS')
        else:
            problems += [
                f"materials.{name}.{key}: found a field; must be a number for an RCS" for key in material.fields
            ]
    if problems:
        raise InputError("\n  ".join([f"{scene.name}:", *problems]) if problems[1:] else problems[0])


def _amplitudes_gib(directions: int, frequencies: int, layers: int) -> float:
    held = len(TERMS) + 1 + 2 * layers  # the error; layers twice, as they are turned to the reference point
    return directions * frequencies * held * _BYTES / 2**30


def working_gib(scene: World, asked: RcsRequest, layers: bool) -> float:
    """What a sweep holds [GiB]: rough places, the launches of all threads, and the amplitudes."""
    device, bounces = asked.body.device, scene.radar.bounces
    kind, several = ("cpu", threads.thread_count()) if device.is_cpu else ("cuda", 1)
    rough = len(asked.body.patches)
    launches = several * (RAYS_TOGETHER[kind] * bounces * HIT_BYTES + (FACE_BYTES[kind] if rough else 0))
    amplitudes = _amplitudes_gib(len(asked.directions), asked.frequencies.size, scene.radar.max_bounces * layers)
    return amplitudes + (_ROUGH_BYTES * rough + launches) / 2**30


def _refuse_size(directions: int, frequencies: int, there: float, layers: int) -> None:
    """`layers`: numbers of bounces by themselves; `there`: memory [GiB]."""
    if (needed := _amplitudes_gib(directions, frequencies, layers)) > there:
        raise InputError(
            f"{directions} directions x {frequencies} frequencies: found {needed:.1f} GiB of amplitudes; must be up to "
            f"{there:.1f} GiB, so ask for fewer at a time"
        )


def _refuse_body(
    scene: World, body: CoherentBody, wavelength: float, rays_per_wavelength: float, memory_gib: float
) -> None:
    """Refuse a body of too many tubes, and a radar inside it."""
    tubes = (2.0 * body.radius * rays_per_wavelength / wavelength) ** 2
    if (needed := tubes * _TUBE_BYTES / 2**30) > (there := min(memory_gib, _MOST_GIB)):
        raise InputError(
            f"{scene.name}: found a body of {2 * body.radius:.3g} m, {tubes:.2g} tubes of {wavelength:.2g} m / "
            f"{rays_per_wavelength:g} for a direction ({needed:.3g} GiB); must be up to {there:.3g} GiB"
        )
    distance = scene.radar.slant_range_m
    nearest = float(np.linalg.norm(body.origin)) + body.standoff + body.radius
    if distance is not None and distance < nearest:
        raise InputError(
            f"{scene.name}: radar.slant_range_m: found {distance:g}; must be at least {nearest:.4g} for this body"
        )


def _warnings(scene: World, found: Rcs, strongest: NDArray[np.float64]) -> list[str]:
    """What a user should know before trusting the numbers; `strongest` (f,) is the largest RCS of any polarization."""
    warnings = []
    if (count := int((found.refined > 0.0).sum())) > 0:
        warnings.append(
            f"in {count} of {found.refined.size} directions up to {100 * found.refined.max():.2g} % of the tubes got "
            "too wide after curved faces and were cut"
        )
    if (count := int((found.aliased > 0.0).sum())) > 0:
        warnings.append(
            f"in {count} of {found.aliased.size} directions up to {100 * found.aliased.max():.2g} % of the tubes stay "
            "too wide: more --rays-per-wavelength makes them fewer"
        )
    # (f, p)
    nothing = found.rcs_m2.max(axis=(0, 1)) <= NOTHING * strongest[:, None]
    for p in np.flatnonzero((nothing & (strongest[:, None] > 0.0)).all(axis=0)):
        warnings.append(f"there is no {found.polarizations[p]} return: its numbers are rounding errors")
    strong = ~nothing & (found.rcs_m2 > 10.0 ** (-WEAK_DB / 10.0) * found.rcs_m2.max(axis=(0, 1)))
    if (count := int((strong & (found.spacing_error_db > LARGE_DB)).sum())) > 0:
        warnings.append(
            f"at {count} of {int(strong.sum())} values within {WEAK_DB:g} dB of the strongest one spacing_error_db is "
            f"above {LARGE_DB:g} dB: ask for more --rays-per-wavelength"
        )
    low = found.fresnel_number < FEW
    if low.any() and "multibounce" in scene.radar.terms:
        warnings.append(
            f"rays do not hold in a cavity at {int(low.sum())} of {low.size} values (Fresnel number down to "
            f"{found.fresnel_number[low].min():.2g}): multibounce is no better than chance there"
            + (", and the interval counts it all as error" if np.isfinite(found.model_error_m).any() else "")
        )
    return warnings


def cautions(scene: World, highest_hz: float | None = None) -> list[str]:
    """What a scene may mean otherwise than it says, known before any ray is sent; without a frequency the radar's."""
    found = left_out_warning(scene, "an RCS")
    mesh = scene.mesh
    used = {name: scene.materials[name] for name in mesh.materials}
    for name, material in used.items():
        if material.bare and material.eps_r is not None:
            found.append(f"materials.{name}: eps_r of a conductor has no effect without thickness_m")
    filled = [i for i, m in enumerate(used.values()) if m.solid]
    if filled:
        seams = joints(mesh.vertices, mesh.faces)
        open_edges = seams.other < 0
        for i in filled:
            if count := int((open_edges & (mesh.face_material[seams.face] == i)).sum()):
                found.append(
                    f"materials.{mesh.materials[i]}: its faces fill a half-space (no thickness_m), and the mesh is "
                    f"open at {count} edges: what is seen from behind is wrong"
                )
    dielectrics = sorted(name for name, m in used.items() if m.solid)
    if dielectrics and "edges" in scene.radar.terms:
        found.append(
            f"edges of {', '.join(dielectrics)} have no term: away from mirror directions the RCS is too low, often by "
            "many decibels"
        )
    coated = sorted(name for name, m in used.items() if m.conductor and m.stack)
    if coated and "edge_waves" in scene.radar.terms:
        found.append(
            f"edge_waves has nothing between edges of {', '.join(coated)}: it knows plates of bare metal alone"
        )
    thin_m = THICK * SPEED_OF_LIGHT / (highest_hz or scene.radar.frequency_hz)
    thick = [name for name in coated if sum(one.thickness_m for one in used[name].stack) > thin_m]
    if thick and "edges" in scene.radar.terms:
        found.append(
            f"edges of {', '.join(thick)} have the impedance of their layers, which are thicker than a twentieth of a "
            "wavelength: off by 3 to 6 dB where edges are all that comes back"
        )
    stacks = sorted(
        name
        for name, m in used.items()
        if not m.conductor and m.stack and (len(m.stack) > 1 or m.stack[0].mu_r not in (1.0, (1.0, 0.0)))
    )
    if stacks and "edges" in scene.radar.terms:
        found.append(
            f"edges of {', '.join(stacks)} have no term: stacks and magnetic slabs in air have their coefficient of "
            "reflection alone, which is right around mirror directions"
        )
    return found
