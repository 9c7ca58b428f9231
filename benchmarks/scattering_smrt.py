"""I2EM beside the IEM of another program, SMRT (Picard et al. 2018), where the two overlap: HH and VV of level ground.

    python benchmarks/scattering_smrt.py [--golden tests/data/smrt_iem.csv] [--write]

It needs SMRT 1.7 (`pip install smrt==1.7`). SMRT's model `iem_fung92` is Fung, Li and Chen (1992). Its model
`iem_fung92_brogioni10` is the same with Fresnel's coefficients of normal incidence where kh kl > sqrt(eps). `--golden`
writes its numbers, which tests/models/test_smrt.py holds the kernels against.
"""

from __future__ import annotations

import csv
import importlib.metadata
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import tables
import warp as wp

from warpsar.kernels.codes import Polarization, Spectrum
from warpsar.kernels.models.i2em import i2em_single

wp.set_module_options({"max_unroll": 1})
FREQUENCY_HZ = 5.405e9
SPECTRA = ("exponential", "gaussian")
ROUGHNESS = ((0.01, 1.0), (0.1, 1.0), (0.3, 3.0), (0.6, 4.0), (1.0, 6.0))  # kh, kl
EPS = (4 - 0.4j, 15 - 3j)
THETA_DEG = (1.0, 20.0, 40.0, 60.0)
CALL = "diffuse_reflection_matrix(5.405e9, 1, conj(eps), mu, mu, pi, 2) * 4 pi mu, series_truncation = 60"
COLUMNS = ("model", "spectrum", "kh", "kl", "eps_re", "eps_im", "theta_deg", "VV_dB", "HH_dB")


@wp.kernel(enable_backward=False)
def single_kernel(polarization: int, given: wp.array2d(dtype=wp.float64), out: wp.array(dtype=wp.float64)):
    """I2EM's single scattering without shadow, as SMRT's; rows: spectrum, cos theta, eps', eps'', kh, kl."""
    i = wp.tid()
    eps = wp.vector(given[i, 2], -given[i, 3])
    value, _eps, _height, _length = i2em_single(
        polarization, int(given[i, 0]), given[i, 1], wp.float64(1.0), eps, given[i, 4], given[i, 5]
    )
    out[i] = value


def ours_db(rows: list[dict[str, Any]], channel: str) -> np.ndarray:
    """sigma0 [dB] of the rows' surfaces, (n,)."""
    given = [
        [
            Spectrum[r["spectrum"].upper()],
            np.cos(np.radians(r["theta_deg"])),
            r["eps_re"],
            r["eps_im"],
            r["kh"],
            r["kl"],
        ]
        for r in rows
    ]
    out = wp.zeros(len(rows), dtype=wp.float64, device="cpu")
    inputs = [int(Polarization[channel]), wp.array(np.array(given, float), dtype=wp.float64, device="cpu")]
    wp.launch(single_kernel, len(rows), inputs=inputs, outputs=[out], device="cpu")
    return 10 * np.log10(out.numpy())


def theirs() -> list[dict[str, Any]]:
    """SMRT's numbers, a row for each model and surface."""
    from smrt.interface.iem_fung92 import IEM_Fung92
    from smrt.interface.iem_fung92_brogioni10 import IEM_Fung92_Briogoni10

    k = 2 * np.pi * FREQUENCY_HZ / 299792458.0
    mu = np.cos(np.radians(THETA_DEG))
    found = []
    for model, spectrum, (kh, kl), eps in itertools.product(
        ({"iem_fung92": IEM_Fung92, "iem_fung92_brogioni10": IEM_Fung92_Briogoni10}).items(), SPECTRA, ROUGHNESS, EPS
    ):
        surface = model[1](
            roughness_rms=kh / k,
            corr_length=kl / k,
            autocorrelation_function=spectrum,
            series_truncation=60,
            warning_handling="ignore",
        )
        # its time dependence is exp(-i w t)
        matrix = surface.diffuse_reflection_matrix(FREQUENCY_HZ, 1, np.conj(eps), mu, mu, np.pi, 2)
        db = 10 * np.log10(np.asarray(matrix.values) * 4 * np.pi * mu)
        for j, theta in enumerate(THETA_DEG):
            values = (model[0], spectrum, kh, kl, eps.real, -eps.imag, theta, float(db[0, j]), float(db[1, j]))
            found.append(dict(zip(COLUMNS, values, strict=True)))
    return found


def write_golden(rows: list[dict[str, Any]], path: Path) -> None:
    with path.open("w", newline="") as stream:
        stream.write(f"# SMRT {importlib.metadata.version('smrt')}: sigma0 = {CALL}\n")
        writer = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows({**r, "VV_dB": f"{r['VV_dB']:.8f}", "HH_dB": f"{r['HH_dB']:.8f}"} for r in rows)


def table_of(rows: list[dict[str, Any]]) -> str:
    """I2EM minus SMRT's model [dB]: the largest difference of both permittivities, by roughness and incidence."""
    lines = []
    for model, spectrum, (kh, kl) in itertools.product(("iem_fung92", "iem_fung92_brogioni10"), SPECTRA, ROUGHNESS):
        mine = [r for r in rows if (r["model"], r["spectrum"], r["kh"], r["kl"]) == (model, spectrum, kh, kl)]
        cells = []
        for theta in THETA_DEG:
            here = [r for r in mine if r["theta_deg"] == theta]
            off = [ours_db(here, c) - [r[f"{c}_dB"] for r in here] for c in ("VV", "HH")]
            cells.append(" / ".join(f"{one[np.argmax(np.abs(one))]:+.3f}" for one in off))
        lines.append([f"`{model}`", spectrum, kh, kl, *cells])
    head = ["SMRT's", "spectrum", "kh", "kl", *(f"{t:g}°, VV / HH" for t in THETA_DEG)]
    return tables.markdown(head, lines)


def main() -> None:
    parser = tables.parser(__doc__, stored=False)
    parser.add_argument("--golden", type=Path, help="where SMRT's numbers go (CSV)")
    given = parser.parse_args()
    wp.config.log_level = wp.LOG_WARNING
    rows = theirs()
    if given.golden is not None:
        write_golden(rows, given.golden)
    tables.publish({"scattering.smrt": table_of(rows)}, {"made": tables.made()}, given.write)


if __name__ == "__main__":
    main()
