"""benchmarks/rcs.py: which files it takes for what, on a plate by the engine; and what it finds on the suite."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import benchmark

import warpsar
from warpsar.curves.sectors import apertures

FREQUENCIES = {"f9": 2.56e9, "f10": 5.12e9, "fx1": 7e9, "f11": 10.24e9}


@pytest.fixture(scope="module")
def rcs() -> Any:
    return benchmark("rcs")


@pytest.fixture(scope="module")
def bodies() -> Any:
    return benchmark("rcs_bodies")


def run(rcs: Any, data: Path, out: Path, *more: str) -> dict[str, Any]:
    before, sys.argv = sys.argv, ["rcs.py", str(data), "-o", str(out), *more]
    try:
        assert rcs.main() == 0
    finally:
        sys.argv = before
    found: dict[str, Any] = json.loads((out / "rcs.json").read_text())
    return found


@pytest.fixture(scope="module")
def synthetic(bodies: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The metal plate by the engine, noise 43 dB under the peak; a further frequency, a repeat, another body."""
    data = tmp_path_factory.mktemp("data")
    folder = data / "austin_rcs" / "measured"
    folder.mkdir(parents=True)
    rng = np.random.default_rng(1)
    phi = np.arange(0.0, 90.25, 0.5)
    for code, frequency in FREQUENCIES.items():
        field = warpsar.rcs(bodies.scene(bodies.pec_plate()), 90.0 - phi, 90.0, [frequency]).amplitude_m[:, 0, 0]
        for p, pol in enumerate("VH"):
            for suffix in ("", ".second") if code == "f9" else ("",):
                noise = np.abs(field).max() * 5e-3 * rng.normal(size=(2, len(phi)))
                power = 4 * np.pi * np.abs(field[:, p] + noise[0] + 1j * noise[1]) ** 2
                rows = zip(phi, 10 * np.log10(power), strict=True)
                lines = [f"{frequency:.6f} 90.000000 {a:.6f} {v:.6f} " for a, v in rows]
                (folder / f"meas_rcs.II.B.sx1.{code}.{pol}{suffix}.txt").write_text("\n".join(lines) + "\n")
    (folder / "meas_rcs.II.D.sx1.f9.V.txt").write_text("\n".join(f"2.56e9 90 {a} {-20 - a / 9}" for a in range(90)))
    (folder / "notes.txt").write_text("no curve")
    (folder / "another.csv").write_text(
        "frequency_hz,theta_deg,phi_deg,rcs_dbsm,polarization\n5e9,90,0,1,VV\n5e9,90,1,2,VV\n"
    )
    return data


@pytest.mark.full
def test_every_curve_has_its_row_and_those_held_back_name_nothing(rcs: Any, synthetic: Path, tmp_path: Path) -> None:
    found = run(rcs, synthetic, tmp_path)["bodies"]
    plate = found["pec_plate"]
    assert plate["verdict"] == ["edge_diffraction"]
    roles = {row["file"]: row["role"] for row in plate["rows"]}
    assert len(plate["rows"]) == len(roles) == 10
    train = {name for name, role in roles.items() if role == "train"}
    assert train == {f"meas_rcs.II.B.sx1.{code}.{pol}.txt" for code in ("f9", "f10") for pol in "HV"}
    for row in plate["rows"]:
        assert set(row["error_db"]) >= {"declared", "final", "null"}
        assert row["sector"] == "all"
        assert row["error_db"]["final"] < min(row["error_db"]["declared"], row["error_db"]["null"])
    assert set(plate["learned"]["repeats"]) == {f"meas_rcs.II.B.sx1.f9.{pol}.second.txt" for pol in "HV"}
    assert [row["polarization"] for row in found["another"]["rows"]] == ["VV"]
    (unknown,) = found["II.D.sx1"]["rows"]
    assert unknown["error_db"]["declared"] is None
    assert "no model" in unknown["note"]
    assert (tmp_path / "rcs_pec_plate.png").stat().st_size > 1000


@pytest.mark.full
def test_a_second_run_takes_its_amplitudes_from_the_cache(
    rcs: Any, synthetic: Path, tmp_path: Path, monkeypatch: Any
) -> None:
    first = run(rcs, synthetic, tmp_path)

    def never(*args: Any, **kwargs: Any) -> None:
        raise AssertionError("worked out again")

    monkeypatch.setattr("warpsar.curves.observe.rcs", never)
    assert run(rcs, synthetic, tmp_path)["bodies"] == first["bodies"]


def test_the_parametric_duct_is_a_closed_body_with_one_mouth(bodies: Any) -> None:
    mesh = bodies.cylinder_box(bodies.Duct(radius_m=0.145, length_m=0.29, right_m=0.01, up_m=-0.005))
    corners = mesh.vertices[mesh.faces]
    area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    np.testing.assert_allclose(area.sum(axis=0), 0.0, atol=1e-12)
    box = bodies.WIDE_BOX
    profile = 0.5 * abs(np.dot(box[:, 0], np.roll(box[:, 1], 1)) - np.dot(box[:, 1], np.roll(box[:, 0], 1)))
    volume = np.einsum("ij,ij->", corners[:, 0], area) / 3.0
    expected = profile * bodies.WIDE_WIDTH_M - np.pi * 0.145**2 * 0.29
    assert volume == pytest.approx(expected, rel=1e-3)  # the polygon of the duct is 0.07 % smaller than its circle
    np.testing.assert_allclose(apertures(mesh), [[1.0, 0.0, 0.0]], atol=1e-6)


def test_the_slab_is_the_engines_and_thin_ones_send_back_by_their_polarization(bodies: Any) -> None:
    learned = benchmark("rcs_learned")
    azimuth, frequency = np.linspace(40.0, 90.0, 26), 5.12e9
    metal = warpsar.rcs(bodies.scene(bodies.sheet()), azimuth, 90.0, [frequency]).terms_m["single"][:, 0, 0]
    thin = {"eps_r": [2.61, -0.0354], "thickness_m": 1.5e-3, "rms_height_m": 0.0}
    plate = warpsar.rcs(bodies.scene(bodies.sheet(), thin), azimuth, 90.0, [frequency]).terms_m["single"][:, 0, 0]
    cos = np.sin(np.deg2rad(azimuth))
    reflected = learned.slab(2.61 - 0.0354j, 1.5e-3, frequency, cos)
    np.testing.assert_allclose(plate[:, 0], -reflected * metal[:, 0], atol=1e-9)  # VV is TE
    # (eps - 1) k d / 2 / cos to first order in k d, which is 0.16 here
    k = 2 * np.pi * frequency / 299792458.0
    np.testing.assert_allclose(np.abs(reflected), np.abs(1.61 - 0.0354j) * k * 1.5e-3 / 2 / cos, rtol=0.06)


@pytest.mark.measured
@pytest.mark.slow
@pytest.mark.parametrize(
    ("body", "verdict", "level_only"),
    [
        ("pec_plate", ["edge_diffraction"], []),
        ("box_closed", ["edge_diffraction"], []),
        ("box_cobra", ["edge_diffraction"], ["multibounce"]),
        ("box_cylinder", ["edge_diffraction", "multibounce"], []),
    ],
)
def test_the_suite_tells_what_each_body_has(
    rcs: Any, bodies: Any, measured_data: Path, tmp_path: Path, body: str, verdict: list[str], level_only: list[str]
) -> None:
    if not (measured_data / "austin_rcs").is_dir():
        pytest.skip(f"no folder austin_rcs in {measured_data}")
    found = run(rcs, measured_data, tmp_path, "--only", body)["bodies"][body]
    assert (found["verdict"], found["level_only"]) == (verdict, level_only)
    for offered in found["learned"].get("offered", {}).values():
        assert offered["outcome"] == "refused"
    if body == "box_cylinder":
        away = [one for one in found["asked"]["away"] if one["effect"] == "multibounce"]
        assert {one["outcome"] for one in away} == {"not testable"}
        low, high = found["learned"]["duct"]["radius_m"]["interval_95"]
        assert bodies.DRAWING.radius_m < low < bodies.MODEL.radius_m < high  # the model is right, the drawing is not
