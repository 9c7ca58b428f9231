"""The command `warpsar`: it imports a subcommand only when it is needed, and turns an error into one message."""

from __future__ import annotations

import gc
import os
from importlib import import_module
from typing import Any, NoReturn

import click

from warpsar.cli import options
from warpsar.errors import InputError, WarpsarError, did_you_mean

INTERRUPTED = 130  # 128 + SIGINT, as shells report it

COMMANDS = {
    "new": "warpsar.cli.new:command",
    "materials": "warpsar.cli.materials:command",
    "simulate": "warpsar.cli.simulate:command",
    "rcs": "warpsar.cli.rcs:command",
    "reflectors": "warpsar.cli.reflectors:command",
    "twin": "warpsar.cli.twin:command",
    "import": "warpsar.cli.import_:command",
    "learn": "warpsar.cli.learn:command",
    "uv": "warpsar.cli.uv:command",
    "evaluate": "warpsar.cli.evaluate:command",
    "diagnose": "warpsar.cli.diagnose:command",
    "view": "warpsar.cli.view:command",
    "schema": "warpsar.cli.schema:command",
}


class LazyGroup(click.Group):
    """A group whose subcommands are named in `COMMANDS` as "module:attribute"."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module, _, attribute = COMMANDS[cmd_name].partition(":")
        command: click.Command = getattr(import_module(module), attribute)
        if all(parameter.name != "quiet" for parameter in command.params):
            command.params.append(options.quiet())
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and not args[0].startswith("-") and args[0] not in COMMANDS:
            ctx.fail(
                f"no such command: {args[0]}; must be one of {', '.join(COMMANDS)}{did_you_mean(args[0], COMMANDS)}"
            )
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        # Imports make half a million objects that stay. To look through them again and again takes 0.1 s of start-up.
        gc.set_threshold(100_000, 50, 50)
        # NumPy reads it when it is loaded. Its BLAS would start threads of its own beside ours, for products too small
        # to share, and they wait for one another in busy loops.
        if "OMP_NUM_THREADS" not in os.environ:  # a user's own number stays
            os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        from warpsar.runtime import console

        console.show_messages()
        try:
            return super().invoke(ctx)
        except WarpsarError as error:
            _refuse(ctx, "" if error.quiet else str(error), error.exit_code)
        except BrokenPipeError:  # click's to handle
            raise
        except OSError as error:  # a folder that cannot be written, a full disk
            message = f"{error.filename}: {error.strerror}" if error.filename else str(error)
            _refuse(ctx, message, InputError.exit_code)
        except KeyboardInterrupt as interrupt:  # with words of its own where a run can be resumed
            _refuse(ctx, str(interrupt) or "interrupted", INTERRUPTED)


def _refuse(ctx: click.Context, message: str, exit_code: int) -> NoReturn:
    if message:
        click.echo(f"Error: {message}", err=True)
    ctx.exit(exit_code)


@click.group(name="warpsar", cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="warpsar", prog_name="warpsar", message="%(prog)s %(version)s")
def main() -> None:
    """Ray-trace calibrated SAR images of triangle meshes, and learn surface parameters from measured ones.

    \b
    Examples:
      warpsar new corner/ --example
      warpsar simulate corner/scene.toml -o corner/out
      warpsar new car/ ~/models/car.obj
      warpsar learn scene.toml -o learned/

    Exit status: 0 done; 1 the command ran, and its result is a failure; 2 bad input or usage; 3 the device is
    not there; 4 diagnose left a part of the residual unexplained. Results go to stdout and to files. Messages and
    progress go to stderr.
    """
