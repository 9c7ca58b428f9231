"""From gradients of the hits' coordinates to gradients of the nodes."""

from __future__ import annotations

import numpy as np
import warp as wp

from warpsar.kernels import shade, shade_lanes
from warpsar.kernels.codes import PAGE, Layout
from warpsar.kernels.wide import NODE_LANES
from warpsar.runtime.launches import Launch, by_stretches
from warpsar.runtime.structs import fill
from warpsar.surface.stage import Stage
from warpsar.trace.merge import starts

_LONGEST = 64  # entries that one thread adds up
_NODES: dict[int, int] = {Layout.UNIFORM: 1, Layout.VERTEX: 3, Layout.TEXTURE: 4}  # that a value mixes


class Spread:
    """The adjoint of `gather_kernel` to the nodes: `nodes_gradient` += A^T `zeta_gradient`, for zeta = A nodes.

    A hit knows its nodes. So Warp's own adjoint adds nine numbers a hit to addresses to which other hits add too. Here
    A is stored by its columns, sorted once: the (hit, share) of a node lie side by side, are read in order and added up
    in registers. Parameters that are laid out alike share one column. `page` counts the vectors of coordinates.
    """

    def __init__(self, stage: Stage, face: wp.array, barycentric: wp.array, page: int = 0) -> None:
        device = face.device
        terms, leader = _terms(stage.surface.places[:, page * PAGE : (page + 1) * PAGE])
        entries = face.shape[0] * terms.shape[1]
        none = stage.surface.nodes.size
        table: wp.array = wp.array(terms, dtype=wp.vec2i, device=device)
        seen = [fill(shade.OnMesh, face=face, barycentric=barycentric), stage.node_maps[page]]

        def empty(n: int, dtype: type = int) -> wp.array:
            return wp.empty(n, dtype=dtype, device=device)

        # twice as long as they are: the sort's room
        node, entry = empty(2 * entries), empty(2 * entries)
        inputs = [*seen, table, none]
        wp.launch(shade.site_kernel, entries, inputs=inputs, outputs=[node, entry], device=device)
        wp.utils.radix_sort_pairs(node, entry, entries, 0, max(1, none.bit_length()))
        self.first, used = starts(node[:entries] if entries else node, _LONGEST, none), entries
        if entries and int(node[entries - 1 : entries].numpy()[0]) == none:  # the last stretch is that of no node
            last = self.first.shape[0] - 1
            used = int(self.first[last:].numpy()[0])
            self.first = self.first[:last] if last else empty(0)
        stretches = self.first.shape[0]
        self.part = empty(used, wp.int64)
        inputs = [*seen, entry, table]
        wp.launch(shade.share_kernel, used, inputs=inputs, outputs=[self.part], device=device)
        self.target = empty(stretches, wp.vec4i)
        inputs = [*seen, self.first, entry, node, table, wp.array(leader, dtype=int, device=device)]
        wp.launch(shade.target_kernel, stretches, inputs=inputs, outputs=[self.target], device=device)

    def adding(self, zeta_gradient: wp.array, nodes_gradient: wp.array) -> Launch:
        """The launch that adds to `nodes_gradient`."""
        device, stretches = zeta_gradient.device, self.first.shape[0]
        assert device is not None
        inputs, outputs = [self.first, self.target, self.part, zeta_gradient], [nodes_gradient]
        if device.is_cpu:
            pieces = by_stretches(self.first, self.part, [self.target])
            return Launch(shade_lanes.spread_kernel, stretches, inputs, outputs, device, pieces)
        return Launch(shade.spread_kernel, stretches * NODE_LANES, inputs, outputs, device)

    def entries(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A by its elements: the hit, the share (float64) and the nodes of the four parameters, -1 for none.

        Shapes (n,), (n,) and (n, 4).
        """
        part, first = self.part.numpy(), self.first.numpy()
        share = (part & 0xFFFFFFFF).astype(np.uint32).view(np.float32).astype(float)
        target = np.repeat(self.target.numpy(), np.diff(first, append=part.size), axis=0)
        return (part >> 32).astype(int), share, target


def _terms(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The nodes of each material's values, and which kinds of parameter share them; int32.

    First (kind, number of the node) of each term, shape (materials, terms, 2), kind -1 for none. Second, for each kind,
    the first kind that is laid out alike, -1 where it is held: shape (materials, kinds).
    """
    leader = np.full(places.shape[:2], -1, np.int32)
    found: list[list[tuple[int, int]]] = []
    for m, kinds in enumerate(places):
        found.append([])
        for k, (layout, _, *shape) in enumerate(kinds):
            if layout == Layout.HELD:
                continue
            alike = [j for j in range(k) if leader[m, j] == j and [kinds[j][0], *kinds[j][2:]] == [layout, *shape]]
            leader[m, k] = alike[0] if alike else k
            if not alike:
                found[m] += [(k, number) for number in range(_NODES[int(layout)])]
    terms = np.full((len(found), max(map(len, found)), 2), -1, np.int32)
    for m, row in enumerate(found):
        terms[m, : len(row)] = np.array(row, np.int32).reshape(-1, 2)
    return terms, leader
