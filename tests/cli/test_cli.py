"""The command line: a refusal is one message and its exit status, never a traceback."""

import os
import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import click
import pytest
from click.testing import CliRunner

from warpsar.cli import main as cli
from warpsar.cli import options
from warpsar.errors import DeviceError, InputError, WarpsarError

pytestmark = pytest.mark.unit


@pytest.mark.parametrize(
    ("error", "exit_code", "message"),
    [
        (WarpsarError("no better than before"), 1, "no better than before"),
        (InputError("scene.toml: bad"), 2, "scene.toml: bad"),
        (PermissionError(13, "Permission denied", "out"), 2, "out: Permission denied"),
        (OSError("out/north.exr: cannot be written"), 2, "out/north.exr: cannot be written"),
        (DeviceError("--device cuda:7: not here"), 3, "--device cuda:7: not here"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
    ids=lambda value: type(value).__name__ if isinstance(value, BaseException) else None,
)
def test_a_refusal_is_one_message(
    error: BaseException, exit_code: int, message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    @click.command()
    def failing() -> None:
        raise error

    monkeypatch.setitem(sys.modules, "failing", SimpleNamespace(command=failing))
    monkeypatch.setitem(cli.COMMANDS, "fail", "failing:command")
    with pytest.raises(SystemExit) as end:
        cli.main(["fail"])
    assert end.value.code == exit_code
    assert capsys.readouterr() == ("", f"Error: {message}\n")


def test_a_defect_keeps_its_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    @click.command()
    def failing() -> None:
        raise ZeroDivisionError

    monkeypatch.setitem(sys.modules, "failing", SimpleNamespace(command=failing))
    monkeypatch.setitem(cli.COMMANDS, "fail", "failing:command")
    with pytest.raises(ZeroDivisionError):
        cli.main(["fail"])


@pytest.mark.parametrize(
    "arguments",
    [
        ["simulat"],
        ["simulate"],
        ["simulate", "missing.toml", "-o", "out"],
        ["simulate", "scene.toml"],
        ["simulate", "scene.toml", "-o", "scene.toml"],
        ["simulate", "scene.toml", "-o", "out", "--max-memory", "0"],
        ["simulate", "scene.toml", "-o", "out", "--seed", "-1"],
        ["simulate", "scene.toml", "-o", "out", "--seed", "one"],
    ],
    ids=" ".join,
)
def test_wrong_usage_is_exit_2(arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").touch()
    result = CliRunner().invoke(cli.main, arguments)
    assert result.exit_code == 2
    assert "Error: " in result.output


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        (
            [],
            {
                "device": None,
                "seed": None,
                "layers": False,
                "variance": False,
                "per_ray": False,
                "max_memory_gib": None,
                "formats": ("exr",),
                "looks": None,
                "declare": False,
                "scatterers": 0,
                "yes": False,
            },
        ),
        (
            [
                *("--device", "cuda:1", "--seed", "7", "--layers", "--variance", "--per-ray", "--max-memory", "1.5"),
                *("--format", "geotiff", "--format", "zarr", "--looks", "4", "--declare", "--scatterers", "9", "--yes"),
            ],
            {
                "device": "cuda:1",
                "seed": 7,
                "layers": True,
                "variance": True,
                "per_ray": True,
                "max_memory_gib": 1.5,
                "formats": ("geotiff", "zarr"),
                "looks": 4.0,
                "declare": True,
                "scatterers": 9,
                "yes": True,
            },
        ),
    ],
    ids=["defaults", "all"],
)
def test_simulate_hands_its_options_on(
    arguments: list[str], options: dict[str, object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = []

    def run(*paths: Path, **options: object) -> None:
        calls.append((paths, options))

    monkeypatch.setattr("warpsar.simulation.command.run", run)
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").touch()
    result = CliRunner().invoke(cli.main, ["simulate", "scene.toml", "-o", "out", *arguments])
    assert (result.exit_code, result.output) == (0, "")
    assert calls == [((Path("scene.toml"), Path("out")), options)]


def test_import_names_the_windows_there_are() -> None:
    from warpsar.cli import import_
    from warpsar.world.taper import TAPERS

    assert tuple(TAPERS) == import_.TAPERS


@pytest.mark.parametrize("name", cli.COMMANDS)
def test_help_has_an_example_of_every_command(name: str) -> None:
    """-h is --help; the examples keep their lines, and name options that exist."""
    short, long = (CliRunner().invoke(cli.main, [name, flag]) for flag in ("-h", "--help"))
    assert (short.exit_code, short.output) == (0, long.output)
    assert re.search(rf"\n  Examples?:\n    warpsar {name}", short.output)
    command = cli.main.get_command(click.Context(cli.main), name)
    assert command is not None
    known = {word for parameter in command.params for word in parameter.opts}
    for line in re.findall(rf"^    warpsar {name}(.*)$", short.output, re.MULTILINE):
        assert set(re.findall(r" (--?[a-z][\w-]*)", line)) <= known


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["simulat", "scene.toml"], "did you mean simulate?"),
        (["daignose"], "did you mean diagnose?"),
        (["xyz"], "no such command: xyz; must be one of new, "),
        (["simulate", "--layrs"], "--layers"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else None,
)
def test_a_near_miss_is_named(arguments: list[str], said: str) -> None:
    result = CliRunner().invoke(cli.main, arguments)
    assert result.exit_code == 2
    assert said in result.stderr


def test_quiet_leaves_out_messages_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Warnings stay; the next command speaks again."""
    from warpsar.runtime import console

    def run(*paths: Path, **options: object) -> None:
        console.say("a message")
        console.warn(["a warning"])

    monkeypatch.setattr("warpsar.simulation.command.run", run)
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").touch()
    words = ["simulate", "scene.toml", "-o", "out"]
    assert CliRunner().invoke(cli.main, [*words, "-q"]).stderr == "warning: a warning\n"
    assert CliRunner().invoke(cli.main, words).stderr == "a message\nwarning: a warning\n"


def test_a_run_says_how_to_make_it_again() -> None:
    """What was given, and that alone: arguments, values of several words, flags; what the command needs comes first."""

    @click.command(name="measure")
    @click.option("--window", type=float, default=2.0)
    @click.option("--size", nargs=2, type=int)
    @click.option("--format", "formats", multiple=True)
    @click.option("--closed-form", is_flag=True)
    @click.argument("products", nargs=-1, required=True)
    @options.out("Folder.")
    @options.resume
    def command(**_: object) -> None:
        click.echo(options.words())
        click.echo(options.words("--resume"))

    given = ["--closed-form", "--size", "3", "4", "a b", "c", "-o", "out", "--format", "x", "--format", "y", "--resume"]
    said = CliRunner().invoke(command, given, catch_exceptions=False).output.splitlines()
    needed, more = (
        ["warpsar", "measure", "a b", "c", "-o", "out"],
        ["--size", "3", "4", "--format", "x", "--format", "y"],
    )
    assert said == [str([*needed, *more, "--closed-form"]), str([*needed, "--resume", *more, "--closed-form"])]
    again = CliRunner().invoke(command, [*needed[2:], *more, "--closed-form"], catch_exceptions=False)
    assert again.output.splitlines() == said


@pytest.mark.parametrize(
    ("given", "threads"), [({}, "1"), ({"OPENBLAS_NUM_THREADS": "3"}, "3"), ({"OMP_NUM_THREADS": "2"}, "None")]
)
def test_blas_starts_no_threads_beside_ours(given: dict[str, str], threads: str) -> None:
    """NumPy reads the number when it is loaded: the command sets it before, unless the user has."""
    code = (
        "import os, sys; from warpsar.cli import main as cli; assert 'numpy' not in sys.modules; "
        "cli.main(['schema', '--help'], standalone_mode=False); print(os.environ.get('OPENBLAS_NUM_THREADS'))"
    )
    env = {k: v for k, v in os.environ.items() if k not in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS")} | given
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == threads
