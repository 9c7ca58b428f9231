"""Total variation of parameter fields, in log coordinates with one weight per kind of parameter (equation 39)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import warp as wp

from warpsar.kernels import loss as kernels
from warpsar.runtime.program import Program
from warpsar.surface.surface import Block, Surface
from warpsar.world.mesh import Mesh

# Differences below this (0.1 % of a parameter) are priced as squares, so that the slope at 0 exists.
ROUNDING = 1e-3


def neighbours(block: Block, mesh: Mesh, material_index: int) -> np.ndarray:
    """Pairs of neighbouring nodes of a field, shape (n, 2), counted from the block's first node.

    Neighbours are texels that share a side, or vertices that share an edge of a face of the material.
    """
    if block.layout == "texture":
        number = np.arange(block.size).reshape(block.shape)
        across = np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], 1)
        down = np.stack([number[:-1].ravel(), number[1:].ravel()], 1)
        return np.concatenate([across, down])
    faces = mesh.faces[mesh.face_material == material_index]
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    return np.unique(np.sort(edges, axis=1), axis=0) - block.first_vertex


class TotalVariation:
    """Sum over neighbours of weight * |difference| of the learned fields, as a program with a gradient.

    `nodes`: the device array that views share (CUDA); by default it has its own. `loss` are partial sums, float64.
    """

    def __init__(
        self,
        surface: Surface,
        mesh: Mesh,
        weights: Mapping[str, float],
        device: wp.Device,
        nodes: wp.array | None,
    ) -> None:
        self.program = Program(device)
        self.nodes = self.program.array(surface.nodes.size) if nodes is None else nodes
        self.loss = self.program.array(int(kernels.PARTIALS), wp.float64, sum_into=True)
        pairs, strength = [], []
        for block in surface.blocks:
            weight = weights.get(block.kind.key, 0.0)
            if block.learn and block.size > 1 and weight > 0:
                found = neighbours(block, mesh, surface.materials.index(block.material)) + block.start
                pairs.append(found)
                strength.append(np.full(len(found), weight))
        self.count = sum(len(p) for p in pairs)
        if not self.count:
            return
        ends = np.concatenate(pairs).T.astype(np.int32, order="C")
        first: wp.array = wp.array(ends[0], dtype=int, device=device)
        second: wp.array = wp.array(ends[1], dtype=int, device=device)
        weight_array: wp.array = wp.array(np.concatenate(strength).astype(np.float32), dtype=float, device=device)
        self.program.launch(
            kernels.variation_kernel,
            self.count,
            [first, second, weight_array, self.nodes, ROUNDING],
            [self.loss],
        )
