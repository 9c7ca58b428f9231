"""What the edge of an endless wedge adds to physical optics, of waves across it: the engine's own fringe currents."""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.coherent.body import faces_of
from warpsar.coherent.records import records, upload
from warpsar.kernels.coherent import coated_edges, edges, reflection, tubes
from warpsar.world.frame import SPEED_OF_LIGHT
from warpsar.world.tables import Material

_LENGTH_M = 1e-6


def fringes(
    material: Material,
    frequency_hz: float,
    phi: NDArray[np.float64],
    outer: float = 2.0,
    reach_m: float = 1e9,
) -> NDArray[np.complex128]:
    """Diffraction coefficients of a wedge of metal, bare or under layers, E and H along its edge, (2, n).

    The wave comes from and goes to angles `phi` (n,) [rad] from the first face. They are those of Keller, without their
    factor e^{-j pi / 4} / sqrt(2 pi k), less those of physical optics of both faces. `outer`: the outer angle over pi,
    2 for a half-plane; `reach_m`: length of the faces.
    """
    edge, radar = records(edges.Edge, 1), records(tubes.TubeRadar, len(phi))
    cosine, sine = np.cos(outer * np.pi), np.sin(outer * np.pi)
    edge["along"], edge["outer"], edge["share"] = [0.0, 0.0, _LENGTH_M], outer, 1.0
    edge["first"], edge["normal_first"] = [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]
    edge["second"], edge["normal_second"] = [cosine, sine, 0.0], [sine, -cosine, 0.0]
    edge["reach_first"] = edge["reach_second"] = reach_m
    level = np.zeros_like(phi)
    radar["s"] = np.stack([np.cos(phi), np.sin(phi), level], axis=1)
    radar["u"] = np.stack([-np.sin(phi), np.cos(phi), level], axis=1)
    radar["v"] = np.stack([level, level, level + 1.0], axis=1)
    device = wp.get_device("cpu")
    out = wp.empty((len(phi), 1, 1, 4), dtype=wp.vec2d, device=device)
    inputs = [
        upload(radar, tubes.TubeRadar, device),
        upload([2.0 * np.pi * frequency_hz / SPEED_OF_LIGHT], wp.float64, device),
        upload(edge, edges.Edge, device),
        upload(np.ones((len(phi), 1)), wp.uint8, device),
        upload(faces_of([material]), reflection.Face, device),
    ]
    wp.launch(coated_edges.coated_edges_kernel, (len(phi), 1, 1), inputs=inputs, outputs=[out], device=device)
    four = out.numpy()[:, 0, 0] @ np.array([1.0, 1.0j])
    return np.asarray(2.0 * np.pi / _LENGTH_M * np.stack([-four[:, 3], four[:, 0]]), np.complex128)
