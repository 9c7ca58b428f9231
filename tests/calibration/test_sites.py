"""Tables of sites in four layouts, and what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from warpsar.calibration.attitude import Facing
from warpsar.calibration.sites import ISCE3_COLUMNS, ReflectorSite, read, sites_at, write_isce3
from warpsar.errors import InputError
from warpsar.world.earth import geodetic_to_ecef

pytestmark = pytest.mark.unit

OWN = "id,latitude_deg,longitude_deg,height_m,azimuth_deg,tilt_deg,shape,leg_m,from,until\n"
GECORIS = (
    "ID,TYPE,INSTALLDATE,STARTDATE,ENDDATE,LATITUDE,LONGITUDE,EL.HEIGHT,ORIENTATION,BAND,CRSHAPE,LEGLENGTH,AZIDIP,ZENDIP"
    "\nHRD,CREF,20200219T1150Z,20200219T1150Z,99999999T9999Z,48.7,18.6,515.8,*,*,SQUAREFLIPPED,0.76,1,2\n"
)
NISAR = (
    "Corner reflector ID, Latitude (deg), Longitude (deg), Height above ellipsoid (m), Azimuth (deg), "
    "Tilt / Elevation angle (deg), Side length (m), Survey Date, Validity, Velocity East (m/s), Velocity North (m/s), "
    "Velocity Up (m/s)\n"
    "N1, 69.5, -128.5, 490.0, 317.0, 12.5, 3.46, 2020-01-01T00:00:00, 7, 3.17e-8, 0, 0\n"
    "N1, 69.6, -128.5, 490.0, 317.0, 12.5, 3.46, 2022-01-01T00:00:00, 7, 0, 0, 0\n"
    "N2, 69.5, -128.5, 490.0, 317.0, 12.5, 3.46, 2020-01-01T00:00:00, 0, 0, 0, 0\n"
)


def write(folder: Path, text: str) -> Path:
    path = folder / "sites.csv"
    path.write_text(text)
    return path


def test_the_last_day_counts_and_lies_after_the_first(tmp_path: Path) -> None:
    path = tmp_path / "sites.csv"
    head = "id,latitude_deg,longitude_deg,height_m,from,until\nA,46,12,250,"
    path.write_text(head + "2024-03-05,2024-03-05\n")
    (site,) = read(path)
    stands = [site.stands(np.datetime64(day, "us")) for day in ("2024-03-04T23:00", "2024-03-05T17:00", "2024-03-06")]
    assert stands == [False, True, False]
    path.write_text(head + "2024-03-05,2024-03-04\n")
    with pytest.raises(InputError, match=r"line 2: until: found '2024-03-04'; must be a date that is not before"):
        read(path)


def test_our_own_columns(tmp_path: Path) -> None:
    (one, other) = read(
        write(tmp_path, OWN + "A,46,12,250,256,10,square,1.5,2020-02-19,2021-01-01\nB,46,12,250,,,,,,\n")
    )
    assert (one.name, one.shape, one.leg_m, one.facings) == ("A", "square", 1.5, (Facing(256.0, 10.0),))
    assert one.stands(np.datetime64("2020-06-01"))
    assert not one.stands(np.datetime64("2021-06-01"))
    assert not one.stands(np.datetime64("2019-06-01"))
    assert (other.facings, other.leg_m) == ((), None)  # measured, not predicted


def test_gecoris_has_two_facings_and_dips(tmp_path: Path) -> None:
    (one,) = read(write(tmp_path, GECORIS))
    assert one.facings == (Facing(91.0, -2.0, True), Facing(269.0, -2.0, True))
    west = np.array([-0.7, -0.1, 0.7])
    assert one.facing(west) == one.facings[1]
    assert one.start == np.datetime64("2020-02-19T11:50")
    assert one.end is None


def test_isce3_counts_from_east(tmp_path: Path) -> None:
    sites = read(write(tmp_path, NISAR))
    assert sites[0].facings == (Facing(407.0, 12.5),)
    # The latest survey that is not after the date; out of service by its validity.
    (first, second) = sites_at(sites, np.datetime64("2021-01-01"))
    assert (first.latitude_deg, first.for_power, first.for_place) == (69.5, True, True)
    assert not second.stands(np.datetime64("2021-01-01"))
    assert not first.stands(np.datetime64("2019-01-01"))  # not surveyed yet: ISCE3 leaves it out, too
    assert sites_at(sites, np.datetime64("2023-01-01"))[0].latitude_deg == 69.6
    assert sites_at(sites, np.datetime64("2019-01-01"))[0].latitude_deg == 69.5
    moved = geodetic_to_ecef(first.geodetic(np.datetime64("2030-01-01"))) - geodetic_to_ecef(
        np.array([69.5, -128.5, 490.0])
    )
    east = np.array([np.sin(np.deg2rad(128.5)), np.cos(np.deg2rad(128.5)), 0.0])
    assert moved @ east == pytest.approx(10.0, rel=2e-3)  # ten years at 3.17e-8 m/s, a metre a year


def test_a_table_without_names_of_columns_and_with_comments(tmp_path: Path) -> None:
    """As in ISCE3's own tests: the line of names is a comment there."""
    row = "CR1,69.7,-128.3,490.0,317.1,12.9,3.462,2023-06-05T17:08:00,2,0,0,0\n"
    (one,) = read(write(tmp_path, "# a comment\n" + row))
    assert (one.name, one.leg_m, one.for_power, one.for_place) == ("CR1", 3.462, True, False)
    (one,) = read(write(tmp_path, "CR1,69.7,-128.3,490.0,317.1,12.9,3.462\n"))  # UAVSAR's
    assert one.facings == (Facing(407.1, 12.9),)


def test_what_is_written_for_isce3_is_read_again(tmp_path: Path) -> None:
    """All that the layout can say comes back; ISCE3 itself reads it with np.loadtxt and these types."""
    sites = read(write(tmp_path, NISAR))
    out = tmp_path / "isce3.csv"
    assert write_isce3(out, sites) == []
    assert read(out) == sites
    kinds = ["O", *["f8"] * 6, "O", "i8", *["f8"] * 3]
    names = [f"f{k}" for k in range(12)]
    data = np.loadtxt(
        out, dtype=list(zip(names, kinds, strict=True)), delimiter=",", comments=["#", "Corner reflector ID,"]
    )
    assert data["f0"].tolist() == ["N1", "N1", "N2"]
    np.testing.assert_allclose(data["f4"], 317.0)
    assert out.read_text().splitlines()[0] == ",".join(ISCE3_COLUMNS[:12])


def test_isce3s_column_of_shapes(tmp_path: Path) -> None:
    """The thirteenth, of 2025: with and without names of columns, and written where a reflector needs it. The flags of
    NISAR's S band count."""
    row = "CR1,69.7,-128.3,490.0,317.1,12.9,2.5,2025-06-05T17:08:00,24,0,0,0,square\n"
    header = NISAR.splitlines()[0] + ", Shape\n"
    bare = read(write(tmp_path, row))
    assert (bare[0].shape, bare[0].for_power, bare[0].for_place) == ("square", True, False)
    assert read(write(tmp_path, header + row)) == bare
    out = tmp_path / "isce3.csv"
    assert write_isce3(out, bare) == []
    assert read(out) == bare
    assert out.read_text().splitlines()[0] == ",".join(ISCE3_COLUMNS)


def test_what_isce3s_layout_cannot_say_is_named(tmp_path: Path) -> None:
    """A device of two attitudes has two rows, the end of its service one of validity 0; others are left out."""
    two = ReflectorSite(
        "T", 46.0, 12.0, 250.0, (Facing(95.0, 3.0), Facing(265.0, 3.0)), "triangular", 1.5,
        np.datetime64("2020-02-19", "us"), np.datetime64("2021-02-19", "us"),
    )  # fmt: skip
    (square,) = read(write(tmp_path, GECORIS))
    bare = ReflectorSite("B", 46.0, 12.0, 250.0, (), "triangular", None)
    out = tmp_path / "isce3.csv"
    left = write_isce3(out, [two, square, bare])
    assert [words.split(":")[0] for words in left] == ["HRD", "B"]
    found = read(out)
    assert [(one.name, one.validity) for one in found] == [("T-1", 7), ("T-1", 0), ("T-2", 7), ("T-2", 0)]
    for day, stands in (("2020-01-01", False), ("2020-06-01", True), ("2021-06-01", False)):
        date = np.datetime64(day)
        assert [one.stands(date) for one in sites_at(found, date)] == [stands] * 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "at least one site"),
        ("id,lat,lon\nA,1,2\n", "without latitude_deg, longitude_deg, height_m; must have id, latitude_deg"),
        ("id,latitude_deg,longitude_deg,hight_m\nA,1,2,3\n", "without height_m; must .* did you mean height_m?"),
        (
            OWN + "A,146,12,250,256,10,square,1.5,,\n",
            "line 2: latitude_deg: found '146'; must be a number from -90 to 90",
        ),
        (OWN + "A,46,12,high,256,10,square,1.5,,\n", "line 2: height_m: found 'high'"),
        (OWN + "A,46,12,250,256,10,round,1.5,,\n", "shape: found 'round'; must be one of triangular, square"),
        (OWN + "A,46,12,250,256,10,square,-1,,\n", "leg_m: found '-1'; must be a number from 0.01 to 100"),
        (OWN + "A,46,12,250,256,10,square,1,soon,\n", "from: found 'soon'; must be a date"),
        (OWN + "A,46,12,250,,,,,,\nA,46,12,250,,,,,,\n", "line 3: id: found 'A', as in line 2; must be there once"),
        (NISAR.replace(", 7,", ", 32,"), "line 2: validity: found '32'; must be a number from 0 to 31"),
        (GECORIS.replace("SQUAREFLIPPED", "SQUAREBASED"), "crshape: found 'SQUAREBASED'"),
        (
            OWN.replace("leg_m", "leg") + "A,46,12,250,256,10,square,1,,\n",
            "found the column 'leg'; did you mean leg_m?",
        ),
        (OWN.replace("azimuth", "azimut") + "A,46,12,250,256,,,,,\n", "column 'azimut_deg'; did you mean azimuth_deg?"),
        (OWN.replace("tilt", "elevation") + "A,46,12,250,256,45,,,,\n", "column 'elevation_deg'; must be tilt_deg"),
        (OWN.replace(",", ";") + "A;46;12;250;256;45;;;;\n", "found cells with ';' between them; must be commas"),
    ],
)
def test_what_is_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"sites\.csv.*" + message):
        read(write(tmp_path, text))


def test_columns_of_the_users_own_are_left_alone(tmp_path: Path) -> None:
    (one,) = read(write(tmp_path, OWN.strip() + ",comment,incidence_deg\nA,46,12,250,256,10,square,1.5,,,old,38\n"))
    assert (one.leg_m, one.shape) == (1.5, "square")


def test_a_file_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        read(tmp_path / "none.csv")
    (tmp_path / "b.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="UTF-8"):
        read(tmp_path / "b.csv")
