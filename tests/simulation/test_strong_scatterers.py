"""Lists of scatterers: all together they are the image, a corner stands at its apex with its level, files are read."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
import trimesh
from click.testing import CliRunner
from effect_worlds import street, with_effect
from worlds import join, mesh_of, plate, scene_of, view

from warpsar.cli.main import main
from warpsar.errors import InputError
from warpsar.scene.scene import Scene
from warpsar.simulation.command import simulate
from warpsar.simulation.strong_scatterers import StrongScatterers, read_csv, together, write_csv, write_ply

METAL = {"eps_r": (1e6, -1e6), "rms_height_m": 1e-6, "correlation_length_m": 0.1}
AXIS_DEG = float(np.rad2deg(np.arccos(1 / np.sqrt(3))))  # of a trihedral, at an azimuth of 45 degrees
APEX = np.array([0.13, 0.07, 0.0])


def corner(side: float = 1.0) -> Scene:
    """A square trihedral of metal, seen along its axis."""
    x, y, z = np.eye(3) * side
    mesh = mesh_of(metal=join([plate(APEX, *pair) for pair in ((x, y), (x, z), (y, z))]))
    made = scene_of(mesh, view(45.0, AXIS_DEG), shape=(20, 20), frequency_hz=9.6e9, materials={"metal": METAL})
    return with_effect(made, "multibounce", {"strength": 1.0, "max_bounces": 3})


def test_all_scatterers_together_are_the_image() -> None:
    """Walls, roofs and bounces beside edges' shifts: each polarization to float32. Hits beyond the border are none."""
    made = with_effect(street(), "multibounce", {"strength": 1.0, "reflection": "lobe"})
    one = simulate(made, device="cpu", scatterers=10**7)[0]
    assert one.scatterers is not None
    assert set(one.scatterers.term) == {"surface", "multibounce"}
    area = float(np.prod(made.grid.spacing_m))
    for name, image in one.beta0.items():
        found = one.scatterers.rcs_m2[name].sum()
        assert found == pytest.approx(area * image.astype(float).sum(), rel=1e-4), name
    total = np.sum(list(one.scatterers.rcs_m2.values()), axis=0)
    assert (np.diff(total) <= 0.0).all()


def test_a_trihedral_stands_at_its_apex_with_its_level_and_its_three_faces() -> None:
    """12 pi a^4 / lambda^2; half a pixel of 0.5 m and half a decibel are what the cell's cut leaves."""
    found = simulate(corner(), device="cpu", scatterers=20)[0].scatterers
    assert found is not None
    assert found.term[0] == "multibounce"
    assert found.bounces[0] == 3
    assert len({face // 2 for face in found.faces[0]}) == 3  # plates of two triangles each
    np.testing.assert_allclose(found.place_m[0], APEX, atol=0.25)
    places = map(tuple, np.round(found.place_m, 3).tolist())
    assert len(set(zip(found.term, found.faces, places, strict=True))) == len(found)  # each once
    triple = found.bounces == 3
    expected = 12.0 * np.pi / (299792458.0 / 9.6e9) ** 2
    assert 10.0 * np.log10(found.rcs_m2["HH"][triple].sum() / expected) == pytest.approx(0.0, abs=0.5)


def test_parts_are_put_together_by_strength() -> None:
    def part(*levels: float) -> StrongScatterers:
        n = len(levels)
        return StrongScatterers(
            ("surface",) * n, ((1,),) * n, np.zeros((n, 3)), np.zeros((n, 2)), {"VV": np.array(levels)}
        )

    found = together([part(3.0, 1.0), part(2.0)], 2)
    assert found.rcs_m2["VV"].tolist() == [3.0, 2.0]
    assert len(found) == 2


def test_files_are_read_again(tmp_path: Path) -> None:
    """The table by this program, the points by another one."""
    made = corner()
    found = simulate(made, device="cpu", scatterers=15)[0].scatterers
    assert found is not None
    write_csv(found, made.mesh, tmp_path / "a.csv")
    write_ply(found, tmp_path / "a.ply")
    place, levels = read_csv(tmp_path / "a.csv")
    np.testing.assert_allclose(place, found.place_m, atol=6e-4)  # three digits are written
    np.testing.assert_allclose(levels["HH"], 10.0 * np.log10(found.rcs_m2["HH"]), atol=6e-4)
    points = trimesh.load(tmp_path / "a.ply")
    np.testing.assert_allclose(points.vertices, found.place_m, atol=6e-5)
    with open(tmp_path / "a.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [len(row["faces"].split()) for row in rows] == [len(one) for one in found.faces]
    assert {row["materials"] for row in rows} >= {"metal metal metal"}
    (tmp_path / "b.csv").write_text("east_m,north_m\n1,2\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"b\.csv: 'up_m'; must be a file of warpsar simulate --scatterers"):
        read_csv(tmp_path / "b.csv")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "east_m,north_m,up_m\n1,2,3\n",
        "east_m,north_m,up_m,rcs_dbsm_HH\n1,2,nan,3\n",
        "east_m,north_m,up_m,rcs_dbsm_HH\n1,2\n",
    ],
    ids=["empty", "no level", "not finite", "short row"],
)
def test_what_is_no_list_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"a\.csv: .*must be a file of warpsar simulate --scatterers"):
        read_csv(tmp_path / "a.csv")


def test_an_empty_list_of_a_view_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("east_m,north_m,up_m,rcs_dbsm_HH\n", encoding="utf-8")
    place, levels = read_csv(tmp_path / "a.csv")
    assert place.shape == (0, 3)
    assert levels["HH"].shape == (0,)


def test_the_commands_write_and_show_them(tmp_path: Path) -> None:
    """`simulate` names the files; `view` has a point for each; a batch refuses."""
    example = str(Path(__file__).resolve().parents[2] / "data" / "example" / "scene.toml")
    out = tmp_path / "out"
    shown = ["simulate", example, "-o", str(out), "--device", "cpu", "--scatterers", "7"]
    assert CliRunner().invoke(main, shown).exit_code == 0
    tables = sorted(out.glob("*_scatterers.csv"))
    assert len(tables) == len(list(out.glob("*_scatterers.ply"))) > 1
    assert all(len(read_csv(table)[0]) == 7 for table in tables)
    asked = ["view", example, "-o", str(tmp_path), "--device", "cpu", "--scatterers", str(tables[0])]
    result = CliRunner().invoke(main, asked)
    assert result.exit_code == 0, result.output
    assert "scatterers HH [dBsm]" in (tmp_path / "view.html").read_text(encoding="utf-8")
    refused = CliRunner().invoke(main, [*shown[:2], "-o", str(out), "--azimuths", "0,90", "--scatterers", "7"])
    assert refused.exit_code == 2
    assert "--scatterers are for one scene" in refused.output
