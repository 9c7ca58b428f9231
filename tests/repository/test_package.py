"""What a user installs: the wheel holds every module, imports light, and README's commands are what the gate runs."""

import json
import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from warpsar.cli.main import COMMANDS
from warpsar.version import __version__

ROOT = Path(__file__).resolve().parents[2]
ROOMS = {"warpsar": "warpsar", "cli": "warpsar.cli", "kernels": "warpsar.kernels"}


def modules() -> list[str]:
    """Every module of the source tree, by the name it is imported under."""
    found = []
    for room, package in ROOMS.items():
        for path in (ROOT / room).rglob("*.py"):
            parts = path.relative_to(ROOT / room).with_suffix("").parts
            found.append(".".join([package, *(part for part in parts if part != "__init__")]))
    return sorted(found)


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the wheel installed; built from a copy, for setuptools builds in place and old builds linger."""
    source, wheels, target = (tmp_path_factory.mktemp(name) for name in ("source", "wheels", "target"))
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, source)
    for room in ROOMS:
        shutil.copytree(ROOT / room, source / room, ignore=shutil.ignore_patterns("__pycache__"))
    pip = [sys.executable, "-m", "pip", "--quiet"]
    subprocess.run([*pip, "wheel", "--no-deps", "--wheel-dir", wheels, source], check=True)
    (wheel,) = wheels.glob("warpsar-*.whl")
    subprocess.run([*pip, "install", "--no-deps", "--target", target, wheel], check=True)
    return target


def run_python(code: str, *arguments: str, cwd: Path, path: Path | None = None) -> str:
    """stdout of `code`, run in a Python of its own in `cwd` with `path` first on its import path."""
    code = f"import sys; sys.path.insert(0, {str(path)!r})\n{code}" if path else code
    done = subprocess.run([sys.executable, "-c", code, *arguments], cwd=cwd, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.full
def test_wheel_holds_every_module(installed: Path, tmp_path: Path) -> None:
    # The file is asked for because an editable install in this environment would stand in for what the wheel lacks.
    code = "import importlib\nfor name in sys.argv[1:]: print(importlib.import_module(name).__file__)"
    files = run_python(code, *modules(), cwd=tmp_path, path=installed).split()
    assert len(files) == len(modules())
    assert [file for file in files if not Path(file).is_relative_to(installed)] == []


def test_wheel_puts_nothing_but_warpsar_on_the_import_path(installed: Path) -> None:
    assert (installed / "warpsar" / "py.typed").is_file()
    assert {path.name for path in installed.iterdir() if path.suffix != ".dist-info"} == {"warpsar", "bin"}


def test_wheel_runs_as_a_module(installed: Path, tmp_path: Path) -> None:
    code = "import runpy; sys.argv[0] = 'warpsar'; runpy.run_module('warpsar', run_name='__main__')"
    assert run_python(code, "--version", cwd=tmp_path, path=installed) == f"warpsar {__version__}\n"


MEASURE = """
from dataclasses import replace
from pathlib import Path
import sys
import numpy as np
import warpsar
from warpsar.io import write_tiff

print(warpsar.__file__)
scene = warpsar.Scene.load("corner/scene.toml")
small = replace(
    scene,
    radar=scene.radar.model_copy(update={"polarizations": ("HH",)}),
    grid=warpsar.Grid(shape=(40, 40), spacing_m=(1.8, 2.0)),
    sampling=scene.sampling.model_copy(update={"rays_per_pixel": 64.0}),
)
truth = replace(small, effects={"noise_floor": {"level": 0.003}})
random = np.random.default_rng(1)
views = []
for view, made in zip(small.views, warpsar.simulate(truth, device="cpu"), strict=True):
    image = Path(f"corner/{view.name}.tif").resolve()
    write_tiff(image, made.beta0["HH"] * random.gamma(16.0, 1 / 16.0, made.beta0["HH"].shape))
    views.append(view.model_copy(update={"images": {"HH": image}, "looks": 16.0}))
replace(small, views=views).save("corner/measured.toml")
"""
WITHOUT_A_CHECKOUT = [
    ("new corner --example", ["corner/scene.obj"]),
    ("", ["corner/measured.toml"]),
    ("simulate corner/measured.toml -o images --device cpu", ["images/north.exr", "images/simulate.json"]),
    ("learn corner/measured.toml -o learned --starts 1 --iterations 5 --device cpu", ["learned/scene.toml"]),
    (
        "diagnose corner/measured.toml -o found --starts 0 --most-effects 1 --draws 400 --device cpu",
        ["found/report.html"],
    ),
    ("view corner/measured.toml -o page --device cpu", ["page/view.html"]),
]
"""What a user types, in an empty folder, and what must lie there then; the empty line runs `MEASURE`."""


@pytest.mark.slow
def test_a_wheel_works_without_a_checkout(installed: Path, tmp_path: Path) -> None:
    env = {**os.environ, "PYTHONPATH": str(installed)}
    for line, files in WITHOUT_A_CHECKOUT:
        command = ["-m", "warpsar", *line.split()] if line else ["-c", MEASURE]
        done = subprocess.run([sys.executable, *command], cwd=tmp_path, env=env, capture_output=True, text=True)
        assert done.returncode in ((0, 4) if line.startswith("diagnose") else (0,)), f"{line}: {done.stderr}"
        if not line:
            assert Path(done.stdout.split()[0]).is_relative_to(installed)
        assert [name for name in files if not (tmp_path / name).stat().st_size] == []
    assert json.loads((tmp_path / "found" / "diagnosis.json").read_text(encoding="utf-8"))["verdict"] == ["noise_floor"]


@pytest.mark.slow
def test_an_sdist_is_complete_and_makes_the_same_wheel(installed: Path, tmp_path: Path) -> None:
    """Git tells what an sdist holds, so this one is made in a repository of its own."""
    pytest.importorskip("build", reason="build is not installed: pip install 'warpsar[dev]'")
    folders = (*ROOMS, "tests", "docs", "examples", "benchmarks", "data")
    for name in ("pyproject.toml", "README.md", "LICENSE", ".gitignore"):
        shutil.copy(ROOT / name, tmp_path)
    for folder in folders:
        shutil.copytree(ROOT / folder, tmp_path / folder, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    git = ["git", "-c", "user.name=tests", "-c", "user.email=tests@example.org"]
    for words in (["init"], ["add", "--all"], ["commit", "--message", "all"]):  # files of no commit are not listed
        subprocess.run([*git, *words], cwd=tmp_path, check=True, capture_output=True)
    # without a choice `build` makes the wheel from the sdist
    subprocess.run([sys.executable, "-m", "build", "--outdir", "made", "."], cwd=tmp_path, check=True)
    (sdist,) = (tmp_path / "made").glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    known = subprocess.run(["git", "ls-files", *folders], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert set(known.stdout.split("\n")) - {""} - held == set()
    (wheel,) = (tmp_path / "made").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if name.startswith("warpsar/")}
    there = {path.relative_to(installed).as_posix() for path in (installed / "warpsar").rglob("*") if path.is_file()}
    assert {name for name in there if "__pycache__" not in name} == names


USER = """
from typing import Any
import numpy as np
import warpsar

mesh = warpsar.Mesh.of({"lawn": (np.zeros((3, 3)), np.zeros((1, 3), int))})
image = np.ones((8, 8), np.float32)
scene = warpsar.Scene(
    mesh=mesh,
    radar=warpsar.Radar(frequency_hz=9.6e9, polarizations=("HH",)),
    grid=warpsar.Grid(shape=(8, 8), spacing_m=(0.5, 0.5)),
    materials={"lawn": warpsar.Material(eps_r=6.0, rms_height_m=1e-3, correlation_length_m=1e-2)},
    views=[warpsar.View(name="a", azimuth_deg=0.0, incidence_deg=40.0, images={"HH": image}, mask=image > 0)],
    sampling=warpsar.Sampling(rays_per_pixel=64.0),
)
reveal_type(scene)
reveal_type(warpsar.simulate(scene))
reveal_type(warpsar.learn(scene, options=warpsar.LearnOptions(starts=1)).loss)
reveal_type(warpsar.diagnose(scene, options=warpsar.DiagnoseOptions(starts=1)))
reveal_type(warpsar.evaluate(scene))
reveal_type(warpsar.renderer(scene).vjp)
warpsar.simulate(3)
warpsar.imagine(scene)
"""
MYPY = """
"warpsar.scene.scene.Scene"
"list[warpsar.simulation.view.SimulatedView]"
"float"
"warpsar.diagnosis.result.Diagnosed"
"warpsar.compare.evaluation.Evaluation"
"def (values: Mapping[str, Any] | None, cotangents:
error: Argument 1 to "simulate" has incompatible type "int"; expected "Scene | PathLike[str] | str"
error: Module has no attribute "imagine"
"""


@pytest.mark.slow
def test_wheel_is_typed_for_its_users(installed: Path, tmp_path: Path) -> None:
    pytest.importorskip("mypy", reason="mypy is not installed: pip install 'warpsar[dev]'")
    (tmp_path / "user.py").write_text(USER, encoding="utf-8")
    mypy = [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--cache-dir=/dev/null", "user.py"]
    env = {**os.environ, "MYPYPATH": str(installed)}
    said = subprocess.run(mypy, cwd=tmp_path, env=env, capture_output=True, text=True).stdout
    lines = [line for line in said.splitlines()[:-1] if ": note: See " not in line]
    for expected, line in zip(MYPY.strip().splitlines(), lines, strict=True):
        assert expected in line.replace("typing.", "").replace("builtins.", "").replace("*", ""), said


@pytest.mark.full
def test_names_are_there_for_help_and_completion(tmp_path: Path) -> None:
    code = """
import sys, pydoc, warpsar
names = set(dir(warpsar))
print(sorted(set(warpsar.__all__) - names), {"warp", "numpy", "pydantic", "scipy"} & set(sys.modules))
for name in warpsar.__all__: getattr(warpsar, name)
text = pydoc.plain(pydoc.render_doc(warpsar.simulate)) + pydoc.plain(pydoc.render_doc(warpsar))
print("simulate(scene: " in text, "Images of every view" in text, "renderer(scene: " in text, "class Mesh" in text)
"""
    assert run_python(code, cwd=tmp_path).splitlines() == ["[] set()", "True True True True"]


@pytest.mark.full
@pytest.mark.parametrize("arguments", [[], *([name] for name in COMMANDS)], ids=lambda names: names[-1:] or "warpsar")
def test_help_imports_nothing_heavy(arguments: list[str], tmp_path: Path) -> None:
    heavy = "warp numpy scipy trimesh matplotlib OpenImageIO pydantic rasterio sarkit h5py lxml"
    code = f"""
import sys
from warpsar.cli.main import main
try:
    main()
except SystemExit as end:
    assert end.code == 0, end.code
print("imported:", *set("{heavy}".split()) & set(sys.modules))
"""
    out = run_python(code, *arguments, "--help", cwd=tmp_path)
    assert "Usage:" in out
    assert out.splitlines()[-1].split() == ["imported:"]


def test_locked_versions_are_those_that_are_asked_for() -> None:
    """Every package that `.[dev,docs]` names stands in the lock, at a version that pyproject.toml admits."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = (ROOT / ".ci" / "requirements-dev.lock").read_text(encoding="utf-8").splitlines()
    locked = [Requirement(line) for line in lines if not line.startswith("#")]
    extras, asked = ["dev", "docs"], list(project["dependencies"])
    for name in extras:
        for text in project["optional-dependencies"][name]:
            one = Requirement(text)
            extras.extend(one.extras) if one.name == "warpsar" else asked.append(text)
    for one in map(Requirement, asked):
        found = [each for each in locked if canonicalize_name(each.name) == canonicalize_name(one.name)]
        assert found, f"{one.name}: docs/contributing.md says how to lock it"
        for each in found:
            (version,) = each.specifier
            assert one.specifier.contains(version.version), f"{each}: pyproject.toml asks for {one}"


def test_readme_holds_two_commands_of_one_line() -> None:
    blocks = (ROOT / "README.md").read_text(encoding="utf-8").split("```sh\n")[1:]
    commands = [block.partition("```")[0].splitlines() for block in blocks]
    assert [len(lines) for lines in commands] == [1, 1]
    (first,), (second,) = commands
    assert first.split(" && ")[-1].split()[:3] == [".venv/bin/warpsar", "simulate", "data/example/scene.toml"]
    assert second.split(" && ")[-1].split()[0] == ".venv/bin/pytest"


@pytest.mark.full
def test_readme_python_makes_the_images_it_says() -> None:
    (snippet,) = (ROOT / "README.md").read_text(encoding="utf-8").split("```python\n")[1:]
    code = snippet.partition("```")[0]
    code += "for name, image in images.items(): print(name, *image.shape, (image > 0).any())"
    lines = run_python(code, cwd=ROOT).splitlines()
    assert lines == [f"{name} 160 160 True" for name in ("north", "south", "west")]


def test_example_mesh_is_what_its_script_writes(tmp_path: Path) -> None:
    (tmp_path / "example").mkdir()
    shutil.copy(ROOT / "data" / "make_example.py", tmp_path)
    run_python("import runpy; runpy.run_path('make_example.py', run_name='__main__')", cwd=tmp_path)
    for name in ("scene.obj", "scene.mtl"):
        assert (tmp_path / "example" / name).read_bytes() == (ROOT / "data" / "example" / name).read_bytes()
