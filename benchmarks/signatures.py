"""How often an effect's own test refuses a right name: draws of speckle about the true model of a small scene.

    python benchmarks/signatures.py --draws 8

Each line of JSON is one draw. The last line counts the outcomes. docs/diagnosis-method.md has the result.
"""

import json
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent))

import diagnosis_rates as rates

from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.frozen import frozen
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.scores.templates import with_effect
from warpsar.diagnosis.turn.signature import signature
from warpsar.effects.base.signature import Signature
from warpsar.runtime import devices
from warpsar.scene.scene import Scene
from warpsar.simulation.rays import Rays
from warpsar.surface.stage import Stage
from warpsar.world.tables import Sampling

RAYS_PER_PIXEL = 256.0


def one_draw(name: str, looks: int, seed: int, device: str, out: Path) -> Signature:
    """The effect's signature where the model is true; odd seeds have correlated speckle."""
    images = rates.clean_images(rates.CASES[name], device, out, name)
    where = devices.resolve_device(device)
    with tempfile.TemporaryDirectory() as folder:
        scene = rates.measured(images, looks, bool(seed % 2), seed, Path(folder))
        truth = replace(scene, materials=rates.truth().materials)
        stage = Stage.of(truth, where)
        density = Sampling(rays_per_pixel=RAYS_PER_PIXEL).density_per_m2(truth.grid)
        one, other = (FitSetup(where, Rays(stage, density, k), {}) for k in (0, 1))
        setup = replace(one, observations=frozen(one, other, truth))

        def as_it_is(model: Scene) -> Fitted:
            return Fitted(model, setup.problem(model), np.zeros(0), 0.0, 0.0, 0)

        return signature(setup, as_it_is(truth), as_it_is(with_effect(truth, name, rates.SINGLE[name])), name)


@click.command()
@click.option("--draws", type=click.IntRange(min=1), default=8, show_default=True, help="Of each effect and looks.")
@click.option("--first", type=int, default=0, show_default=True, help="The first seed.")
@click.option("-o", "--out", default="out/rates", show_default=True, type=click.Path(file_okay=False, path_type=Path))
@click.option("--device", default="cpu", show_default=True)
def main(draws: int, first: int, out: Path, device: str) -> None:
    """Outcomes of every effect's own test on right names."""
    out.mkdir(parents=True, exist_ok=True)
    counts: Counter[str] = Counter()
    for name in rates.SINGLE:
        for looks in rates.LOOKS:
            for seed in range(first, first + draws):
                found = one_draw(name, looks, seed, device, out)
                counts[found.outcome] += 1
                click.echo(json.dumps([name, looks, seed, found.outcome, found.text]))
    click.echo(json.dumps(counts))


if __name__ == "__main__":
    main()
