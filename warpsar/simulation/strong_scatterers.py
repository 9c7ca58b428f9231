"""The strongest scatterers of a view: where they stand, over which faces their power comes, and how much it is.

What RaySAR calls its signature: each contribution to the image with its place in space and its number of bounces (Auer,
Hinz and Bamler, IEEE TGRS 48, 2010).
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.errors import InputError
from warpsar.io.images import replacing
from warpsar.render.render import Deposited, ViewRender
from warpsar.world.mesh import Mesh

PLACES = ("east_m", "north_m", "up_m")
IMAGE_PLACES = ("range_m", "azimuth_m")
RCS = "rcs_dbsm_"
"""Before the polarization's name."""
_FAINTEST = 1e-30  # m2, for a logarithm


@dataclass(frozen=True)
class StrongScatterers:
    """Contributions to one view's image, the strongest first, shape (n,) each: one for each pixel, term and order of
    faces.

    `term` is "surface" or the effect that adds the power. `faces` are numbers of the scene's triangles in the order of
    the bounces; empty where no face is known. `place_m`, (n, 3), is east, north, up; that of several bounces is where a
    single one would have their range, azimuth and mean elevation. `in_image_m`, (n, 2), is range and azimuth from the
    reference point. `rcs_m2[pol]` is beta0 times the pixel's area, before the system's response.
    """

    term: tuple[str, ...]
    faces: tuple[tuple[int, ...], ...]
    place_m: NDArray[np.float64]
    in_image_m: NDArray[np.float64]
    rcs_m2: dict[str, NDArray[np.float64]]

    def __len__(self) -> int:
        return len(self.term)

    @property
    def bounces(self) -> NDArray[np.int64]:
        """Number of faces; 1 where none is known."""
        return np.array([max(len(one), 1) for one in self.faces], np.int64)

    def strongest(self, count: int) -> StrongScatterers:
        """The first `count` by the sum of all polarizations."""
        total = np.sum(list(self.rcs_m2.values()), axis=0)
        kept = np.argsort(-total, kind="stable")[:count]
        return StrongScatterers(
            tuple(self.term[i] for i in kept),
            tuple(self.faces[i] for i in kept),
            self.place_m[kept],
            self.in_image_m[kept],
            {name: power[kept] for name, power in self.rcs_m2.items()},
        )


def strongest_of(render: ViewRender, reference_point_m: Sequence[float], count: int) -> StrongScatterers:
    """The `count` strongest contributions to a render's image after a forward run."""
    area = float(np.prod(render.spacing_m))
    by_term: dict[tuple[str, int], dict[str, Deposited]] = {}
    for name, deposits in render.deposited.items():
        seen: Counter[str] = Counter()
        for one in deposits:
            by_term.setdefault((one.term, seen[one.term]), {})[name] = one
            seen[one.term] += 1
    parts = []
    for (term, _), of in by_term.items():
        one = next(iter(of.values()))
        at = np.arange(one.bins.shape[0]) if one.sample is None else one.sample.numpy()
        place = one.points.numpy()[at].astype(float)
        inside = _inside(render, place)
        at, place = at[inside], place[inside]
        faces = np.column_stack([np.zeros((len(at), 0), int), *(each.numpy()[at] for each in one.faces)])
        pixel = np.floor(_in_image(render, place) / render.spacing_m).astype(int)
        keys, first, which = np.unique(np.column_stack([pixel, faces]), axis=0, return_index=True, return_inverse=True)
        which = which.reshape(-1)
        powers = {
            name: area * _power(of[name])[inside] if name in of else np.zeros(len(at)) for name in render.deposited
        }
        rcs = {name: np.bincount(which, power, len(keys)).astype(float) for name, power in powers.items()}
        total = np.sum(list(powers.values()), axis=0)
        sums = [np.bincount(which, total * axis, len(keys)) for axis in place.T]
        whole = np.bincount(which, total, len(keys))
        mean = np.where(
            whole[:, None] > 0.0, np.stack(sums, axis=1) / np.maximum(whole, _FAINTEST)[:, None], place[first]
        )
        kept = np.argsort(-whole, kind="stable")[:count]
        parts.append(
            StrongScatterers(
                (term,) * len(kept),
                tuple(tuple(row) for row in keys[kept, 2:].tolist()),
                mean[kept] + np.asarray(reference_point_m, float),
                _in_image(render, mean[kept]),
                {name: power[kept] for name, power in rcs.items()},
            )
        )
    return together(parts, count)


def together(parts: Sequence[StrongScatterers], count: int) -> StrongScatterers:
    """The `count` strongest of several lists."""
    return StrongScatterers(
        tuple(chain.from_iterable(one.term for one in parts)),
        tuple(chain.from_iterable(one.faces for one in parts)),
        np.concatenate([one.place_m for one in parts]),
        np.concatenate([one.in_image_m for one in parts]),
        {name: np.concatenate([one.rcs_m2[name] for one in parts]) for name in parts[0].rcs_m2},
    ).strongest(count)


def _power(one: Deposited) -> NDArray[np.float64]:
    """beta0 that each bin gets, over one pixel."""
    sigma = one.sigma.numpy().astype(float)
    return (sigma if one.sample is None else sigma[one.sample.numpy()]) * one.weight.numpy()


def _in_image(render: ViewRender, points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Range and azimuth [m] of points about the reference point, (n, 2)."""
    geometry = render.geometry
    along, across = points @ geometry.d, points @ geometry.v
    if geometry.slant_range_m is not None:
        along = np.hypot(geometry.slant_range_m + along, across) - geometry.slant_range_m
    return np.stack([along, points @ geometry.u], axis=1)


def _inside(render: ViewRender, points: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which points lie in the image: hits are binned beyond it, too, where an effect may move them in."""
    half = 0.5 * np.multiply(render.shape, render.spacing_m)
    return np.asarray((np.abs(_in_image(render, points)) <= half).all(axis=1))


# ---- files


def write_csv(found: StrongScatterers, mesh: Mesh, path: Path) -> None:
    """A row for each scatterer. Faces and materials of a path are separated by spaces."""
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        levels = [RCS + name for name in found.rcs_m2]
        table.writerow(["term", "bounces", "faces", "materials", *PLACES, *IMAGE_PLACES, *levels])
        for i, faces in enumerate(found.faces):
            names = " ".join(mesh.materials[mesh.face_material[face]] for face in faces)
            numbers = [*found.place_m[i], *found.in_image_m[i], *(_dbsm(power[i]) for power in found.rcs_m2.values())]
            about = found.term[i], found.bounces[i], " ".join(map(str, faces)), names
            table.writerow([*about, *(f"{number:.3f}" for number in numbers)])


def write_ply(found: StrongScatterers, path: Path) -> None:
    """Points for any 3-D program, with number of bounces and level."""
    levels = [RCS + name for name in found.rcs_m2]
    header = ["ply", "format ascii 1.0", "comment x east, y north, z up [m]", f"element vertex {len(found)}"]
    header += ["property double x", "property double y", "property double z", "property int bounces"]
    header += [f"property float {name}" for name in levels] + ["end_header"]
    rows = np.column_stack([found.place_m, found.bounces, *(_dbsm(power) for power in found.rcs_m2.values())])
    with replacing(path) as temporary:
        np.savetxt(
            temporary, rows, ["%.4f"] * 3 + ["%d"] + ["%.3f"] * len(levels), header="\n".join(header), comments=""
        )


def _dbsm(rcs_m2: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(10.0 * np.log10(np.maximum(rcs_m2, _FAINTEST)))


def read_csv(path: Path) -> tuple[NDArray[np.float64], dict[str, NDArray[np.float64]]]:
    """Places, (n, 3), and levels [dBsm] by polarization, (n,), of a file of `write_csv`. Raises InputError."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        place = np.array([[float(row[name]) for name in PLACES] for row in rows]).reshape(-1, 3)
        names = [name for name in (rows[0] if rows else {}) if name.startswith(RCS)]
        return place, {name.removeprefix(RCS): np.array([float(row[name]) for row in rows]) for name in names}
    except (OSError, UnicodeDecodeError, KeyError, TypeError, ValueError, csv.Error) as error:
        raise InputError(f"{path}: {error}; must be a file of warpsar simulate --scatterers") from error
