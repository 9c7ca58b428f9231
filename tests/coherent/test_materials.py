"""Reflection of layers, and materials of a scene file, in the coherent engine."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from bodies import FREQUENCY, K, amplitudes, dihedral, plate, scene
from click.testing import CliRunner

import warpsar
from warpsar import InputError, Material
from warpsar.cli.main import main
from warpsar.coherent.rcs import cautions
from warpsar.scene.file import parse


def stack(eps: complex, thickness: float | None, backed: bool, sine: float) -> tuple[complex, complex]:
    """R of a layer in TE and TM by 2 x 2 matrices of the tangential fields; of a half-space with thickness None."""
    cosine = np.sqrt(1 - sine**2)
    q = np.sqrt(eps - sine**2 + 0j)
    q = -q if q.imag > 0 else q
    found = []
    for air, inside in ((cosine, q), (1 / cosine, eps / q)):  # admittances over that of space
        if thickness is None:
            found.append((air - inside) / (air + inside))
            continue
        phase = K * q * thickness
        m = np.array([[np.cos(phase), 1j * np.sin(phase) / inside], [1j * inside * np.sin(phase), np.cos(phase)]])
        e, h = m @ ([0.0, 1.0] if backed else [1.0, air])
        found.append((air * e - h) / (air * e + h))
    return complex(found[0]), complex(found[1])


@pytest.mark.parametrize(
    ("material", "eps", "thickness", "backed"),
    [
        ({"eps_r": 4.0}, 4.0, None, False),
        ({"eps_r": (5.0, -1.3)}, 5.0 - 1.3j, None, False),
        ({"eps_r": (2.61, -0.035), "thickness_m": 0.0015}, 2.61 - 0.035j, 0.0015, False),
        ({"eps_r": (2.61, -0.3), "thickness_m": 0.02}, 2.61 - 0.3j, 0.02, False),
        ({"eps_r": (3.0, -0.5), "thickness_m": 0.004, "conductor": True}, 3.0 - 0.5j, 0.004, True),
        ({"eps_r": (60.0, -40.0), "thickness_m": 5.0}, 60.0 - 40.0j, None, False),  # so thick that nothing passes
    ],
)
def test_a_plate_reflects_as_its_layers(material: dict[str, Any], eps: complex, thickness: Any, backed: bool) -> None:
    """-R of the conductor's amplitude. Turned about a vertical axis HH is TM and VV is TE."""
    turned = np.array([0.0, 12.0, 31.0, 55.0])
    mesh = plate(0.3, 0.2)
    conductor = amplitudes(mesh, 90.0 - turned, 90.0, terms=("single",))[:, 0]
    covered = amplitudes(mesh, 90.0 - turned, 90.0, terms=("single",), material={"rms_height_m": 0.0, **material})[:, 0]
    for i, angle in enumerate(np.deg2rad(turned)):
        te, tm = stack(eps, thickness, backed, np.sin(angle))
        assert covered[i, 0] / conductor[i, 0] == pytest.approx(-tm, abs=1e-9)
        assert covered[i, 3] / conductor[i, 3] == pytest.approx(-te, abs=1e-9)


def across_slab(eps: complex, thickness: float, angle: float) -> tuple[complex, complex]:
    """What a slab's polarization sends back along `angle`, over -2 cos times a conductor's: in TE (VV) and TM (HH).

    INT jk (eps - 1) p . E e^{jk z cos} dz, by the midpoint rule over depths. E at each depth by 2 x 2 matrices: the
    tangential fields there are those at the back, taken through what is below; the normal part is from curl H.
    """
    sine, cosine = np.sin(angle), np.cos(angle)
    q = np.sqrt(eps - sine**2 + 0j)
    q = -q if q.imag > 0 else q
    te, tm = stack(eps, thickness, False, sine)
    below = (np.arange(4000) + 0.5) / 4000 * thickness  # of the back
    weight = K * (eps - 1) * 1j * np.exp(-1j * K * cosine * (thickness - below)) * thickness / 4000
    total = []
    for air, inside, r in ((cosine, q, te), (1 / cosine, eps / q, tm)):

        def fields(depth, air=air, inside=inside):
            phase = K * q * depth
            e = np.cos(phase) + 1j * np.sin(phase) / inside * air
            return e, 1j * inside * np.sin(phase) + np.cos(phase) * air

        e, h = fields(below)
        scale = (1 + r) / fields(thickness)[0]  # the front's tangential E is 1 + R
        # p has cos along the face and sin along the normal; E_t = cos e. The normal part is sin H_y / eps.
        whole = e if air == cosine else cosine * cosine * e + sine**2 * h * cosine / eps
        total.append((weight * whole * scale).sum())
    return total[0], total[1]


@pytest.mark.parametrize(("eps", "thickness"), [(2.61 - 0.035j, 0.0015), (2.61 - 0.3j, 0.02), (60.0 - 40.0j, 0.05)])
def test_the_polarization_across_a_slab(eps: complex, thickness: float) -> None:
    """Single and edges together are the currents in the slab; its fields by matrices, their integral by numbers."""
    turned = np.array([1e-3, 12.0, 31.0, 55.0, 75.0])
    mesh, material = plate(0.3, 0.2), {"rms_height_m": 0.0, "eps_r": (eps.real, eps.imag), "thickness_m": thickness}
    conductor = amplitudes(mesh, 90.0 - turned, 90.0, terms=("single",))[:, 0]
    slab = amplitudes(mesh, 90.0 - turned, 90.0, terms=("single", "edges"), material=material)[:, 0]
    for i, angle in enumerate(np.deg2rad(turned)):
        te, tm = across_slab(eps, thickness, angle)
        allowed = 1e-4 if abs(eps) > 10 else 1e-5  # of the midpoint rule
        assert slab[i, 3] / conductor[i, 3] == pytest.approx(te / (2 * np.cos(angle)), rel=allowed)
        assert slab[i, 0] / conductor[i, 0] == pytest.approx(tm / (2 * np.cos(angle)), rel=allowed)


def test_a_very_thin_plate_has_the_normal_field_over_eps() -> None:
    """(eps - 1) k^2 d / (4 pi) x area x pattern x (cos^2 + sin^2 / eps) in HH, and 1 in VV.

    Le Vine, Schneider, Lang, Carter, IEEE TAP 33(12), 1985. Physical optics alone has cos^2 - sin^2 / eps.
    """
    turned, eps, thickness = np.array([20.0, 48.0, 70.0]), 2.6, 1e-6
    angle = np.deg2rad(turned)
    material = {"rms_height_m": 0.0, "eps_r": eps, "thickness_m": thickness}
    found = amplitudes(plate(0.3, 0.2), 90.0 - turned, 90.0, terms=("single", "edges"), material=material)[:, 0]
    whole = (eps - 1) * K**2 * thickness / (4 * np.pi) * 0.06 * np.sinc(K * 0.3 * np.sin(angle) / np.pi)
    assert found[:, 3] == pytest.approx(whole, rel=1e-3)
    assert found[:, 0] == pytest.approx(whole * (np.cos(angle) ** 2 + np.sin(angle) ** 2 / eps), rel=1e-3)
    alone = amplitudes(plate(0.3, 0.2), 90.0 - turned, 90.0, terms=("single",), material=material)[:, 0]
    assert alone[:, 0] == pytest.approx(whole * (np.cos(angle) ** 2 - np.sin(angle) ** 2 / eps), rel=1e-3)


def test_a_slab_so_thick_that_nothing_passes_is_finite() -> None:
    """Its wave that comes up would overflow: e^{+x} of a way through 5 m."""
    parts = [
        amplitudes(
            plate(0.3, 0.2), 60.0, 90.0, material={"rms_height_m": 0.0, "eps_r": (60.0, -40.0), "thickness_m": d}
        )
        for d in (0.1, 5.0)
    ]
    assert parts[1] == pytest.approx(parts[0], rel=1e-6)


def test_two_bounces_have_both_coefficients() -> None:
    """In the fold of a dihedral each bounce is at 45 degrees: TE across the fold is R_te^2, TM is R_tm^2."""
    mesh, eps = dihedral(0.3, 0.24), 5.0 - 0.7j
    conductor = amplitudes(mesh, 45.0, 90.0, terms=("multibounce",))[0, 0]
    covered = amplitudes(
        mesh, 45.0, 90.0, terms=("multibounce",), material={"eps_r": (5.0, -0.7), "rms_height_m": 0.0}
    )[0, 0]
    te, tm = stack(eps, None, False, np.sqrt(0.5))
    # The second face's currents are those of its own R: -R of the conductor's, in the mean over the directions.
    assert covered[3] / conductor[3] == pytest.approx(te * te, abs=0.02)
    assert covered[0] / conductor[0] == pytest.approx(tm * tm, abs=0.02)


def test_a_rough_face_loses_coherence() -> None:
    """exp(-2 (k h cos)^2) in amplitude."""
    h, angle = 0.002, np.deg2rad(25.0)
    smooth, rough = (
        amplitudes(
            plate(0.3, 0.2), 65.0, 90.0, terms=("single",), material={"eps_r": 6.0, "rms_height_m": height, **more}
        )[0, 0, 0]
        for height, more in ((0.0, {}), (h, {"correlation_length_m": 0.02}))
    )
    assert rough / smooth == pytest.approx(np.exp(-2 * (K * h * np.cos(angle)) ** 2), rel=1e-9)


@pytest.mark.parametrize(
    "table",
    [
        {"conductor": True},
        {"conductor": True, "eps_r": 3.0, "thickness_m": 0.01},
        {"eps_r": 3.0, "rms_height_m": 0},
        {"eps_r": [3.0, -0.1], "rms_height_m": 0.0, "thickness_m": 0.002},
    ],
)
def test_smooth_materials_are_accepted(table: dict[str, Any]) -> None:
    assert Material(**table).rms_height_m == 0.0


@pytest.mark.parametrize(
    ("table", "key"),
    [
        ({"eps_r": 3.0}, "rms_height_m: missing"),
        ({"rms_height_m": 0.0}, "eps_r: missing"),
        ({"eps_r": 3.0, "rms_height_m": 0.001}, "correlation_length_m: missing"),
        ({"conductor": True, "thickness_m": 0.01}, "eps_r: missing"),
        ({"conductor": True, "thickness_m": -0.01}, "thickness_m: found -0.01"),
    ],
)
def test_incomplete_materials_are_refused(table: dict[str, Any], key: str) -> None:
    _, problems = parse({"materials": {"body": table}})
    assert any(problem.startswith(f"materials.body.{key}") for problem in problems), problems


def test_an_image_of_power_refuses_what_is_smooth() -> None:
    with pytest.raises(InputError, match=r"materials\.default: found conductor = true.*warpsar rcs"):
        warpsar.simulate(scene(plate(1.0, 1.0), polarizations=("HH",)), device="cpu")


SCENE = """
[scene]
mesh = "plate.obj"
[radar]
frequency_hz = 10e9
polarizations = ["VV"]
[image]
shape = [4, 4]
spacing_m = [1.0, 1.0]
[materials.body]
conductor = true
[[views]]
name = "none"
azimuth_deg = 0.0
incidence_deg = 45.0
"""


@pytest.fixture
def files(tmp_path: Path) -> Path:
    mesh = "\n".join(["v 0 -0.1 -0.1", "v 0 0.1 -0.1", "v 0 0.1 0.1", "v 0 -0.1 0.1", "usemtl body", "f 1 2 3 4", ""])
    (tmp_path / "plate.obj").write_text(mesh)
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path


def test_rcs_writes_its_table(files: Path) -> None:
    """The plate's 4 pi A^2 / lambda^2, and every column."""
    words = ["rcs", str(files / "scene.toml"), "-o", str(files / "out"), "--azimuths", "88:92:2", "--device", "cpu"]
    done = CliRunner().invoke(main, [*words, "--frequencies", f"5e9,{FREQUENCY!r}"])
    assert done.exit_code == 0, done.output
    head, *lines = (files / "out" / "rcs.csv").read_text().splitlines()
    assert head == (
        "azimuth_deg,incidence_deg,frequency_hz,polarization,rcs_dbsm,amplitude_re_m,amplitude_im_m,fresnel_number,"
        "ray_spacing_m,spacing_error_db,low_dbsm,high_dbsm"
    )
    rows = [dict(zip(head.split(","), line.split(","), strict=True)) for line in lines]
    assert [(r["azimuth_deg"], r["frequency_hz"]) for r in rows] == [
        ("88.0", "5000000000.0"), ("88.0", repr(FREQUENCY)), ("90.0", "5000000000.0"), ("90.0", repr(FREQUENCY))
    ]  # fmt: skip
    assert {r["fresnel_number"] for r in rows} == {""}
    expected = 10 * np.log10(4 * np.pi * 0.04**2 / 0.03**2)
    assert float(rows[3]["rcs_dbsm"]) == pytest.approx(expected, abs=0.05)  # its edges add a little
    amplitude = complex(float(rows[3]["amplitude_re_m"]), float(rows[3]["amplitude_im_m"]))
    assert 10 * np.log10(4 * np.pi * abs(amplitude) ** 2) == pytest.approx(float(rows[3]["rcs_dbsm"]), abs=1e-5)
    assert float(rows[0]["ray_spacing_m"]) == pytest.approx(0.003)
    assert {r["spacing_error_db"] for r in rows} == {"0.0000"}  # the borders of plates are exact
    assert {"rcs.png", "rcs.json"} <= {path.name for path in (files / "out").iterdir()}


@pytest.mark.parametrize(
    ("material", "message"),
    [
        ({"conductor": True, "eps_r": 3.0}, r"eps_r of a conductor has no effect without thickness_m"),
        ({"eps_r": 3.0, "rms_height_m": 0.0}, r"fill a half-space .* open at 4 edges"),
        ({"eps_r": 3.0, "rms_height_m": 0.0}, "edges of default have no term"),
        (
            {"conductor": True, "eps_r": 3.0, "thickness_m": 0.002},
            "edges of default have the impedance of their layers",
        ),
    ],
)
def test_what_may_be_meant_otherwise_is_said(material: dict[str, Any], message: str) -> None:
    """Before work starts, and with the result."""
    assert any(re.search(message, line) for line in cautions(scene(plate(0.1, 0.1), material=material)))
    found = warpsar.rcs(scene(plate(0.1, 0.1), material=material), 90.0, device="cpu")
    assert any(re.search(message, line) for line in found.warnings)
    assert np.isnan(found.model_error_m).all() == (
        material.get("thickness_m") is not None or "conductor" not in material
    )


def test_a_closed_half_space_and_a_plain_conductor_need_no_word() -> None:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    closed = warpsar.Mesh.of(box.vertices, box.faces)
    assert cautions(scene(plate(0.1, 0.1))) == []
    assert cautions(scene(closed, material={"eps_r": 3.0, "rms_height_m": 0.0}, terms=("single",))) == []


def test_layers_add_up_to_the_table(files: Path) -> None:
    words = ["rcs", str(files / "scene.toml"), "-o", str(files / "out"), "--azimuths", "88:92:2", "--device", "cpu"]
    done = CliRunner().invoke(main, [*words, "--layers"])
    assert done.exit_code == 0, done.output
    tables = []
    for name in ("rcs.csv", "layers.csv"):
        head, *lines = (files / "out" / name).read_text().splitlines()
        tables.append([dict(zip(head.split(","), line.split(","), strict=True)) for line in lines])
    assert {row["layer"] for row in tables[1]} == {"single", "multibounce", "edges", "rough"}  # a plate: no bounces
    for row in tables[0]:
        parts = [r for r in tables[1] if r["azimuth_deg"] == row["azimuth_deg"]]
        total = sum(float(r["amplitude_re_m"]) for r in parts)
        assert total == pytest.approx(float(row["amplitude_re_m"]), abs=1e-9)


def test_parquet_holds_the_same_table(files: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed")
    words = ["rcs", str(files / "scene.toml"), "-o", str(files / "out"), "--azimuths", "88:92:2", "--device", "cpu"]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    head, *lines = (files / "out" / "rcs.csv").read_text().splitlines()
    table = parquet.read_table(files / "out" / "rcs.parquet").to_pydict()
    assert list(table) == head.split(",")
    assert table["polarization"] == ["VV", "VV"]
    assert table["fresnel_number"] == [None, None]
    assert table["rcs_dbsm"] == [float(line.split(",")[4]) for line in lines]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--azimuths", "0:400:1"], "--azimuths: found 361"),
        (["--azimuths", "0", "--incidences", "190"], "--incidences: found 190"),
        (["--azimuths", "0", "--frequencies", "9e9,5e9"], "must ascend"),
        (["--azimuths", "0", "--frequencies", "-5e9"], "--frequencies: found -5E+9"),
        (["--azimuths", "north"], "--azimuths: found 'north'"),
    ],
)
def test_bad_sweeps_are_refused_in_one_message(files: Path, options: list[str], message: str) -> None:
    done = CliRunner().invoke(main, ["rcs", str(files / "scene.toml"), "-o", str(files / "out"), *options])
    assert done.exit_code == 2
    assert message in done.output
    assert len(done.output.strip().splitlines()) == 1
    assert not (files / "out").exists()


MESH = ("--material", "metal", "--frequencies", repr(FREQUENCY), "--azimuths", "90", "--device", "cpu")


@pytest.mark.parametrize(
    ("side_m", "unit", "options", "guess"),
    [
        (0.2, "m", (), "taken as m, a guess. If it is wrong: --units with cm, mm, in, ft"),
        (2.0, "mm", (), "taken as mm, a guess"),  # 2000 units across
        (0.2, "mm", ("--units", "mm"), ""),
        (0.2, "m", ("--up", "y"), "taken as m, a guess"),
    ],
)
def test_rcs_of_a_mesh_file_knows_its_unit(
    tmp_path: Path, side_m: float, unit: str, options: tuple[str, ...], guess: str
) -> None:
    """The plate's 4 pi A^2 / lambda^2, whatever unit its file has. The report's command gives the same again, so it
    states the unit."""
    corners = np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)]) * side_m / 2.0
    flat = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3)])
    flat.apply_scale({"m": 1.0, "mm": 1000.0}[unit])
    flat.export(tmp_path / "plate.stl")
    done = CliRunner().invoke(main, ["rcs", str(tmp_path / "plate.stl"), "-o", str(tmp_path / "out"), *MESH, *options])
    assert done.exit_code == 0, done.output
    assert guess in done.output
    assert ("a guess" in done.output) == bool(guess)
    row = (tmp_path / "out" / "rcs.csv").read_text().splitlines()[1].split(",")
    assert float(row[4]) == pytest.approx(10 * np.log10(4 * np.pi * side_m**4 / 0.03**2), abs=0.05)
    assert f"--units {unit}" in (tmp_path / "out" / "report.html").read_text()


def test_rcs_of_a_mesh_file_says_all_that_is_missing_and_names_the_file(tmp_path: Path) -> None:
    trimesh.creation.box((900.0, 300.0, 250.0)).export(tmp_path / "part.stl")
    path = str(tmp_path / "part.stl")
    done = CliRunner().invoke(main, ["rcs", path, "--azimuths", "0"])
    assert done.exit_code == 2
    assert "--material: missing" in done.output
    assert "--frequencies: missing" in done.output
    done = CliRunner().invoke(main, ["rcs", path, "-o", str(tmp_path / "out"), *MESH])
    assert done.exit_code == 2
    assert f"Error: {path}: found a body of " in done.output
    assert "taken as m, a guess" in done.output  # so that a wrong unit is seen
    (tmp_path / "scene.toml").write_text(SCENE)
    done = CliRunner().invoke(main, ["rcs", str(tmp_path / "scene.toml"), "--azimuths", "0", "--units", "mm"])
    assert done.exit_code == 2
    assert "--units: found 'mm'; must be left out" in done.output


@pytest.mark.parametrize(
    ("azimuths", "more", "message"),
    [
        ([np.nan], {}, "azimuths: found nan"),
        ([], {}, "azimuths: found an array of shape"),
        ([0.0], {"frequencies_hz": [5e9, 5e9]}, "must ascend"),
        ([0.0], {"incidences_deg": 181.0}, "incidences: found 181"),
        (np.zeros(10**6), {"incidences_deg": np.zeros(10**6)}, "GiB of amplitudes"),
    ],
)
def test_bad_arrays_are_refused(azimuths: Any, more: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        warpsar.rcs(scene(plate(0.1, 0.1)), azimuths, device="cpu", **more)


def test_a_body_of_too_many_tubes_is_refused() -> None:
    with pytest.raises(InputError, match=r"found a body of .* tubes of .* must be up to .* GiB"):
        warpsar.rcs(scene(plate(2000.0, 2000.0)), 90.0, device="cpu")


GLASS = {"eps_r": (2.6, -0.04), "rms_height_m": 0.0}


def holed() -> warpsar.Mesh:
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    return warpsar.Mesh.of(box.vertices, box.faces[~(box.face_normals[:, 0] > 0.9)])


@pytest.mark.parametrize(
    ("mesh", "azimuths"),
    [
        (plate(0.1, 0.1), [90.0, 270.0]),
        (warpsar.Mesh.of(plate(0.1, 0.1).vertices, [[0, 1, 2], [0, 3, 2]]), [90.0, 270.0]),  # wound either way round
        (holed(), [0.0, 80.0]),
    ],
)
def test_the_inside_of_a_half_space_is_refused(mesh: warpsar.Mesh, azimuths: list[float]) -> None:
    """A slab without a thickness, and a body with a hole: no wave comes from inside a half-space."""
    with pytest.raises(
        InputError, match=r"materials\.default\.thickness_m: found none, .* open at 4 edges .*; must be"
    ):
        warpsar.rcs(scene(mesh, material=GLASS), azimuths, 90.0, device="cpu")
    for material in ({"conductor": True}, {**GLASS, "thickness_m": 0.001}):
        warpsar.rcs(scene(mesh, material=material), azimuths, 90.0, device="cpu")


def test_one_side_of_an_open_half_space_is_ground() -> None:
    """Hills that hide their own lee sides, a corner that is seen into, and a box with a hole on its far side."""
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-1.0, 1.0, 21), indexing="ij")
    vertices = np.stack([x.ravel(), y.ravel(), 0.2 * np.cos(6 * x.ravel()) * np.cos(5 * y.ravel())], axis=1)
    i, j = (each.ravel() for each in np.meshgrid(np.arange(20), np.arange(20), indexing="ij"))
    a, b = 21 * i + j, 21 * (i + 1) + j
    faces = np.concatenate([np.stack([a, b, b + 1], 1), np.stack([a, b + 1, a + 1], 1)])
    ground = warpsar.Mesh.of(vertices, faces)
    for mesh, azimuths, incidence in ((ground, [0.0, 130.0], 60.0), (dihedral(0.1, 0.1), [30.0, 60.0], 80.0),
                                      (holed(), [200.0, 270.0, 340.0], 60.0)):  # fmt: skip
        body = scene(mesh, material={**GLASS, "rms_height_m": 0.001, "correlation_length_m": 0.01}, terms=("single",))
        warpsar.rcs(body, azimuths, incidence, 1e9, device="cpu")


@pytest.mark.parametrize(
    ("radar", "options", "message"),
    [
        ("slant_range_m = 0.05", [], r"scene\.toml: radar\.slant_range_m: found 0\.05; must be at least"),
        ("", ["--frequencies", "1e13"], r"scene\.toml: found a body of .* must be up to .* GiB"),
        ("terms = []", [], r"radar\.terms: found \[\]; must hold at least 1"),
        ('terms = ["magic"]', [], r"radar\.terms\[0\]: found 'magic'"),
        ("max_bounces = 0", [], r"radar\.max_bounces: found 0; must be"),
        ("", ["--azimuths", "0:360:0.00001"], r"--azimuths: found .*, 36000000 angles; allowed are up to 10000000"),
    ],
)
def test_what_is_refused_writes_nothing(files: Path, radar: str, options: list[str], message: str) -> None:
    """One line, and no folder."""
    path = files / "scene.toml"
    path.write_text(path.read_text().replace("[radar]", f"[radar]\n{radar}"))
    done = CliRunner().invoke(main, ["rcs", str(path), "-o", str(files / "out"), "--azimuths", "90", *options])
    assert done.exit_code == 2, done.output
    assert re.search(message, done.output), done.output
    assert len(done.output.strip().splitlines()) == 1
    assert not (files / "out").exists()
