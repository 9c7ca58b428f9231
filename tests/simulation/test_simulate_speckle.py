"""Speckle of `simulate`: its statistics, its streams, and the scene that names it as measured."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from scipy.optimize import brentq
from scipy.signal import windows
from scipy.stats import gamma, kstest
from test_cli_simulate import MESH, SCENE

from warpsar.cli.main import main
from warpsar.effects.base.phase import Response
from warpsar.io.images import read_channel
from warpsar.scene.scene import Scene
from warpsar.simulation.speckle import speckled


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    (tmp_path / "scene.obj").write_text(MESH)
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path / "scene.toml"


def warpsar(*arguments: str | Path) -> Result:
    return CliRunner().invoke(main, [*map(str, arguments), "--device", "cpu"])


@pytest.mark.parametrize("looks", [0.7, 1.0, 4.0, 16.0])
def test_statistics(looks: float) -> None:
    """Gamma of mean one and variance 1 / L in every region, whatever its beta0, and white."""
    beta0 = np.full((400, 400), 0.05, np.float32)
    beta0[:, 200:] = 20.0
    image = speckled(beta0, looks, seed=3, view=0, polarization="HH")
    assert (image.dtype, image.shape) == (np.float32, beta0.shape)
    for region in (np.s_[:, :200], np.s_[:, 200:]):
        ratio = image[region].astype(float) / beta0[region]
        n = ratio.size
        # four standard errors; the variance's is sqrt((2 + 6 / L) / n) of it
        assert ratio.mean() == pytest.approx(1.0, abs=4 / np.sqrt(looks * n))
        assert ratio.var() == pytest.approx(1 / looks, rel=4 * np.sqrt((2 + 6 / looks) / n))
        assert kstest(ratio.ravel(), gamma(looks, scale=1 / looks).cdf).pvalue > 1e-3
        centred = ratio - ratio.mean()
        for step in ((0, 1), (1, 0), (1, 1)):
            neighbour = np.roll(centred, step, axis=(0, 1))
            assert abs(np.corrcoef(centred.ravel(), neighbour.ravel())[0, 1]) < 4 / np.sqrt(n)


def test_dark_pixels_stay_dark() -> None:
    assert not speckled(np.zeros((5, 5), np.float32), 1.0, seed=0, view=0, polarization="HH").any()


def test_each_view_and_polarization_has_a_stream_of_its_own() -> None:
    ones = np.ones((100, 100), np.float32)
    images = {
        (seed, view, polarization): speckled(ones, 1.0, seed=seed, view=view, polarization=polarization).ravel()
        for seed in (0, 1)
        for view in (0, 1)
        for polarization in ("HH", "VV")
    }
    correlation = np.corrcoef(list(images.values()))
    assert np.abs(correlation - np.eye(len(images))).max() < 0.05
    again = speckled(ones, 1.0, seed=0, view=1, polarization="VV")
    np.testing.assert_array_equal(again.ravel(), images[0, 1, "VV"])


@pytest.mark.full
def test_the_noiseless_image_stays_and_the_speckled_one_stands_beside_it(scene: Path) -> None:
    plain, noisy, other = (scene.parent / name for name in ("plain", "noisy", "other"))
    assert warpsar("simulate", scene, "-o", plain).exit_code == 0
    assert warpsar("simulate", scene, "-o", noisy, "--looks", "4").exit_code == 0
    assert warpsar("simulate", scene, "-o", other, "--looks", "4").exit_code == 0
    said = json.loads((noisy / "simulate.json").read_text())
    for view in said["views"]:
        assert view["files"]["image"] == f"{view['name']}.exr"
        assert view["files"]["speckled"] == f"{view['name']}_looks4.exr"
        assert view["looks"] == 4
        for polarization in ("HH", "VV"):
            clean = read_channel(noisy / view["files"]["image"], polarization)
            np.testing.assert_array_equal(clean, read_channel(plain / view["files"]["image"], polarization))
            image = read_channel(noisy / view["files"]["speckled"], polarization)
            assert (image[clean > 0] != clean[clean > 0]).all()
            np.testing.assert_array_equal(image, read_channel(other / view["files"]["speckled"], polarization))
    assert "speckled" not in json.loads((plain / "simulate.json").read_text())["views"][0]["files"]
    assert not (noisy / "scene.toml").exists()


@pytest.mark.full
def test_a_declared_scene_is_one_that_every_command_reads(scene: Path) -> None:
    """simulate, learn, evaluate, diagnose: four lines of shell."""
    a, b, c, d = (scene.parent / name for name in "abcd")
    done = warpsar("simulate", scene, "-o", a, "--looks", "4", "--declare")
    assert done.exit_code == 0, done.output
    assert f"next: warpsar evaluate {a / 'scene.toml'} -o {a / 'evaluated'}" in done.output
    assert json.loads((a / "simulate.json").read_text())["scene"] == "scene.toml"
    declared = Scene.load(a / "scene.toml")
    for view in declared.views:
        assert view.looks == 4
        for polarization in ("HH", "VV"):
            np.testing.assert_array_equal(
                declared.measured(view, polarization), read_channel(a / f"{view.name}_looks4.exr", polarization)
            )
    for arguments in (
        ("learn", a / "scene.toml", "-o", b, "--iterations", "2"),
        ("evaluate", b / "scene.toml", "-o", c),
        ("diagnose", a / "scene.toml", "-o", d),
    ):
        done = warpsar(*arguments)
        assert done.exit_code == 0, done.output
    assert (d / "diagnosis.json").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("-o", "out", "--declare"), "--declare: found no --looks"),
        (("-o", ".", "--looks", "4", "--declare"), "where the scene file itself lies"),
        (("-o", "out", "--looks", "0"), "--looks"),
        (("-o", "out", "--looks", "4", "--azimuths", "0", "--incidences", "30"), "are for one scene"),
    ],
)
def test_refused(arguments: tuple[str, ...], message: str, scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(scene.parent)
    done = warpsar("simulate", scene.name, *arguments)
    assert done.exit_code == 2
    assert message in done.output
    assert scene.read_text() == SCENE
    assert not (scene.parent / "out").exists()


FWHM = 2.4  # pixels
LAGS = np.arange(1, 6)


def of_taylor(lags: np.ndarray) -> np.ndarray:
    """Squared Fourier transform of the squared window, by SciPy's own window and a width found by bisection."""
    weights = windows.taylor(4096, nbar=5, sll=35, norm=False)
    position = (np.arange(4096) + 0.5) / 4096 - 0.5
    half = brentq(lambda x: (weights @ np.cos(2 * np.pi * x * position) / weights.sum()) ** 2 - 0.5, 0.1, 1.0)
    phase = np.cos(2 * np.pi * np.outer(lags * 2.0 * half / FWHM, position))
    return (phase @ weights**2 / (weights**2).sum()) ** 2


EXPECTED = {
    "none": lambda lags: np.sinc(0.8858929 * lags / FWHM) ** 2,
    None: lambda lags: np.exp(-4.0 * np.log(2.0) * lags**2 / (2.0 * FWHM**2)),  # twice the variance of the kernel
    "taylor": of_taylor,
}


@pytest.mark.full
@pytest.mark.parametrize("looks", [1.0, 2.5, 4.0, 16.0])
@pytest.mark.parametrize("taper", ["none", "taylor", None])
def test_neighbours_share_speckle_as_the_response_makes_them(taper: str | None, looks: float) -> None:
    """Along range by the window, along azimuth by half the width; every pixel by itself is gamma as without."""
    response = Response((FWHM * 0.5, FWHM * 0.5 * 2.0), (taper, taper))
    size = 1200
    image = speckled(
        np.ones((size, size), np.float32),
        looks,
        seed=1,
        view=0,
        polarization="HH",
        response=response,
        spacing_m=(0.5, 1.0),
    )
    centred = image.astype(float) - 1.0
    # speckle of some 10 pixels is one: four standard errors; a hundredth more beyond four looks, whose law is reached
    # by quantiles of four fields
    error = 4.0 * np.sqrt(10.0) / size
    assert centred.mean() == pytest.approx(0.0, abs=error / np.sqrt(looks))
    assert centred.var() * looks == pytest.approx(1.0, abs=error * np.sqrt(2.0 + 6.0 / looks))
    for axis in (0, 1):
        found = [(centred * np.roll(centred, lag, axis)).mean() / centred.var() for lag in LAGS]
        np.testing.assert_allclose(
            found, EXPECTED[taper](LAGS.astype(float)), atol=error + (0.01 if looks % 1 or looks > 4 else 0)
        )
    alone = image[::12, ::12].ravel()  # sinc^2 at 12 pixels is below 0.005
    assert kstest(alone, gamma(looks, scale=1 / looks).cdf).pvalue > 1e-3


@pytest.mark.full
def test_the_command_draws_speckle_of_the_declared_response(scene: Path, tmp_path: Path) -> None:
    """With a point spread of three pixels in range, neighbours in range are alike; without one they are not."""
    sharp = scene.read_text()
    found = []
    for name, text in (
        ("sharp", sharp),
        ("wide", sharp + '\n[effects.point_spread]\nrange_fwhm_m = 1.5\nwindow = "sinc"\n'),
    ):
        scene.write_text(text)
        assert warpsar("simulate", scene, "-o", tmp_path / name, "--looks", "1").exit_code == 0
        view = Scene.load(scene).views[0].name
        plain, noisy = (read_channel(tmp_path / name / f"{view}{end}.exr", "HH") for end in ("", "_looks1"))
        lit = plain > 0.2 * np.median(plain[plain > 0])
        ratio = np.where(lit, noisy / np.where(lit, plain, 1.0) - 1.0, 0.0)
        both = lit[1:] & lit[:-1]
        found.append(float((ratio[1:] * ratio[:-1])[both].mean()))
    assert abs(found[0]) < 0.25
    assert found[1] > found[0] + 0.4
