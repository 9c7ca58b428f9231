"""Amplitudes of some directions with all that is discrete held, as programs that run backward."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.body import CoherentBody
from warpsar.coherent.directions import Directions, radar_records
from warpsar.coherent.records import host, records, upload
from warpsar.coherent.rough import surfaces
from warpsar.coherent.sweep import Worker
from warpsar.kernels.coherent import radiate, reflection, slopes, tubes
from warpsar.kernels.coherent.rough import RoughSurface
from warpsar.runtime.program import Program


@dataclass
class TubeSlopes:
    """Gradients of Re sum conj(cotangent) A to all that a program reads."""

    vertices: NDArray[np.float64]
    """(n, 3)."""
    stuff: Any
    """Records of `reflection.Face`, (materials,): summed over frequencies."""
    surfaces: Any
    """Records of `RoughSurface`, (materials,)."""

    @classmethod
    def empty(cls, body: CoherentBody) -> TubeSlopes:
        m = len(body.materials)
        return cls(np.zeros(body.shape.vertices.shape), records(reflection.Face, m), records(RoughSurface, m))

    def add(self, other: TubeSlopes) -> None:
        self.vertices += other.vertices
        for name in ("permittivity", "permeability", "thickness", "under", "rms_height"):
            self.stuff[name] += other.stuff[name]
        for name in ("permittivity", "rms_height", "length"):
            self.surfaces[name] += other.surfaces[name]


@dataclass(frozen=True)
class TubePaths:
    """Tubes with what they meet: n tubes, b bounces at most."""

    view: NDArray[np.int32]
    """Of which direction, (n,)."""
    place: NDArray[np.float64]
    """Middle along u and v [m], (n, 2)."""
    side_u: NDArray[np.float64]
    """Sides along u and v [m], (n, 2)."""
    side_v: NDArray[np.float64]
    count: NDArray[np.int32]
    """(n,)."""
    face: NDArray[np.int32]
    """(n, b)."""
    caustics: NDArray[np.int32]
    counts: NDArray[np.bool_]
    """Which hits send something to the radar, (n, b)."""

    def __getitem__(self, some: Any) -> TubePaths:
        return TubePaths(*(getattr(self, name)[some] for name in self.__dataclass_fields__))

    def sending(self) -> tuple[NDArray[np.intp], TubePaths]:
        """The tubes that send anything, up to the last hit that does: their numbers, and they, counts descending."""
        last = self.counts.shape[1] - np.argmax(self.counts[:, ::-1], axis=1)
        count = np.where(self.counts.any(axis=1), last, 0).astype(np.int32)
        by = np.argsort(-count, kind="stable")[: np.count_nonzero(count)]
        some = slice(0, int(count.max(initial=0)))
        each = replace(self, count=count)[by]
        face, caustics, counts = (getattr(each, name)[:, some] for name in ("face", "caustics", "counts"))
        return by, replace(each, face=face, caustics=caustics, counts=counts)


class Sight:
    """Some directions: their radars, and the flat regions that each sees as a whole."""

    def __init__(self, worker: Worker, directions: Directions, beyond: NDArray[np.int64]) -> None:
        self.worker, self.directions, self.beyond = worker, directions, beyond
        radars = radar_records(directions, worker.body.origin, worker.distance)
        self.radars = upload(radars, tubes.TubeRadar, worker.body.device)
        self.exact = worker.lit_regions(self.radars)
        self.whole: NDArray[np.bool_] = self.exact.numpy() != 0
        """The same on the host, (directions, regions)."""

    def counts(self, view: NDArray[np.int32], face: NDArray[np.int32], seen: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Which hits, (n, b), send something: those that the radar sees, of the terms that are asked for."""
        region = self.worker.body.shape.region[face[:, 0]]
        counts = seen != 0
        counts[:, 0] &= ("single" in self.worker.terms) & ~((region >= 0) & self.whole[view, region])
        counts[:, 1:] &= "multibounce" in self.worker.terms
        return counts


class Held:
    """A program that reads vertices and materials and adds up amplitudes in `slots` places."""

    def __init__(self, sight: Sight, slots: int | None = None) -> None:
        """Without `slots` each direction has a place."""
        self.sight, self.worker = sight, sight.worker
        body, device = self.worker.body, self.worker.body.device
        self.program = Program(device)
        self.vertices = upload(body.shape.vertices, wp.vec3d, device)
        self.stuff = body.stuff(len(self.worker.k))
        self.surfaces = upload(surfaces(body.materials), RoughSurface, device)
        for array in (self.vertices, self.stuff, self.surfaces):
            array.requires_grad = True
        self.normals = self._normals()
        slots = len(sight.directions) if slots is None else slots
        self.amplitude = self.program.array((slots, len(self.worker.k), 4), wp.vec2d, sum_into=True)

    def _normals(self) -> Any:
        """Normals of curved surfaces, by their vertices."""
        body, program = self.worker.body, self.program
        fan = body.shape.fan
        some = np.flatnonzero(body.shape.curved)
        if not len(some):
            return body.rays.normals
        total = program.array(int(fan.max()) + 1, wp.vec3d, sum_into=True)
        normals = program.array(fan.shape, wp.vec3d)
        chosen, fans = upload(some, int, body.device), upload(fan, int, body.device)
        program.launch(slopes.fans_kernel, len(some), [self.vertices, body.rays.faces, chosen, fans], [total])
        program.launch(slopes.normals_kernel, len(some), [total, chosen, fans], [normals])
        return normals

    def faces(self) -> None:
        """What flat regions, edges and scatterers send that the radar sees as a whole."""
        worker, body, radars, device = self.worker, self.worker.body, self.sight.radars, self.worker.body.device
        count = len(worker.k)
        region = body.shape.region
        view, some = np.nonzero((region >= 0) & self.sight.whole[:, region])
        for term, slabs in (("single", 0), ("edges", 1)):
            if len(some) and term in worker.terms and (body.has_slabs or not slabs):
                inputs = [radars, worker.wavenumbers, self.stuff, body.face_material, self.vertices, body.rays.faces]
                inputs += [upload(view, int, device), upload(some, int, device), slabs]
                self.program.launch(slopes.facets_kernel, (len(some), count), inputs, [self.amplitude])
        if worker.edges.shape[0] and "edges" in worker.terms:
            seen = worker.free(radars, worker.edge_middle, worker.edge_outward, both_sides=False).numpy() != 0
            self._seams(*np.nonzero(seen))
        if body.scatterers is not None and "rough" in worker.terms:
            seen = worker.free(radars, body.scatterer_points, body.scatterer_normals, both_sides=True).numpy() != 0
            for group in body.scatterer_groups:  # those of other models are held: `learned` refuses what moves them
                seen[:, group.part] &= group.crossed is None
            view, some = np.nonzero(seen)
            face, at = body.scatterer_faces[some], _weights(body)[some]
            inputs = [radars, worker.wavenumbers, self.surfaces, body.variant, self.vertices, body.rays.faces]
            inputs += [
                upload(view, int, device),
                upload(host(body.scatterers)[some], body.scatterers.dtype, device),
                upload(face, int, device),
                upload(at, wp.vec2d, device),
            ]
            self.program.launch(slopes.places_kernel, (len(face), count), inputs, [self.amplitude])

    def _seams(self, view: NDArray[np.int64], which: NDArray[np.int64]) -> None:
        """Fringe currents of the pieces of edges `which` that views see, with the surfaces that these end."""
        worker, body, device, program = self.worker, self.worker.body, self.worker.body.device, self.program
        seams = seams_of(body, np.pi / worker.k.max())
        some = seams[np.unique(which)]
        there = np.unique(body.shape.surface[np.concatenate([some["face"], some["other"]])])
        some = upload(np.flatnonzero(np.isin(body.shape.surface, there)), int, device)
        surface = upload(body.shape.surface, int, device)
        total = program.array(int(body.shape.surface.max()) + 1, wp.vec4d, sum_into=True)
        mesh = [self.vertices, body.rays.faces]
        program.launch(slopes.surfaces_kernel, some.shape[0], [*mesh, some, surface], [total])
        inputs = [self.sight.radars, worker.wavenumbers, *mesh, surface, total]
        inputs += [upload(view, int, device), upload(which, int, device), upload(seams, slopes.Seam, device)]
        kernel = slopes.seams_kernel
        if body.has_coats:
            kernel, inputs = slopes.coated_seams_kernel, [*inputs, self.stuff, body.face_material]
        program.launch(kernel, (len(which), len(worker.k)), inputs, [self.amplitude])

    def follow(
        self, paths: TubePaths, slot: NDArray[np.int32] | None = None
    ) -> list[tuple[int, wp.array, wp.array | None]]:
        """Tubes along their paths, whose counts descend, and what they send; `slot`: where each adds it, or its view.

        All tubes meet a face, also those that are followed up to it only (count 0).

        Returns for each bounce how many tubes come so far, the tubes before it, and their hits before that.
        """
        worker, program, device = self.worker, self.program, self.worker.body.device
        body, n, frequencies = worker.body, len(paths.count), len(worker.k)
        sides = [upload(getattr(paths, name), wp.vec2d, device) for name in ("place", "side_u", "side_v")]
        tube = program.array(n, tubes.Tube)
        first = upload(np.ascontiguousarray(paths.face[:, 0]), int, device)
        view = upload(paths.view, int, device)
        inputs = [self.sight.radars, view, self.vertices, body.rays, first, *sides, body.standoff]
        program.launch(slopes.begin_kernel, n, inputs, [tube])
        packed = records(radiate.Pair, (n, frequencies))
        packed["h"]["re"] = self.sight.directions.u[paths.view, None]
        packed["v"]["re"] = self.sight.directions.v[paths.view, None]
        fields = upload(packed, radiate.Pair, device)
        slots = view if slot is None else upload(slot, int, device)
        states: list[tuple[int, wp.array, wp.array | None]] = [(n, tube, None)]
        for b in range(int(paths.count.max(initial=0))):
            m = int((paths.count > b).sum())
            hit, after = program.array(m, tubes.Hit), program.array(m, tubes.Tube)
            back = program.array((m, frequencies), radiate.Pair)
            face, caustics, counts = (
                upload(np.ascontiguousarray(each[:m, b]), int, device)
                for each in (paths.face, paths.caustics, paths.counts.astype(np.int32))
            )
            inputs = [self.vertices, body.rays.faces, self.normals, body.rays.curved, face, caustics, tube]
            program.launch(slopes.meet_kernel, m, inputs, [hit, after])
            inputs = [self.sight.radars, worker.wavenumbers, self.stuff, body.face_material]
            inputs += [view, counts, slots, hit, fields]
            program.launch(slopes.radiate_kernel, (m, frequencies), inputs, [back, self.amplitude])
            tube, fields = after, back
            states.append((m, tube, hit))
        return states

    def run(self) -> NDArray[np.complex128]:
        """The amplitudes, (slots, frequencies, 4)."""
        self.program.forward()
        parts = self.amplitude.numpy()
        whole: NDArray[np.complex128] = parts[..., 0] + 1j * parts[..., 1]
        return whole

    def slopes(self, array: wp.array, seed: Any) -> TubeSlopes:
        """Gradients of sum(seed * array), once the program has run."""
        self.program.backward({array: seed})
        stuff = records(reflection.Face, len(self.worker.body.materials))
        found = host(self.stuff.grad)
        for name in ("permittivity", "permeability", "thickness", "under", "rms_height"):
            stuff[name] = found[name].sum(axis=0)
        return TubeSlopes(self.vertices.grad.numpy().copy(), stuff, host(self.surfaces.grad).copy())


def seams_of(body: CoherentBody, longest_m: float) -> Any:
    """The pieces of `CoherentBody.edge_pieces`, by the vertices that they hang on."""
    wedges, vertices, faces = body.shape.wedges, body.shape.vertices, body.shape.faces
    which, step, cuts = body.cuts(longest_m)
    packed = records(slopes.Seam, len(which))
    packed["first"], packed["last"] = wedges.vertex[which].T
    begin, end = wedges.part[which].T
    packed["begin"] = begin + (end - begin) * step / cuts
    packed["end"] = begin + (end - begin) * (step + 1) / cuts
    packed["face"], packed["other"] = wedges.face[which].T
    along = vertices[packed["last"]] - vertices[packed["first"]]

    def sign(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.where(np.einsum("ij,ij->i", one, other) < 0.0, -1.0, 1.0)

    for face, into, up in (("face", "first", "normal_first"), ("other", "second", "normal_second")):
        p = vertices[faces[packed[face]]]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        packed[f"into_{face}"] = sign(np.cross(normal, along), getattr(wedges, into)[which])
        packed[f"up_{face}"] = sign(np.cross(along, getattr(wedges, into)[which]), getattr(wedges, up)[which])
    packed["sheet"] = wedges.outer[which] > 2.0 - 1e-6
    packed["share"] = wedges.share[which]
    return packed


def _weights(body: CoherentBody) -> NDArray[np.float64]:
    """Barycentric weights of the second and third corner at each scatterer, (n, 2)."""
    p = body.shape.vertices[body.shape.faces[body.scatterer_faces]]
    e1, e2, at = p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], body.scatterer_points.numpy() - p[:, 0]
    g11, g12, g22 = (np.einsum("ij,ij->i", x, y) for x, y in ((e1, e1), (e1, e2), (e2, e2)))
    b1, b2 = (np.einsum("ij,ij->i", x, at) for x in (e1, e2))
    det = g11 * g22 - g12 * g12
    return np.stack([(g22 * b1 - g12 * b2) / det, (g11 * b2 - g12 * b1) / det], axis=1)
