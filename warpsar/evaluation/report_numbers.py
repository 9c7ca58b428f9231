"""Numbers in evaluate's report: the metrics of both roles, and a verdict in words."""

from __future__ import annotations

from warpsar.compare.evaluation import Evaluation
from warpsar.compare.judgement import ERROR_RATE, Judgement
from warpsar.compare.metrics import ImageMetrics, PooledMetrics
from warpsar.evaluation.report_parts import plus_minus
from warpsar.io import html as report
from warpsar.scene.scene import Scene

METRICS = (
    "deviance",
    "deviance, all pixels",
    "rmse [dB]",
    "nrmse",
    "rmse [beta0]",
    "correlation",
    "pixels",
    "left out",
)

_LEFT = {
    "speckle": "explains {its}: nothing but speckle is left.",
    "structure": "does not explain {its}: structure is left.",
    "edges": "does not explain {its}: edges do not agree.",
    "looks": "does not explain {its}: their looks are not the declared ones.",
    "texture": "does not explain {its}: they have texture.",
    "distribution": "does not explain {its}: their values scatter unlike speckle.",
    "level": "does not explain {its}: their level is another.",
    "cannot be told": "and {its}: too few pixels to tell whether they agree.",
}


def verdict_sentence(name: str, found: Evaluation) -> str:
    """In one sentence whether the scene called `name` explains its test images, or its train images without any."""
    role = "test" if "test" in found.verdicts else "train"
    return f"{name} {_LEFT[found.verdicts[role].finding].format(its=f'its {role} images')}"


def _pm(m: ImageMetrics | PooledMetrics) -> str:
    return plus_minus(m["deviance"], m["deviance_error"])


def metric_cells(m: ImageMetrics | PooledMetrics) -> list[str]:
    """One cell for each of `METRICS`."""
    return [
        _pm(m),
        plus_minus(m["deviance_all"], m["deviance_all_error"]),
        f"{m['rmse_db']:.2f}",
        f"{m['nrmse']:.3f}",
        f"{m['rmse']:.3g}",
        f"{m['correlation']:.3f}",
        f"{m['pixels']:,}",
        f"{m['left_out']:,}",
    ]


def summary_section(scene: Scene, found: Evaluation, before: Evaluation | None) -> str:
    """Verdict and metrics of both roles; with `before`, that model's metrics above its own."""
    named = [("", found)] if before is None else [(", before", before), (", after", found)]
    rows = [
        [role + when, str(m["images"]), *metric_cells(m)]
        for role in ("train", "test")
        for when, one in named
        for m in [getattr(one, role)]
        if m is not None
    ]
    blocks = [report.paragraph(_verdict(role, one)) for role, one in found.verdicts.items()]
    if any(one.wrong for one in found.verdicts.values()):
        blocks.append(report.paragraph("The next step is warpsar diagnose, which names what the model lacks."))
    blocks.append(report.table(["views", "images", *METRICS], rows))
    explained = (
        "Deviance is the mean of 2 L (I/mu - 1 - ln(I/mu)) over what speckle alone would leave: 1 is a perfect model. "
        "It is taken over the lit interior: pixels whose 3 x 3 neighbours the model lights, off the image's edge. "
        "The second one takes every valid pixel, shadows too, with a level added to the model that is fitted to each "
        "image. ± is one standard error from the spread of the pixels, with the correlation of neighbours. A few "
        "bright pixels make it large, so the verdict does not use it: there, the error is that of speckle and of the "
        f"looks. The tests are set so that a model that is right gets another verdict than speckle in "
        f"{100.0 * ERROR_RATE:g} % of all cases; correlated speckle of one look gets it more often."
    )
    if not scene.grid.calibrated:
        explained += (
            " The images are not calibrated: one gain per image is fitted, so absolute brightness is not tested."
        )
    noise = max(i.sampling_noise for i in found.images)
    explained += f" Rays add at most {noise:.1g} to a deviance, as two independent renders show."
    zeros = sum(m["zeros"] for _, m in _roles(found))
    if zeros:
        explained += f" {zeros} lit pixels measure exactly 0, which no speckle makes; they are left out."
    return report.section("In short", *blocks, report.paragraph(explained, quiet=True))


def _roles(found: Evaluation) -> list[tuple[str, PooledMetrics]]:
    return [(role, m) for role, m in (("train", found.train), ("test", found.test)) if m is not None]


def _verdict(role: str, one: Judgement) -> str:
    name = {"train": "On the train views", "test": "On the test views, which no fit has touched"}[role]
    return f"{name}, {one.words}."
