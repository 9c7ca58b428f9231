"""The scatterers of rough faces. They belong to places: rays, directions and frequencies do not change them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from warpsar.coherent.records import records
from warpsar.coherent.rough_models import kind_of
from warpsar.coherent.shape import MeshShape
from warpsar.errors import InputError
from warpsar.kernels.codes import Spectrum
from warpsar.kernels.coherent import bistatic, rough
from warpsar.world.tables import Material

MOST = 20_000_000
"""Scatterers of a scene: 2.5 GB."""
_TOGETHER = 2**15
"""Scatterers placed at a time: what they need stays in the cache."""
_CONDUCTOR = (1e9, 0.0)


def scatterers(
    shape: MeshShape, face_material: NDArray[np.int32], materials: Sequence[Material], spacing_m: float, seed: int
) -> tuple[Any, NDArray[np.int64]]:
    """Scatterers at about `spacing_m`, each at a random place of an equal part of its face; and the face of each, (n,).

    Those of a kind lie together, and those of `ka_spm` first. Raises InputError for more than `MOST`.
    """
    is_rough = np.array([material.rms_height_m != 0.0 for material in materials])
    faces = np.flatnonzero(is_rough[face_material])
    kind = np.array([kind_of(material) for material in materials])
    faces = faces[np.argsort(kind[face_material[faces]], kind="stable")]
    corners = shape.vertices[shape.faces[faces]]
    start = corners[:, 0].copy()
    first, second = corners[:, 1] - start, corners[:, 2] - start
    cross = np.cross(first, second)
    twice = np.linalg.norm(cross, axis=1)
    # The expected number of scatterers is exact, so small faces get one now and then, with the area of a whole cell.
    wanted = 0.5 * twice / spacing_m**2
    if wanted.sum() > MOST:
        raise InputError(
            f"rough faces: found {0.5 * twice.sum():.3g} m2, {wanted.sum():.3g} scatterers {spacing_m:.3g} m apart; "
            f'must be at most {MOST:.3g}, or leave "rough" out of radar.terms'
        )
    random = np.random.default_rng(seed)
    count = np.floor(wanted + random.random(len(faces))).astype(int)
    of = np.repeat(np.arange(len(faces)), count)
    a, b = random.random((2, len(of)))
    outside = a + b > 1.0
    for part in (a, b):
        np.subtract(1.0, part, out=part, where=outside)
    made = records(rough.Scatterer, len(of))
    normal = cross / twice[:, None]
    for low in range(0, len(of), _TOGETHER):
        some = slice(low, low + _TOGETHER)
        face = of[some]
        made["point"][some] = start[face] + a[some, None] * first[face] + b[some, None] * second[face]
        made["normal"][some] = normal[face]
        gauss = random.standard_normal((len(face), 4)) * np.sqrt(0.5)
        made["diffuse"][some], made["specular"][some] = gauss[:, :2], gauss[:, 2:]
    made["area"] = spacing_m**2
    made["material"] = face_material[faces][of]
    return made, faces[of]


def surfaces(materials: Sequence[Material]) -> Any:
    """The parameters of the surface model, one for each material. A model does not look at those that it has not."""
    packed = records(rough.RoughSurface, len(materials))
    for m, material in enumerate(materials):
        eps = _CONDUCTOR if material.conductor else material.eps_r or 1.0
        packed["spectrum"][m] = Spectrum[material.spectrum.upper()]
        packed["permittivity"][m] = eps if isinstance(eps, tuple) else (eps, 0.0)
        packed["rms_height"][m] = material.rms_height_m or 0.0
        length = material.correlation_length_m or float(bistatic.HEIGHTS) * packed["rms_height"][m] or 1.0
        packed["length"][m] = length if isinstance(length, tuple) else (length, length)
        packed["specular_fraction"][m] = material.specular_fraction
    return packed
