"""Bodies from a file of poses, and the error that all poses of one survey have in common."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_normal
from worlds import BRICK, SOIL, ground, mesh_of, scene_of, view

import warpsar
from warpsar.differentiable.geometry import exact_images
from warpsar.errors import InputError
from warpsar.learning.geometry import Geometry
from warpsar.learning.pose_search import find_poses, survey_errors
from warpsar.learning.prior import Known, Prior
from warpsar.runtime import devices
from warpsar.scene.placing import with_objects
from warpsar.world.objects.poses import posed
from warpsar.world.objects.table import Object
from warpsar.world.tables import Material

CPU = devices.resolve_device("cpu")
SURVEY = """# a survey
name,x_m,y_m,heading_ccw_deg,length_m,width_m,colour
Malibu,9.97,-5.22,3.4,4.77,1.74,red
Camry,20.66,-18.7,182.8,4.75,1.74,blue
"""
TABLE = {"name": "car", "primitive": "car", "size_m": (4.6, 1.8, 1.5), "material": "metal"}
SCENE = """
[scene]

[radar]
frequency_hz = 9.6e9
polarizations = ["HH"]

[image]
shape = [64, 64]
spacing_m = [1.0, 1.0]

[materials.metal]
conductor = true
rms_height_m = 0.001
correlation_length_m = 0.01

[[objects]] # parked
name = "car"
poses = "cars.csv"
primitive = "car"
size_m = [4.6, 1.8, 1.5]
material = "metal"
learn = ["heading"]
tolerance = { heading_deg = 1.0 }
survey_tolerance = { heading_deg = 4.0 }

[[views]]
name = "east"
azimuth_deg = 90.0
incidence_deg = 45.0
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "cars.csv"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.unit
def test_a_line_is_a_body(tmp_path: Path) -> None:
    """Counter-clockwise headings turn round, a missing column leaves the table's value, other columns are not read."""
    malibu, camry = posed(Object(**TABLE), written(tmp_path, SURVEY))
    assert (malibu.label, malibu.position_m, malibu.heading_deg) == ("Malibu", (9.97, -5.22, 0.0), -3.4)
    assert (camry.size_m, camry.material, camry.survey) == ((4.75, 1.74, 1.5), "metal", "cars")
    (first, _) = posed(Object(**TABLE, heading_deg=7.0), written(tmp_path, "east_m,north_m\n1,2\n3,4\n"))
    assert (first.label, first.heading_deg, first.poses) == ("car000", 7.0, None)


@pytest.mark.unit
@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("name,east_m\na,1\n", "north_m or y_m is missing"),
        ("east_m,x_m,north_m\n1,1,1\n", "east_m and x_m; must be one of them"),
        ("east_m,north_m,heading_deg,heading_ccw_deg\n1,1,1,1\n", "must be one of them"),
        ("east_m,north_m\n", "no line with a pose"),
        ("", "no line names the columns"),
        ("east_m,north_m\n1\n", "line 2: found 1 values; must be 2"),
        ("east_m,north_m\n1,two\n3,nan\n", "line 2: north_m: found 'two'; must be a number"),
        ("east_m,north_m,length_m\n1,2,0\n", "line 2: found size_m"),
        ("name,east_m,north_m\n?,1,2\n", "line 2: name: "),
        ("east_m,north_m,east_m\n1,2,3\n", "the column east_m twice"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_line(tmp_path: Path, text: str, told: str) -> None:
    with pytest.raises(InputError, match=r"cars\.csv") as refused:
        posed(Object(**TABLE), written(tmp_path, text))
    assert told in str(refused.value)


@pytest.mark.unit
def test_columns_alone_may_state_the_size(tmp_path: Path) -> None:
    """Without `size_m` the file must have all three columns, and each line is judged as a table is."""
    bare = Object(**{**TABLE, "size_m": None}, poses="cars.csv")
    columns = "east_m,north_m,length_m,width_m,height_m\n"
    low, high = posed(bare, written(tmp_path, f"{columns}1,2,4.5,1.7,1.4\n3,4,5,2,2.5\n"))
    assert (low.size_m, high.size_m, high.poses) == ((4.5, 1.7, 1.4), (5.0, 2.0, 2.5), None)
    for text, told in (
        ("east_m,north_m,length_m\n1,2,3\n", "found no column width_m, height_m for a car without size_m"),
        ("east_m,north_m\n1,2\n", "found no column length_m, width_m, height_m"),
        (f"{columns}1,2,0,1,1\n", "line 2: found size_m"),
    ):
        with pytest.raises(InputError) as refused:
            posed(bare, written(tmp_path, text))
        assert told in str(refused.value)
    with pytest.raises(InputError, match="length_m beside a mesh"):
        posed(Object(mesh="a.obj", poses="cars.csv"), written(tmp_path, f"{columns}1,2,3,1,1\n"))
    (tmp_path / "scene.toml").write_text(SCENE.replace("size_m = [4.6, 1.8, 1.5]\n", ""), encoding="utf-8")
    written(tmp_path, f"{columns}1,2,4.5,1.7,1.4\n")
    assert [one.size_m for one in warpsar.Scene.load(tmp_path / "scene.toml").objects] == [(4.5, 1.7, 1.4)]


@pytest.mark.unit
def test_a_table_that_contradicts_its_file_is_refused() -> None:
    with pytest.raises(InputError, match="poses with position_m"):
        Object(**TABLE, poses="cars.csv", position_m=(1.0, 2.0, 0.0))
    with pytest.raises(InputError, match="without survey"):
        Object(**TABLE, tolerance={"heading_deg": 1.0}, survey_tolerance={"heading_deg": 4.0})
    with pytest.raises(InputError, match="must have a tolerance of it"):
        Object(**TABLE, survey="s", survey_tolerance={"heading_deg": 4.0})


@pytest.mark.unit
def test_a_scene_file_with_poses_is_saved_with_a_table_for_each_body(tmp_path: Path) -> None:
    """The saved scene is the same, and reads no file of poses."""
    written(tmp_path, SURVEY)
    (tmp_path / "scene.toml").write_text(SCENE, encoding="utf-8")
    scene = warpsar.Scene.load(tmp_path / "scene.toml")
    assert [one.label for one in scene.objects] == ["Malibu", "Camry"]
    (tmp_path / "out").mkdir()
    scene.save(tmp_path / "out" / "scene.toml")
    again = warpsar.Scene.load(tmp_path / "out" / "scene.toml")
    assert again.objects == scene.objects
    assert "poses" not in (tmp_path / "out" / "scene.toml").read_text()
    assert again.objects[0].survey_tolerance == {"heading_deg": 4.0}


def headings(count: int, own: float, common: float) -> list[Known]:
    """Numbers with slopes of their own, of which the first two thirds share an error."""
    return [
        Known(
            f"h{k}",
            k,
            1.0 * k,
            float(np.hypot(own, common)) if 3 * k < 2 * count else own,
            "deg",
            lambda x, k=k: (1.0 + k) * x,  # type: ignore[misc]
            lambda x, k=k: 1.0 + k,  # type: ignore[misc]
            ("cars.heading_deg", common) if 3 * k < 2 * count else None,
        )
        for k in range(count)
    ]


@pytest.mark.unit
def test_bodies_of_one_kind_have_materials_and_shares_of_their_own(tmp_path: Path) -> None:
    """Each begins as what the kind has, and a fit then moves each; a name that is taken is refused."""
    (tmp_path / "cars.csv").write_text(SURVEY)
    detail = (
        '[effects.unresolved_detail]\nlevel = 0.1\nspread_m = 2.0\nmaterials = ["metal"]\nshare = { metal = 0.7 }\n'
    )
    text = SCENE.replace('material = "metal"', 'material = "metal"\nown_material = true') + detail
    (tmp_path / "scene.toml").write_text(text)
    scene = warpsar.Scene.load(tmp_path / "scene.toml")
    assert list(scene.materials) == [one.material for one in scene.objects] == ["Malibu", "Camry"]
    assert {one.rms_height_m for one in scene.materials.values()} == {0.001}
    table = scene.effects["unresolved_detail"]
    assert table["materials"] == ["Malibu", "Camry"]
    assert table["share"] == {"Malibu": 0.7, "Camry": 0.7}
    scene.save(tmp_path / "saved.toml")
    assert "own_material" not in (tmp_path / "saved.toml").read_text()
    assert list(warpsar.Scene.load(tmp_path / "saved.toml").materials) == ["Malibu", "Camry"]
    (tmp_path / "scene.toml").write_text(
        text.replace("[materials.metal]", "[materials.Camry]\nconductor = true\n\n[materials.metal]")
    )
    with pytest.raises(InputError, match=r"own_material: found a material 'Camry' in the file"):
        warpsar.Scene.load(tmp_path / "scene.toml")


def test_a_shared_error_is_a_gaussian_with_its_covariance() -> None:
    """Value, gradient and information are those of scipy's multivariate normal, of covariance own^2 + common^2 11'."""
    known = headings(6, 1.0, 4.0)
    prior, x = Prior(known, 6), np.random.default_rng(1).normal(size=6)
    covariance = np.eye(6)
    covariance[:4, :4] += 16.0
    law = multivariate_normal(np.arange(6.0), covariance)
    slopes = np.diag(1.0 + np.arange(6.0))
    elsewhere = np.zeros(6)
    assert prior.value(x) - prior.value(elsewhere) == pytest.approx(
        law.logpdf(slopes @ elsewhere) - law.logpdf(slopes @ x), rel=1e-9
    )
    wanted = slopes @ np.linalg.solve(covariance, slopes @ x - np.arange(6.0))
    np.testing.assert_allclose(prior.gradient(x), wanted, rtol=1e-9)
    np.testing.assert_allclose(prior.information(x), slopes @ np.linalg.inv(covariance) @ slopes, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(prior.push(x, [x + 0.1, x + 0.2], 0.1), 0.0, atol=1e-9)  # values are linear in x


@pytest.mark.unit
def test_the_common_error_is_told_from_single_ones() -> None:
    """Values that are told well: the mean of what they are off, shrunk by own^2 / n beside common^2."""
    known = headings(6, 1.0, 4.0)
    off = np.array([0.5, -0.5, 0.2, -0.2, 9.0, 9.0])
    x = (np.arange(6.0) + 3.0 + off) / (1.0 + np.arange(6.0))
    found = survey_errors(Prior(known, 6), x, np.zeros((6, 6)))["cars.heading_deg"]
    assert found["value"] == pytest.approx(3.0 * 16.0 / (16.0 + 1.0 / 4.0))
    assert found["sd"] == pytest.approx(1.0 / np.sqrt(1.0 / 16.0 + 4.0))
    assert found["unit"] == "deg"
    alone = survey_errors(Prior(known, 6), x, np.diag([1e6] * 6))["cars.heading_deg"]
    assert alone["sd"] > 100.0  # what the images do not tell is not told


@pytest.mark.full
def test_headings_that_are_all_off_are_found_with_what_they_have_in_common() -> None:
    """Three boxes, all turned by 5 degrees: with a survey error of 4 the images pull less than with 1 of each alone."""
    views = [view(azimuth, 45, name=f"v{k}") for k, azimuth in enumerate((10, 100))]
    plain = scene_of(mesh_of(g=ground(40)), views, shape=(64, 64), spacing_m=(0.5, 0.5))
    places = ((-9.0, 6.0, 0.0), (0.0, -8.0, 0.0), (9.0, 5.0, 0.0))
    known = [
        Object(
            name=f"box{k}",
            primitive="box",
            size_m=(6.0, 3.0, 3.0),
            position_m=place,
            heading_deg=20.0,
            material="body",
            learn=("heading",),
            tolerance={"heading_deg": 1.0},
            survey="site",
            survey_tolerance={"heading_deg": 4.0},
        )
        for k, place in enumerate(places)
    ]
    materials = {"g": Material(**SOIL), "body": Material(**BRICK)}
    truth = with_objects(plain, [one.model_copy(update={"heading_deg": 25.0}) for one in known], materials)
    images = exact_images(truth, CPU)
    random = np.random.default_rng(2)
    seen = [
        one.model_copy(
            update={"images": {"HH": images[one.name]["HH"] * random.gamma(16.0, 1 / 16.0, (64, 64))}, "looks": 16.0}
        )
        for one in truth.views
    ]
    found = find_poses(replace(with_objects(plain, known, materials), views=seen), CPU, search=False, held=True)
    common = found.numbers["site.heading_deg"]
    assert common["value"] == pytest.approx(5.0, abs=3.0 * common["sd"])
    for one in found.scene.objects:
        assert one.heading_deg == pytest.approx(25.0, abs=0.5)
        assert one.survey == "site"
        assert one.known_of("heading_deg", (0.0,)) == ((20.0, 1.0),)


@pytest.mark.unit
def test_each_element_may_have_its_own_tolerance() -> None:
    """A body that stands on known ground is known better in height than on the map."""
    one = Object(**TABLE, tolerance={"position_m": [0.8, 1.2, 0.02]}, position_m=(1.0, 2.0, 0.0))
    assert one.known_of("position_m", (1.0, 2.0, 0.0)) == ((1.0, 0.8), (2.0, 1.2), (0.0, 0.02))
    assert one.pinned().known_of("position_m", (5.0, 5.0, 5.0)) == ((1.0, 0.8), (2.0, 1.2), (0.0, 0.02))
    with pytest.raises(InputError, match="three of them"):
        Object(**TABLE, tolerance={"position_m": [0.8, 1.2]})
    with pytest.raises(InputError, match="above 0"):
        Object(**TABLE, tolerance={"heading_deg": [1.0, 1.0, 1.0]})


@pytest.mark.unit
def test_a_tolerance_of_0_holds_one_element() -> None:
    """A car that stands on known ground, and whose width no image shows: four numbers of six are learned."""
    known = {"position_m": [0.7, 0.7, 0.0], "size_m": [0.46, 0.0, 0.18]}
    one = Object(**TABLE, learn=("position", "size"), tolerance=known)
    plain = scene_of(mesh_of(g=ground(40)), [view(90, 45)], shape=(32, 32), spacing_m=(1.0, 1.0))
    geometry = Geometry(with_objects(plain, [one], {"g": Material(**SOIL), "metal": Material(**BRICK)}))
    assert geometry.labels == ["car.east", "car.north", "car.length", "car.height"]
    assert [sd for _, sd in geometry.known] == [0.7, 0.7, 0.46, 0.18]
    (moved,) = geometry.at(np.full(4, 0.5)).objects
    assert moved.position_m == (0.5, 0.5, 0.0)
    assert moved.size_m is not None
    assert moved.size_m[1] == 1.8
    assert moved.size_m[0] > 4.6
    for bad in ([0.0, 0.0, 0.0], [0.7, 0.7, -0.1]):
        with pytest.raises(InputError, match="above 0"):
            Object(**TABLE, tolerance={"position_m": bad})
    with pytest.raises(InputError, match="survey_tolerance of position_m with a tolerance of 0"):
        Object(**TABLE, tolerance=known, survey="plan", survey_tolerance={"position_m": 1.0})
