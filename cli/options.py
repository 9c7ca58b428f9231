"""Options that several commands share."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click
from click.core import ParameterSource

device = click.option(
    "--device",
    metavar="cpu|cuda|cuda:N",
    help="Device to work on. Default: the first CUDA device if there is one (with torchrun, the process's own), "
    "else the CPU.",
)

resume = click.option("--resume", is_flag=True, help="Continue from the checkpoint in the output folder.")

yes = click.option("--yes", is_flag=True, help="Accept a mesh that is more than 5000 m across.")


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
        words = shlex.join(_resuming(click.get_current_context()))
        raise KeyboardInterrupt(f"interrupted; go on with: {words}") from None


def _resuming(context: click.Context) -> list[str]:
    """The words of this command with --resume: scene and folder, then every other option that was given."""
    needed: list[str] = []
    given: list[str] = []
    for parameter in context.command.params:
        name = str(parameter.name)
        if name in ("resume", "quiet") or context.get_parameter_source(name) is not ParameterSource.COMMANDLINE:
            continue
        values = context.params[name] if parameter.multiple else (context.params[name],)
        option = [] if isinstance(parameter, click.Argument) else [parameter.opts[0]]
        (needed if parameter.required else given).extend(word for value in values for word in (*option, str(value)))
    return ["warpsar", str(context.info_name), *needed, "--resume", *given]
