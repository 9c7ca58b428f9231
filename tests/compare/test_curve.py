"""A measured curve beside its model: its residual, and what is said of what is left."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest
from synthetic import AZIMUTH, curve, field

from warpsar.compare.curve import CurveComparison, curves_beside, judge_curves
from warpsar.curves.noise import Noise
from warpsar.curves.observed import ObservedCurve
from warpsar.errors import InputError

REPEATS = 60


def measured(rng: np.random.Generator, shown: list[str], **how: object) -> ObservedCurve:
    """A curve of two terms of the same mean power, of which some are shown."""
    terms = {name: field(rng, 5e9) for name in ("single", "edges")}
    return curve(rng, terms, shown, **how)  # type: ignore[arg-type]


def test_the_residual_of_a_true_model_is_standard_normal() -> None:
    """Rows drawn independently from Rice's density itself: |a + n|^2 with n of the mean power that is declared."""
    rng, rows = np.random.default_rng(2), 4000
    amplitude = rng.normal(size=rows) + 1j * rng.normal(size=rows)
    background, share = 0.05, 0.02
    power = background + share * np.abs(amplitude) ** 2
    drawn = np.sqrt(power / 2.0) * (rng.normal(size=rows) + 1j * rng.normal(size=rows))
    azimuth = np.arange(rows, dtype=float)
    seen = ObservedCurve(
        "one", 5e9, "VV", "train", azimuth, azimuth, np.abs(amplitude + drawn) ** 2, {"all": amplitude}, 1.0
    )
    found = CurveComparison(seen, ("all",), Noise(background, share))
    assert kstest(found.residual, "norm").pvalue > 0.01
    # the mean of n squares of standard normal numbers: 1 +- sqrt(2 / n), four standard errors
    assert found.scaled_deviance.mean() == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / rows))
    doubled = CurveComparison(replace(seen, measured_m2=2.0 * seen.measured_m2), ("all",), Noise(background, share))
    assert doubled.scaled_deviance.mean() > 2.0


@pytest.mark.full
def test_a_right_model_is_seldom_called_wrong() -> None:
    """Noise fitted to the train curves, judged on them and on others of the same body."""
    wrong = {"train": 0, "test": 0}
    for seed in range(REPEATS):
        rng = np.random.default_rng(seed)
        seen = [measured(rng, ["single", "edges"], role=role) for role in ("train", "train", "test", "test")]
        compared = curves_beside(seen, ("single", "edges"))
        for role in wrong:
            wrong[role] += judge_curves([one for one in compared if one.role == role]).wrong
    # of 60, at a rate of 0.5 % for each: three or more by chance in 0.3 %. Test curves have a noise that others told.
    assert wrong["train"] <= 2
    assert wrong["test"] <= 3


@pytest.mark.full
def test_a_model_that_lacks_half_the_power_is_wrong() -> None:
    found = 0
    for seed in range(REPEATS):
        rng = np.random.default_rng(seed)
        seen = [measured(rng, ["single", "edges"], role=role) for role in ("train", "train", "test", "test")]
        said = judge_curves([one for one in curves_beside(seen, ("single",)) if one.role == "test"])
        found += said.wrong
        assert "noise" in said.findings or not said.wrong
    assert found >= 0.9 * REPEATS  # half of the power is left to the noise, where a fifth is granted


def test_entries_say_what_the_suite_measures() -> None:
    """Mean |dB| against the closed form of a model that is 3 dB too strong everywhere."""
    rng = np.random.default_rng(1)
    one = measured(rng, ["single"], background_m2=1e-9, share=1e-9)
    strong = one.beside({"single": np.sqrt(2.0) * one.terms["single"]})
    (found,) = curves_beside([strong], ("single",))
    entry = found.content()
    assert entry["error_db"]["model"] == pytest.approx(10.0 * np.log10(2.0), abs=0.01)
    assert entry["level_db"] == pytest.approx(10.0 * np.log10(2.0), abs=0.01)
    assert entry["correlation"] == pytest.approx(1.0, abs=1e-3)
    assert entry["directions"] == len(one.measured_m2) < len(AZIMUTH) + 1


def test_nothing_to_judge_is_said() -> None:
    with pytest.raises(InputError, match="found none to judge"):
        judge_curves([])
    assert curves_beside([], ("single",)) == []


def test_evaluate_takes_a_scene_of_curves_alone(tmp_path: Path) -> None:
    from test_commands import with_curves

    import warpsar

    path = with_curves(tmp_path / "scene", "conductor = true", "conductor = true", ("single",))
    found = warpsar.evaluate(path, device="cpu")
    assert found.images == []
    assert [one.role for one in found.curves] == ["train", "train", "test", "test"]
    assert set(found.curve_verdicts) == {"train", "test"}
    # noise is 50 dB under the peak of each curve, so that of the test curves, at another frequency, is another
    assert not found.curve_verdicts["train"].wrong
    for one in found.curves:
        error = one.content()["error_db"]
        assert error["model"] < 0.5 * min(error["null"], error["smooth"])
