"""The learned law of backscatter in diagnose's report: drawn over incidence, so that a person can name it."""

from __future__ import annotations

import numpy as np

from warpsar.diagnosis.result import Diagnosed
from warpsar.effects.registry import get
from warpsar.io import html as report
from warpsar.io.figures import new


def law_section(done: Diagnosed) -> list[str]:
    """A section, or none where no law was learned."""
    incidence = np.linspace(0.0, 90.0, 181)
    effects = done.diagnosis.final.scene.effects
    laws = [law for name, table in effects.items() if (law := get(name).law_db(table, incidence))]
    if not laws:
        return []
    figure, axes = new(6.0, 3.4)
    for channel, factor in laws[0].items():
        axes.plot(incidence, factor, label=channel)
    axes.set(xlabel="local incidence [deg]", ylabel="learned factor on sigma0 [dB]", xlim=(0.0, 90.0))
    axes.axhline(0.0, color="0.6", linewidth=0.8)
    axes.legend()
    said = (
        "No named effect explains what was left, so a factor on sigma0 was learned from the images. Its shape may tell "
        "what it is: a slope over all angles is another roughness, a bend of one polarization another model, a step a "
        "layer. It is no explanation by itself."
    )
    words = "The learned factor on sigma0 over local incidence, of each polarization"
    return [report.section("The learned backscatter", report.paragraph(said), report.drawing(figure, words))]
