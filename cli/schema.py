"""`warpsar schema`: the JSON schema of a scene file, for editors."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(name="schema", short_help="Write the JSON schema of scene.toml, for editors.")
@click.option(
    "-o", "--out", type=click.Path(dir_okay=False, path_type=Path), help="File to write. Default: print on stdout."
)
def command(out: Path | None) -> None:
    """Write the JSON schema of scene.toml.

    An editor with TOML support then completes keys, explains them and marks mistakes. The first line of a scene.toml
    names the file: `#:schema scene.schema.json`.

    \b
    Example:
      warpsar schema -o scene.schema.json
    """
    from warpsar.scene.schema import run

    text = run(out)
    if out is None:
        click.echo(text, nl=False)
    else:
        from warpsar.runtime import console

        console.say(f"written: {out}")
