"""I2EM beside the IEM of another program, SMRT 1.7, whose numbers stand in data/smrt_iem.csv."""

import csv
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scattering_reference as reference

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))
import scattering_smrt as peer

GOLDEN = Path(__file__).resolve().parents[1] / "data" / "smrt_iem.csv"


def rows() -> list[dict[str, Any]]:
    """The golden numbers; the first line says the version and the call that made them."""
    with GOLDEN.open(newline="") as stream:
        assert stream.readline() == f"# SMRT 1.7: sigma0 = {peer.CALL}\n"
        return [
            {key: value if key in ("model", "spectrum") else float(value) for key, value in row.items()}
            for row in csv.DictReader(stream)
        ]


def off_db(chosen: list[dict[str, Any]]) -> np.ndarray:
    """The kernels' I2EM minus SMRT, VV and HH, (n, 2)."""
    return np.stack([peer.ours_db(chosen, c) - [r[f"{c}_dB"] for r in chosen] for c in ("VV", "HH")], axis=1)


@pytest.mark.parametrize("spectrum", peer.SPECTRA)
@pytest.mark.parametrize("model", ["iem_fung92", "iem_fung92_brogioni10"])
def test_both_limits_are_smrts(model: str, spectrum: str) -> None:
    """A smooth surface (small perturbation) and the normal (Kirchhoff): there all of the family is one."""
    mine = [r for r in rows() if r["model"] == model and r["spectrum"] == spectrum]
    smooth = off_db([r for r in mine if r["kh"] == 0.01])
    assert np.abs(smooth).max() < 0.003  # the second power has (kh)^2 of the first
    normal = off_db([r for r in mine if r["theta_deg"] == 1.0])
    assert np.abs(normal).max() < 0.005  # what differs grows as sin^2: 3e-4 at one degree


def test_between_them_it_is_as_far_as_the_page_says() -> None:
    """Exponential surfaces up to 40 degrees and kh 0.6: the complementary field of 2002 in place of 1992's."""
    mine = [
        r
        for r in rows()
        if r["model"] == "iem_fung92" and r["spectrum"] == "exponential" and r["theta_deg"] <= 40 and r["kh"] <= 0.6
    ]
    vv, hh = np.abs(off_db(mine)).max(axis=0)
    assert vv == pytest.approx(0.338, abs=0.005)
    assert hh == pytest.approx(1.009, abs=0.005)


def test_the_references_iem_is_smrts() -> None:
    """Fung, Li and Chen's 1992 model, which the page compares on the full-wave table."""
    for r in rows():
        if r["model"] == "iem_fung92":
            eps = r["eps_re"] - 1j * r["eps_im"]
            for c in ("VV", "HH"):
                found = reference.iem(c, np.radians(r["theta_deg"]), eps, r["kh"], r["kl"], r["spectrum"])
                assert 10 * np.log10(found) == pytest.approx(r[f"{c}_dB"], abs=1e-6)


@pytest.mark.skipif(find_spec("smrt") is None, reason="SMRT is not installed: pip install smrt==1.7")
def test_smrt_still_says_so() -> None:
    for one, golden in zip(peer.theirs(), rows(), strict=True):
        for c in ("VV_dB", "HH_dB"):
            assert one[c] == pytest.approx(golden[c], abs=1e-6)
