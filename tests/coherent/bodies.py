"""Bodies with closed forms, and what comes back from them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import warpsar
from warpsar.world.frame import SPEED_OF_LIGHT

WAVELENGTH = 0.03
FREQUENCY = SPEED_OF_LIGHT / WAVELENGTH
K = 2.0 * np.pi / WAVELENGTH
ALL = ("HH", "HV", "VH", "VV")
DIAGONAL = float(np.rad2deg(np.arccos(1.0 / np.sqrt(3.0))))
"""Incidence of the axis of a corner between the planes of the coordinates [deg]."""


def rectangles(*corners: ArrayLike) -> warpsar.Mesh:
    """A mesh of rectangles, (4, 3) each."""
    vertices = np.concatenate([np.asarray(each, float) for each in corners])
    faces = np.concatenate([[[i, i + 1, i + 2], [i, i + 2, i + 3]] for i in range(0, len(vertices), 4)])
    return warpsar.Mesh.of(vertices, faces)


def plate(width: float, height: float) -> warpsar.Mesh:
    """In the plane x = 0, about the origin."""
    y, z = width / 2, height / 2
    return rectangles([[0, -y, -z], [0, y, -z], [0, y, z], [0, -y, z]])


def dihedral(a: float, b: float) -> warpsar.Mesh:
    """Two plates, a wide and b high, that meet in the z axis; it opens to +X+Y."""
    return rectangles([[0, 0, 0], [a, 0, 0], [a, 0, b], [0, 0, b]], [[0, 0, 0], [0, a, 0], [0, a, b], [0, 0, b]])


def square_trihedral(a: float) -> warpsar.Mesh:
    return rectangles(
        [[0, 0, 0], [a, 0, 0], [a, a, 0], [0, a, 0]],
        [[0, 0, 0], [a, 0, 0], [a, 0, a], [0, 0, a]],
        [[0, 0, 0], [0, a, 0], [0, a, a], [0, 0, a]],
    )


def triangular_trihedral(a: float) -> warpsar.Mesh:
    corners = np.array([[0, 0, 0], [a, 0, 0], [0, a, 0], [0, 0, a]], float)
    return warpsar.Mesh.of(corners, np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1]]))


def scene(mesh: warpsar.Mesh, *, reference: Any = (0.0, 0.0, 0.0), material: Any = None, **radar: Any) -> warpsar.Scene:
    material = material or {"conductor": True}
    return warpsar.Scene(
        mesh=mesh,
        radar=warpsar.Radar(**{"frequency_hz": FREQUENCY, "polarizations": ALL, **radar}),
        grid=warpsar.Grid(shape=(4, 4), spacing_m=(1.0, 1.0)),
        materials={name: warpsar.Material(**material) for name in mesh.materials},
        views=[warpsar.View(name="none", azimuth_deg=0.0, incidence_deg=45.0)],
        reference_point_m=reference,
    )


def amplitudes(
    mesh: warpsar.Mesh, azimuth: ArrayLike, incidence: ArrayLike, *, finer: float = 10.0, **more: Any
) -> NDArray[np.complex128]:
    """A [m] at every pair of angles, shape (azimuths, incidences, 4), of one frequency."""
    found = warpsar.rcs(scene(mesh, **more), azimuth, incidence, device="cpu", rays_per_wavelength=finer)
    return found.amplitude_m[:, :, 0]


def decibels(area: ArrayLike) -> NDArray[np.float64]:
    return 10.0 * np.log10(np.asarray(area, float))


def cross_section(amplitude: ArrayLike) -> NDArray[np.float64]:
    return 4.0 * np.pi * np.abs(np.asarray(amplitude)) ** 2
