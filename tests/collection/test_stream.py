"""Products with phase: what is said before the work, and the memory that the work is held to."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
import warp as wp
from click.testing import CliRunner
from collected_scenes import field, scene, square_trihedral

import warpsar
from warpsar.cli.main import main
from warpsar.coherent.body import CoherentBody
from warpsar.coherent.patches import RoughPatches
from warpsar.coherent.shape import MeshShape, faces_alone
from warpsar.collection import forecast as forecasting
from warpsar.collection import places
from warpsar.collection.bodies import Bodies
from warpsar.collection.command import wide_tubes
from warpsar.collection.direct import SAMPLE_BYTES, DirectImage, direct, direct_of_rough
from warpsar.collection.forecast import FEWEST, forecast, room_of
from warpsar.collection.history import phase_history
from warpsar.collection.places import COARSE, GROUP, TubeTally
from warpsar.collection.plan import plan_of
from warpsar.collection.scatterers import TOGETHER, Stream
from warpsar.kernels.coherent.tubes import TubeRadar, free_kernel
from warpsar.runtime import devices

ALL = {"terms": ("single", "multibounce", "edges", "rough"), "max_bounces": 3}


def corner() -> warpsar.Scene:
    """Three rough squares, whose coherent part the tubes follow over up to three bounces."""
    return scene(square_trihedral(1.2), radar=ALL, shape=(24, 24), collection={"focus": "direct"})


def stream(made: warpsar.Scene, most: int, *, once: bool = False) -> Stream:
    cpu = devices.resolve_device("cpu")
    (plan,) = (plan_of(made, view, cpu) for view in made.views)
    return Stream(made, plan, Bodies(made, [plan], cpu, 0).of(plan), once=once, together=most)


@pytest.mark.full
def test_parts_change_nothing() -> None:
    """Scatterers in many small parts make the image and the phase history that they make together."""
    made, cpu = corner(), devices.resolve_device("cpu")
    images, samples = [], []
    for most in (TOGETHER, 8192):
        found = stream(made, most, once=True)
        images.append(direct(found.plan, found, ("HH",), made.grid, cpu).images["HH"])
        found = stream(made, most)
        samples.append(phase_history(found.plan, found, ("HH",), cpu).samples)
    for one, other in (images, samples):
        # Sums of 1e6 scatterers in float32, most of which cancel: up to 1e-3 off a sum in float64 when they are added
        # at once, and 3e-5 in parts. A part that is lost is 5e-3 and more.
        assert np.abs(one - other).max() < 3e-3 * np.abs(one).max()
        assert np.abs(one).max() > 0.0


def test_parts_are_as_small_as_asked() -> None:
    """Of tubes a part may be larger by what one launch of them hits."""
    found = stream(corner(), 8192)
    sizes = [len(part) for part in found.parts]
    launch = GROUP * COARSE**2 * found.worker.tracer.bounces
    assert max(sizes) <= 8192 + launch
    assert len(sizes) > 3
    assert sum(sizes) == found.count


@pytest.mark.full
def test_the_scatterers_of_a_forecast(monkeypatch: pytest.MonkeyPatch) -> None:
    """A forecast counts the scatterers that the work then finds. Its time is in docs/benchmarks.md."""
    monkeypatch.setattr(forecasting, "LONG_S", 0.0)
    made, cpu = corner(), devices.resolve_device("cpu")
    plans = [plan_of(made, view, cpu) for view in made.views]
    for product, once in (("slc", True), ("phase-history", False)):
        bodies = Bodies(made, plans, cpu, 0)
        said = forecast(bodies, plans, product)
        assert said is not None
        found = Stream(made, plans[0], bodies.of(plans[0]), once=once)
        count = sum(len(part) for part in found.parts)
        # tubes of a share of the cells that matter, seen from one place of the track
        assert said.scatterers == pytest.approx(count, rel=0.25)
        assert f"1 view, {said.scatterers:.2g} scatterers: about " in str(said)


def test_memory_is_bounded_or_refused() -> None:
    made, cpu = corner(), devices.resolve_device("cpu")
    plans = [plan_of(made, view, cpu) for view in made.views]
    rooms = [room_of(made, plans, "slc", cpu, gib) for gib in (0.2, 0.3, 4.0)]
    most = [room.together for room in rooms]
    assert rooms[0].tile_bytes < rooms[1].tile_bytes < rooms[2].tile_bytes
    assert FEWEST <= most[0] < most[1] < most[2] == TOGETHER
    with pytest.raises(warpsar.InputError, match=r"slc: found .* GiB .*--max-memory allows 0.001 GiB"):
        room_of(made, plans, "slc", cpu, 0.001)


@pytest.mark.parametrize("product", ["slc", "phase-history"])
def test_on_the_console(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, product: str) -> None:
    """The forecast stands before the files; what does not fit is refused before anything is written."""
    monkeypatch.setattr(forecasting, "LONG_S", 0.0)
    made = scene(field(6.0, 6.0), collection={"resolution_m": (1.0, 1.0)}, shape=(16, 16), spacing=(0.5, 0.5))
    made.save(tmp_path / "scene.toml")
    words = ["simulate", str(tmp_path / "scene.toml"), "--product", product, "--device", "cpu", "-o"]
    done = CliRunner().invoke(main, [*words, str(tmp_path / "refused"), "--max-memory", "0.0001"])
    assert done.exit_code == 2
    assert not (tmp_path / "refused").exists()
    done = CliRunner().invoke(main, [*words, str(tmp_path / "out"), "--max-memory", "0.5"])
    assert done.exit_code == 0, done.output
    assert done.stderr.index(" scatterers: about ") < done.stderr.index("one.npz")


def test_wide_tubes_in_words() -> None:
    """What counts is their power: many that send nothing back change no level."""
    assert wide_tubes(TubeTally(100, 28, 1.0, 0.005)) == []
    (said,) = wide_tubes(TubeTally(50, 14, 0.5, 0.1) + TubeTally(50, 14, 0.5, 0.1))
    assert said.startswith("28 % of the tubes")
    assert "20 % of the power of single and multibounce, which is 0.97 dB lower without them" in said
    assert "too strong toward the mirror direction" in said


def test_wide_tubes_of_a_sphere() -> None:
    """A sphere spreads every tube far from its middle; a plate none."""
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    smooth = {"material": {"conductor": True}, "radar": {"terms": ("single",)}, "collection": {"focus": "direct"}}
    found = stream(scene(warpsar.Mesh.of(ball.vertices, ball.faces), **smooth), TOGETHER, once=True)
    list(found.parts)
    assert found.tally.tubes > 0
    assert 0 <= found.tally.wide_power <= found.tally.power
    plate = stream(scene(field(1.0, 1.0), **smooth), TOGETHER, once=True)
    list(plate.parts)
    assert plate.tally.wide == 0


def town() -> warpsar.Scene:
    """Rough ground with a block that stands on it, two polarizations, and more ground than the image shows."""
    block = trimesh.creation.box((6.0, 5.0, 4.0))
    block.apply_translation((1.0, 2.0, 2.0))
    ground = field(60.0, 60.0)
    mesh = warpsar.Mesh.of(
        np.concatenate([ground.vertices, block.vertices]), np.concatenate([ground.faces, block.faces + 4])
    )
    rough = {"terms": ("rough",), "polarizations": ("HH", "HV")}
    table = {"focus": "direct", "scatterers_per_cell": 16.0}
    return scene(mesh, radar=rough, shape=(70, 90), spacing=(0.25, 0.25), collection=table)


def test_tiles_are_the_whole_image(device: str) -> None:
    """To the rounding of sums in float32, which each takes in its own order. Each scatterer counts once."""
    made, where = town(), devices.resolve_device(device)
    plans = [plan_of(made, view, where) for view in made.views]
    names = tuple(made.radar.polarizations)
    image = DirectImage(plans[0], names, made.grid, where)
    small = int(0.72 * SAMPLE_BYTES * len(names) * np.prod(image.samples((slice(0, 70), slice(0, 90)))))
    assert len(image.tiles(small)) >= 4
    images = []
    for tile_bytes in (2**31, small):
        bodies = Bodies(made, plans, where, 3, 2**16, tile_bytes)
        images.append(direct_of_rough(bodies, plans[0]))
    for name in names:
        one, other = (image.images[name] for image in images)
        assert np.abs(one - other).max() < 2e-6 * np.abs(one).max()
    assert images[0].scatterers == images[1].scatterers > 10_000


def test_a_part_of_a_surface_is_the_same_surface() -> None:
    """Patches of a surface have the scatterers that they have in the whole, in any parts."""
    made, cpu = town(), devices.resolve_device("cpu")
    (plan,) = (plan_of(made, view, cpu) for view in made.views)
    body = Bodies(made, [plan], cpu, 0).of(plan)
    whole = body.patches.on(cpu).placed(slice(0, len(body.patches)))
    some = np.arange(1, len(body.patches.face), 3)
    part = body.patches.chosen(some)
    placed = [part.on(cpu).placed(slice(a, min(a + 777, len(part)))) for a in range(0, len(part), 777)]
    starts = body.patches.ends - body.patches.count
    index = np.concatenate([np.arange(starts[i], body.patches.ends[i]) for i in some])
    for name in ("point", "diffuse", "specular", "normal"):
        found = np.concatenate([each.scatterers.numpy()[name] for each in placed])
        assert np.array_equal(found, whole.scatterers.numpy()[name][index])
    assert np.array_equal(
        body.patches.faces_of(slice(5, 5005)), np.repeat(body.patches.face, body.patches.count)[5:5005]
    )


def test_patches_cover_their_faces() -> None:
    """The parts of a face have its area, lie on it, and have as many scatterers as its area over a cell's."""
    made, cpu = town(), devices.resolve_device("cpu")
    (plan,) = (plan_of(made, view, cpu) for view in made.views)
    body = Bodies(made, [plan], cpu, 0).of(plan)
    patches = body.patches
    assert len(patches.face) > 100
    area = 0.5 * np.linalg.norm(np.cross(patches.first, patches.second), axis=1)
    corners = body.shape.vertices[body.shape.faces]
    of_face = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    np.testing.assert_allclose(np.bincount(patches.face, area), of_face, rtol=1e-9)
    count = np.bincount(patches.face, patches.count)
    np.testing.assert_allclose(count, of_face / patches.spacing_m**2, atol=np.sqrt(np.bincount(patches.face).max()))
    point = body.scatterer_points.numpy()
    places = point - corners[body.scatterer_faces, 0]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[body.scatterer_faces]
    assert np.abs((places * normal).sum(axis=1)).max() < 1e-9 * np.abs(normal).max()
    ground = point[np.isin(body.scatterer_faces, (0, 1))][:, :2]
    found = np.histogram2d(*ground.T, bins=6)[0]
    assert np.abs(found / found.mean() - 1.0).max() < 5.0 / np.sqrt(
        found.mean()
    )  # patches are strata: less than Poisson


def test_numbers_of_scatterers_are_gaussian() -> None:
    """Complex, of unit power, and independent: moments to 4 standard errors."""
    made, cpu = town(), devices.resolve_device("cpu")
    (plan,) = (plan_of(made, view, cpu) for view in made.views)
    numbers = Bodies(made, [plan], cpu, 0).of(plan).scatterers.numpy()
    one, other = (numbers[name] @ [1.0, 1.0j] for name in ("diffuse", "specular"))
    n = len(one)
    assert n > 1e5
    for value in (one, other):
        assert (np.abs(value) ** 2).mean() == pytest.approx(1.0, abs=4.0 / np.sqrt(n))
        assert (np.abs(value) ** 4).mean() == pytest.approx(2.0, abs=4.0 * np.sqrt(20.0 / n))
        assert np.abs((value**2).mean()) < 4.0 * np.sqrt(2.0 / n)
        assert np.abs((value[1:] * value[:-1].conj()).mean()) < 4.0 / np.sqrt(n)
    assert np.abs((one * other.conj()).mean()) < 4.0 / np.sqrt(n)


def test_rough_faces_beside_tubes() -> None:
    """Rough faces go into an image on the device, and tubes and edges by the stream: the image of one stream of all."""
    made = scene(square_trihedral(0.3), radar=ALL, shape=(16, 16), collection={"focus": "direct"})
    (image,) = warpsar.slc(made, device="cpu")
    found = stream(made, TOGETHER, once=True)
    whole = direct(found.plan, found, ("HH",), made.grid, devices.resolve_device("cpu")).images["HH"]
    assert np.abs(image.images["HH"] - whole).max() < 1e-4 * np.abs(whole).max()
    alone = stream(made, TOGETHER, once=True)
    rough = direct_of_rough(Bodies(made, [alone.plan], alone.body.device, 0), alone.plan).images["HH"]
    assert np.abs(rough).max() > 1e-3 * np.abs(whole).max()


def test_scatterers_share_a_face_evenly() -> None:
    """Blocks of a square with 64 scatterers each: independent places would differ by 64 in their variance. Over draws
    each sixteenth of a scatterer's share is as likely as any other: 4 standard errors."""
    made = scene(field(32.0, 32.0), collection={"resolution_m": (1.0, 1.0)}, radar={"terms": ("rough",)})
    device = wp.get_device("cpu")
    fine = np.zeros((32, 32))
    for seed in range(40):
        patches = RoughPatches.of(*shape_and_materials(made), 0.5, seed)
        where = patches.on(device).placed(slice(0, len(patches))).points.numpy()
        blocks = np.histogram2d(where[:, 0], where[:, 1], 8, [[-16.0, 16.0]] * 2)[0]
        assert blocks.mean() == pytest.approx(64.0, abs=0.1)
        assert blocks.var() < 0.25 * 64.0
        fine += np.histogram2d(where[:, 0], where[:, 1], 32, [[-16.0, 16.0]] * 2)[0]
    assert abs(fine / fine.mean() - 1.0).max() < 4.0 / np.sqrt(fine.mean())


def test_neighbours_share_what_is_left_over() -> None:
    """Faces that are smaller than the share of one scatterer: a hundred together have as many as they should."""
    mesh = trimesh.creation.box((20.0, 20.0, 0.0)).subdivide().subdivide().subdivide().subdivide().subdivide()
    made = scene(warpsar.Mesh.of(mesh.vertices, mesh.faces), radar={"terms": ("rough",)})
    patches = RoughPatches.of(*shape_and_materials(made), 0.5, 3)
    assert patches.count.max() == 1
    shape = shape_and_materials(made)[0]
    corners = shape.vertices[shape.faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    had = np.bincount(patches.face, patches.count, len(area))
    for first in range(0, len(area) - 100, 100):
        assert had[first : first + 100].sum() == pytest.approx(area[first : first + 100].sum() / 0.25, abs=1.0)


@pytest.mark.parametrize("place", [None, (3e3, -2e3, 4e3)], ids=["plane wave", "near"])
def test_eight_points_look_for_shadows_as_one_does(place: tuple[float, float, float] | None) -> None:
    """Against Warp's query of a single ray, on a heap of boxes that hide each other, to the last point."""
    random = np.random.default_rng(2)
    heap = [trimesh.creation.box(random.uniform(0.5, 6.0, 3), random_turn(random)) for _ in range(40)]
    mesh = trimesh.util.concatenate(heap)
    made = scene(warpsar.Mesh.of(mesh.vertices, mesh.faces), radar={"terms": ("rough",)})
    device = wp.get_device("cpu")
    body = CoherentBody.of(made, device, spacing_m=0.3, seed=0, rough_only=True)
    worker = places.worker_of(body, 200.0, ("rough",), 1, 1.0)
    radar = places.sight(body, np.array(place or (1.0, 2.0, 3.0)))[1]
    if place is None:
        single = radar.numpy()
        single["near"] = 0
        radar = wp.array(single, dtype=TubeRadar, device=device)
    placed = body.patches.on(device).placed(slice(0, len(body.patches)))
    for both_sides in (True, False):
        found = worker.free(radar, placed.points, placed.normals, both_sides).numpy()
        alone = wp.empty(found.shape, dtype=wp.uint8, device=device)
        inputs = [body.rays, radar, placed.points, placed.normals, int(both_sides)]
        wp.launch(free_kernel, found.shape, inputs=inputs, outputs=[alone], device=device)
        assert np.array_equal(found, alone.numpy())
        assert 0.1 < found.mean() < 0.9


def random_turn(random: np.random.Generator) -> np.ndarray:
    turn = trimesh.transformations.random_rotation_matrix(random.random(3))
    turn[:3, 3] = random.uniform(-10.0, 10.0, 3)
    return np.asarray(turn)


def shape_and_materials(made: warpsar.Scene) -> tuple[MeshShape, np.ndarray, tuple[warpsar.Material, ...]]:
    shape = faces_alone(made.mesh.vertices, made.mesh.faces)
    return shape, made.mesh.face_material, tuple(made.materials[name] for name in made.mesh.materials)
