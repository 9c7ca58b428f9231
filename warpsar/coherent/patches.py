"""The scatterers of rough faces. They belong to places: rays, directions and frequencies do not change them.

Faces are cut into patches, and each scatterer of a patch is drawn by its own number. So any part of a surface is made
where and when it is needed, on the device, and memory does not grow with the surface.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.records import field, upload
from warpsar.coherent.rough_models import ScattererGroup, kind_of
from warpsar.coherent.shape import MeshShape
from warpsar.errors import InputError
from warpsar.kernels.coherent import placing, rough
from warpsar.runtime.structs import fill
from warpsar.world.tables import Material

F64 = NDArray[np.float64]
MOST = 20_000_000
"""Scatterers that are held at once: 2.5 GB."""
SIDE, SIDE_M = 128.0, 50.0
"""Longest side of a patch, in spacings of scatterers and [m]: it lies on a map as on the ellipsoid to 0.05 mm."""


@dataclass(frozen=True)
class PlacedScatterers:
    """Scatterers on a device; those of a kind lie together."""

    scatterers: wp.array
    """(n,), `kernels.coherent.rough.Scatterer`."""
    site: wp.array
    """(n,), vec3d, about the reference point [m]; none where nobody said where that is."""
    groups: tuple[ScattererGroup, ...]

    @cached_property
    def points(self) -> wp.array:
        return field(self.scatterers, "point", wp.vec3d)

    @cached_property
    def normals(self) -> wp.array:
        return field(self.scatterers, "normal", wp.vec3d)

    def __len__(self) -> int:
        return int(self.scatterers.shape[0])


@dataclass(frozen=True)
class RoughPatches:
    """Triangles with scatterers, by the models' kinds: those of `ka_spm` come first."""

    start: F64
    """A corner about the body's middle, (n, 3) [m]; `first` and `second` lead from it to the others."""
    first: F64
    second: F64
    face: NDArray[np.int64]
    material: NDArray[np.int32]
    kind: NDArray[np.int64]
    count: NDArray[np.int64]
    """Scatterers of each, (n,)."""
    number: NDArray[np.int64]
    """Of the first scatterer of each, (n,)."""
    spacing_m: float
    seed: int

    @classmethod
    def of(
        cls,
        shape: MeshShape,
        face_material: NDArray[np.int32],
        materials: Sequence[Material],
        spacing_m: float,
        seed: int,
    ) -> RoughPatches:
        """Scatterers at about `spacing_m`, each at a random place of its share of a patch."""
        is_rough = np.array([material.rms_height_m != 0.0 for material in materials])
        faces = np.flatnonzero(is_rough[face_material])
        kind = np.array([kind_of(material) for material in materials])
        faces = faces[np.argsort(kind[face_material[faces]], kind="stable")]
        start, first, second, longest = _longest_across(shape.vertices.take(shape.faces[faces], axis=0))
        of, start, first, second = _cut(start, first, second, longest, min(SIDE * spacing_m, SIDE_M))
        across = np.cross(first, second)
        wanted = 0.5 * np.sqrt(np.einsum("ni,ni->n", across, across)) / spacing_m**2
        # The expected number is exact, so small faces get one now and then, with the area of a whole cell. Neighbours
        # in the mesh share what is left over: where one has got one, the next has not.
        upto = np.floor(np.cumsum(wanted) + np.random.default_rng(seed).random()).astype(np.int64)
        count = np.diff(upto, prepend=0)
        own = face_material[faces][of]
        found = cls(
            start, first, second, faces[of], own, kind[own], count, np.cumsum(count) - count, spacing_m, seed
        )  # fmt: skip
        return found if count.all() else found.chosen(count > 0)

    def __len__(self) -> int:
        """Scatterers."""
        return int(self.count.sum())

    @cached_property
    def ends(self) -> NDArray[np.int64]:
        """How many scatterers there are up to the end of each patch."""
        return np.cumsum(self.count)

    @cached_property
    def hashed_seed(self) -> int:
        """64 bits: neighbouring seeds draw other streams."""
        return int(np.random.SeedSequence(self.seed).generate_state(1, np.uint64)[0])

    def chosen(self, some: NDArray[Any] | slice) -> RoughPatches:
        """Some of the patches, with the same scatterers."""
        names = ("start", "first", "second", "face", "material", "kind", "count", "number")
        return replace(self, **{name: getattr(self, name)[some] for name in names})

    def faces_of(self, some: slice) -> NDArray[np.int64]:
        """The faces of the scatterers from one number to another, (n,)."""
        if not len(self.ends):
            return np.empty(0, np.int64)
        low, high = np.searchsorted(self.ends, [some.start, max(some.stop - 1, some.start)], side="right")
        reached = np.clip(self.ends[low : high + 1], some.start, some.stop)
        found: NDArray[np.int64] = np.repeat(self.face[low : high + 1], np.diff(reached, prepend=some.start))
        return found

    def refuse_many(self) -> None:
        """Raise InputError for more than can be held at once."""
        if len(self) > MOST:
            raise InputError(
                f"rough faces: found {len(self) * self.spacing_m**2:.3g} m2, {len(self):.3g} scatterers "
                f'{self.spacing_m:.3g} m apart; must be at most {MOST:.3g}, or leave "rough" out of radar.terms'
            )

    def on(self, device: wp.Device, about: Callable[[F64], F64] | None = None) -> PatchesOnDevice:
        """On a device, ready to be filled. `about` brings places about the body's middle into the track's frame."""
        arrays = {name: upload(getattr(self, name), wp.vec3d, device) for name in ("start", "first", "second")}
        site = {name: np.empty((0, 3)) for name in arrays}
        if about is not None:
            start, first, second = (about(self.start + side) for side in (0.0, self.first, self.second))
            site = {"start": start, "first": first - start, "second": second - start}
        arrays |= {f"site_{name}": upload(values, wp.vec3d, device) for name, values in site.items()}
        made = fill(
            placing.Patches,
            **arrays,
            number=upload(self.number, wp.int64, device),
            material=upload(self.material, int, device),
        )
        return PatchesOnDevice.of(self, made, np.arange(len(self.face)), device)


@dataclass(frozen=True)
class PatchesOnDevice:
    """Patches on a device, and those of them whose scatterers are wanted."""

    patches: RoughPatches
    arrays: Any
    """Of all patches, `kernels.coherent.placing.Patches`."""
    index: NDArray[np.int64]
    """Of the wanted ones, (n,), ascending."""
    ends: NDArray[np.int64]
    """How many scatterers there are up to the end of each of them."""
    on_device: tuple[wp.array, wp.array, wp.array]
    """`index` and `ends`, and of every `placing.EVERY`-th scatterer the place in them."""

    @classmethod
    def of(cls, patches: RoughPatches, arrays: Any, index: NDArray[np.int64], device: wp.Device) -> PatchesOnDevice:
        ends = np.cumsum(patches.count[index])
        blocks = -(-ends // placing.EVERY)
        reached = np.cumsum(np.bincount(blocks), dtype=np.int32)  # how many patches end before
        there = upload(index.astype(np.int32), int, device), upload(ends, wp.int64, device)
        return cls(patches, arrays, index, ends, (*there, upload(reached, int, device)))

    @property
    def device(self) -> wp.Device:
        return self.arrays.start.device

    def __len__(self) -> int:
        """Scatterers."""
        return int(self.ends[-1]) if len(self.ends) else 0

    def chosen(self, some: NDArray[np.bool_]) -> PatchesOnDevice:
        """Some of all patches, (n,), with the same scatterers."""
        if some.all() and len(self.index) == len(some):
            return self
        return PatchesOnDevice.of(self.patches, self.arrays, np.flatnonzero(some), self.device)

    @cached_property
    def _kinds(self) -> list[tuple[int, int, int]]:
        """Each kind, its first scatterer and the end of them."""
        kind = self.patches.kind[self.index]
        if not kind.any():
            return [(0, 0, len(self))] if len(kind) else []
        starts = [*np.flatnonzero(np.diff(kind, prepend=-1)).tolist(), len(kind)]
        return [(int(kind[a]), int(self.ends[a - 1]) if a else 0, int(self.ends[b - 1])) for a, b in pairwise(starts)]

    def placed(self, some: slice) -> PlacedScatterers:
        """The scatterers from one number to another, counted over the wanted patches."""
        own, device, count = self.patches, self.device, some.stop - some.start
        sited = self.arrays.site_start.shape[0] > 0
        made = wp.empty(count, dtype=rough.Scatterer, device=device)
        site = wp.empty(count if sited else 0, dtype=wp.vec3d, device=device)
        crossed = wp.empty(count if any(kind for kind, _, _ in self._kinds) else 0, dtype=wp.vec2d, device=device)
        inputs = [own.hashed_seed, self.arrays, *self.on_device, some.start, own.spacing_m**2]
        wp.launch(placing.place_kernel, count, inputs=inputs, outputs=[made, site, crossed], device=device)
        groups = []
        for kind, first, end in self._kinds:
            low, high = max(first - some.start, 0), min(end - some.start, count)
            if low < high:
                groups.append(ScattererGroup(kind, slice(low, high), crossed[low:high] if kind else None))
        return PlacedScatterers(made, site, tuple(groups))


def _longest_across(corners: F64) -> tuple[F64, F64, F64, F64]:
    """Of triangles (n, 3, 3): the corner across from the longest side, the two sides from it, (n, 3) each, and the
    longest side, (n,).

    Each number is worked out once: a mesh of 10^5 faces is brought to a device in less time than it is seen in.
    """
    sides = np.empty_like(corners)
    for k in range(3):
        np.subtract(corners[:, (k + 1) % 3], corners[:, k], out=sides[:, k])
    squares = np.einsum("nij,nij->ni", sides, sides)
    longest = squares.argmax(axis=1)
    row = 3 * np.arange(len(corners))
    across, before = row + _ACROSS.take(longest), row + _BEFORE.take(longest)
    flat = sides.reshape(-1, 3)
    second = flat.take(before, axis=0)
    return (
        corners.reshape(-1, 3).take(across, axis=0),
        flat.take(across, axis=0),
        np.negative(second, out=second),
        np.sqrt(squares.reshape(-1).take(row + longest)),
    )


_ACROSS, _BEFORE = np.array([2, 0, 1]), np.array([1, 2, 0])
"""Of the longest side, which leads from the corner of its number to the next: the corner across from it, and the side
that leads to that."""


def _cut(
    start: F64, first: F64, second: F64, longest: F64, longest_m: float
) -> tuple[NDArray[np.int64], F64, F64, F64]:
    """Triangles, by a corner and the two sides from it, (n, 3) each, in congruent parts whose sides are at most
    `longest_m`: of which each is a part, a corner, and the two sides from it."""
    parts = np.ceil(longest / longest_m).astype(np.int64).clip(1)
    if (parts == 1).all():
        return np.arange(len(start)), start, first, second
    of = np.repeat(np.arange(len(start)), parts**2)
    begin = np.cumsum(parts**2) - parts**2
    made = np.stack([start.take(of, axis=0), first.take(of, axis=0), second.take(of, axis=0)])
    for n in np.unique(parts[parts > 1]).tolist():
        some = np.flatnonzero(parts == n)
        i, j = np.divmod(np.arange(n * n), n)
        upright = i + j < n
        # The parts that stand upside down are those of the other half of the parallelogram, turned by half a turn.
        a = np.where(upright, i, n - i) / n
        b = np.where(upright, j, n - j) / n
        sign = np.where(upright, 1.0, -1.0) / n
        e1, e2 = first[some], second[some]
        there = begin[some][:, None] + np.arange(n * n)
        made[0, there] = start[some][:, None] + a[:, None] * e1[:, None] + b[:, None] * e2[:, None]
        made[1, there] = sign[:, None] * e1[:, None]
        made[2, there] = sign[:, None] * e2[:, None]
    return of, made[0], made[1], made[2]
