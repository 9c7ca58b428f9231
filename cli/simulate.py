"""`warpsar simulate`: a scene file in, one calibrated image per view out."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(name="simulate")
@click.argument("scene", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option(
    "-o",
    "--out",
    required=True,
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder for images (EXR, beta0), quick looks (PNG, dB) and simulate.json; made if missing.",
)
@click.option(
    "--device",
    metavar="cpu|cuda|cuda:N",
    help="Default: the first CUDA device if there is one, else the CPU.",
)
@click.option("--seed", type=click.IntRange(min=0), help="Of the rays' jitter; the same seed gives the same image.")
@click.option("--layers", is_flag=True, help="Also incidence angle, layover count, shadow mask and material per pixel.")
@click.option("--variance", is_flag=True, help="Also the sampling variance of every pixel, from a second seed.")
@click.option(
    "--per-ray",
    is_flag=True,
    help="Keep every ray's hit; by default hits of one face in one pixel are merged.",
)
@click.option(
    "--max-memory",
    type=click.FloatRange(min=0, min_open=True),
    metavar="GIB",
    help="Bound on the memory for rays and hits; a smaller one only takes longer.",
)
def command(
    scene: Path,
    out: Path,
    device: str | None,
    seed: int | None,
    layers: bool,
    variance: bool,
    per_ray: bool,
    max_memory: float | None,
) -> None:
    """Simulate every view of SCENE, a scene.toml beside its mesh."""
    from warpsar.simulation import run

    run(
        scene,
        out,
        device=device,
        seed=seed,
        layers=layers,
        variance=variance,
        per_ray=per_ray,
        max_memory_gib=max_memory,
    )
