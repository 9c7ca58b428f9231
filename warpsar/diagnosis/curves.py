"""Which terms of the engine measured curves of radar cross-section show, and the scene does not declare."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from warpsar.coherent.left_out import left_out
from warpsar.compare.curve import CurveComparison, CurveJudgement, content_of, curve_verdicts, curves_beside
from warpsar.curves.materials import MaterialTest
from warpsar.curves.observe import observe
from warpsar.curves.search import CANDIDATES, TermSearch, by_sector
from warpsar.curves.sectors import apertures
from warpsar.diagnosis.curve_materials import ask, with_material
from warpsar.errors import InputError
from warpsar.scene.scene import Scene


@dataclass(frozen=True)
class DiagnosedCurves:
    """A scene with the terms that its curves ask for; its curves before and after."""

    scene: Scene
    materials: list[MaterialTest]
    """What each part of the body was asked, likeliest first."""
    found: dict[str, TermSearch]
    """By sector."""
    before: list[CurveComparison]
    after: list[CurveComparison]

    @property
    def verdict(self) -> list[str]:
        """The part whose material is another one, if any, and effects whose terms were added."""
        named = [f"materials.{one.part}: {one.kind}" for one in self.materials if one.outcome == "named"]
        return named + list(dict.fromkeys(effect for one in self.found.values() for effect in one.verdict))

    @cached_property
    def verdicts(self) -> dict[str, CurveJudgement]:
        """What the model with the added terms leaves of the curves of each role."""
        return curve_verdicts(self.after)

    @property
    def unexplained(self) -> bool:
        """Whether something is left of the train curves that no term of the engine explains.

        Test curves do not decide: those of another frequency may have another noise. `in_short` says what they leave.
        """
        return self.verdicts["train"].wrong

    @property
    def in_short(self) -> str:
        """One line: what is left unexplained first, then the names, and what the test curves leave."""
        tied = [f"one of {'; '.join(self.tied)}, not told apart"] if self.tied else []
        names, wrong = ", ".join([*self.verdict, *tied]), [role for role, one in self.verdicts.items() if one.wrong]
        left = [f"{role} curves: {self.verdicts[role].words}" for role in wrong]
        if self.unexplained:
            return "; ".join([f"unexplained: {left[0]}", *([f"found: {names}"] if names else []), *left[1:]])
        return "; ".join([names or ("no term is missing" if wrong else "nothing missing"), *left])

    @property
    def level_only(self) -> list[str]:
        """Effects that tell the mean power and not the pattern."""
        names = dict.fromkeys(effect for one in self.found.values() for effect in one.level_only)
        return [one for one in names if one not in self.verdict]

    def content(self) -> dict[str, Any]:
        """For diagnosis.json."""
        return {
            "not_applied_to_curves": list(left_out(self.scene, "rcs")),
            "verdict": self.verdict,
            "unexplained": self.unexplained,
            "curves_verdict": {role: one.content() for role, one in self.verdicts.items()},
            "level_only": self.level_only,
            "materials": [asdict(one) for one in self.materials],
            "tied_materials": self.tied,
            "sectors": {name: [asdict(each) for each in one.asked] for name, one in self.found.items()},
            "before": content_of(self.before),
            "after": content_of(self.after),
        }

    @property
    def tied(self) -> list[str]:
        """Materials of parts, one of which is another than declared, and which the curves do not tell apart."""
        return [f"materials.{one.part}: {one.kind}" for one in self.materials if one.outcome == "tied"]

    @property
    def words(self) -> list[str]:
        """A sentence for each question."""
        return [one.words for one in self.materials] + [
            f"{one.effect}, {sector}: {one.outcome}" + (f", {one.why}" if one.why else "")
            for sector, found in self.found.items()
            for one in found.asked
        ] or ["Every term that there is was declared."]


def diagnose_curves(scene: Scene, cache: Path, device: str | None = None) -> DiagnosedCurves:
    """Which terms of the engine the curves show and `[radar] terms` does not declare.

    Raises InputError without train curves.
    """
    if not any(curve.role == "train" for curve in scene.curves):
        raise InputError(f"{scene.name}: curves: found no train curve; must have one to name anything")
    other = next((i for i, curve in enumerate(scene.curves) if curve.mesh is not None), None)
    if other is not None:
        raise InputError(
            f"{scene.name}: curves[{other}].mesh: found {scene.curves[other].mesh}; must be left out: sectors and "
            "parts are those of one body (warpsar evaluate takes several)"
        )
    asked = ask(scene, cache, device)
    named = next((one for one in asked if one.outcome == "named"), None)
    before = curves_beside(observe(scene, cache=cache, device=device), scene.radar.terms)
    if named is not None:
        scene = with_material(scene, named)
    declared = scene.radar.terms
    every = tuple(dict.fromkeys((*declared, *CANDIDATES.values())))
    whole = replace(scene, radar=scene.radar.model_copy(update={"terms": every}))
    curves = observe(whole, cache=cache, device=device)
    found = by_sector(curves, apertures(scene.mesh), declared)
    terms = tuple(dict.fromkeys(term for one in found.values() for term in one.terms))
    after = replace(scene, radar=scene.radar.model_copy(update={"terms": terms}))
    return DiagnosedCurves(after, asked, found, before, curves_beside(curves, terms))
