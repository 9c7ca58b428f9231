"""What the reader of diagnose's report should do next: one or two sentences that follow from the verdict."""

from __future__ import annotations

import shlex
from collections.abc import Set
from dataclasses import dataclass
from pathlib import Path

from warpsar.compare.judgement import SHARE, Finding
from warpsar.diagnosis.result import Diagnosed


@dataclass(frozen=True)
class Step:
    """A sentence, and the line to type in a shell that goes with it, where there is one."""

    words: str
    command: str = ""


def next_steps(done: Diagnosed, out: Path) -> list[Step]:
    """At most two, the most pressing first; `out` is the folder of the written scene."""
    steps = []
    if done.diagnosis.not_asked:
        steps.append(Step("Run the same command with --resume and more time: it goes on where the time was over."))
    if done.unexplained:
        steps.append(Step(_where_to_look(done)))
    steps += [Step(f"{by.sentence[0].upper()}{by.sentence[1:]}.") for _, by in done.alternatives]
    if not done.unexplained:
        steps += _with_the_scene(done, out)
    return steps[:2]


def _with_the_scene(done: Diagnosed, out: Path) -> list[Step]:
    """What to do with a scene that explains its images."""
    command = shlex.join(["warpsar", "evaluate", str(out / "scene.toml"), "-o", str(out / "evaluate")])
    steps = [Step("Look at every image beside the scene that was written here:", command)]
    if "test" not in done.verdicts:
        steps.append(
            Step('Give a view role = "test" and run this again: only a view that no fit has used tests the answer.')
        )
    elif done.speckle.names:
        names = " and ".join(done.speckle.names)
        steps.append(Step(f"Declare {names} as the written scene does, if whoever made the images agrees."))
    elif done.changed:
        steps.append(Step("Check these names by other means, and then write them into the scene file that you keep."))
    return steps


def refuted(done: Diagnosed) -> bool:
    """Whether no place departs from the model, and test views speak against what was found."""
    return done.unexplained and not done.findings and not done.diagnosis.turns[-1].alarms


def _where_to_look(done: Diagnosed) -> str:
    """Where to look for what nothing found explains."""
    left, findings = done.left, done.findings
    if findings and not findings & {"structure", "edges"}:
        return _of_even_ground(findings)
    if refuted(done):
        return "Compare the residuals of the test views below: the model holds on the train views and not on them."
    if findings == {"edges"}:
        worst = next(one.edges.off(SHARE)[0] for one in done.verdicts.values() if "edges" in one.findings)
        return f"Look at the outlines in {worst.image}: at the mesh's heights, and at the angles of that view."
    about = f"row {left.shape.row}, column {left.shape.col} of {left.image}"
    if left.moves.way == "image" or not done.place.parts:
        return f"Look at the radar and its processing about {about}: no place on the mesh accounts for it."
    part = done.place.parts[0]
    east, north, up = part.centre_m
    place = f"about east {east:.1f} m, north {north:.1f} m, up {up:.1f} m ({part.material})"
    return {
        "surface": f"The mesh lacks something {place}: look at its shape and material there.",
        "both": f"Look at the mesh {place}, and measure from another azimuth: the views look too much alike to tell "
        "mesh from radar.",
        "one view": f"Look at the mesh {place}, and measure from another azimuth: one view does not tell mesh from "
        "radar.",
        "neither": f"Look at {about} first, which is {place}: no other view shows it clearly.",
    }[left.moves.way]


def _of_even_ground(findings: Set[Finding]) -> str:
    """No place stands out: the scatter of even ground is of another kind, or its level."""
    if findings & {"looks", "texture", "distribution"}:
        return (
            "Ask how the images were averaged, filtered or compressed: the scatter of even ground departs, not a place."
        )
    return "Look at the images' calibration and at the materials: the level is off everywhere, not at one place."
