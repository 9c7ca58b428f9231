"""What the phase of complex images says, in diagnose's report; nothing where no view has samples with phase."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from warpsar.diagnosis.phase.declared import PhaseAsked
from warpsar.io import html as report
from warpsar.io.figures import new

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PLACES = 201


def phase_section(found: Sequence[PhaseAsked]) -> list[str]:
    """A sentence for each view, and the phases that were named, over the aperture."""
    if not found:
        return []
    said = [report.bullets([one.words for one in found])]
    if named := [one for one in found if one.named]:
        said.append(report.drawing(_figure(named), "Phase error over slow time, as it was named"))
    return [report.section("The phase of complex images", *said)]


def phase_sentence(found: Sequence[PhaseAsked]) -> str:
    """For the head of the page; empty where nothing was named."""
    named = [f"{one.view} ({'motion_error' if one.moved else 'phase_error'})" for one in found if one.named]
    return f"The phase over slow time is wrong in {', '.join(named)}. " if named else ""


def _figure(named: Sequence[PhaseAsked]) -> Figure:
    figure, axes = new(6.0, 3.2)
    place = np.linspace(-1.0, 1.0, _PLACES)
    for one in named:
        axes.plot(place, one.phase(place), label=one.view)
    axes.set(xlabel="place along the aperture", ylabel="phase error [rad]")
    axes.grid(alpha=0.3)
    axes.legend()
    return figure
