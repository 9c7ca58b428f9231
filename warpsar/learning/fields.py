"""What the data tell about a parameter field: each node's standard deviation, and how many views see it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from warpsar.io.images import replacing, write_exr
from warpsar.learning.problem import FitProblem
from warpsar.runtime import console
from warpsar.scene.beside import file_stem
from warpsar.surface.samples import image_pixels
from warpsar.surface.surface import KINDS, Block

# An information block with a smaller share than this of its largest eigenvalue is blind in that direction.
BLIND = 1e-6


def node_weights(problem: FitProblem, block: Block, view_index: int) -> csr_array:
    """Interpolation weights of a block's nodes at the view's hits, shape (hits, block.size).

    Rows of other materials are empty.
    """
    hits = problem.views[view_index].render.whole.shaded
    mesh = problem.scene.mesh
    face = hits.face.numpy()
    mine = np.flatnonzero(mesh.face_material[face] == problem.surface.materials.index(block.material))
    b12 = hits.barycentric.numpy()[mine].astype(float)
    b = np.column_stack([1.0 - b12.sum(1), b12])
    corners = mesh.faces[face[mine]]
    if block.layout == "uniform":
        columns, weights = np.zeros((mine.size, 1), int), np.ones((mine.size, 1))
    elif block.layout == "vertex":
        columns, weights = corners - block.first_vertex, b
    else:
        assert mesh.uv is not None  # refused at the door
        uv = np.einsum("ij,ijk->ik", b, mesh.uv[corners].astype(float))
        rows, cols = block.shape
        x, y = uv[:, 0] * cols - 0.5, (1.0 - uv[:, 1]) * rows - 0.5
        x0, y0 = np.floor(x).astype(int), np.floor(y).astype(int)
        fx, fy = x - x0, y - y0
        xs = [np.clip(x0 + i, 0, cols - 1) for i in (0, 1)]
        ys = [np.clip(y0 + i, 0, rows - 1) for i in (0, 1)]
        columns = np.column_stack([ys[j] * cols + xs[i] for j in (0, 1) for i in (0, 1)])
        weights = np.column_stack([wy * wx for wy in (1 - fy, fy) for wx in (1 - fx, fx)])
    rows_of = np.repeat(mine, columns.shape[1])
    return csr_array((weights.ravel(), (rows_of, columns.ravel())), shape=(hits.count, block.size))


def hit_slopes(problem: FitProblem, view_index: int, polarization: str) -> np.ndarray:
    """d(sum of beta0) / d zeta of every hit at the last run, shape (hits, 4).

    One backward pass serves all hits, since each hit's power depends on its own coordinates alone. It leaves out how
    an effect of the image stage spreads this power over pixels.
    """
    render = problem.views[view_index].render.whole
    image = render.images[polarization]
    render.program.zero_gradients()  # arrays have none before the first is asked for
    render.zeta.retain_grad = True  # Warp spends an array's gradient on the launch that wrote it
    render.program.backward({image: np.ones(image.shape[0], np.float32)})
    return render.zeta.grad.numpy().astype(float)


@dataclass(frozen=True)
class FieldUncertainty:
    """Of one learned field, `stem` of its file: the standard deviation in the learned coordinate, and the number of
    views that see it, of each node, shape (nodes,)."""

    block: Block
    stem: str
    sd: np.ndarray
    views: np.ndarray

    def write(self, folder: Path) -> dict[str, Any]:
        """An EXR map of a texture, an NPY file of vertices, in `folder`. Returns a summary."""
        return _write(folder, self.stem, self.block, self.sd, self.views)


def field_uncertainty(problem: FitProblem, x: np.ndarray) -> dict[str, FieldUncertainty]:
    """What the views tell of each node of each field, by "material.key"; all processes call this.

    The Fisher information of the speckle is taken jointly over the parameters of one node. Neighbours are held, so the
    standard deviation is a lower bound; total variation is not counted. It is infinite for a node that no pixel sees.
    """
    problem.modelled(x)
    fields = [block for block in problem.surface.blocks if block.learn and block.size > 1]
    groups: dict[tuple[str, tuple[int, ...]], list[Block]] = {}
    for block in fields:
        groups.setdefault((block.material, block.shape), []).append(block)
    found: dict[str, FieldUncertainty] = {}
    if not problem.keeps_hits:
        console.say("fields: no standard deviations, which need the hits of all views at hand (--max-memory)")
        return found
    for (material, _), group in groups.items():
        size, kinds = group[0].size, [KINDS.index(b.kind) for b in group]
        information = np.zeros((size, len(group), len(group)))
        seen_in = np.zeros(size, int)
        for index, view in enumerate(problem.views):
            hits = view.render.whole.shaded
            at_hits = node_weights(problem, group[0], index)
            lit = np.zeros(size, bool)
            for seen in view.observations:
                slopes = hit_slopes(problem, index, seen.polarization)
                image = view.render.whole.images[seen.polarization].numpy().astype(float)
                used = seen.interior.ravel()
                pixel = image_pixels(hits, problem.scene.grid.shape)
                inside = (pixel >= 0) & used[pixel]
                collect = csr_array(
                    (inside.astype(float), (np.maximum(pixel, 0), np.arange(hits.count))),
                    shape=(used.size, hits.count),
                )
                scale = np.where(used, np.sqrt(seen.looks) / np.maximum(image, 1e-30), 0.0)
                columns = [
                    (collect @ at_hits.multiply(slopes[:, k][:, None]).tocsr()).multiply(scale[:, None]).tocsc()
                    for k in kinds
                ]
                for i, a in enumerate(columns):
                    for j, b in enumerate(columns):
                        information[:, i, j] += np.asarray(a.multiply(b).sum(axis=0)).ravel()
                lit |= np.asarray((collect @ at_hits).sum(axis=0)).ravel() > 0
            seen_in += lit
        information, seen_in = problem.over_views(information), problem.over_views(seen_in).astype(int)
        sd = _sd(information)
        for i, block in enumerate(group):
            stem = file_stem(problem.surface.materials, material, block.kind.key)
            found[f"{material}.{block.kind.key}"] = FieldUncertainty(block, stem, sd[:, i], seen_in)
    return found


def _sd(information: np.ndarray) -> np.ndarray:
    """Standard deviations from (n, k, k) information blocks; infinite along what a block cannot see."""
    values, vectors = np.linalg.eigh(information)
    seen = values > BLIND * np.maximum(values[:, -1:], 1e-300)
    inverse = np.where(seen, 1.0 / np.where(seen, values, 1.0), 0.0)
    variance = np.einsum("nij,nj,nij->ni", vectors, inverse, vectors)
    blind = np.einsum("nij,nj->ni", vectors**2, (~seen).astype(float)) > 1e-3
    return np.where(blind, np.inf, np.sqrt(variance))


def _write(folder: Path, stem: str, block: Block, sd: np.ndarray, seen_in: np.ndarray) -> dict[str, Any]:
    if block.layout == "texture":
        maps = {"sd": sd.reshape(block.shape), "views": seen_in.reshape(block.shape)}
        name = f"{stem}_sd.exr"
        write_exr(folder / name, {k: v.astype(np.float32) for k, v in maps.items()})
    else:
        name = f"{stem}_sd.npy"
        with replacing(folder / name) as temporary, temporary.open("wb") as stream:
            np.save(stream, np.column_stack([sd, seen_in]))
    finite = sd[np.isfinite(sd)]
    return {
        "file": name,
        "nodes": int(sd.size),
        "seen": int((seen_in > 0).sum()),
        "determined": int((sd < 0.5).sum()),
        "median_sd_log": float(np.median(finite)) if finite.size else None,
    }
