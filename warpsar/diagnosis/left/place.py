"""Where on the surface something is left: a window of pixels back to the world, and the residual on the mesh."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter

from warpsar.compare.comparison import Comparison
from warpsar.diagnosis.found import Diagnosis
from warpsar.diagnosis.models.projection import pixel_of, shift_px
from warpsar.evaluation.meshview import MeshView
from warpsar.scene.scene import Scene
from warpsar.speckle.scan import Spot, Window
from warpsar.trace.hits import Hits
from warpsar.world.tables import View

SMOOTHED = 5  # pixels on a side over which the residual on the mesh is averaged


@dataclass(frozen=True)
class SurfacePart:
    """Lit surface of one material inside the window: its share of the window's lit area (dA), its middle and corners in
    world coordinates [m]."""

    material: str
    share: float
    centre_m: list[float]
    low_m: list[float]
    high_m: list[float]


@dataclass(frozen=True)
class InView:
    """The place in one image, seen there or not: the pixel, and measured over modelled power about it [dB]."""

    image: str
    role: str
    row: int
    col: int
    ratio_db: float


@dataclass(frozen=True)
class ResidualPlace:
    """The strongest window on the surface.

    `range_m`, `azimuth_m`: its middle, about the reference point. `ratio_db`: measured over modelled power in it [dB].
    `parts`: what is lit in it, largest first; none where nothing is. `views`: the middle of the largest part in every
    image.
    """

    view: str
    polarization: str
    row: int
    col: int
    window: Window
    z: float
    ratio_db: float
    range_m: float
    azimuth_m: float
    parts: list[SurfacePart]
    views: list[InView]


def place(diagnosis: Diagnosis, images: Sequence[Comparison], spot: Spot) -> ResidualPlace:
    """Back-project the spot; `images` are the final model's."""
    scene = diagnosis.final.scene
    seen = diagnosis.observations[spot.observation]
    train = [image for image in images if image.role == "train"]
    rows, cols = scene.grid.shape
    hits = _hits(diagnosis, seen.view)
    shift = shift_px(scene, seen.view)
    pixel = hits.pixel.numpy()
    high, wide = spot.window
    inside = (np.abs(pixel // cols - (spot.row - shift[0])) <= high // 2 + 0.5) & (
        np.abs(pixel % cols - (spot.col - shift[1])) <= wide // 2 + 0.5
    )
    parts = _parts(scene, hits, inside)
    middle = [
        (i + 0.5 - n / 2) * s for i, n, s in zip((spot.row, spot.col), (rows, cols), scene.grid.spacing_m, strict=True)
    ]
    views = (
        [] if not parts else [_in_view(diagnosis, image, np.array(parts[0].centre_m), spot.window) for image in images]
    )
    return ResidualPlace(
        view=seen.view.name,
        polarization=seen.polarization,
        row=spot.row,
        col=spot.col,
        window=spot.window,
        z=spot.z,
        ratio_db=_window_db(train[spot.observation], spot.row, spot.col, spot.window),
        range_m=middle[0],
        azimuth_m=middle[1],
        parts=parts,
        views=views,
    )


def _hits(diagnosis: Diagnosis, view: View) -> Hits:
    """What the view lights, binned by its pixels."""
    return diagnosis.setup.rays_of(diagnosis.final.scene).hits(diagnosis.final.scene, view, [])


def _parts(scene: Scene, hits: Hits, inside: np.ndarray) -> list[SurfacePart]:
    points = hits.point.numpy()[inside].astype(float) + np.asarray(scene.reference_point_m)
    weight = hits.weight.numpy()[inside].astype(float)
    material = scene.mesh.face_material[hits.face.numpy()[inside]]
    found = []
    for index in np.unique(material):
        mine = material == index
        found.append(
            SurfacePart(
                scene.mesh.materials[index],
                float(weight[mine].sum() / weight.sum()),
                np.average(points[mine], axis=0, weights=weight[mine]).tolist(),
                points[mine].min(axis=0).tolist(),
                points[mine].max(axis=0).tolist(),
            )
        )
    return sorted(found, key=lambda part: -part.share)


def _in_view(diagnosis: Diagnosis, image: Comparison, world: np.ndarray, window: Window) -> InView:
    scene = diagnosis.final.scene
    row, col = (
        int(np.floor(at[0])) for at in pixel_of(scene, image.seen.view, (world - scene.reference_point_m)[None])
    )
    return InView(image.name, image.role, row, col, _window_db(image, row, col, window))


def _window_db(image: Comparison, row: int, col: int, window: Window) -> float:
    """10 log10 of measured over modelled power of the compared pixels in a window; nan where there are none."""
    rows, cols = image.simulated.shape
    high, wide = (size // 2 for size in window)
    box = (slice(max(row - high, 0), max(row + high + 1, 0)), slice(max(col - wide, 0), max(col + wide + 1, 0)))
    use = image.seen.interior[box]
    if row >= rows + high or col >= cols + wide or not use.any():
        return float("nan")
    ratio = image.seen.measured[box][use].sum(dtype=float) / image.simulated[box][use].sum()
    return float(10.0 * np.log10(ratio))


def residual_on(side: MeshView, diagnosis: Diagnosis, images: Sequence[Comparison]) -> np.ndarray:
    """Measured over modelled power [dB] at every ray of a picture of the mesh, averaged over `SMOOTHED` pixels and the
    train views that see the place; nan where none does, shape (n,)."""
    scene = diagnosis.final.scene
    rows, cols = scene.grid.shape
    faces = len(scene.mesh.faces)
    total, count = np.zeros((2, len(side.point)))
    for image in images:
        if image.role != "train":
            continue
        mask = image.seen.interior
        power = [
            uniform_filter(np.where(mask, plane, 0.0).astype(float), SMOOTHED, mode="constant")
            for plane in (image.seen.measured, image.simulated)
        ]
        row, col = pixel_of(scene, image.seen.view, side.point)
        on = np.flatnonzero((row >= 0) & (row < rows) & (col >= 0) & (col < cols))
        row, col = row[on], col[on]
        compared = mask[row.astype(int), col.astype(int)]
        on, row, col = on[compared], row[compared], col[compared]
        pixel = row.astype(int) * cols + col.astype(int)
        shift = shift_px(scene, image.seen.view)
        unmoved = np.floor(row - shift[0]).astype(int) * cols + np.floor(col - shift[1]).astype(int)
        hits = _hits(diagnosis, image.seen.view)
        seen = np.isin(unmoved * faces + side.face[on], hits.pixel.numpy().astype(np.int64) * faces + hits.face.numpy())
        on, pixel = on[seen], pixel[seen]
        total[on] += power[0].ravel()[pixel] / power[1].ravel()[pixel]
        count[on] += 1
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(10.0 * np.log10(total / count))
