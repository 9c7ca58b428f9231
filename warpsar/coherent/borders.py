"""Borders of light in some directions: where neighbouring rays meet other surfaces, and what a moving border adds.

The amplitude is an integral over the plane across the look direction. Where the order of the surfaces that a ray meets
changes, its integrand jumps. Such a border moves with the edge of the face that makes it, and the integral's derivative
has a part for it: on either side what is sent there, times the border's velocity across itself past the tubes, along
its length (Reynolds; Li, Aittala, Durand, Lehtinen, ACM TOG 37(6), 2018). Borders are found between neighbouring rays
of a grid, by bisection.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.held import Held, Sight, TubePaths, TubeSlopes
from warpsar.coherent.rays import CellRays, frame
from warpsar.coherent.records import upload
from warpsar.coherent.traced import Traced
from warpsar.kernels.coherent import borders, slopes, tubes
from warpsar.runtime.structs import fill

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

    def __getitem__(self, some: Any) -> RayHits:
        return RayHits(self.count[some], self.hits[some])


@dataclass(frozen=True)
class Pairs:
    """Neighbouring rays that meet other surfaces: n of them."""

    view: NDArray[np.int32]
    """(n,)."""
    step: NDArray[np.float64]
    """Width of a cell of that direction along u and v [m], (n, 2)."""
    along: NDArray[np.int64]
    """Whether their line runs along u (0) or v (1), (n,)."""
    left: NDArray[np.float64]
    """Places along u and v [m], (n, 2)."""
    right: NDArray[np.float64]
    mark: NDArray[np.uint64]
    """Of what the left and the right ray meet, (n,)."""
    last: NDArray[np.uint64]

    def __getitem__(self, some: Any) -> Pairs:
        return Pairs(*(getattr(self, name)[some] for name in self.__dataclass_fields__))

    @classmethod
    def joined(cls, parts: Sequence[Pairs]) -> Pairs:
        return cls(*(np.concatenate([getattr(one, name) for one in parts]) for name in cls.__dataclass_fields__))


@dataclass(frozen=True)
class Crossings:
    """Where lines of grids cross borders, as seen from one side: n of them. Those with more bounces come first."""

    view: NDArray[np.int32]
    step: NDArray[np.float64]
    """As in `Pairs`."""
    along: NDArray[np.int64]
    place: NDArray[np.float64]
    """Along u and v [m], (n, 2)."""
    sign: NDArray[np.float64]
    """1 on the left of a line, -1 on the right, (n,)."""
    seen: RayHits
    """On this side."""
    bounces: NDArray[np.int64]
    """How many hits both sides share, (n,)."""
    shade: NDArray[np.bool_]
    """Whether the face stands between the last of these and the radar, and not in the ray's own way, (n,)."""
    face: NDArray[np.int64]
    """The face whose edge makes the border, and the corner opposite to the edge, (n,)."""
    corner: NDArray[np.int64]


def look_at(sight: Sight, view: NDArray[Any], place: NDArray[np.float64], step: NDArray[np.float64]) -> RayHits:
    """What rays of views (n,) at places of their planes, (n, 2) [m], meet."""
    rays = CellRays.of(place, step, sight.worker.body.device, view)
    hits, count = Traced(sight.worker.tracer, sight.radars, rays).found()
    return RayHits(count, hits)


class Marker:
    """Numbers for the surfaces that rays meet, in their order, and which of them the radar sees."""

    def __init__(self, sight: Sight) -> None:
        body, self.device, most = sight.worker.body, sight.worker.body.device, sight.worker.tracer.bounces
        surface = upload(body.shape.surface, int, self.device)
        marked = fill(borders.Marked, body=body.rays, surface=surface, standoff=body.standoff, most=most)
        self.inputs = [marked, sight.radars]

    def __call__(self, view: NDArray[Any], place: NDArray[np.float64], step: NDArray[np.float64]) -> Any:
        mark = wp.empty(len(view), dtype=wp.uint64, device=self.device)
        inputs = [*self.inputs, *self._uploaded(view, place, step)]
        wp.launch(borders.marks_kernel, len(view), inputs=inputs, outputs=[mark], device=self.device)
        return mark.numpy()

    def halved(self, pairs: Pairs) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The places next to the first border on the way from left to right, (n, 2) each."""
        view, low, high, step = self._uploaded(pairs.view, pairs.left, pairs.right, pairs.step)
        inputs = [*self.inputs, view, step, upload(pairs.mark, wp.uint64, self.device), HALVINGS]
        wp.launch(borders.halve_kernel, len(pairs.view), inputs=inputs, outputs=[low, high], device=self.device)
        return low.numpy(), high.numpy()

    def _uploaded(self, view: NDArray[Any], *others: NDArray[np.float64]) -> list[Any]:
        return [upload(view, int, self.device), *(upload(each, wp.vec2d, self.device) for each in others)]


def pairs_of(sight: Sight, marker: Marker) -> Iterator[Pairs]:
    """The pairs of all directions' grids with one more cell at each side, some columns at a time."""
    worker = sight.worker
    most = worker.tracer.together
    waiting: list[tuple[int, NDArray[Any], NDArray[Any], NDArray[np.intp], int]] = []
    there = 0
    for view in range(len(sight.directions)):
        low, step, count = frame(worker.body, sight.directions, view, worker.spacing, worker.distance)
        rows = int(count[1]) + 2
        strip = max(most // rows, 2)
        for first in range(-1, int(count[0]), strip - 1):
            columns = np.arange(first, min(first + strip, int(count[0]) + 1))
            if waiting and there + len(columns) * rows > most:
                yield _different(marker, waiting)
                waiting, there = [], 0
            waiting.append((view, low, step, columns, rows))
            there += len(columns) * rows
    if waiting:
        yield _different(marker, waiting)


def _gathered(parts: Iterator[Pairs], least: int) -> Iterator[Pairs]:
    """Parts together, at least so many pairs but for the last ones: a launch of few takes as long."""
    waiting: list[Pairs] = []
    for part in parts:
        waiting.append(part)
        if sum(len(each.view) for each in waiting) >= least:
            yield Pairs.joined(waiting)
            waiting = []
    if waiting:
        yield Pairs.joined(waiting)


def _different(marker: Marker, strips: Sequence[tuple[int, Any, Any, Any, int]]) -> Pairs:
    """Neighbours in strips of grids, each with its view, corner, step, columns and rows, whose marks differ."""
    places = [
        low + (np.stack(np.meshgrid(columns, np.arange(-1, rows - 1), indexing="ij"), axis=-1) + 0.5) * step
        for _, low, step, columns, rows in strips
    ]
    sizes = [each.shape[0] * each.shape[1] for each in places]
    view = np.repeat([strip[0] for strip in strips], sizes).astype(np.int32)
    step = np.repeat([strip[2] for strip in strips], sizes, axis=0)
    place = np.concatenate([each.reshape(-1, 2) for each in places])
    mark, found, start = marker(view, place, step), [], 0
    for each, size, strip in zip(places, sizes, strips, strict=True):
        number = start + np.arange(size).reshape(each.shape[:2])
        start += size
        own = (
            number if strip[3][0] == -1 else number[1:]
        )  # the lines along v of the first column are the strip's before
        for along, one, other in ((0, number[:-1], number[1:]), (1, own[:, :-1], own[:, 1:])):
            one, other = one.ravel(), other.ravel()
            differ = mark[one] != mark[other]
            one, other = one[differ], other[differ]
            where = np.full(len(one), along)
            found.append(Pairs(view[one], step[one], where, place[one], place[other], mark[one], mark[other]))
    return Pairs.joined(found)


def crossings(sight: Sight, marker: Marker, pairs: Pairs) -> Crossings | None:
    """The borders between pairs from both sides; None where there are none. What no face's edge makes is left out."""
    found = []
    for _ in range(ROUNDS):
        if not len(pairs.view):
            break
        low, high = marker.halved(pairs)
        found.append((pairs, low, high))
        mark = marker(pairs.view, high, pairs.step)
        more = mark != pairs.last
        pairs = replace(pairs, left=high, mark=mark)[more]
    if not found:
        return None
    pairs = Pairs.joined([each[0] for each in found])
    low, high = (np.concatenate([each[i] for each in found]) for i in (1, 2))
    return _made_by(sight, pairs, low, high)


def _made_by(sight: Sight, pairs: Pairs, low: NDArray[np.float64], high: NDArray[np.float64]) -> Crossings | None:
    shape, n = sight.worker.body.shape, len(low)
    view = np.tile(pairs.view, 2)
    both = look_at(sight, view, np.concatenate([low, high]), np.tile(pairs.step, (2, 1)))
    most = both.hits.shape[1]
    sends = sight.counts(view, both.hits["face"], both.hits["seen"]).reshape(2, n, most)
    there = (np.arange(most) < both.count[:, None]).reshape(2, n, most)
    hits = both.hits.reshape(2, n, most)
    surface = np.where(there, shape.surface[hits["face"]], -1)
    other_surface, other_seen = surface[0] != surface[1], hits["seen"][0] != hits["seen"][1]
    first = np.argmax(other_surface | other_seen, axis=1)
    each = np.arange(n)
    shade = ~other_surface[each, first]
    path = np.where(there, hits["path"], np.inf)[:, each, first]
    near = np.where(shade, np.argmin(hits["seen"][:, each, first], axis=0), np.argmin(path, axis=0))
    at = np.ascontiguousarray(hits[near, each, first])
    face, point, d = at["face"].copy(), at["point"].copy(), at["d"].copy()
    turned = np.flatnonzero(shade)
    if len(turned):
        face[turned], point[turned] = _blockers(sight, pairs.view[turned], at[turned])
        d[turned] = sight.directions.s[pairs.view[turned]]
    corner, gap = _corner(shape.vertices[shape.faces[face]], point)
    good = (face >= 0) & (gap < NEAR * pairs.step.min(axis=1)) & (other_surface | other_seen).any(axis=1)
    good &= ~_inside(sight, face, corner, d)
    good &= (sends & (np.arange(most) >= first[:, None])).any(axis=(0, 2))  # before it both sides send the same
    bounces = np.where(shade, first + 1, first)
    some = np.flatnonzero(np.tile(good, 2) & (both.count > 0))  # the sky sends nothing
    if not len(some):
        return None
    which = some % n
    some = some[np.argsort(-bounces[which], kind="stable")]
    which = some % n
    return Crossings(
        pairs.view[which],
        pairs.step[which],
        pairs.along[which],
        np.concatenate([low, high])[some],
        np.where(some < n, 1.0, -1.0),
        both[some],
        bounces[which],
        shade[which],
        face[which],
        corner[which],
    )


def _blockers(sight: Sight, view: NDArray[Any], hits: Any) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    device, n = sight.worker.body.device, len(hits)
    face, point = wp.empty(n, dtype=int, device=device), wp.zeros(n, dtype=wp.vec3d, device=device)
    inputs = [sight.worker.body.rays, sight.radars, upload(view, int, device), upload(hits, tubes.Hit, device)]
    wp.launch(borders.blockers_kernel, n, inputs=inputs, outputs=[face, point], device=device)
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
    """What moving borders add to the gradients of Re sum conj(cotangent) A.

    `cotangents` have the shape (c, directions, frequencies, 4).
    """
    total = [TubeSlopes.empty(sight.worker.body) for _ in cotangents]
    marker = Marker(sight)
    for pairs in _gathered(pairs_of(sight, marker), sight.worker.tracer.together // 2):
        found = crossings(sight, marker, pairs)
        if found is not None:
            for sum_, part in zip(total, _moved(sight, found, cotangents), strict=True):
                sum_.add(part)
    return total


def _moved(sight: Sight, found: Crossings, cotangents: NDArray[np.complex128]) -> Iterator[TubeSlopes]:
    """What the light beside the borders gains as they move past the places that its tubes belong to."""
    n = len(found.view)
    unit = np.broadcast_to(np.eye(2)[:, None], (2, n, 2))
    face, caustics = found.seen.hits["face"], found.seen.hits["caustics"]
    held, nothing = Held(sight), np.zeros(face.shape, bool)
    count = found.bounces.astype(np.int32)
    paths = TubePaths(found.view, found.place, unit[0], unit[1], count, face, caustics, nothing)
    weight = _edges(sight, held, held.follow(paths), found)
    held.run()
    slope = weight.numpy()[:, 1:]
    steep = np.linalg.norm(slope, axis=1)
    steep[steep == 0.0] = np.inf
    across = slope / steep[:, None]
    each = np.arange(n)
    part = across[each, found.along]  # of the border's normal along the grid's line
    width = found.step[each, 1 - found.along]
    light = _light(sight, found, across, width / np.maximum(np.abs(part), STEEP))
    for cotangent in cotangents:
        change = found.sign * (light * cotangent.conj()[found.view]).real.sum(axis=(1, 2))
        seed = np.zeros((n, 3))
        seed[:, 0] = -change * width * part / steep
        yield held.slopes(weight, seed)


def _edges(sight: Sight, held: Held, states: Any, found: Crossings) -> wp.array:
    """The weight of the corner opposite to the edge that each tube passes, and its slopes along u and v."""
    body, device = sight.worker.body, sight.worker.body.device
    view, faces, corners = (upload(each, int, device) for each in (found.view, found.face, found.corner))
    weight = held.program.array(len(found.view), wp.vec3d)
    for b, (_, tube, hit) in enumerate(states):
        for shaded in (False, True):
            which = np.flatnonzero((found.shade == shaded) & (found.bounces == b))
            if not len(which):
                continue
            inputs = [held.vertices, body.rays.faces, upload(which, int, device), faces, corners]
            if shaded:
                held.program.launch(slopes.shades_kernel, len(which), [sight.radars, view, *inputs, hit], [weight])
            else:
                held.program.launch(slopes.rims_kernel, len(which), [*inputs, tube], [weight])
    return weight


def _light(
    sight: Sight, found: Crossings, across: NDArray[np.float64], length: NDArray[np.float64]
) -> NDArray[np.complex128]:
    """The amplitude per area of the plane, (n, frequencies, 4), in tubes that lie along the border."""
    along = np.stack([-across[:, 1], across[:, 0]], axis=1) * length[:, None]
    thin, hits, count = THIN * length[:, None] * across, found.seen.hits, found.seen.count
    counts = sight.counts(found.view, hits["face"], hits["seen"])
    paths = TubePaths(found.view, found.place, along, thin, count, hits["face"], hits["caustics"], counts)
    by, paths = paths.sending()
    held = Held(sight, len(count))
    if len(by):
        held.follow(paths, by.astype(np.int32))
    amplitude: NDArray[np.complex128] = held.run() / (THIN * length**2)[:, None, None]
    return amplitude
