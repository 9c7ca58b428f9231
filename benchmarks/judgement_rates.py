"""How often `warpsar diagnose` gives an all-clear, where nothing is wrong and where something is.

    python benchmarks/judgement_rates.py run -o out/judgement --scenes 240
    python benchmarks/judgement_rates.py table -o out/judgement [--write]

Every scene is drawn from a seed that is its number: ground with two to four buildings, three to six views, 1 to 16
looks, white or correlated speckle, materials that start beside the truth. In a third of them nothing is wrong. In the
others the scene file declares one thing wrongly, or the images hold something that it does not say. Images are of rays,
1024 for each pixel; the judgement's are of exact areas. A run appends one line of JSON to runs.jsonl in the folder;
runs that are there already are not made again. docs/judgement.md has the results.
"""

import math
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.stats import beta

from warpsar.runtime import devices

sys.path.insert(0, str(Path(__file__).resolve().parent))

import runs
import tables

from warpsar.compare.comparison import compare
from warpsar.diagnosis.command import in_short
from warpsar.diagnosis.found import DiagnoseOptions
from warpsar.diagnosis.result import diagnose
from warpsar.effects.registry import get
from warpsar.io.images import write_tiff
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
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
MINUTES = 0.2  # for the search where something is wrong: its names are not asked here, and can only add to what is said


@dataclass(frozen=True)
class Drawn:
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


def laws(scene: Scene, texture: float = math.inf, factor: float = 1.0, only: str = "") -> dict[str, Law]:
    """The laws of the views' declared looks, times a factor (in one view, or in all)."""
    found = {}
    for view in scene.views:
        assert view.looks is not None
        found[view.name] = Law(view.looks * (factor if only in ("", view.name) else 1.0), texture)
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


def drawn(kind: str, random: np.random.Generator) -> Drawn:
    """The scene of a seed, with something of that kind wrong."""
    scene = base(random, gabled=1 if kind == "roof" else int(random.integers(0, 2)))
    train = next(view.name for view in scene.views)
    true, declared, law, change = scene, scene, laws(scene), as_it_is
    if kind == "looks":
        law = laws(scene, factor=float(random.choice([random.uniform(0.4, 0.75), random.uniform(1.4, 2.5)])))
    elif kind == "looks of a view":
        law = laws(scene, factor=float(random.choice([random.uniform(0.4, 0.7), random.uniform(1.5, 2.5)])), only=train)
    elif kind == "texture":
        looks = scene.views[0].looks
        assert looks is not None
        # power varies by as much as with looks that are wrong by a quarter, at least
        law = laws(scene, texture=float(random.uniform(1.5, min(8.0, 3.0 * (looks + 1.0)))))
    elif kind == "azimuth of a view":
        true = turned(scene, train, azimuth_deg=sign(random, 0.8, 2.0))
    elif kind == "incidence of a view":
        true = turned(scene, train, incidence_deg=sign(random, 0.8, 2.0))
    elif kind == "incidences":
        true = turned(scene, "", incidence_deg=sign(random, 0.8, 2.0))
    elif kind == "spacing":
        factor = 1.0 + sign(random, 0.02, 0.04)
        both = random.choice(["range", "azimuth"])
        step = scene.grid.spacing_m
        other = (step[0] * factor, step[1]) if both == "range" else (step[0], step[1] * factor)
        true = replace(scene, grid=scene.grid.model_copy(update={"spacing_m": other}))
    elif kind == "height":
        factor = 1.0 + sign(random, 0.15, 0.35)
        true = moved(scene, lambda v: v * [1.0, 1.0, factor])
    elif kind == "place":
        way = random.uniform(0.0, 2.0 * math.pi)
        step = random.uniform(0.4, 1.2) * np.array([math.cos(way), math.sin(way), 0.0])
        true = moved(scene, lambda v: v + step)
    elif kind == "a house more":
        declared = without(scene)
    elif kind == "a house less":
        true = without(scene)
    elif kind == "roof":
        mesh = scene.mesh
        flat = float(np.sort(np.unique(mesh.vertices[np.unique(mesh.faces[mesh.groups["house0"]]), 2]))[1])
        declared = moved(scene, lambda v: np.column_stack([v[:, :2], np.minimum(v[:, 2], flat)]))
    elif kind == "ripple of the gain":
        rows, period, depth = scene.grid.shape[0], random.uniform(8.0, 30.0), random.uniform(0.5, 1.5)
        gain = 10.0 ** (depth * np.sin(2.0 * math.pi * np.arange(rows) / period) / 10.0)
        change = lambda name, image: image * gain[:, None]  # noqa: E731
    elif kind == "bright ground":
        centre, width, level = random.uniform(-12.0, 12.0, 2), random.uniform(2.0, 4.0), random.uniform(1.0, 3.0)
        change = patch_of_ground(scene, centre, width, level)
    elif kind == "a smear":
        row, level = int(random.integers(30, scene.grid.shape[0] - 30)), random.uniform(1.0, 3.0)
        change = smear(train, row, level)
    elif kind == "a blur of one axis":
        width = random.uniform(1.0, 2.0)
        change = lambda name, image: gaussian_filter(image, (0.0, width))  # noqa: E731
    elif kind == "noise_floor":
        true = replace(scene, effects={"noise_floor": {"level": float(random.uniform(0.002, 0.006))}})
    elif kind == "multibounce":
        true = replace(scene, effects={"multibounce": {**get("multibounce").rate_case}})
    elif kind == "registration":
        shift = {key: sign(random, 0.15, 0.6) for key in ("range_m", "azimuth_m")}
        true = replace(scene, effects={"registration": shift})
    elif kind != "nothing":
        raise AssertionError(kind)
    return Drawn(true, declared, law, change)


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


WRONG = (
    "looks",
    "looks of a view",
    "texture",
    "azimuth of a view",
    "incidence of a view",
    "incidences",
    "spacing",
    "height",
    "place",
    "a house more",
    "a house less",
    "roof",
    "ripple of the gain",
    "bright ground",
    "a smear",
    "a blur of one axis",
    "noise_floor",
    "multibounce",
    "registration",
)


def kind_of(number: int) -> str:
    """Nothing in every third scene; the others in turn."""
    return "nothing" if number % 3 == 0 else WRONG[(number - number // 3 - 1) % len(WRONG)]


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


def with_images(
    random: np.random.Generator, found: Drawn, clean: Mapping[str, np.ndarray], correlated: bool, folder: Path
) -> list[View]:
    """The declared views with the images under speckle, as files of the folder."""
    views = []
    for view in found.declared.views:
        path = folder / f"{view.name}.tif"
        speckle = speckled(random, found.law[view.name], clean[view.name].shape, correlated)
        write_tiff(path, (clean[view.name] * speckle).astype(np.float32))
        views.append(view.model_copy(update={"images": {"HH": path}}))
    return views


def seen(found: Drawn, clean: Mapping[str, np.ndarray], sharing: float, device: str, folder: Path) -> float:
    """2 ln L by which images without speckle differ from the declared model, bounded, plus what other laws of speckle
    make of it: how much there is to be found. `sharing`: pixels that share one speckle."""
    views = []
    for view in found.declared.views:
        path = folder / f"clean_{view.name}.tif"
        write_tiff(path, np.maximum(clean[view.name], 1e-12).astype(np.float32))
        views.append(view.model_copy(update={"images": {"HH": path}}))
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


def one_run(number: int, device: str, minutes: float) -> dict[str, Any]:
    started = time.perf_counter()
    random = np.random.default_rng([20261123, number])
    kind = kind_of(number)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        correlated = bool(random.random() < 0.3)
        while True:
            found = drawn(kind, random)
            if correlated:  # the sum of so many fields
                whole = {v: replace(law, looks=float(max(round(law.looks), 1))) for v, law in found.law.items()}
                found = replace(found, law=whole)
            clean = {
                view.name: found.change(view.name, made.beta0["HH"].astype(float))
                for view, made in zip(found.true.views, simulate(found.true, device=device), strict=True)
            }
            there = seen(found, clean, SHARING if correlated else 1.0, device, folder)
            if kind == "nothing" or there > SEEN:
                break
        views = with_images(random, found, clean, correlated, folder)
        materials = {}
        for key, one in found.declared.materials.items():
            a, b, c = np.exp(START_SD * random.standard_normal(3))
            values = {"eps_r": 1 + (one.eps_r - 1) * a, "rms_height_m": one.rms_height_m * b}
            materials[key] = one.model_copy(update={**values, "correlation_length_m": one.correlation_length_m * c})
        scene = replace(found.declared, views=views, materials=materials, sampling=Sampling(seed=number))
        limit = None if kind == "nothing" else 60.0 * minutes
        done = diagnose(scene, device=device, options=DiagnoseOptions(time_limit_s=limit))
    return {
        "number": number,
        "kind": kind,
        "looks": scene.views[0].looks,
        "views": len(views),
        "correlated": correlated,
        "there": round(there, 1),
        "verdict": done.verdict,
        "unexplained": done.unexplained,
        "reasons": done.reasons,
        "edges_judged": {role: one.edges.judged for role, one in done.verdicts.items()},
        "edges_m": {role: one.edges.most_m for role, one in done.verdicts.items() if one.edges.judged},
        "speckle": {
            "true": {name: {"looks": law.looks, "texture": law.texture} for name, law in found.law.items()},
            "found": asdict(done.speckle),
        },
        "findings": {role: one.findings for role, one in done.verdicts.items()},
        "chances": {role: [one.p_window, one.p_profile, one.p_level] for role, one in done.verdicts.items()},
        "open_surface": done.open_surface,
        "line": in_short(done),
        "not_asked": done.diagnosis.not_asked,
        "seconds": round(time.perf_counter() - started, 1),
    }


def clear(row: Mapping[str, Any]) -> bool:
    """Whether a run says "nothing missing"."""
    return not row["verdict"] and not row["unexplained"]


def bounds(count: int, of: int) -> str:
    """95 % of Clopper and Pearson."""
    low = 0.0 if count == 0 else float(beta.ppf(0.025, count, of - count + 1))
    high = 1.0 if count == of else float(beta.ppf(0.975, count + 1, of - count))
    return f"{100 * low:.1f} to {100 * high:.1f} %"


@click.group()
def main() -> None:
    """Rates of right and false all-clears of `warpsar diagnose`."""


@main.command()
@runs.out
@runs.scenes(240)
@click.option(
    "--kind", "kinds", multiple=True, type=click.Choice(["nothing", *WRONG]), help="Repeatable; default: all."
)
@runs.jobs(2)
@runs.minutes(MINUTES)
@runs.max_time
@runs.device
def run(
    out: Path, scenes: int, kinds: tuple[str, ...], jobs: int, minutes: float, max_time: float, device: str | None
) -> None:
    """Make the runs that are not in the folder yet."""
    where = devices.resolve_device(device)
    runs.append(
        out, (n for n in range(scenes) if not kinds or kind_of(n) in kinds), one_run,
        lambda row: f"{row['number']} {row['kind']}, {row['looks']:g} looks: {row['line']}, {row['seconds']} s",
        where.alias, minutes, jobs=jobs, max_time=max_time,
    )  # fmt: skip


@main.command()
@runs.out
@runs.write
def table(out: Path, write: bool) -> None:
    """The rates of the runs that are there."""
    rows = runs.stored(out)
    lines = []
    for kind in ("nothing", *WRONG):
        mine = [row for row in rows if row["kind"] == kind]
        if not mine:
            continue
        named = sum(bool(row["verdict"]) and not row["unexplained"] for row in mine)
        told = sum(row["unexplained"] for row in mine)
        all_clear = sum(clear(row) for row in mine)
        lines.append([kind, len(mine), all_clear or "", named or "", told or ""])
    wrong, right = ([row for row in rows if (row["kind"] == "nothing") == is_right] for is_right in (False, True))
    rates = [
        ["all-clear where nothing is wrong", f"{sum(map(clear, right))} of {len(right)}"],
        ["all-clear where something is", f"{sum(map(clear, wrong))} of {len(wrong)}"],
    ]
    for line, (found, of) in zip(rates, ((right, right), (wrong, wrong)), strict=True):
        line.append(bounds(sum(map(clear, found)), len(of)) if of else "")
    head = ["wrong in the scene file", "scenes", "all-clear", "something named, and nothing left", "unexplained"]
    bodies = {
        "judgement_rates": tables.markdown(head, lines),
        "judgement_rates_sums": tables.markdown(["", "scenes", "95 %"], rates),
    }
    tables.publish(bodies, runs.oldest(rows), write)


if __name__ == "__main__":
    main()
