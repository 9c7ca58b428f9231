"""A report stands alone: nothing is fetched, nothing is left open, and what users wrote stays text."""

import re
from dataclasses import replace
from html.parser import HTMLParser
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from learning_scenes import cube_scene, measured, views_at
from matplotlib.image import imread
from worlds import view

from warpsar.diagnosis.report.left import ratio_words
from warpsar.evaluation.command import run
from warpsar.evaluation.report import stated
from warpsar.evaluation.report_images import reduced
from warpsar.evaluation.report_parts import beta0_rgb
from warpsar.io import html as report
from warpsar.io.figures import new
from warpsar.io.grey_scale import GreyScale
from warpsar.io.html_image import ImageAxis, image

VOID = {"meta", "img", "br", "hr", "link", "input"}


class Reader(HTMLParser):
    """Tags with their attributes, what is left open, and the text outside of tags."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.text += data


def read(document: str) -> Reader:
    reader = Reader()
    reader.feed(document)
    reader.close()
    assert reader.open == []
    return reader


def assert_alone(document: str) -> Reader:
    """Every attribute that a browser follows holds its content itself. Style asks for nothing; scripts are inside."""
    scripts = re.findall(r"<script>(.*?)</script>", document, re.S)
    assert not scripts or scripts == [
        (report.ASSETS / name).read_text("utf-8") for name in ("panzoom.min.js", "report.js")
    ]
    for script in scripts:
        assert not re.search(
            r"fetch\(|XMLHttpRequest|WebSocket|import\(|importScripts|sendBeacon|\.src\s*=|eval\(", script
        )
        document = document.replace(script, "")
    reader = read(document)
    followed = {"src", "href", "srcset", "data", "poster", "action", "background", "xlink:href"}
    for tag, attributes in reader.tags:
        assert tag not in ("link", "iframe", "object", "embed", "base")
        for name in followed & set(attributes):
            assert str(attributes[name]).startswith("data:image/")
        assert "url(" not in (attributes.get("style") or "")
        assert not any(name.startswith("on") for name in attributes)
    without_pictures = re.sub(r"data:image/[a-z+]+;base64,[A-Za-z0-9+/=]+", "", document)
    assert "//" not in without_pictures
    assert "@import" not in document
    assert "url(" not in without_pictures
    return reader


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Report of a small scene with the files of a fit beside it, and names that would break careless HTML."""
    folder = tmp_path_factory.mktemp("evaluated & <b>bold</b>".replace("/", "_"))
    views = [*views_at((200.0, 40.0)), view(80.0, 50.0, name="judge", role="test")]
    scene = measured(cube_scene(views, polarizations=("HH",)), folder)
    mesh = scene.mesh
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.vertices]
    for index, name in enumerate(mesh.materials):
        lines += [f"usemtl {name}", *(f"f {a} {b} {c}" for a, b, c in mesh.faces[mesh.face_material == index] + 1)]
    (folder / "scene.obj").write_text("mtllib scene.mtl\n" + "\n".join(lines) + "\n")
    (folder / "scene.mtl").write_text("".join(f"newmtl {name}\n" for name in mesh.materials))
    replace(scene, mesh_path=folder / "scene.obj").save(folder / "scene.toml")
    rows = ["iteration,start,loss,train_deviance,test_deviance", "1,0,120.0,3.0,4.0", "2,0,20.0,1.1,1.2", "3,0,19,1,1"]
    (folder / "history.csv").write_text("\n".join(rows) + "\n")
    run(folder / "scene.toml", folder / "out", device="cpu")
    return folder / "out" / "report.html"


@pytest.mark.full
def test_report_stands_alone(evaluated: Path) -> None:
    assert_alone(evaluated.read_text(encoding="utf-8"))
    assert evaluated.stat().st_size < 5e6


def test_report_holds_what_it_should(evaluated: Path) -> None:
    reader = read(evaluated.read_text(encoding="utf-8"))
    for title in (
        "Measured, simulated, residual",
        "What the residual follows",
        "Parameters of the surface",
        "What is not identifiable",
        "Convergence of the fit",
        "To make this again",
    ):
        assert title in reader.text
    assert "warpsar evaluate " in reader.text
    assert "warp-lang" in reader.text
    assert "alone not identifiable" in reader.text or "determined by itself" in reader.text
    described = [attributes["alt"] or "" for tag, attributes in reader.tags if tag == "img"]
    assert described[:2] == ["residual", "measured"]  # on the first screen, before any table
    assert [tag for tag, _ in reader.tags if tag in ("img", "table")][:2] == ["img", "img"]
    assert "scene.toml and its test images: too few pixels to tell whether they agree." in reader.text
    del described[:2]
    assert described.count("measured") == described.count("simulated") == described.count("residual") == 2
    assert sum(text.startswith("Residual against") for text in described) == 5
    assert sum("from azimuth" in text for text in described) == 6  # three learned parameters, two sides
    metas = [attributes.get("content") for tag, attributes in reader.tags if tag == "meta"]
    assert "width=device-width, initial-scale=1" in metas


def test_what_users_wrote_stays_text() -> None:
    nasty = '<script>alert("1")</script> & \'"'
    blocks = [
        report.heading(nasty),
        report.paragraph(nasty),
        report.paragraph(nasty, quiet=True),
        report.bullets([nasty]),
        report.command(nasty),
        report.table([nasty], [[nasty]], nasty),
        report.facts([(nasty, nasty)]),
        report.scale("viridis", [nasty], nasty),
        report.picture(report.png(np.zeros((2, 2, 3))), nasty),
        image(report.png(np.zeros((2, 2, 3))), nasty, ImageAxis(nasty, -1.0, 1.0), ImageAxis(nasty, -1.0, 2.0)),
        report.row(report.cell(report.paragraph(nasty))),
    ]
    reader = assert_alone(report.page(nasty, nasty, report.section(nasty, *blocks)))
    assert [tag for tag, _ in reader.tags].count("script") == 2  # the page's own: assert_alone
    assert reader.text.count(nasty) == 21  # the title twice: <title> and <h1>
    assert [attributes["alt"] for tag, attributes in reader.tags if tag == "img"] == [nasty, nasty]


def test_the_key_of_greys_is_linear_in_db() -> None:
    """Of black, ground, bright and white at -40, -30, -20 and 0 dB: numbers at even steps, and under each its grey."""
    key = report.beta0_scale(GreyScale((-40.0, -30.0, -20.0, 0.0)))
    assert re.findall(r"<span>(.*?)</span>", key) == ["\u221240", "\u221230", "\u221220", "\u221210", "0 dB"]
    greys = [int(stop[1:3], 16) / 255.0 for stop in re.findall("#[0-9a-f]{6}", key)]
    assert [greys[k * (len(greys) - 1) // 4] for k in range(5)] == pytest.approx([0.0, 0.42, 0.8, 0.9, 1.0], abs=0.005)
    assert "no mesh" not in key
    assert "no mesh there" in report.beta0_scale(GreyScale((-40.0, -30.0, -20.0, 0.0)), beyond_mesh=True)


@pytest.mark.parametrize(
    ("ends", "marks"),
    [
        ((-36.0, 36.0), [-20, 0, 20]),
        ((-40.0, 40.0), [-40, -20, 0, 20, 40]),
        ((0.0, 0.35), [0, 0.1, 0.2, 0.3]),
        ((5.0, -5.0), [-5, 0, 5]),
        ((1000.0, 1003.0), [1000, 1001, 1002, 1003]),
    ],
)
def test_axes_have_round_numbers(ends: tuple[float, float], marks: list[float]) -> None:
    assert ImageAxis("range [m]", *ends).ticks() == pytest.approx(marks)


def test_a_mark_stands_where_its_value_lies() -> None:
    made = image(
        report.png(np.zeros((2, 4, 3))), "a", ImageAxis("range [m]", -10.0, 10.0), ImageAxis("azimuth [m]", 30.0, -30.0)
    )
    down, along = (dict(re.findall(rf'<i style="{side}: ([\d.]+)%">([^<]+)</i>', made)) for side in ("top", "left"))
    assert down == {"0": "−10", "25": "−5", "50": "0", "75": "5", "100": "10"}
    assert along == {"16.67": "20", "50": "0", "83.33": "−20"}


def test_no_ratio_where_no_pixel_is_compared() -> None:
    assert ratio_words(float("nan")) == "no lit pixel is compared there"
    assert ratio_words(-1.25) == "measured over modelled -1.25 dB"


def test_parameters_of_effects_are_words() -> None:
    table = {"level": 0.0029933207, "window": "taylor", "gain_db": {"north": 1.0}, "materials": ["lawn"]}
    assert stated(table) == "level 0.002993, window taylor, gain_db of north 1, materials lawn"


def test_table_has_a_cell_for_every_value() -> None:
    reader = read(report.page("t", "l", report.table(["a", "b"], [["x", 1], ["y", 2]], "said")))
    count = {tag: sum(t == tag for t, _ in reader.tags) for tag in ("th", "td", "tr", "caption")}
    assert count == {"th": 2, "td": 4, "tr": 3, "caption": 1}


def test_a_figure_is_the_same_bytes_twice() -> None:
    def drawn() -> str:
        figure, axis = new(3.0, 2.0)
        axis.plot([0, 1], [0, 1], label="line")
        axis.fill_between([0, 1], [0, 0], [1, 1])
        axis.legend()
        return report.drawing(figure, "a line")

    assert drawn() == drawn()
    assert_alone(drawn())


def test_png_keeps_its_pixels() -> None:
    rgb = np.random.default_rng(0).integers(0, 256, (7, 5, 3), dtype=np.uint8)
    back = imread(BytesIO(report.png(rgb)))
    np.testing.assert_array_equal(np.round(back[..., :3] * 255), rgb)


def test_colours_end_where_the_scale_ends() -> None:
    values = np.array([-9.0, -3.0, 0.0, 3.0, 9.0, np.nan])
    rgb = report.colour(values, "gray", -3.0, 3.0)
    np.testing.assert_allclose(rgb[[0, 1]], 0.0)
    np.testing.assert_allclose(rgb[[3, 4]], 1.0)
    np.testing.assert_allclose(rgb[2], 0.5, atol=1 / 255)
    np.testing.assert_allclose(rgb[5], 0.75)
    assert np.isfinite(report.colour(values, "gray", 1.0, 1.0)).all()


def test_reduced_averages_power_not_decibel() -> None:
    power = np.array([[1.0, 3.0, 9.0], [100.0, 0.0, 9.0]])
    mask = np.array([[True, True, True], [False, True, True]])
    np.testing.assert_allclose(reduced(power, mask, 2), [[4 / 3]])  # the last column fills no block
    np.testing.assert_allclose(reduced(power, mask, 1), [[1.0, 3.0, 9.0], [np.nan, 0.0, 9.0]])


def test_simulated_pixels_beyond_the_mesh_are_blue_and_count_for_no_scale() -> None:
    """The measured image has ground there, and stays grey; the same floor counts for the measured image alone."""
    measured, simulated = np.full((8, 8), 0.1), np.full((8, 8), 0.1)
    simulated[:, 4:] = 1e-6  # a noise floor
    there = np.ones((8, 8), bool)
    there[:, 4:] = False
    (plain, told), key = beta0_rgb([measured, simulated], [None, there])
    grey = [bool(np.ptp(picture, axis=2).max() < 1e-9) for picture in (plain, told[:, :4], told[:, 4:])]
    assert grey == [True, True, False]
    assert (told[:, 4:, 2] > told[:, 4:, 0]).all()
    np.testing.assert_allclose(told[:, :4], plain[:, :4])
    assert "−22" in key  # black is 12 dB below the ground of both; with the floor it would be 25
