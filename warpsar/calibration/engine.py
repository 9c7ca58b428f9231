"""The prediction of the engine: a trihedral's mesh, at its attitude, seen by `warpsar.rcs`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from warpsar.calibration.attitude import Facing, Shape
from warpsar.coherent.rcs import rcs
from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Grid, Material, Polarization, Radar, View

F64 = NDArray[np.float64]


def trihedral_mesh(shape: Shape, leg_m: float, facing: Facing) -> Mesh:
    """Plates of a trihedral about its corner, in east, north, up [m]; without thickness."""
    x, y, z = leg_m * facing.legs()
    corner = np.zeros(3)
    if shape == "triangular":
        return Mesh.of(np.stack([corner, x, y, z]), np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]]))
    plates = [(corner, p, p + q, q) for p, q in ((x, y), (y, z), (z, x))]
    faces = [[i, i + 1, i + 2, i, i + 2, i + 3] for i in range(0, 12, 4)]
    return Mesh.of(np.concatenate(plates), np.array(faces).reshape(-1, 3))


def engine_rcs_m2(
    shape: Shape,
    leg_m: float,
    facing: Facing,
    look_deg: Sequence[tuple[float, float]],
    frequency_hz: float,
    polarization: Polarization,
    device: str | None = None,
) -> F64:
    """Radar cross-sections [m2], (n,), for directions to the radar: azimuth clockwise from north, and incidence [deg].

    All bounces and edges of a perfect conductor, without the ground (docs/coherent.md).
    """
    mesh = trihedral_mesh(shape, leg_m, facing)
    scene = Scene(
        mesh=mesh,
        radar=Radar(frequency_hz=frequency_hz, polarizations=(polarization,)),
        grid=Grid(shape=(4, 4), spacing_m=(1.0, 1.0)),
        materials={name: Material(conductor=True) for name in mesh.materials},
        views=[View(name="none", azimuth_deg=0.0, incidence_deg=45.0)],
        reference_point_m=(0.0, 0.0, 0.0),
    )
    found = [rcs(scene, azimuth, incidence, device=device).rcs_m2[0, 0, 0, 0] for azimuth, incidence in look_deg]
    return np.array(found)
