"""Options that several commands share."""

from __future__ import annotations

import click

device = click.option(
    "--device",
    metavar="cpu|cuda|cuda:N",
    help="Device to work on. Default: the first CUDA device if there is one (with torchrun, the process's own), "
    "else the CPU.",
)
