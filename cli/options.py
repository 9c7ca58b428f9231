"""Options that several commands share."""

from __future__ import annotations

import click

device = click.option(
    "--device",
    metavar="cpu|cuda|cuda:N",
    help="Default: the first CUDA device if there is one (under torchrun, the process's own), else the CPU.",
)
