"""The strongest scatterers of a view: where they stand, over which faces their power comes, and how much it is.

What RaySAR calls its signature: each contribution to the image with its place in space and its number of bounces (Auer,
Hinz and Bamler, IEEE TGRS 48, 2010).
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from warpsar.effects.base.recorder import pixels_of
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
    reference point, before any shift. `rcs_m2[pol]` is beta0 times the pixel's area, before the system's response.
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
    alike: dict[tuple[str, int], list[tuple[str, Deposited]]] = {}
    for name, deposits in render.deposited.items():
        for one in deposits:
            alike.setdefault((one.term, len(one.faces)), []).append((name, one))
    origin = np.asarray(reference_point_m, float)
    return together([_joined(render, term, some, origin, count) for (term, _), some in alike.items()], count)


def _joined(
    render: ViewRender,
    term: str,
    deposits: Sequence[tuple[str, Deposited]],
    reference_point_m: NDArray[np.float64],
    count: int,
) -> StrongScatterers:
    """The `count` strongest of deposits of one term and one number of faces, each with its polarization: those of one
    pixel and one order of faces are one scatterer, which stands at the mean place of their power."""
    rows, places, powers, channels = [], [], [], []
    names = tuple(render.deposited)
    for name, one in deposits:
        row, col, inside = pixels_of(render, one.bins.numpy())
        at = (np.arange(len(row)) if one.sample is None else one.sample.numpy())[inside]
        rows.append(np.column_stack([row[inside], col[inside], *(each.numpy()[at] for each in one.faces)]))
        places.append(one.points.numpy()[at].astype(float))
        powers.append(one.sigma.numpy()[at].astype(float) * one.weight.numpy()[inside])
        channels.append(np.full(len(at), names.index(name)))
    power, place = float(np.prod(render.spacing_m)) * np.concatenate(powers), np.concatenate(places)
    keys, which = np.unique(np.concatenate(rows), axis=0, return_inverse=True)
    cells = which.reshape(-1) * len(names) + np.concatenate(channels)
    rcs = np.bincount(cells, power, len(keys) * len(names)).astype(float).reshape(len(keys), len(names))
    share = np.maximum(power, _FAINTEST)  # so that what sends nothing has a place, too
    whole = np.bincount(which.reshape(-1), share, len(keys))
    mean = np.stack([np.bincount(which.reshape(-1), share * axis, len(keys)) / whole for axis in place.T], axis=1)
    kept = np.argsort(-rcs.sum(axis=1), kind="stable")[:count]
    keys, mean, rcs = keys[kept], mean[kept], rcs[kept]
    return StrongScatterers(
        (term,) * len(keys),
        tuple(map(tuple, keys[:, 2:].tolist())),
        mean + reference_point_m,
        np.stack(render.geometry.range_and_azimuth_m(mean), axis=1),
        {name: rcs[:, k] for k, name in enumerate(names)},
    )


def together(parts: Sequence[StrongScatterers], count: int) -> StrongScatterers:
    """The `count` strongest of several lists."""
    return StrongScatterers(
        tuple(chain.from_iterable(one.term for one in parts)),
        tuple(chain.from_iterable(one.faces for one in parts)),
        np.concatenate([one.place_m for one in parts]),
        np.concatenate([one.in_image_m for one in parts]),
        {name: np.concatenate([one.rcs_m2[name] for one in parts]) for name in parts[0].rcs_m2},
    ).strongest(count)


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
            table = csv.DictReader(file)
            rows, columns = list(table), table.fieldnames or ()
        levels = [name for name in columns if name.startswith(RCS)]
        for name in (*PLACES, *(() if levels else (RCS,))):
            if name not in columns:
                raise KeyError(name)
        numbers = np.array([[float(row[name]) for name in (*PLACES, *levels)] for row in rows])
        if not np.isfinite(numbers).all():
            raise ValueError("a number is not finite")
    except (OSError, UnicodeDecodeError, KeyError, TypeError, ValueError, csv.Error) as error:
        allowed = f"with the columns {', '.join(PLACES)} and {RCS}HH or the like"
        raise InputError(f"{path}: {error}; must be a file of warpsar simulate --scatterers, {allowed}") from error
    place, of_levels = np.split(numbers.reshape(-1, 3 + len(levels)), [3], axis=1)
    return place, {name.removeprefix(RCS): values for name, values in zip(levels, of_levels.T, strict=True)}
