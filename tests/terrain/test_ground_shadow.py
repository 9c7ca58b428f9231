"""What the radar sees of rough ground, against every facet held against every ray in NumPy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from product_files import SITE, nearest, place
from terrain_files import dem, product

import warpsar
from warpsar.terrain.result import SimulatedProduct
from warpsar.world.earth import geodetic_to_ecef

F64 = np.ndarray
SIZE, STEP_M = 31, 60.0
"""Posts: cells of the map are then a quarter of a post's, and their middles lie inside of facets."""
FINE_SIZE, FINE_M = 61, 20.0
"""Posts as near as cells: all middles lie on diagonals. Slopes that turn away from the radar do so over several."""


def hills(hole: bool) -> F64:
    """Slopes of some 50 degrees, as steep as rays at the site's incidence of some 51; with a hole of no data."""
    from scipy.ndimage import gaussian_filter

    rough = gaussian_filter(np.random.default_rng(11).standard_normal((SIZE, SIZE)), 2.0)
    heights = SITE[2] + 220.0 * rough / rough.std()
    if hole:
        heights[12:17, 13:18] = np.nan
    return heights


def round_hills() -> F64:
    from scipy.ndimage import gaussian_filter

    rough = gaussian_filter(np.random.default_rng(0).standard_normal((FINE_SIZE, FINE_SIZE)), 6.0)
    return np.asarray(SITE[2] + 80.0 * rough / rough.std())


def posts(path: Path) -> F64:
    """Earth-centred places of an elevation model's posts, (rows, columns, 3) [m]."""
    import rasterio

    with rasterio.open(path) as file:
        heights, affine = file.read(1).astype(np.float64), file.transform
    column, row = np.meshgrid(np.arange(heights.shape[1]) + 0.5, np.arange(heights.shape[0]) + 0.5)
    return geodetic_to_ecef(np.stack([affine.f + affine.e * row, affine.c + affine.a * column, heights], axis=-1))


def triangles(post: F64) -> F64:
    """(n, 3, 3): two between four posts, parted by the diagonal from lower left to upper right."""
    upper = np.stack([post[:-1, :-1], post[1:, :-1], post[:-1, 1:]], axis=2)
    lower = np.stack([post[:-1, 1:], post[1:, :-1], post[1:, 1:]], axis=2)
    found: F64 = np.concatenate([each.reshape(-1, 3, 3) for each in (upper, lower)])
    return found[np.isfinite(found).all(axis=(1, 2))]


def hit(start: F64, along: F64, facets: F64) -> np.bool_:
    """Whether a ray meets one of the facets (n, 3, 3) (Moeller and Trumbore 1997)."""
    a = facets[:, 0]
    ab, ac = facets[:, 1] - a, facets[:, 2] - a
    across = np.cross(along, ac)
    size = (ab * across).sum(-1)
    offset = start - a
    turned = np.cross(offset, ab)
    u, v = (offset * across).sum(-1) / size, (turned @ along) / size
    far = (turned * ac).sum(-1) / size
    return ((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (far > 0.0)).any()


def cells(found: SimulatedProduct, path: Path, count: int) -> tuple[F64, F64]:
    """Middles of some cells of the map on the ground, (n, 3) earth-centred, and their `shadow`.

    Middles on a diagonal between two facets are left out where others are not.
    """
    post, shadow = posts(path), found.map["shadow"]
    affine = found.map_place.affine
    import rasterio

    with rasterio.open(path) as file:
        inverse = ~file.transform
    known = np.argwhere(np.isfinite(shadow))
    chosen = known[np.linspace(0, len(known) - 1, count).astype(int)]
    lon, lat = (
        affine.c + affine.a * (chosen[:, 1] + 0.5),
        affine.f + affine.e * (chosen[:, 0] + 0.5),
    )
    column, row = inverse.a * lon + inverse.c - 0.5, inverse.e * lat + inverse.f - 0.5
    i, j = np.floor(row).astype(int), np.floor(column).astype(int)
    down, right = (row - i)[:, None], (column - j)[:, None]
    upper = post[i, j] + down * (post[i + 1, j] - post[i, j]) + right * (post[i, j + 1] - post[i, j])
    last = post[i + 1, j + 1]
    lower = last + (1.0 - down) * (post[i, j + 1] - last) + (1.0 - right) * (post[i + 1, j] - last)
    inside = np.abs(down + right - 1.0)[:, 0] > 0.02
    inside |= not inside.any()
    return np.where(down + right <= 1.0, upper, lower)[inside], shadow[chosen[:, 0], chosen[:, 1]][inside]


def by_every_facet(points: F64, path: Path) -> tuple[F64, F64]:
    """Whether rays turned by a tenth of a degree agree, and whether they meet a facet, for each point.

    Rays go to the satellite's place abeam of the site, less than 0.05 degrees from that abeam of a cell.
    """
    radar = place(nearest(SITE)[0])
    facets = triangles(posts(path))
    sure, dark = np.ones(len(points), bool), np.zeros(len(points), bool)
    for number, point in enumerate(points):
        to_radar = (radar - point) / np.linalg.norm(radar - point)
        up = point / np.linalg.norm(point)
        side = np.cross(to_radar, up) / np.linalg.norm(np.cross(to_radar, up))
        tilt = np.cross(side, to_radar)
        rays = [to_radar + np.deg2rad(0.1) * turn for turn in (0.0 * side, side, -side, tilt, -tilt)]
        answers = {bool(hit(point + 0.1 * up, ray, facets)) for ray in rays}
        sure[number], dark[number] = len(answers) == 1, True in answers
    return sure, dark


@pytest.mark.parametrize("hole", [False, True])
def test_every_ray_against_every_facet(tmp_path: Path, hole: bool) -> None:
    """Where rays turned by a tenth of a degree agree, the map says the same of each of 400 cells."""
    path = dem(tmp_path, hills(hole), step_m=STEP_M)
    found = warpsar.twin(product(tmp_path), path, geoid_offset_m=0.0, device="cpu")
    points, shadow = cells(found, path, 400)
    sure, dark = by_every_facet(points, path)
    assert sure.mean() > 0.95
    assert 0.1 < dark[sure].mean() < 0.9
    np.testing.assert_array_equal(shadow[sure] == 1.0, dark[sure])


def test_a_middle_between_two_facets_is_no_hole_in_the_shadow(tmp_path: Path) -> None:
    """There a facet that is turned away may begin at the very place, and the ray must not start below it. On a ridge
    the map takes the facet that lies away from the radar, and says shadow: so it may say it too often."""
    path = dem(tmp_path, round_hills(), step_m=FINE_M)
    found = warpsar.twin(product(tmp_path), path, geoid_offset_m=0.0, device="cpu")
    points, shadow = cells(found, path, 700)
    sure, dark = by_every_facet(points, path)
    assert 0.1 < dark[sure].mean() < 0.9
    assert not np.any((shadow == 0.0) & dark & sure)
    assert np.mean((shadow == 1.0)[sure] == dark[sure]) > 0.97
