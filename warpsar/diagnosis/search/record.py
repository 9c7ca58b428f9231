"""How far a diagnosis has come, and its checkpoint: the declared model's fit, then turns and confirmations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from warpsar.diagnosis.found import Candidate, Confirmed, DarkScan, DiagnoseOptions, Turn
from warpsar.diagnosis.geometry.registry import content, scene_with
from warpsar.diagnosis.models.carried import Carried
from warpsar.diagnosis.models.fit_setup import FitSetup
from warpsar.diagnosis.models.left_out import ViewsLeftOut
from warpsar.diagnosis.models.refit import Fitted
from warpsar.diagnosis.run_log import RunLog, open_run_log
from warpsar.diagnosis.search.confirmation import Confirmation
from warpsar.effects.base.signature import Signature
from warpsar.learning.learn import tag_of
from warpsar.scene.scene import Scene
from warpsar.speckle.scan import Spot
from warpsar.version import __version__


class SearchRecord:
    """What is fitted and decided so far; `log` may be of an earlier part of the run."""

    def __init__(self, log: RunLog | None = None) -> None:
        self._log = log or RunLog()
        self._stored = self._log.entries

    def declared(self, setup: FitSetup, scene: Scene, fit: Callable[[], Fitted]) -> Fitted:
        """The declared model, fitted: as stored, or by `fit`."""
        self._scene = scene
        if self._stored:
            return Fitted.of(setup, scene, self._stored[0])
        fitted = fit()
        self._log.add(fitted.content())
        return fitted

    def turn(self, stage: int, setup: FitSetup, base: Fitted, run: Callable[[], Turn]) -> Turn:
        """The turn that is stage `stage`, counted from 0, about the model `base`: as stored, or by `run`."""
        if stage + 1 < len(self._stored):
            return _turn_of(self._scene, self._stored[stage + 1], setup, base)
        turn = run()
        self._log.add(_content(self._scene, turn))
        return turn

    def confirmation(self, stage: int, setup: FitSetup, base: Fitted, run: Callable[[], Confirmation]) -> Confirmation:
        """The confirmation that is stage `stage`, counted with the turns: as stored, or by `run`."""
        if stage + 1 < len(self._stored):
            stored = self._stored[stage + 1]
            asked = [Confirmed(**{**one, **_parts(one)}) for one in stored["asked"]]
            return Confirmation(_fitted(self._scene, stored["fitted"], setup, base), asked)
        confirmation = run()
        self._log.add(
            {
                "fitted": _fitted_content(self._scene, confirmation.fitted),
                "asked": [asdict(one) for one in confirmation.asked],
            }
        )
        return confirmation


def open_record(scene: Scene, options: DiagnoseOptions, folder: Path, resume: bool) -> SearchRecord:
    """The run as it stands; refusals as `open_run_log` has them."""
    chosen = {key: value for key, value in asdict(options).items() if key != "time_limit_s"}
    tag = tag_of(scene, {"command": "diagnose", "version": __version__, **chosen})
    return SearchRecord(open_run_log(folder, tag, resume))


def _content(scene: Scene, turn: Turn) -> dict[str, Any]:
    """A turn in JSON's types; its base is the model that the turn before ended with."""
    return {
        "candidates": [asdict(candidate) for candidate in turn.candidates],
        "added": turn.added,
        "spot": asdict(turn.spot),
        "scan_minus_log_p": turn.scan_minus_log_p,
        "p_scan": turn.p_scan,
        "threshold": turn.threshold,
        "fitted": None if turn.fitted is None else _fitted_content(scene, turn.fitted),
        "dropped": turn.dropped,
        "dark": None if turn.dark is None else asdict(turn.dark),
        "draws": turn.draws,
    }


def _turn_of(scene: Scene, stored: Mapping[str, Any], setup: FitSetup, base: Fitted) -> Turn:
    """The turn that `_content` gave."""
    candidates = [Candidate(**{**each, **_parts(each)}) for each in stored["candidates"]]
    fitted = None if stored["fitted"] is None else _fitted(scene, stored["fitted"], setup, base)
    about = {**stored, "candidates": candidates, "spot": Spot.from_content(stored["spot"]), "fitted": fitted}
    about["dark"] = None if stored["dark"] is None else DarkScan.of(stored["dark"])
    return Turn(**about, base=base)


def _parts(stored: Mapping[str, Any]) -> dict[str, Any]:
    """The answers within a candidate or a confirmed effect."""
    left, carried, own = stored["left_out"], stored["carried"], stored["signature"]
    return {
        "left_out": None if left is None else ViewsLeftOut(**left),
        "carried": None if carried is None else Carried(**carried),
        "signature": None if own is None else Signature(**own),
    }


def _fitted_content(scene: Scene, fitted: Fitted) -> dict[str, Any]:
    about = {"bound": fitted.problem.misfit.bound, "geometry": content(scene, fitted.scene)}
    return fitted.content() | about


def _fitted(scene: Scene, stored: Mapping[str, Any], setup: FitSetup, base: Fitted) -> Fitted:
    """The model that `_fitted_content` gave, on a setup of the same bound."""
    like = scene_with(scene, base.scene, stored["geometry"])
    return Fitted.of(replace(setup, bound=stored["bound"]), like, stored)
