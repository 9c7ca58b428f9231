"""Borders of light in one direction: where neighbouring rays meet other surfaces, and what a moving border adds.

The amplitude is an integral over the plane across the look direction. Where the order of the surfaces that a ray meets
changes, its integrand jumps. Such a border moves with the edge of the face that makes it, and the integral's derivative
has a part for it: on either side what is sent there, times the border's velocity across itself past the tubes, along
its length (Reynolds; Li, Aittala, Durand, Lehtinen, ACM TOG 37(6), 2018). Borders are found between neighbouring rays
of a grid, by bisection.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.held import Held, Sight, TubePaths, TubeSlopes
from warpsar.coherent.rays import CellRays, frame
from warpsar.coherent.records import upload
from warpsar.coherent.traced import Traced
from warpsar.kernels.coherent import slopes, tubes

HALVINGS = 18
"""A tenth of a wavelength of 3 cm becomes 1e-8 m, what float32 tells apart in a tree of half a metre."""
ROUNDS = 4
"""Borders between two neighbouring rays that are told apart."""
NEAR = 1e-2
"""A border lies this share of a cell from the edge that makes it, or it is none: rays that slip through a seam."""
STEEP = 0.1
"""A line of the grid that meets a border at a smaller sine than this adds little, and its piece is taken no longer."""
THIN = 1e-6
"""Width of a border's tube over its length."""


@dataclass(frozen=True)
class RayHits:
    """What rays meet: n rays, b bounces at most."""

    count: NDArray[np.int32]
    hits: Any
    """Records of `tubes.Hit`, (n, b); those from `count` on are zero."""
    mark: NDArray[np.uint64]
    """A number for the surfaces that are met, in their order, and which of them the radar sees, (n,)."""

    def __getitem__(self, some: Any) -> RayHits:
        return RayHits(self.count[some], self.hits[some], self.mark[some])


@dataclass(frozen=True)
class Crossings:
    """Where lines of a grid cross a border: n of them."""

    place: NDArray[np.float64]
    """On either side, along u and v [m], (2, n, 2)."""
    along: NDArray[np.int64]
    """Whether the line runs along u (0) or v (1), (n,)."""
    seen: tuple[RayHits, RayHits]
    """On either side."""
    bounces: NDArray[np.int64]
    """How many hits both sides share, (n,)."""
    shade: NDArray[np.bool_]
    """Whether the face stands between the last of these and the radar, and not in the ray's own way, (n,)."""
    face: NDArray[np.int64]
    """The face whose edge makes the border, and the corner opposite to the edge, (n,)."""
    corner: NDArray[np.int64]


def look_at(sight: Sight, place: NDArray[np.float64], step: NDArray[np.float64]) -> RayHits:
    """What rays at places of the plane, (n, 2) [m], meet."""
    n, shape = len(place), sight.worker.body.shape
    rays = CellRays.of(place, np.broadcast_to(step, place.shape), sight.worker.body.device)
    hits, count = Traced(sight.worker.tracer, sight.radars, rays).found()
    there = np.arange(hits.shape[1]) < count[:, None]
    mark = np.full(n, 1469598103934665603, np.uint64)
    for b in range(hits.shape[1]):
        what = 2 * shape.surface[hits["face"][:, b]].astype(np.uint64) + hits["seen"][:, b].astype(np.uint64) + 1
        mark = np.where(there[:, b], (mark ^ what) * np.uint64(1099511628211), mark)
    return RayHits(count, hits, mark)


def crossings(
    sight: Sight, step: NDArray[np.float64], low: NDArray[np.float64], count: NDArray[np.int64]
) -> Iterator[Crossings]:
    """The borders of a grid with one more cell at each of its sides, a strip at a time."""
    rows = int(count[1]) + 2
    strip = max(sight.worker.tracer.together // rows, 2)
    for first in range(-1, int(count[0]) + 1, strip - 1):
        i = np.arange(first, min(first + strip, int(count[0]) + 1))
        if len(i) < 2:
            continue
        grid = np.stack(np.meshgrid(i, np.arange(-1, rows - 1), indexing="ij"), axis=-1)
        place = low + (grid + 0.5) * step
        seen = look_at(sight, place.reshape(-1, 2), step)
        number = np.arange(len(i) * rows).reshape(len(i), rows)
        pairs = [(number[:-1], number[1:], 0), (number[:, :-1], number[:, 1:], 1)]
        if first > -1:  # the lines along v of the first column belong to the strip before
            pairs[1] = (number[1:, :-1], number[1:, 1:], 1)
        one, other, along = (
            np.concatenate([np.broadcast_to(p[c], p[0].shape).ravel() for p in pairs]) for c in range(3)
        )
        differ = seen.mark[one] != seen.mark[other]
        one, other, along = one[differ], other[differ], along[differ]
        places, marks = place.reshape(-1, 2), seen.mark
        found = _bisected(sight, step, places[one], places[other], along, marks[one], marks[other])
        yield from (c for c in found if len(c.along))


def _bisected(
    sight: Sight,
    step: NDArray[np.float64],
    left: NDArray[np.float64],
    right: NDArray[np.float64],
    along: NDArray[np.int64],
    mark: NDArray[np.uint64],
    last: NDArray[np.uint64],
) -> Iterator[Crossings]:
    for _ in range(ROUNDS):
        if not len(along):
            return
        low, high = left.copy(), right.copy()
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            same = (look_at(sight, middle, step).mark == mark)[:, None]
            low, high = np.where(same, middle, low), np.where(same, high, middle)
        sides = look_at(sight, low, step), look_at(sight, high, step)
        yield _made_by(sight, step, np.stack([low, high]), along, sides)
        more = sides[1].mark != last
        left, right, along, mark, last = high[more], right[more], along[more], sides[1].mark[more], last[more]


def _made_by(
    sight: Sight,
    step: NDArray[np.float64],
    place: NDArray[np.float64],
    along: NDArray[np.int64],
    sides: tuple[RayHits, RayHits],
) -> Crossings:
    """Which face's edge makes each border. What is none is left out."""
    body, n = sight.worker.body, len(along)
    shape = body.shape
    most = max(side.hits.shape[1] for side in sides)
    surface, seen, path = (
        np.full((2, n, most + 1), -1),
        np.zeros((2, n, most + 1), int),
        np.full((2, n, most + 1), np.inf),
    )
    for i, side in enumerate(sides):
        wide = side.hits.shape[1]
        there = np.arange(wide) < side.count[:, None]
        surface[i, :, :wide] = np.where(there, shape.surface[side.hits["face"]], -1)
        seen[i, :, :wide] = side.hits["seen"]
        path[i, :, :wide] = np.where(there, side.hits["path"], np.inf)
    other_surface, other_seen = surface[0] != surface[1], seen[0] != seen[1]
    first = np.argmax(other_surface | other_seen, axis=1)
    each = np.arange(n)
    shade = ~other_surface[each, first]
    near = np.where(shade, np.argmin(seen[:, each, first], axis=0), np.argmin(path[:, each, first], axis=0))
    face, point, d = np.full(n, -1), np.zeros((n, 3)), np.zeros((n, 3))
    for i, side in enumerate(sides):
        some = np.flatnonzero(near == i)
        if not len(some):
            continue
        hits = np.ascontiguousarray(side.hits[some, np.minimum(first[some], side.hits.shape[1] - 1)])
        face[some], point[some], d[some] = hits["face"], hits["point"], hits["d"]
        turned = np.flatnonzero(shade[some])
        if len(turned):
            face[some[turned]], point[some[turned]] = _blockers(sight, hits[turned])
            d[some[turned]] = sight.directions.s[sight.index]
    corner, gap = _corner(shape.vertices[shape.faces[face]], point)
    good = (face >= 0) & (gap < NEAR * step.min()) & (other_surface | other_seen).any(axis=1)
    good &= ~_inside(sight, face, corner, d)
    kept = np.flatnonzero(good)
    bounces = np.where(shade, first + 1, first)
    return Crossings(
        place[:, kept],
        along[kept],
        (sides[0][kept], sides[1][kept]),
        bounces[kept],
        shade[kept],
        face[kept],
        corner[kept],
    )


def _blockers(sight: Sight, hits: Any) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    device, n = sight.worker.body.device, len(hits)
    face, point = wp.empty(n, dtype=int, device=device), wp.zeros(n, dtype=wp.vec3d, device=device)
    inputs = [sight.worker.body.rays, sight.radars, upload(hits, tubes.Hit, device)]
    wp.launch(slopes.blockers_kernel, n, inputs=inputs, outputs=[face, point], device=device)
    return face.numpy(), point.numpy()


def _corner(p: NDArray[np.float64], at: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The corner opposite to the edge of triangles (n, 3, 3) nearest to points, and the distance to that edge [m]."""
    gap = np.empty((len(p), 3))
    for i in range(3):
        a, b = p[:, (i + 1) % 3], p[:, (i + 2) % 3]
        gap[:, i] = np.linalg.norm(np.cross(b - a, at - a), axis=1) / np.linalg.norm(b - a, axis=1)
    corner = gap.argmin(axis=1)
    return corner, gap[np.arange(len(p)), corner]


def _inside(sight: Sight, face: Any, corner: Any, d: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether the edge lies inside a surface whose faces on both sides look the same way: no border runs there."""
    shape = sight.worker.body.shape
    vertices, faces = shape.vertices, shape.faces
    beyond = sight.beyond[face, corner]

    def facing(of: NDArray[np.int64]) -> NDArray[np.float64]:
        p = vertices[faces[of]]
        normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
        return np.einsum("ij,ij->i", normal, d)

    # Both faces are wound alike where they hold their common edge in opposite orders.
    a, b = faces[face, (corner + 1) % 3], faces[face, (corner + 2) % 3]
    alike = ~((faces[beyond] == a[:, None]) & (np.roll(faces[beyond], -1, axis=1) == b[:, None])).any(axis=1)
    turn = np.where(alike, 1.0, -1.0)
    return (beyond >= 0) & (facing(face) * turn * facing(beyond) > 0.0)


def border_slopes(sight: Sight, cotangents: NDArray[np.complex128]) -> list[TubeSlopes]:
    """What moving borders add to the gradients of Re sum conj(cotangent) A, for cotangents (c, frequencies, 4)."""
    worker = sight.worker
    low, step, count = frame(worker.body, sight.directions, sight.index, worker.spacing, worker.distance)
    total = [TubeSlopes.empty(worker.body) for _ in cotangents]
    for found in crossings(sight, step, low, count):
        for sum_, part in zip(total, _strip(sight, step, found, cotangents), strict=True):
            sum_.add(part)
    return total


def _strip(
    sight: Sight, step: NDArray[np.float64], found: Crossings, cotangents: NDArray[np.complex128]
) -> list[TubeSlopes]:
    total = [TubeSlopes.empty(sight.worker.body) for _ in cotangents]
    for side, sign in ((0, 1.0), (1, -1.0)):
        some = np.flatnonzero(found.seen[side].count > 0)  # the sky sends nothing
        some = some[np.argsort(-found.bounces[some], kind="stable")]
        if len(some):
            for sum_, part in zip(total, _side(sight, step, found, side, some, sign * cotangents), strict=True):
                sum_.add(part)
    return total


def _side(
    sight: Sight,
    step: NDArray[np.float64],
    found: Crossings,
    side: int,
    some: NDArray[np.int64],
    cotangents: NDArray[np.complex128],
) -> Iterator[TubeSlopes]:
    """What the light on one side of the borders gains as they move past the places that its tubes belong to."""
    n, bounces, seen, place = len(some), found.bounces[some], found.seen[side][some], found.place[side][some]
    unit = np.broadcast_to(np.eye(2)[:, None], (2, n, 2))
    face, caustics = seen.hits["face"], seen.hits["caustics"]
    held = Held(sight)
    nothing = np.zeros(face.shape, bool)
    states = held.follow(TubePaths(place, unit[0], unit[1], bounces.astype(np.int32), face, caustics, nothing))
    weight = _edges(sight, held, states, found.shade[some], bounces, found.face[some], found.corner[some])
    held.run()
    slope = weight.numpy()[:, 1:]
    steep = np.linalg.norm(slope, axis=1)
    steep[steep == 0.0] = np.inf
    across = slope / steep[:, None]
    part = across[np.arange(n), found.along[some]]  # of the border's normal along the grid's line
    width = step[1 - found.along[some]]
    light = _light(sight, place, seen, across, width / np.maximum(np.abs(part), STEEP))
    for cotangent in cotangents:
        change = (light * cotangent.conj()).real.sum(axis=(1, 2))
        seed = np.zeros((n, 3))
        seed[:, 0] = -change * width * part / steep
        yield held.slopes(weight, seed)


def _edges(
    sight: Sight,
    held: Held,
    states: Any,
    shade: NDArray[np.bool_],
    bounces: NDArray[np.int64],
    face: NDArray[np.int64],
    corner: NDArray[np.int64],
) -> wp.array:
    """The weight of the corner opposite to the edge that each tube passes, and its slopes along u and v."""
    body, device = sight.worker.body, sight.worker.body.device
    faces, corners = upload(face, int, device), upload(corner, int, device)
    weight = held.program.array(len(face), wp.vec3d)
    for b, (_, tube, hit) in enumerate(states):
        for shaded in (False, True):
            which = np.flatnonzero((shade == shaded) & (bounces == b))
            if not len(which):
                continue
            inputs = [held.vertices, body.rays.faces, upload(which, int, device), faces, corners]
            if shaded:
                held.program.launch(slopes.shades_kernel, len(which), [sight.radars, *inputs, hit], [weight])
            else:
                held.program.launch(slopes.rims_kernel, len(which), [*inputs, tube], [weight])
    return weight


def _light(
    sight: Sight,
    place: NDArray[np.float64],
    seen: RayHits,
    across: NDArray[np.float64],
    length: NDArray[np.float64],
) -> NDArray[np.complex128]:
    """The amplitude per area of the plane, (n, frequencies, 4), in tubes that lie along the border."""
    n = len(place)
    along = np.stack([-across[:, 1], across[:, 0]], axis=1) * length[:, None]
    face, counts = seen.hits["face"], sight.counts(seen.hits["face"], seen.hits["seen"])
    paths = TubePaths(place, along, THIN * length[:, None] * across, seen.count, face, seen.hits["caustics"], counts)
    by = np.argsort(-seen.count, kind="stable")
    held = Held(sight, n)
    held.follow(paths[by], by.astype(np.int32))
    amplitude: NDArray[np.complex128] = held.run() / (THIN * length**2)[:, None, None]
    return amplitude
