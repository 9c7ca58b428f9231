"""Towns at random: ground with two to four buildings, seen from three to six sides; their images, and changes of both.

Studies of many scenes draw them: search_rates.py, interval_rates.py and storeys.py.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from warpsar.compare.comparison import compare
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.speckle.law import Law
from warpsar.speckle.likelihood import bounded, deviance
from warpsar.world.mesh import Mesh
from warpsar.world.tables import Grid, Material, Radar, Sampling, View

KEYS = ("eps_r", "rms_height_m", "correlation_length_m")
START_SD = 0.2  # of ln(eps_r - 1), ln h, ln l about the truth
RAYS_PER_PIXEL = 1024.0
CORRELATION_PX = 0.7  # standard deviation of the field's Gaussian response
SHARING = 2.0 * math.pi * CORRELATION_PX**2  # pixels that then share one speckle: the intensity's correlation, summed
SEEN = 100.0  # 2 ln L, bounded, by which an image of the truth must differ from one as declared: less is nothing
BOUND = 20.0


@dataclass(frozen=True)
class DrawnTown:
    """`true`: the scene of the images. `declared`: that of the file. `law`, by view: how power scatters. `change`: what
    is done to an image beside speckle."""

    true: Scene
    declared: Scene
    law: Mapping[str, Law]
    change: Callable[[str, np.ndarray], np.ndarray]


def building(random: np.random.Generator, middle: np.ndarray, gabled: bool) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Vertices, faces and the name of each face's material: a box, turned, with a flat or a gabled roof."""
    length, width, height = random.uniform(5.0, 11.0), random.uniform(4.0, 8.0), random.uniform(3.0, 7.0)
    turn = random.uniform(0.0, math.pi)
    low = [[x * length / 2, y * width / 2, z] for z in (0.0, height) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    ridge = [[-length / 2, 0.0, height + 0.4 * width], [length / 2, 0.0, height + 0.4 * width]]
    faces, names = [], []
    for a in range(4):
        b = (a + 1) % 4
        faces += [[a, b, 4 + b], [a, 4 + b, 4 + a]]
        names += ["wall", "wall"]
    if gabled:
        faces += [[4, 5, 9], [4, 9, 8], [6, 7, 8], [6, 8, 9], [4, 8, 7], [5, 6, 9]]
        names += ["roof"] * 4 + ["wall"] * 2
    else:
        faces += [[4, 5, 6], [4, 6, 7]]
        names += ["roof"] * 2
    points = np.array([*low, *ridge])
    cosine, sine = math.cos(turn), math.sin(turn)
    points[:, :2] = points[:, :2] @ np.array([[cosine, sine], [-sine, cosine]])
    points[:, :2] += middle
    return points, np.array(faces), names


def town(random: np.random.Generator, *, gabled: int = 0) -> Mesh:
    """Level ground and buildings that stand apart; each is a group of the mesh. `gabled`: how many have gables."""
    half = 26.0
    vertices = [np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])]
    faces, names, groups = [np.array([[0, 1, 2], [0, 2, 3]])], ["ground", "ground"], {}
    count = int(random.integers(2, 5))
    places = random.permutation([[-11.0, -10.0], [11.0, -9.0], [-9.0, 11.0], [10.0, 10.0]])[:count]
    for k, place in enumerate(places):
        points, own, materials = building(random, place + random.uniform(-2.0, 2.0, 2), k < gabled)
        first = sum(len(one) for one in faces)
        faces.append(own + sum(len(one) for one in vertices))
        vertices.append(points)
        names += materials
        groups[f"house{k}"] = np.arange(first, first + len(own), dtype=np.int32)
    order = ("ground", "wall", "roof")
    index = np.array([order.index(name) for name in names], np.int32)
    return Mesh(np.concatenate(vertices), np.concatenate(faces).astype(np.int32), index, order, groups=groups)


def base(random: np.random.Generator, **of_mesh: Any) -> Scene:
    spacing = float(random.choice([0.4, 0.5, 0.6]))
    count = int(random.integers(3, 7))
    first = random.uniform(0.0, 360.0)
    looks = float(random.choice([1.0, 2.0, 4.0, 8.0, 16.0]))
    views = [
        View(
            name=f"v{k}",
            azimuth_deg=float((first + 360.0 * k / count + random.uniform(-15.0, 15.0)) % 360.0),
            incidence_deg=float(random.uniform(32.0, 58.0)),
            role="test" if k == count - 1 else "train",
            looks=looks,
        )
        for k in range(count)
    ]
    values = {
        "ground": (random.uniform(3.0, 10.0), random.uniform(8e-4, 1.8e-3), random.uniform(6e-3, 1.4e-2)),
        "wall": (random.uniform(4.0, 10.0), random.uniform(5e-4, 1.5e-3), random.uniform(4e-3, 1e-2)),
        "roof": (random.uniform(3.0, 8.0), random.uniform(5e-4, 1.5e-3), random.uniform(4e-3, 1e-2)),
    }
    side = int(random.choice([96, 112, 128]))
    return Scene(
        mesh=town(random, **of_mesh),
        radar=Radar(frequency_hz=9.6e9, polarizations=("HH",)),
        grid=Grid(shape=(side, side), spacing_m=(spacing, spacing)),
        materials={name: Material(**dict(zip(KEYS, value, strict=True))) for name, value in values.items()},
        views=views,
        sampling=Sampling(rays_per_pixel=RAYS_PER_PIXEL, seed=int(random.integers(1, 10**6))),
    )


def as_it_is(name: str, image: np.ndarray) -> np.ndarray:
    return image


def laws(scene: Scene, texture: float = math.inf, factor: float = 1.0) -> dict[str, Law]:
    """The laws of the views' declared looks, times a factor."""
    found = {}
    for view in scene.views:
        assert view.looks is not None
        found[view.name] = Law(view.looks * factor, texture)
    return found


def turned(scene: Scene, name: str, azimuth_deg: float = 0.0, incidence_deg: float = 0.0) -> Scene:
    """The scene whose view, or all views, look from elsewhere."""
    return replace(
        scene,
        views=[
            v.model_copy(
                update={
                    "azimuth_deg": v.azimuth_deg + azimuth_deg,
                    "stated_incidence_deg": v.incidence_deg + incidence_deg,
                }
            )
            if name in ("", v.name)
            else v
            for v in scene.views
        ],
    )


def moved(scene: Scene, change: Callable[[np.ndarray], np.ndarray]) -> Scene:
    """The scene whose first house has other vertices."""
    mesh = scene.mesh
    own = np.unique(mesh.faces[mesh.groups["house0"]])
    vertices = mesh.vertices.copy()
    vertices[own] = change(vertices[own])
    return replace(scene, mesh=replace(mesh, vertices=vertices))


def without(scene: Scene) -> Scene:
    """The scene without its first house."""
    mesh = scene.mesh
    keep = np.ones(len(mesh.faces), bool)
    keep[mesh.groups["house0"]] = False
    return replace(scene, mesh=replace(mesh, faces=mesh.faces[keep], face_material=mesh.face_material[keep], groups={}))


def sign(random: np.random.Generator, low: float, high: float) -> float:
    return float(random.choice([-1.0, 1.0]) * random.uniform(low, high))


def patch_of_ground(scene: Scene, centre: np.ndarray, width: float, level: float) -> Callable[..., np.ndarray]:
    """A round patch of ground that is brighter in every view, at its place in each."""
    from warpsar.world.world import geometry_of

    def change(name: str, image: np.ndarray) -> np.ndarray:
        axes = geometry_of(scene, next(view for view in scene.views if view.name == name))
        rows, cols = np.indices(image.shape) + 0.5
        along = (rows - image.shape[0] / 2.0) * scene.grid.spacing_m[0] / math.hypot(*axes.d[:2]) ** 2
        across = (cols - image.shape[1] / 2.0) * scene.grid.spacing_m[1]
        ground = along[..., None] * axes.d[:2] + across[..., None] * axes.u[:2]
        inside = np.hypot(*(np.moveaxis(ground, -1, 0) - centre[:, None, None])) < width
        return np.where(inside, image * (1.0 + level), image)

    return change


def smear(name: str, row: int, level: float) -> Callable[..., np.ndarray]:
    """Power along a line of range columns in one view."""

    def change(of: str, image: np.ndarray) -> np.ndarray:
        changed = image.copy()
        if of == name:
            changed[row : row + 2, 20:60] += level * np.median(image[image > 0])
        return changed

    return change


def speckled(random: np.random.Generator, law: Law, shape: tuple[int, int], correlated: bool) -> np.ndarray:
    """Intensity of mean 1: white, or of fields with a Gaussian response. Texture is white."""
    if not correlated:
        return law.draw(random, shape)
    fields = gaussian_filter(
        random.standard_normal((2 * round(law.looks), *shape)), (0.0, CORRELATION_PX, CORRELATION_PX), mode="wrap"
    )
    impulse = np.zeros(shape)
    impulse[0, 0] = 1.0
    power = float((gaussian_filter(impulse, CORRELATION_PX, mode="wrap") ** 2).sum())
    texture = 1.0 if math.isinf(law.texture) else random.gamma(law.texture, 1.0 / law.texture, shape)
    return np.asarray((fields**2).mean(axis=0) / power * texture)


def seeing(views: Iterable[View], images: Callable[[View], np.ndarray]) -> list[View]:
    """The views with what they measure, in HH."""
    return [view.model_copy(update={"images": {"HH": images(view).astype(np.float32)}}) for view in views]


def with_images(
    random: np.random.Generator, found: DrawnTown, clean: Mapping[str, np.ndarray], correlated: bool
) -> list[View]:
    """The declared views with the images under speckle."""

    def image(view: View) -> np.ndarray:
        return clean[view.name] * speckled(random, found.law[view.name], clean[view.name].shape, correlated)

    return seeing(found.declared.views, image)


def seen(found: DrawnTown, clean: Mapping[str, np.ndarray], sharing: float, device: str) -> float:
    """2 ln L by which images without speckle differ from the declared model, bounded, plus what other laws of speckle
    make of it: how much there is to be found. `sharing`: pixels that share one speckle."""
    views = seeing(found.declared.views, lambda view: np.maximum(clean[view.name], 1e-12))
    total = 0.0
    for image in compare(replace(found.declared, views=views), devices.resolve_device(device), edges=False).images:
        level = image.level
        use = image.usable
        terms = 0.5 * deviance(image.measured[use] + level, image.simulated[use] + level, image.seen.looks)
        total += 2.0 * float(bounded(terms, BOUND).sum())
        law, stated = found.law[image.view.name], image.seen.law
        if law != stated:
            total += image.seen.count * abs(law.log_mean - stated.log_mean)
    return total / sharing
