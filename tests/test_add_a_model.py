"""docs/add-a-model.md does what it says: its files and commands, in a copy of the repository."""

import json
import math
import re
from pathlib import Path

from written_page import WrittenPage, run

TRUTH = {"nadir": 0.2, "cosine_power": 1.5}


def test_a_reader_gets_from_nothing_to_a_fit_that_finds_it(tmp_path: Path) -> None:
    page = WrittenPage("add-a-model.md")
    assert len(page.files) == 5
    checkout = page.checkout(tmp_path)
    tests, make, learn = page.commands
    passed = re.search(r"(\d+) passed", run(tests, checkout))
    assert passed is not None
    assert int(passed[1]) >= 10  # its own physics three times, and one test of all models at least for each promise
    run(make, checkout)
    run(learn, checkout)
    found = json.loads((checkout / "out" / "learned" / "learn.json").read_text())
    for key, true in TRUTH.items():
        told = found["materials"]["lawn"][key]
        assert told["sd_log"] < 0.1
        assert abs(math.log(told["value"] / true)) < 3.5 * told["sd_log"]


KEYS = [f"`several_{k}`" for k in range(5)]
SEVERAL = {
    "kernels/models/several.py": """
from typing import Any

import warp as wp

from warpsar.kernels.codes import Coordinate
from warpsar.kernels.scattering import bounded_cosine, is_crossed, sine_squared

PLACES = 8


@wp.func
def sigma0_and_slopes_of(
    polarization: int,
    spectrum: int,
    variant: int,
    wavenumber: Any,
    cos_incidence: Any,
    cos_twist: Any,
    cos2_azimuth: Any,
    eps_im: Any,
    aspect: Any,
    zeta: Any,
):
    zero = type(wavenumber)(0.0)
    c = bounded_cosine(cos_incidence)
    s = sine_squared(c)
    s4 = s * s
    found = wp.vector(zero, zero, zero, zero, zero, zero, zero, zero, zero)
    if not is_crossed(polarization):
        kh = wavenumber * wp.exp(zeta[Coordinate.HEIGHT])
        log = zeta[0] + zeta[2] * wp.log(c) + zeta[3] * s + zeta[4] * s4 + zeta[5] * s4 * s4 - kh
        value = wp.exp(log)
        by_cosine = value * wp.log(c)
        found = wp.vector(value, value, -kh * value, by_cosine, value * s, value * s4, value * s4 * s4, zero, zero)
    return found
""",
    "warpsar/models/several.py": """
from warpsar.models.base.model import BackscatterModel, Domain, SurfaceParameter
from warpsar.models.base.parameters import RMS_HEIGHT

OWN = [
    SurfaceParameter(f"several_{k}", f"a{k}", "linear", -9.0, 9.0, (-10.0, 10.0), 0.5, "A coefficient.", 0.2 * k - 1.0)
    for k in range(5)
]
MODEL = BackscatterModel("several", "a law of six numbers", 60, (RMS_HEIGHT, *OWN), Domain("it"), channels=("HH", "VV"))
""",
    "docs/scattering.md": f"| `several` | a law of six numbers | h | h, {', '.join(KEYS)} | |\n",
}
"""A model of more parameters than one vector of the device holds."""


def test_a_model_may_have_more_parameters_than_four(tmp_path: Path) -> None:
    page = WrittenPage("add-a-model.md")
    page.files = SEVERAL
    tests = "pytest -q tests/test_models.py tests/coherent/test_rough_models.py -k several"
    passed = re.search(r"(\d+) passed", run(tests, page.checkout(tmp_path)))
    assert passed is not None
    assert int(passed[1]) >= 10
