"""`warpsar learn`: from measured images to a scene with learned surface parameters."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from warpsar.cli import options


@click.command(name="learn", short_help="Find surface parameters from measured images.")
@options.scene
@options.out(
    "Folder for scene.toml with the learned values, report.html, learn.json, history.csv and figures; made if missing."
)
@options.device
@click.option("--loss", default="gamma", show_default=True, help="Loss: gamma, mse or log.")
@click.option("--optimiser", default="auto", show_default=True, help="Optimiser: auto, lm or adam.")
@click.option("--starts", type=click.IntRange(min=1), default=3, show_default=True, help="Starting points for lm.")
@click.option(
    "--iterations",
    type=click.IntRange(min=1),
    default=500,
    show_default=True,
    help="Iterations at most, over all starts.",
)
@click.option(
    "--max-time", type=click.FloatRange(min=0, min_open=True), metavar="SECONDS", help="Stop after this time."
)
@click.option(
    "--rate",
    type=click.FloatRange(min=0, min_open=True),
    default=0.05,
    show_default=True,
    help="Adam's first learning rate.",
)
@click.option(
    "--tv",
    multiple=True,
    metavar="KEY=WEIGHT",
    help="Weight of the total variation of a field, such as eps_r=5. Can be repeated.",
)
@click.option(
    "--validity",
    type=click.FloatRange(min=0),
    default=0.0,
    show_default=True,
    help="Weight of a penalty outside the model's domain of validity.",
)
@click.option(
    "--checkpoint-every",
    type=click.IntRange(min=1),
    default=10,
    show_default=True,
    help="Iterations between checkpoints.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the further starts.")
@click.option(
    "--max-memory",
    type=click.FloatRange(min=0, min_open=True),
    metavar="GIB",
    help="Memory for hits. Views that do not fit are traced again in every iteration. Default: 60 % of the memory.",
)
@options.resume
def command(
    scene: Path,
    out: Path,
    device: str | None,
    loss: str,
    optimiser: str,
    starts: int,
    iterations: int,
    max_time: float | None,
    rate: float,
    tv: tuple[str, ...],
    validity: float,
    checkpoint_every: int,
    seed: int,
    max_memory: float | None,
    resume: bool,
) -> None:
    """Learn the surface parameters of SCENE from its measured views with the role train.

    \b
    Examples:
      warpsar learn scene.toml -o learned/
      warpsar learn scene.toml -o learned/ --resume
      warpsar learn scene.toml -o learned/ --tv eps_r=5 --max-time 600
    """
    from warpsar.evaluation.learned import write_learn_report
    from warpsar.learning import command as learning
    from warpsar.runtime import once

    weights = {}
    for item in tv:
        key, _, weight = item.partition("=")
        try:
            weights[key] = float(weight)
        except ValueError:
            raise click.BadParameter(f"found {item!r}; allowed is KEY=WEIGHT", param_hint="--tv") from None
    chosen = learning.LearnOptions(
        loss=loss,
        optimiser=optimiser,
        starts=starts,
        iterations=iterations,
        max_time_s=float("inf") if max_time is None else max_time,
        rate=rate,
        total_variation=weights,
        validity=validity,
        checkpoint_every=checkpoint_every,
        seed=seed,
        max_memory_gib=max_memory,
    )
    with options.resumable(out):
        found, content = learning.fitted(scene, out, device=device, options=chosen, resume=resume)
    once.write(partial(write_learn_report, scene, out, found, content))
    once.write(partial(learning.print_in_short, found))
