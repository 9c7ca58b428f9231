"""A learned table of sigma0 over incidence, beside the one that it began with."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from warpsar.io.figures import new

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {"HH": "C0", "VV": "C1", "HV": "C2"}
SURE = 1.96  # standard deviations of a 95 % interval


def figure_of_table(name: str, told: Mapping[str, Any]) -> Figure:
    """Each learned channel as given (dashed) and as learned, with 95 % intervals; grey is the incidence seen.

    `told` is what learn.json says of the table (`LearnedTable.content`).
    """
    figure, axis = new(7.0, 4.4)
    incidence = np.asarray(told["incidence_deg"])
    for channel, sd in told["sd_db"].items():
        colour, learned, half = COLOURS[channel], np.asarray(told["learned_db"][channel]), SURE * np.asarray(sd)
        axis.fill_between(incidence, learned - half, learned + half, color=colour, alpha=0.18, lw=0)
        axis.plot(incidence, told["given_db"][channel], "--", color=colour, lw=1.2, label=f"{channel} as given")
        axis.plot(incidence, learned, ".-", color=colour, label=f"{channel} learned, 95 %")
    axis.axvspan(*told["incidence_seen_deg"], color="0.9", lw=0, zorder=0, label="seen by the train views")
    axis.set(xlabel="local incidence [deg]", ylabel="sigma0 [dB]", xlim=(incidence[0], incidence[-1]), title=name)
    axis.grid(alpha=0.3, lw=0.4)
    figure.legend(loc="outside lower center", frameon=False, fontsize=8, ncols=len(told["sd_db"]) + 1)
    return figure
