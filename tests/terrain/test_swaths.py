"""A product of several sub-swaths: one view of each that shows the ground."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from product_files import Band, write_safe
from terrain_files import dem, flat

import warpsar
from warpsar.cli.main import main
from warpsar.errors import InputError

SHAPE = (64, 256)
APART = 240
"""Pixels from the first of IW1 to the first of IW2: the last 16 of IW1 lie on the same ground."""


def product(folder: Path) -> Path:
    """Three sub-swaths, of which the third lies 12 km farther than the ground."""
    for swath, pixel in (("IW1", 200.0), ("IW2", 200.0 - APART), ("IW3", 200.0 - 5000.0)):
        band = Band(lines=SHAPE[0], pixels=SHAPE[1], centre=(31.5, pixel))
        safe = write_safe(folder, np.zeros(SHAPE, np.complex64), band, swath=swath)
    return safe


def run(*words: object) -> tuple[int, str, str]:
    done = CliRunner().invoke(main, ["twin", *map(str, words), "--device", "cpu"])
    return done.exit_code, done.stdout, done.stderr


def layers(path: Path) -> dict[str, np.ndarray]:
    import rasterio

    with rasterio.open(path) as file:
        return dict(zip(file.descriptions, file.read(), strict=True))


def test_each_swath_that_shows_the_ground_has_a_view(tmp_path: Path) -> None:
    out = tmp_path / "out"
    code, _, said = run(product(tmp_path), "--dem", dem(tmp_path, flat(61)), "--geoid-offset", 0, "-o", out)
    assert code == 0, said
    assert "twin: the ground is in IW1, IW2, and not in IW3" in said
    content = json.loads((out / "twin.json").read_text())
    assert content["views"] == {"IW1": "IW1/twin.json", "IW2": "IW2/twin.json"}
    assert list(content["without_ground"]) == ["IW3"]
    assert "must overlap" in content["without_ground"]["IW3"]
    assert sorted(one.name for one in out.iterdir()) == ["IW1", "IW2", "report.html", "twin.json"]
    assert all((out / file).is_file() for file in content["files"])
    report = (out / "report.html").read_text()
    assert '<a href="IW1/report.html">' in report
    assert report.count("data:image/png") == 2
    # the same ground in both: IW2 begins 240 pixels farther
    views = {name: json.loads((out / name / "twin.json").read_text()) for name in ("IW1", "IW2")}
    images = {name: layers(out / name / "image.tif") for name in views}
    near, far = (
        images[name]["beta0"][:, slice(first - of["window"]["pixels"][0], first + 16 - of["window"]["pixels"][0])]
        for (name, of), first in zip(views.items(), (APART, 0), strict=True)
    )
    assert near.shape == far.shape == (near.shape[0], 16)
    assert np.isfinite(near).all()
    np.testing.assert_allclose(near, far, rtol=1e-4)  # single precision of edges that count from another pixel


def test_where_one_alone_shows_it_there_is_one_twin(tmp_path: Path) -> None:
    safe, model, out = product(tmp_path), dem(tmp_path, flat(5)), tmp_path / "out"
    code, _, said = run(safe, "--dem", model, "--geoid-offset", 0, "-o", out)
    assert code == 0, said
    assert "twin: the ground is in IW1, and not in IW2, IW3" in said
    content = json.loads((out / "twin.json").read_text())
    assert content["platform"] == "S1A IW1"
    found = warpsar.twin(safe, model, geoid_offset_m=0.0, device="cpu")
    assert found.window.pixels == tuple(content["window"]["pixels"])


def test_python_asks_which(tmp_path: Path) -> None:
    safe, model = product(tmp_path), dem(tmp_path, flat(61))
    said = r"found 2 sub-swaths that show the ground; name one of s1a-iw1-slc-vv-\S+\.xml, s1a-iw2-slc-vv-\S+\.xml"
    with pytest.raises(InputError, match=said):
        warpsar.twin(safe, model, geoid_offset_m=0.0, device="cpu")
    (one,) = (safe / "annotation").glob("s1a-iw2-*.xml")
    assert warpsar.twin(one, model, geoid_offset_m=0.0, device="cpu").product.platform == "S1A IW2"


def test_a_swath_that_would_leave_the_folder_is_named_by_its_file(tmp_path: Path) -> None:
    safe, model, out = product(tmp_path), dem(tmp_path, flat(61)), tmp_path / "a" / "out"
    (one,) = (safe / "annotation").glob("s1a-iw2-*.xml")
    one.write_text(one.read_text().replace("<swath>IW2<", "<swath>../../IW2<"))
    code, _, said = run(safe, "--dem", model, "--geoid-offset", 0, "-o", out)
    assert code == 0, said
    assert sorted(one.name for one in out.iterdir() if one.is_dir()) == sorted(["IW1", one.stem])
    assert not (tmp_path / "IW2").exists()


def test_two_polarizations_must_be_told_apart(tmp_path: Path) -> None:
    safe, model = product(tmp_path), dem(tmp_path, flat(9))
    (one,) = (safe / "annotation").glob("s1a-iw1-*.xml")
    text = one.read_text().replace("<polarisation>VV<", "<polarisation>VH<")
    (one.parent / one.name.replace("-vv-", "-vh-")).write_text(text)
    code, _, said = run(safe, "--dem", model, "--geoid-offset", 0, "-o", tmp_path / "out")
    assert code == 2
    assert "found images of the polarizations VH, VV; state one by --polarization" in said
    assert not (tmp_path / "out").exists()
