"""Numbers in evaluate's report: the metrics of both roles, and a verdict in words."""

from __future__ import annotations

from warpsar.evaluation.image import Evaluation, ImageMetrics, PooledMetrics
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


def summary_section(scene: Scene, found: Evaluation) -> str:
    rows = [[role, str(m["images"]), *metric_cells(m)] for role, m in _roles(found)]
    blocks = [report.table(["views", "images", *METRICS], rows)]
    blocks += [report.paragraph(_verdict(role, m)) for role, m in _roles(found)]
    explained = (
        "Deviance is the mean of 2 L (I/mu - 1 - ln(I/mu)) over what speckle alone would leave: 1 is a perfect model. "
        "It is taken over the lit interior: pixels whose 3 x 3 neighbours the model lights, off the image's edge. "
        "The second one takes every valid pixel, shadows too, with a level added to the model that is fitted to each "
        "image. ± is one standard error, with the correlation of neighbouring pixels."
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


def _verdict(role: str, m: PooledMetrics) -> str:
    name = {"train": "On the train views", "test": "On the test views, which no fit has touched"}[role]
    away = (m["deviance"] - 1.0) / m["deviance_error"]
    if abs(away) <= 3.0:
        return f"{name}, the model leaves no more than speckle: deviance {_pm(m)}."
    if away < 0:
        return f"{name}, less is left than speckle of these looks leaves: deviance {_pm(m)}; check `looks`."
    return f"{name}, something is left beside speckle: deviance {_pm(m)}, {away:.0f} standard errors above the floor."
