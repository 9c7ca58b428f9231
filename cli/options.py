"""Options that several commands share."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

import click
from click.core import ParameterSource

from warpsar.formats import registry

Command = TypeVar("Command", bound=Callable[..., Any])

UNITS = ("m", "cm", "mm", "in", "ft")  # a copy from warpsar.world.objects.table, which imports NumPy; a test compares
UP = ("y", "z")

FILE = click.Path(exists=True, dir_okay=False, path_type=Path)


class _SceneFile(click.Path):
    """A scene file; where its folder is given in its place, the message names the file."""

    def __init__(self) -> None:
        super().__init__(exists=True, dir_okay=False, path_type=Path)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        inside = Path(value) / "scene.toml"
        if inside.is_file():
            self.fail(f"{value!r} is a folder; its scene file is {str(inside)!r}.", param, ctx)
        return super().convert(value, param, ctx)


SCENE = _SceneFile()

scene = click.argument("scene", type=SCENE)

device = click.option(
    "--device",
    metavar="cpu|cuda|cuda:N",
    help="Device to work on. Default: the first CUDA device if there is one (with torchrun, the process's own), "
    "else the CPU.",
)

resume = click.option("--resume", is_flag=True, help="Continue from the checkpoint in the output folder.")

yes = click.option("--yes", is_flag=True, help="Accept a mesh that is more than 5000 m across.")


def out(words: str) -> Callable[[Command], Command]:
    """-o: the folder of what a command writes, in `words`."""
    return click.option("-o", "--out", required=True, type=click.Path(file_okay=False, path_type=Path), help=words)


def polarization(words: str) -> Callable[[Command], Command]:
    return click.option("--polarization", type=click.Choice(("HH", "HV", "VH", "VV")), help=words)


def radiometry(whose: str) -> Callable[[Command], Command]:
    words = f"Quantity of the power of {whose}, for products that do not state it (GAMMA)."
    return click.option("--radiometry", type=click.Choice(("beta0", "sigma0", "gamma0")), help=words)


def file_format(name: str, words: str) -> Callable[[Command], Command]:
    """The format of what a radar measured, of all that the registry has."""
    formats = click.Choice(("auto", *registry.names()))
    return click.option(name, "file_format", type=formats, default="auto", show_default=True, help=words)


def quiet() -> click.Option:
    """-q of every command: only results, warnings and errors."""

    def chosen(context: click.Context, option: click.Parameter, value: bool) -> None:
        from warpsar.runtime import console

        console.be_quiet(value)

    words = "No messages and no progress; warnings and errors stay."
    return click.Option(["-q", "--quiet"], is_flag=True, expose_value=False, callback=chosen, help=words)


@contextmanager
def resumable(out: Path) -> Iterator[None]:
    """A run that keeps a checkpoint in the folder `out`: where Ctrl-C ends it, the message says how to go on."""
    from warpsar.io.checkpoint import NAME

    try:
        yield
    except KeyboardInterrupt:
        if not (out / NAME).exists():
            raise KeyboardInterrupt("interrupted before the first checkpoint") from None
        raise KeyboardInterrupt(f"interrupted; go on with: {shlex.join(words('--resume'))}") from None


def words(*more: str) -> list[str]:
    """This command as it was given, which makes the same again: what it needs, `more`, then every other option."""
    context = click.get_current_context()
    needed: list[str] = []
    given: list[str] = []
    for parameter in context.command.params:
        name = str(parameter.name)
        if name in ("resume", "quiet") or context.get_parameter_source(name) is not ParameterSource.COMMANDLINE:
            continue
        value = context.params[name]
        option = [] if isinstance(parameter, click.Argument) else [parameter.opts[0]]
        found = needed if parameter.required else given
        if isinstance(parameter, click.Option) and parameter.is_flag:
            found += option if value else parameter.secondary_opts
            continue
        for each in value if parameter.multiple else (value,):
            found += [*option, *map(str, each if isinstance(each, tuple) else (each,))]
    return ["warpsar", str(context.info_name), *needed, *more, *given]
