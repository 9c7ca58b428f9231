"""The page of `warpsar view` in headless Chromium: it draws, it answers, and its console stays empty."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from warpsar.viewer.command import run

ROOT = Path(__file__).resolve().parents[2]
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
WITHOUT_GPU = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]

playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed: pip install 'warpsar[browser]'"
)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no Chromium on this machine")


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Any, list[str]]]:
    out = tmp_path_factory.mktemp("view")
    scene = ROOT / "data/example/scene.toml"
    text = scene.read_text().replace('"scene.obj"', f'"{scene.parent / "scene.obj"}"')
    for old, new in (("shape = [160, 160]", "shape = [80, 80]"), ("[0.45, 0.5]", "[0.9, 1.0]"), ("256.0", "32.0")):
        assert old in text
        text = text.replace(old, new)
    (out / "scene.toml").write_text(text)
    path = run(out / "scene.toml", out / "page", before=out / "scene.toml", device="cpu")
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=BROWSER, args=WITHOUT_GPU)
        page = browser.new_page(viewport={"width": 900, "height": 600})
        said: list[str] = []
        page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: said.append(f"error: {error}"))
        page.on("request", lambda request: said.append(request.url) if request.url.startswith("http") else None)
        page.goto(path.as_uri())
        page.wait_for_function("document.body.dataset.drawn > 0")
        yield page, said
        browser.close()


def picture(page: Any) -> np.ndarray:
    """The canvas as it stands after all drawing, shape (rows, cols, 3)."""
    before = -1
    while (now := int(page.evaluate("Number(document.body.dataset.drawn)"))) != before:
        before = now
        page.wait_for_timeout(250)
    canvas = page.locator("#canvas").screenshot()
    return np.asarray(Image.open(BytesIO(canvas)).convert("RGB")).astype(float)


@pytest.mark.full
def test_every_quantity_draws_a_picture_of_its_own(shown: tuple[Any, list[str]]) -> None:
    page, said = shown
    names = page.eval_on_selector_all("#quantity option", "all => all.map(one => one.value)")
    assert {"material", "object", "eps_r", "lit, shadow, layover", "modelled HH", "modelled VV"} <= set(names)
    pictures = {}
    for name in ("material", "eps_r", "lit, shadow, layover", "modelled HH"):
        page.select_option("#quantity", name)
        pictures[name] = picture(page)
        assert pictures[name].std() > 5.0, f"{name}: an empty canvas"
    seen = list(pictures.values())
    for i, one in enumerate(seen):
        for other in seen[i + 1 :]:
            assert np.abs(one - other).max() > 50.0
    assert said == []


def test_the_view_chosen_is_the_view_shown(shown: tuple[Any, list[str]]) -> None:
    page, said = shown
    page.select_option("#quantity", "lit, shadow, layover")
    page.select_option("#view", "north")
    first = picture(page)
    page.select_option("#view", "west")
    assert np.abs(picture(page) - first).max() > 50.0
    assert "lit by west" in page.inner_text("#legend")
    assert said == []


@pytest.mark.full
def test_along_the_radar_nothing_is_in_shadow(shown: tuple[Any, list[str]]) -> None:
    """Whoever looks from where the radar stands sees what it lights. The camera is near and sees in perspective, so
    some of the dark sides show."""
    page, said = shown
    page.select_option("#quantity", "lit, shadow, layover")
    page.select_option("#view", "south")
    page.uncheck("#grid")

    def dark(image: np.ndarray) -> float:
        return float(((image.max(axis=2) < 75.0) & (image.max(axis=2) > 20.0)).mean())

    page.click("#home")
    page.uncheck("#arrows")
    askew = dark(picture(page))
    page.click("#from-radar")
    along = dark(picture(page))
    assert askew > 0.01
    assert along < 0.2 * askew
    page.check("#grid")
    assert said == []


def test_a_drag_turns_and_a_pointer_reads(shown: tuple[Any, list[str]]) -> None:
    page, said = shown
    page.select_option("#quantity", "material")
    page.click("#home")
    first = picture(page)
    page.mouse.move(300, 300)
    page.mouse.down()
    page.mouse.move(420, 330, steps=5)
    page.mouse.up()
    assert np.abs(picture(page) - first).max() > 50.0
    page.mouse.move(301, 320)
    page.wait_for_function("document.getElementById('pointed').textContent.includes('material')")
    assert "up" in page.inner_text("#pointed")
    assert said == []


def test_before_and_after_are_chosen(shown: tuple[Any, list[str]]) -> None:
    page, said = shown
    assert page.is_checked("input[value='after']")
    page.check("input[value='before']")
    assert picture(page).std() > 5.0
    page.check("input[value='after']")
    assert said == []


@pytest.mark.full
def test_before_and_after_are_a_switch(shown: tuple[Any, list[str]], tmp_path: Path) -> None:
    """The page opens on the scene asked for; the switch shows the other one's surface and images, and back."""
    scene = (ROOT / "data/example/scene.toml").read_text()
    mesh = (ROOT / "data/example/scene.obj").as_posix()
    small = (
        scene.replace('"scene.obj"', f'"{mesh}"').replace("[160, 160]", "[40, 40]").replace("[0.45, 0.5]", "[1.8, 2.0]")
    )
    (tmp_path / "first.toml").write_text(small.replace("256.0", "16.0"))
    lines = small.replace("256.0", "16.0").splitlines()
    at = lines.index("[materials.lawn]")
    height = next(i for i in range(at, len(lines)) if lines[i].startswith("rms_height_m"))
    lines[height] = "rms_height_m = 0.0025"
    (tmp_path / "then.toml").write_text("\n".join(lines))
    path = run(tmp_path / "then.toml", tmp_path / "page", before=tmp_path / "first.toml", device="cpu")
    page = shown[0].context.browser.new_page(viewport={"width": 900, "height": 600})
    page.goto(path.as_uri())
    page.wait_for_function("document.body.dataset.drawn > 0")
    assert page.is_checked("input[value=after]")
    for quantity in ("h [mm]", "modelled HH"):
        page.select_option("#quantity", quantity)
        page.wait_for_timeout(1000)
        after = picture(page)
        page.check("input[value=before]")
        assert drawn_within_10_s(page, lambda now, was=after: np.abs(now - was).max() > 30.0), quantity
        page.check("input[value=after]")
        assert drawn_within_10_s(page, lambda now, was=after: np.abs(now - was).max() < 30.0), quantity
    page.close()


def drawn_within_10_s(page: Any, wanted: Callable[[np.ndarray], bool]) -> bool:
    """Whether the canvas comes to look as wanted: a busy machine draws late."""
    return any(wanted(picture(page)) for _ in range(40))
