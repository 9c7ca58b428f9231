"""A learned table of sigma0 over incidence, beside the one that it began with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from warpsar.io.figures import new
from warpsar.learning.table import LearnedTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COLOURS = {"HH": "C0", "VV": "C1", "HV": "C2"}
SURE = 1.96  # standard deviations of a 95 % interval


def figure_of_table(name: str, one: LearnedTable) -> Figure:
    """Each learned channel as given (dashed) and as learned, with 95 % intervals; grey is the incidence seen."""
    figure, axis = new(7.0, 4.4)
    incidence = one.given.incidence_deg
    for channel, sd in one.sd_db.items():
        colour, learned = COLOURS[channel], one.found.sigma0_db[channel]
        axis.fill_between(incidence, learned - SURE * sd, learned + SURE * sd, color=colour, alpha=0.18, lw=0)
        axis.plot(incidence, one.given.sigma0_db[channel], "--", color=colour, lw=1.2, label=f"{channel} as given")
        axis.plot(incidence, learned, ".-", color=colour, label=f"{channel} learned, 95 %")
    axis.axvspan(*one.seen_deg, color="0.9", lw=0, zorder=0, label="seen by the train views")
    axis.set(xlabel="local incidence [deg]", ylabel="sigma0 [dB]", xlim=(incidence[0], incidence[-1]), title=name)
    axis.grid(alpha=0.3, lw=0.4)
    figure.legend(loc="outside lower center", frameon=False, fontsize=8, ncols=len(one.sd_db) + 1)
    return figure
