"""The two scenes on which several effects are missing at once (diagnosis_pairs.py)."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import diagnosis_rates
import numpy as np

from warpsar.scene.scene import Scene
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Grid, Material, Radar, Sampling, View

SIDES = 24  # of the tank
YARD = {"gravel": (5.0, 0.0020, 0.012), "brick": (7.0, 0.0012, 0.009), "tile": (4.5, 0.0015, 0.011)}
# azimuth, incidence, role
YARD_VIEWS = (
    (25, 33, "train"),
    (85, 50, "train"),
    (150, 41, "train"),
    (230, 47, "train"),
    (320, 37, "train"),
    (120, 44, "test"),
)


class _Builder:
    """Triangles of a mesh, added polygon by polygon; corners counter-clockwise as seen from outside."""

    def __init__(self) -> None:
        self.vertices: list[tuple[float, float, float]] = []
        self.faces: list[list[int]] = []
        self.material: list[int] = []

    def polygon(self, material: int, *corners: tuple[float, float, float]) -> None:
        """A convex polygon, as a fan."""
        n = len(self.vertices)
        self.vertices += corners
        self.faces += [[n, n + k, n + k + 1] for k in range(1, len(corners) - 1)]
        self.material += [material] * (len(corners) - 2)

    def shed(self, x: float, y: float, width: float, length: float, eaves: float, ridge: float) -> None:
        """A shed whose ridge runs along y; (x, y) is its corner of least coordinates."""
        a, b, m, c, d = x, x + width, x + width / 2, y, y + length
        self.polygon(1, (a, d, 0), (a, c, 0), (a, c, eaves), (a, d, eaves))
        self.polygon(1, (b, c, 0), (b, d, 0), (b, d, eaves), (b, c, eaves))
        self.polygon(1, (a, c, 0), (b, c, 0), (b, c, eaves), (m, c, ridge), (a, c, eaves))
        self.polygon(1, (b, d, 0), (a, d, 0), (a, d, eaves), (m, d, ridge), (b, d, eaves))
        self.polygon(2, (a, c, eaves), (m, c, ridge), (m, d, ridge), (a, d, eaves))
        self.polygon(2, (m, c, ridge), (b, c, eaves), (b, d, eaves), (m, d, ridge))

    def tank(self, x: float, y: float, radius: float, height: float) -> None:
        """An upright cylinder with a flat top."""
        angles = 2.0 * np.pi * np.arange(SIDES + 1) / SIDES
        rim = [(x + radius * float(np.cos(a)), y + radius * float(np.sin(a))) for a in angles]
        for (ax, ay), (bx, by) in pairwise(rim):
            self.polygon(1, (ax, ay, 0), (bx, by, 0), (bx, by, height), (ax, ay, height))
        self.polygon(2, *((px, py, height) for px, py in rim[:-1]))


def yard() -> Scene:
    """Three gabled sheds in a row and a tank on level gravel of 30 m; five train views and a test view, HH and VV."""
    made = _Builder()
    made.polygon(0, (-15, -15, 0), (15, -15, 0), (15, 15, 0), (-15, 15, 0))
    for x in (-11.0, -4.0, 3.0):
        made.shed(x, -9.0, 5.0, 9.0, 3.0, 4.6)
    made.tank(4.0, 7.0, 3.2, 4.0)
    mesh = Mesh(
        np.array(made.vertices, float),
        np.array(made.faces, np.int32),
        np.array(made.material, np.int32),
        tuple(YARD),
    )
    return Scene(
        mesh=mesh,
        radar=Radar(frequency_hz=9.6e9, polarizations=("HH", "VV")),
        grid=Grid(shape=(64, 64), spacing_m=(0.5, 0.5)),
        materials={
            name: Material(**dict(zip(diagnosis_rates.KEYS, values, strict=True))) for name, values in YARD.items()
        },
        views=[
            View(name=f"v{i}", azimuth_deg=a, incidence_deg=b, role=role) for i, (a, b, role) in enumerate(YARD_VIEWS)
        ],
        sampling=Sampling(rays_per_pixel=diagnosis_rates.CLEAN_RAYS_PER_PIXEL),
    )


SCENES: dict[str, Callable[[], Scene]] = {"house": diagnosis_rates.truth, "yard": yard}
