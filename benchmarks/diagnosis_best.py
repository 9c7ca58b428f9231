"""How often `warpsar diagnose` could be right at best: what speckle lets anyone know of each effect of the library.

    python benchmarks/diagnosis_best.py run -o out/best
    python benchmarks/diagnosis_best.py table -o out/best [--rates out/rates] [--write]

The cases are those of diagnosis_rates.py. An oracle knows which effect is missing, and with which parameters. It fits
by one step from the truth (limits.py). docs/diagnosis-rates.md has the table.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np

from warpsar.runtime import devices

sys.path.insert(0, str(Path(__file__).resolve().parent))

import limits
import runs
import tables
from diagnosis_rates import LOOKS, SINGLE, judged, speckle, truth
from limits import HeldViews, Model, NoiseFree
from towns import CORRELATION_PX

from warpsar.compare.observation import Observation
from warpsar.diagnosis.dark.evidence import Dark
from warpsar.diagnosis.scores.bootstrap import Bootstrap, bootstrap
from warpsar.diagnosis.scores.evidence import LARGEST, Evidence
from warpsar.diagnosis.scores.score import TangentProjection, TemplateGroup, minus_log_p
from warpsar.effects.registry import get, names
from warpsar.speckle.scan import Scan
from warpsar.speckle.tail import Tail, Tails

KINDS = ("white", "correlated")
FAMILY_ERROR = 0.01
LEFT_OUT_RULES = ("left_out", "left_out_positive", "left_out_as_expected")


def autocovariance(kind: str) -> np.ndarray:
    return limits.white() if kind == "white" else limits.correlated(CORRELATION_PX)


@dataclass(frozen=True)
class Decision:
    """What decides in a turn at some number of looks and kind of speckle: the calibrated scores of speckle alone."""

    boot: Bootstrap
    threshold: float

    @classmethod
    def of(cls, nothing: NoiseFree, looks: int, kind: str, draws: int) -> Decision:
        """Of a scene where `nothing` is missing, as the program draws it."""
        evidence = nothing.evidence(nothing.truth, autocovariance(kind), looks)
        maker, projection = nothing.templates(nothing.truth, evidence)
        groups = {name: nothing.groups(name, maker, projection, evidence) for name in names()}
        testable = {name: found for name, found in groups.items() if found}
        scan = Scan(evidence.observations, evidence.autocovariance, evidence.silent)
        boot = bootstrap(evidence, projection, testable, scan, draws, 0)
        return cls(boot, boot.threshold(FAMILY_ERROR))


def drawn(noise_free: NoiseFree, looks: int, kind: str, draws: int, seed: int) -> np.ndarray:
    """beta0 of the compared pixels with speckle, shape (n, draws)."""
    random = np.random.default_rng([seed, looks, int(kind == "correlated")])
    parts = [speckled(random, one, looks, kind, draws) for one in noise_free.seen]
    return noise_free.truth.mu[:, None] * np.concatenate(parts, axis=1).T


def speckled(random: np.random.Generator, seen: Observation, looks: int, kind: str, draws: int) -> np.ndarray:
    """Speckle of an image's compared pixels, shape (draws, pixels)."""
    shape = seen.interior.shape
    return np.stack([speckle(random, shape, looks, kind == "correlated")[seen.interior] for _ in range(draws)])


def independent_looks(noise_free: NoiseFree, looks: float, kind: str) -> float:
    """Looks x pixels over the correlation area."""
    return looks * noise_free.truth.mu.size / float(autocovariance(kind).sum())


def at_best(
    noise_free: NoiseFree,
    name: str,
    base: Model,
    rivals: Mapping[str, Model],
    looks: int,
    kind: str,
    decision: Decision,
    draws: int,
    seed: int = 0,
) -> dict[str, Any]:
    """Shares of `draws` in which the effect passes each rule."""
    model = noise_free.truth
    dark = in_the_dark(noise_free, name)
    if dark:  # no other effect puts power there
        rivals = {other: rival for other, rival in rivals.items() if get(other).additive}
    beta0 = drawn(noise_free, looks, kind, draws, seed)
    evidence = noise_free.evidence(base, autocovariance(kind), looks)
    size = model.size - base.size
    price = float(np.log(independent_looks(noise_free, looks, kind)))
    gain = limits.gains(noise_free, beta0, looks, model, base)
    inflation = limits.inflation(noise_free, model, base, evidence)
    turn = Turn.of(noise_free, name, base, evidence, decision)
    random = np.random.default_rng([seed, looks, int(kind == "correlated"), 1])

    def on_test_views(one: Observation) -> np.ndarray:
        return speckled(random, one, looks, kind, draws)

    left = limits.left_out(noise_free, beta0, looks, model, base, model.parts[name])
    worth = gain - size * price
    ahead = {
        other: worth - limits.gains(noise_free, beta0, looks, rival, base) + (rival.size - base.size) * price
        for other, rival in rivals.items()
    }
    passes = {
        "score": turn.scores(beta0) > decision.threshold,
        "threshold": turn.rarity(gain / inflation) > decision.threshold,
        "price": worth > 0,
        "rivals": np.all([np.ones(draws), *(a > 0 for a in ahead.values())], axis=0),
        "left_out": np.array([one.gain > 2.0 * one.error for one in left]),
        "left_out_positive": np.array([one.gain > 0.0 for one in left]),
        "left_out_as_expected": np.array([one.as_expected for one in left]),
        "test_views": HeldViews(noise_free).stands(beta0, looks, model, base, on_test_views),
    }
    best: np.ndarray = (passes["threshold"] & passes["price"] | dark) & passes["test_views"]
    expected = looks * limits.expected_gain(model, base)
    return {
        "case": name,
        "looks": looks,
        "speckle": kind,
        "expected_gain": expected,
        "size": size,
        "price": size * price,
        "threshold_p": decision.threshold,
        "gain": [float(gain.mean()), float(gain.std())],
        "left_out": np.mean([[o.gain, o.error, o.expected] for o in left], axis=0).tolist(),
        "inflation": inflation,
        "draws": draws,
        "share": {rule: float(np.mean(found)) for rule, found in passes.items()},
        "best": float(np.mean(best)),
        "best_named": float(np.mean(best & passes["rivals"])),
        "best_and": {rule: float(np.mean(best & passes[rule])) for rule in LEFT_OUT_RULES},
        "rivals": {
            other: {
                "behind": looks * limits.expected_gain(model, rivals[other]),
                "size": rivals[other].size - base.size,
                "ahead": float(np.mean(a > 0)),
            }
            for other, a in ahead.items()
        },
    }


def in_the_dark(noise_free: NoiseFree, name: str) -> bool:
    """Whether power in pixels far from everything lit gives the effect away, whatever the looks."""
    pixels = sum(int(one.dark.sum()) for one in noise_free.seen)
    positive = sum(int((one.dark & (one.measured > 0)).sum()) for one in noise_free.seen)
    return get(name).additive and Dark(pixels, positive).asks


@dataclass(frozen=True)
class Turn:
    """The program's own score test of one effect about a model."""

    base: Model
    evidence: Evidence
    projection: TangentProjection
    groups: list[TemplateGroup]
    tail: Tail | Tails

    @classmethod
    def of(cls, noise_free: NoiseFree, name: str, base: Model, evidence: Evidence, decision: Decision) -> Turn:
        maker, projection = noise_free.templates(base, evidence)
        groups = noise_free.groups(name, maker, projection, evidence)
        return cls(base, evidence, projection, groups, decision.boot.tails[name])

    def scores(self, beta0: np.ndarray) -> np.ndarray:
        """Calibrated -ln p of the largest score in every draw, shape (draws,)."""
        residual = self.evidence.root_looks[:, None] * (beta0 / self.base.mu[:, None] - 1.0)
        left = self.projection(np.clip(residual, -LARGEST, LARGEST))
        return self.tail(np.max([one.statistics(left)[1].max(axis=0) for one in self.groups], axis=0))

    def rarity(self, gain: np.ndarray) -> np.ndarray:
        """The same of a statistic that is as large as `gain`: the trials that the effect has count as before."""
        bounds = self.groups[0].one_sided
        return self.tail(minus_log_p(gain, bounds.count(False), bounds.count(True)))


@click.group()
def main() -> None:
    """What `warpsar diagnose` could find at best."""


@main.command()
@runs.out
@click.option("--case", "cases", multiple=True, type=click.Choice(list(SINGLE)))
@click.option("--looks", multiple=True, type=click.Choice([str(n) for n in LOOKS]))
@click.option("--speckle", "kinds", multiple=True, type=click.Choice(KINDS))
@click.option("--repeats", default=100, show_default=True, help="Draws of speckle.")
@click.option("--draws", default=1000, show_default=True, help="Of the bootstrap.")
@runs.device
def run(
    out: Path,
    cases: tuple[str, ...],
    looks: tuple[str, ...],
    kinds: tuple[str, ...],
    repeats: int,
    draws: int,
    device: str | None,
) -> None:
    """Write best.json: what is possible at best, for every effect, number of looks and kind of speckle.

    Cases that the file holds and that are not asked for stay as they are.
    """
    out.mkdir(parents=True, exist_ok=True)
    where = devices.resolve_device(device)
    settings = list(product([int(n) for n in looks] or LOOKS, kinds or KINDS))
    cases, path, when = cases or tuple(SINGLE), out / "best.json", tables.made()
    rows = [row for row in tables.stored(path)["rows"] if row["case"] not in cases] if path.is_file() else []
    with tempfile.TemporaryDirectory() as folder:
        nothing = NoiseFree(truth(), {}, where, Path(folder))
        decisions = {key: Decision.of(nothing, *key, draws) for key in settings}
    for key, decision in decisions.items():
        click.echo(f"{key[0]} looks, {key[1]}: threshold {decision.threshold:.2f}", err=True)
    for name in cases:
        started = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            noise_free = NoiseFree(truth(), {name: SINGLE[name]}, where, Path(folder))
            base = noise_free.fitted({})
            rivals = noise_free.rivals(base, name)
            rows += [at_best(noise_free, name, base, rivals, *key, decisions[key], repeats) for key in settings]
        for row in rows[-len(settings) :]:
            click.echo(said(row), err=True)
        click.echo(f"  {time.perf_counter() - started:.0f} s", err=True)
        tables.save(path, {"made": when, "rows": rows})


def said(row: Mapping[str, Any]) -> str:
    """A line for the console."""
    shares = ", ".join(f"{rule} {share:.2f}" for rule, share in row["share"].items())
    rivals = ", ".join(f"{n} {r['behind']:.1f}/{r['size']}" for n, r in row["rivals"].items())
    gain, error, _ = row["left_out"]
    return (
        f"{row['case']}, {row['looks']}, {row['speckle']}: expected {row['expected_gain']:.1f} "
        f"(price {row['price']:.1f}, left out {gain:.1f} +- {error:.1f}); {shares}; best {row['best']:.2f}, "
        f"named {row['best_named']:.2f}; rivals behind by: {rivals or 'none'}"
    )


def division(rows: Sequence[Mapping[str, Any]], found: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: a line per case and number of looks, with what was found beside what is possible. Shares are of white
    and correlated speckle together, as the runs are."""
    lines = []
    for name, looks in dict.fromkeys((row["case"], row["looks"]) for row in rows):
        mine = [row for row in rows if (row["case"], row["looks"]) == (name, looks)]
        right = [judged(row) == "right" for row in found if (row["case"], row["looks"]) == (name, looks)]
        best, named = (float(np.mean([row[key] for row in mine])) for key in ("best", "best_named"))
        nearest = min(mine[0]["rivals"].items(), key=lambda item: item[1]["behind"], default=None)
        missed = max(named - float(np.mean(right)), 0.0) if right else None
        lines.append(
            [
                name,
                looks,
                f"{mine[0]['expected_gain']:.0f}",
                " / ".join(f"{row['price']:.0f}" for row in mine),
                f"{nearest[0]} {nearest[1]['behind']:.1f}" if nearest else "",
                " / ".join(_percent(row["best"]) for row in mine),
                " / ".join(_percent(row["best_named"]) for row in mine),
                f"{sum(right)} of {len(right)}" if right else "",
                _percent(1.0 - best),
                _percent(best - named),
                "" if missed is None else _percent(missed),
            ]
        )
    header = [
        "missing",
        "looks",
        "2 ln L",
        "price",
        "nearest rival, behind by",
        "detectable",
        "and told apart",
        "found",
    ]
    return tables.markdown([*header, "undetectable", "not told apart", "missed by us"], lines)


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


@main.command()
@runs.out
@click.option("--rates", type=click.Path(file_okay=False, path_type=Path), help="Folder of diagnosis_rates.py.")
@runs.write
def table(out: Path, rates: Path | None, write: bool) -> None:
    """Markdown of best.json beside what was found."""
    result = tables.stored(out / "best.json")
    found = runs.stored(rates) if rates else []
    tables.publish({"diagnosis_best": division(result["rows"], found)}, result, write)


if __name__ == "__main__":
    main()
