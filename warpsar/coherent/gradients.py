"""`warpsar.rcs_gradients`: how complex amplitudes change with materials, vertices and poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from warpsar.coherent.borders import border_slopes
from warpsar.coherent.held import Held, Sight, TubePaths, TubeSlopes
from warpsar.coherent.learned import RcsParameter, learned, moves_vertices
from warpsar.coherent.rays import CellGrid
from warpsar.coherent.rcs import Rcs, RcsRequest, swept
from warpsar.coherent.shape import beyond
from warpsar.coherent.sweep import POLARIZATIONS, RAYS_PER_WAVELENGTH, Worker, batches_of, shift, tubes_of
from warpsar.coherent.traced import LEVELS
from warpsar.errors import InputError
from warpsar.parameters.parameter import Parameter
from warpsar.parameters.tree import Named, Parameters, parameters_of
from warpsar.runtime import devices, threads
from warpsar.scene.scene import scene_or_file
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.world import World

VIEWS = 64
"""Directions that are pulled together, at most: each brings what it sees of edges and faces."""
TASKS = 4
"""And tasks of the sweep."""
GRAZING = 1e-9
"""A flat face is neither lit nor dark where its normal has this cosine to the radar, or less."""


@dataclass(frozen=True)
class RcsGradients:
    """Amplitudes of a scene, and their derivatives to some parameters."""

    rcs: Rcs
    """The amplitudes, as `warpsar.rcs` gives them."""
    parameters: tuple[str, ...]
    _scene: World = field(repr=False)
    _tree: Parameters[Parameter] = field(repr=False)
    _asked: RcsRequest = field(repr=False)
    _learned: Mapping[str, RcsParameter] = field(repr=False)

    def vjp(self, cotangent: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Gradients of Re sum conj(cotangent) A, an array of each parameter's shape, per unit of the parameter.

        `cotangent` is complex, of the shape of `rcs.amplitude_m`: of a loss L it is dL/dRe(A) + j dL/dIm(A). Raises
        InputError for another shape.
        """
        given = np.asarray(cotangent, np.complex128)
        if given.shape != self.rcs.amplitude_m.shape:
            raise InputError(f"cotangent: found shape {given.shape}; must be {self.rcs.amplitude_m.shape}")
        total = {name: np.zeros(one.shape) for name, one in self._learned.items()}
        flat = given.reshape(1, -1, *given.shape[2:])
        some = np.flatnonzero(flat.any(axis=(0, 2, 3)))
        counts = [tubes_of(self._asked.body, self._asked.directions, int(i), self._worker.spacing) for i in some]
        batches = [some[part] for part in batches_of(counts, TASKS * self._worker.task, VIEWS)]
        for _, (part,) in self._pulled([(which, flat[:, which]) for which in batches]):
            for name, one in self._learned.items():
                total[name] += one.gradient(part)
        return Named(self._tree, total)

    def jacobian(self) -> dict[str, NDArray[np.complex128]]:
        """dA / d parameter, complex: the shape of `rcs.amplitude_m`, then the parameter's.

        It takes two reverse passes for every frequency and polarization.
        """
        shape = self.rcs.amplitude_m.shape
        size = int(np.prod(shape[2:]))
        unit = np.concatenate([np.eye(size), 1j * np.eye(size)]).reshape(-1, 1, *shape[2:])
        total = {
            name: np.zeros((shape[0] * shape[1], size, *one.shape), complex) for name, one in self._learned.items()
        }
        for (index,), parts in self._pulled([(np.array([i]), unit) for i in range(shape[0] * shape[1])]):
            for i, part in enumerate(parts):
                for name, one in self._learned.items():
                    total[name][index, i % size] += (1.0 if i < size else 1.0j) * one.gradient(part)
        found = {name: total[name].reshape(*shape, *one.shape) for name, one in self._learned.items()}
        return Named(self._tree, found)

    def _pulled(
        self, cotangents: Sequence[tuple[NDArray[np.intp], NDArray[np.complex128]]]
    ) -> Iterator[tuple[NDArray[np.intp], list[TubeSlopes]]]:
        """For some directions (d,) each the gradients of their cotangents (c, d, frequencies, polarizations), in
        pieces."""
        worker, asked = self._worker, self._asked
        turn = shift(asked.body, asked.directions, worker.k, worker.distance).conj()
        chosen = [POLARIZATIONS.index(name) for name in self.rcs.polarizations]
        faces = beyond(asked.body.shape)

        def tasks() -> Iterator[partial[tuple[NDArray[np.intp], list[TubeSlopes]]]]:
            for which, given in cotangents:
                seed = np.zeros((*given.shape[:2], len(worker.k), len(POLARIZATIONS)), complex)
                seed[..., chosen] = given * turn[which][:, :, None]
                sight = Sight(worker, asked.directions[which], faces)
                yield partial(_of_faces, which, sight, seed)
                grid = CellGrid(asked.body, sight.directions, worker.spacing, worker.distance)
                for start in range(0, len(grid), worker.tracer.together):
                    yield partial(_of_tubes, which, sight, grid, start, seed)
                if moves_vertices(self.parameters):
                    yield partial(_of_borders, which, sight, seed)

        yield from threads.ordered(tasks(), asked.body.device)

    @cached_property
    def _worker(self) -> Worker:
        radar, asked = self._scene.radar, self._asked
        k = 2.0 * np.pi * asked.frequencies / SPEED_OF_LIGHT
        spacing = float(2.0 * np.pi / k.max() / asked.rays_per_wavelength)
        return Worker(asked.body, k, spacing, radar.terms, radar.max_bounces, LEVELS, radar.slant_range_m)


def rcs_gradients(
    scene: World | PathLike[str] | str,
    azimuths_deg: ArrayLike,
    incidences_deg: ArrayLike = 90.0,
    frequencies_hz: ArrayLike | None = None,
    *,
    parameters: Sequence[str],
    device: str | None = None,
    rays_per_wavelength: float = RAYS_PER_WAVELENGTH,
) -> RcsGradients:
    """Amplitudes as `warpsar.rcs` gives them, and their derivatives to `parameters`, in reverse mode.

    >>> found = warpsar.rcs_gradients(scene, [30.0, 45.0], 60.0, parameters=["materials.body.eps_r", "mesh.vertices"])
    >>> gradients = found.vjp(found.rcs.amplitude_m - measured)  # of half the sum of squares
    >>> slopes = found.jacobian()["mesh.vertices"]               # (azimuths, incidences, frequencies, pol., n, 3)

    Parameters, with shapes and units:

    - `materials.NAME.eps_r`: as in the scene, () or (2,)
    - `materials.NAME.thickness_m`, `materials.NAME.rms_height_m`: () [m]
    - `materials.NAME.layers.0.eps_r`, `.mu_r`: as in the scene, () or (2,), and `.thickness_m`: () [m], of each layer;
      `.eps_r_loss`, `.mu_r_loss`: (), the losses eps'' and mu'' that it states
    - `materials.NAME.correlation_length_m`: as in the scene, () or (2,) [m]
    - `mesh.vertices`: (n, 3) [m]
    - `pose.position_m`, `objects.NAME.position_m`: (3,) [m]
    - `pose.heading_deg`, `.pitch_deg`, `.roll_deg`, and those of an object: () [degrees]

    `pose` moves all that there is, and turns it about the reference point. Held are which faces an edge has, which
    piece of an edge and which scatterer the radar sees, and how many scatterers there are. Borders of light move with
    the edges that make them. docs/coherent-checks.md says more.

    Raises InputError as `warpsar.rcs` does, and for parameters that have no derivative; DeviceError.
    """
    scene = scene_or_file(scene)
    for term in {"transmission", "edge_waves"} & set(scene.radar.terms):
        raise InputError(f'{scene.name}: radar.terms: found "{term}", which has no derivative; leave it out here')
    tree = parameters_of(scene)
    found = learned(scene, parameters, tree)
    asked = RcsRequest.of(scene, azimuths_deg, incidences_deg, frequencies_hz, device, rays_per_wavelength)
    devices.load_kernels(asked.body.device, "coherent.slopes", "coherent.borders")
    if moves_vertices(found):
        _refuse_grazing(asked)
    return RcsGradients(swept(scene, asked), tuple(found), scene, tree, asked, found)


def _refuse_grazing(asked: RcsRequest) -> None:
    cosine = np.abs(asked.directions.s @ asked.body.shape.regions.normal.T)
    if (cosine < GRAZING).any():
        index = int(np.flatnonzero((cosine < GRAZING).any(axis=1))[0])
        azimuth, incidence = divmod(index, asked.incidences.size)
        raise InputError(
            f"azimuth {asked.azimuths[azimuth]:g}, incidence {asked.incidences[incidence]:g}: a flat face stands "
            "exactly along the line of sight. It appears or vanishes as it moves, so vertices and poses have no "
            "derivative; ask for a direction beside it"
        )


def _of_faces(
    which: NDArray[np.intp], sight: Sight, seed: NDArray[np.complex128]
) -> tuple[NDArray[np.intp], list[TubeSlopes]]:
    held = Held(sight)
    held.faces()
    return which, _backward(held, seed)


def _of_tubes(
    which: NDArray[np.intp], sight: Sight, grid: CellGrid, start: int, seed: NDArray[np.complex128]
) -> tuple[NDArray[np.intp], list[TubeSlopes]]:
    total = [TubeSlopes.empty(sight.worker.body) for _ in seed]
    tracer = sight.worker.tracer
    for traced in tracer.narrowed(sight.radars, grid, start, min(start + tracer.together, len(grid))):
        hits, count = traced.found()
        chosen = np.flatnonzero((traced.kept.numpy() != 0) & (count > 0))
        hits = hits[chosen]
        zero = np.zeros(len(chosen))
        size, view = traced.rays.cells.size.numpy()[chosen], traced.rays.cells.view.numpy()[chosen]
        paths = TubePaths(
            view,
            traced.rays.cells.place.numpy()[chosen],
            np.stack([size[:, 0], zero], axis=1),
            np.stack([zero, size[:, 1]], axis=1),
            count[chosen],
            hits["face"],
            hits["caustics"],
            sight.counts(view, hits["face"], hits["seen"]),
        )
        by, paths = paths.sending()
        if not len(by):
            continue
        held = Held(sight)
        held.follow(paths)
        for sum_, part in zip(total, _backward(held, seed), strict=True):
            sum_.add(part)
    return which, total


def _of_borders(
    which: NDArray[np.intp], sight: Sight, seed: NDArray[np.complex128]
) -> tuple[NDArray[np.intp], list[TubeSlopes]]:
    return which, border_slopes(sight, seed)


def _backward(held: Held, seed: NDArray[np.complex128]) -> list[TubeSlopes]:
    held.run()
    parts: list[Any] = [np.stack([one.real, one.imag], axis=-1) for one in seed]
    return [held.slopes(held.amplitude, part) for part in parts]
