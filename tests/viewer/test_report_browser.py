"""A report in headless Chromium: a click enlarges a picture, the wheel zooms, and the axes follow."""

from __future__ import annotations

from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from test_view_browser import BROWSER, WITHOUT_GPU, playwright

from warpsar.io import html
from warpsar.io.figures import new
from warpsar.io.html_image import MARKS, ImageAxis, image

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[tuple[Any, list[str]]]:
    pixels = np.random.default_rng(1).random((20, 40, 3))
    picture = image(
        html.png(pixels), "measured", ImageAxis("range [m]", -10.0, 10.0), ImageAxis("azimuth [m]", -20.0, 20.0)
    )
    table = html.table([f"column {i}" for i in range(30)], [["value"] * 30], "A caption that is long. " * 8)
    path = tmp_path / "report.html"
    html.write(path, html.page("A report", "of a test", html.section("Images", html.row(picture), table)))
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=BROWSER, args=WITHOUT_GPU)
        page = browser.new_page(viewport={"width": 400, "height": 800})
        said: list[str] = []
        page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: said.append(f"error: {error}"))
        page.goto(path.as_uri())
        yield page, said
        browser.close()


def marks(page: Any, axis: str) -> dict[float, float]:
    """Where the numbers of the enlarged picture stand, as shares of its side."""
    read = "all => all.map(one => [one.textContent, one.style.left || one.style.top])"
    found = page.eval_on_selector_all(f"dialog .{axis} i", read)
    return {float(text.replace("\u2212", "-")): float(at.rstrip("%")) / 100.0 for text, at in found}


@pytest.mark.full
def test_axes_follow_the_zoom(opened: tuple[Any, list[str]]) -> None:
    """What lies under the pointer stays there: its azimuth by the axis is the same before and after the wheel."""
    page, said = opened
    page.click("figure img")
    box = page.locator("dialog .box").bounding_box()
    assert box["width"] == pytest.approx(2.0 * box["height"], rel=0.02)  # metres are as long in both directions
    assert marks(page, "along") == pytest.approx({-20: 0.0, -10: 0.25, 0: 0.5, 10: 0.75, 20: 1.0}, abs=1e-6)
    at = 0.7  # of the width: azimuth 8 m
    page.mouse.move(box["x"] + at * box["width"], box["y"] + 0.5 * box["height"])
    for _ in range(5):
        page.mouse.wheel(0, -100)
        page.wait_for_timeout(60)
    page.wait_for_timeout(500)
    (first, left), *_, (last, right) = sorted(marks(page, "along").items())
    metres = (last - first) / (right - left)
    assert metres < 30.0  # of 40: it is enlarged
    assert first + (at - left) * metres == pytest.approx(8.0, abs=0.4)  # a pixel of the picture is 1 m
    page.click("dialog button:has-text('Whole')")
    page.wait_for_timeout(500)
    assert marks(page, "along") == pytest.approx({-20: 0.0, -10: 0.25, 0: 0.5, 10: 0.75, 20: 1.0}, abs=1e-3)
    page.click("dialog button:has-text('Close')")
    assert not page.is_visible("dialog")
    assert said == []


def test_a_caption_is_as_wide_as_the_page(opened: tuple[Any, list[str]]) -> None:
    page, _ = opened
    assert page.locator("table").bounding_box()["width"] > 1000
    assert page.locator("caption span").bounding_box()["width"] <= 400 - 2 * 16


ENDS = [(-36.0, 36.0), (0.0, 0.35), (5.0, -5.0), (1000.0, 1003.0), (-3412.5, 96.25), (0.021, 0.0245)]


def test_both_statements_of_round_numbers_agree(opened: tuple[Any, list[str]]) -> None:
    """Python labels the small picture, read without scripts and printed; the script labels what is enlarged."""
    page, _ = opened
    for ends in ENDS:
        found = page.evaluate("([from, to, most]) => ticks(from, to, most)", [*ends, MARKS])
        assert found == pytest.approx(ImageAxis("", *ends).ticks(), rel=1e-9, abs=1e-12)


@pytest.mark.full
def test_a_dark_page_has_dark_drawings(tmp_path: Path) -> None:
    """A plot with white paper, and a picture of a mesh with nothing behind, on a page in dark colours."""
    figure, axis = new(3.0, 2.0)
    axis.plot([0, 1], [0, 1])
    nothing = report_picture()
    path = tmp_path / "dark.html"
    html.write(path, html.page("A", "b", html.section("c", html.row(html.drawing(figure, "d"), nothing, across=2))))
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=BROWSER, args=WITHOUT_GPU)
        for scheme, dark in (("light", False), ("dark", True)):
            page = browser.new_context(color_scheme=scheme, viewport={"width": 800, "height": 600}).new_page()
            page.goto(path.as_uri())
            for kind in ("drawing", "picture"):
                shot = page.locator(f"img.{kind}").screenshot()
                corner = np.asarray(Image.open(BytesIO(shot)).convert("L"))[3:8, 3:8]
                assert (corner.max() < 60) if dark else (corner.min() > 240), (scheme, kind)
        browser.close()


def report_picture() -> str:
    return html.picture(html.png(np.zeros((40, 60, 4), np.uint8)), "nothing")


def test_numbers_stay_whole_on_a_phone(tmp_path: Path) -> None:
    """Facts beside four pictures, at 400 pixels: a value may break at a space, never inside a number."""
    cells = [html.picture(html.png(np.zeros((9, 9, 3))), "a")] * 4
    said = html.cell(html.facts([("deviance before", "1.285 \u00b1 0.088"), ("all pixels", "1.2120 \u00b1 0.0430")]))
    path = tmp_path / "facts.html"
    html.write(path, html.page("A", "b", html.section("c", html.row(*cells, said, across=5))))
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=BROWSER, args=WITHOUT_GPU)
        page = browser.new_page(viewport={"width": 400, "height": 800})
        page.goto(path.as_uri())
        heights = page.eval_on_selector_all("dd", "all => all.map(one => one.getBoundingClientRect().height)")
        browser.close()
    assert max(heights) < 30.0  # one line each


def test_nothing_is_wider_than_a_phone(tmp_path: Path) -> None:
    """A long title and command, bars and a wide table at 390 pixels: what is too wide scrolls by itself."""
    bars = html.bars([html.Bar("a_name_of_an_effect", 1.0, "100000"), html.Bar("b", 0.5, "7.1", True)], 0.4, "a key")
    table = html.table([f"column {i}" for i in range(30)], [["value"] * 30])
    command = html.command("warpsar evaluate " + "a-folder-with-a-long-name/" * 6 + "scene.toml")
    path = tmp_path / "wide.html"
    html.write(path, html.page("A_title_without_any_space" * 6, "b", html.section("c", bars, table, command)))
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=BROWSER, args=WITHOUT_GPU)
        page = browser.new_page(viewport={"width": 390, "height": 844})
        page.goto(path.as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        full, half = (one.bounding_box()["width"] for one in page.locator(".bars i").all())
        browser.close()
    assert half == pytest.approx(full / 2.0, abs=0.5)
