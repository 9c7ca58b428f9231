"""Draws figures 3 and 4 of the method's paper again, from the scattering functions: sigma0 against incidence.

    python benchmarks/paper_figures.py --out docs/figures

X band, 9.6 GHz. Figure 3 varies one of rms height, correlation length and permittivity about a surface inside
each model's domain; figure 4 mixes the two models of one surface.
"""

from pathlib import Path

import click
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import warp as wp
from matplotlib.axes import Axes
from numpy.typing import NDArray

from warpsar.kernels.codes import Polarization, Spectrum, Variant
from warpsar.kernels.scattering import sigma0

WAVENUMBER = 2.0 * np.pi * 9.6e9 / 299792458.0
INCIDENCE_DEG = np.linspace(0.0, 80.0, 321)

# eps_r, rms height [m], correlation length [m]; each inside the domain of its model (docs/physics.md).
BRAGG_SURFACE = {"eps_r": 6.885, "rms_height": 0.0005, "length": 0.010}
FACET_SURFACE = {"eps_r": 6.885, "rms_height": 0.020, "length": 0.200}
# The paper's plane before learning: outside both domains; no surface lies inside both.
MIXED_SURFACE = {"eps_r": 25.0, "rms_height": 0.005, "length": 0.010}


@wp.kernel
def curve_kernel(
    # In:
    cos_theta: wp.array(dtype=wp.float64),
    polarization: int,
    wavenumber: wp.float64,
    eps_r: wp.float64,
    rms_height: wp.float64,
    length: wp.float64,
    tau: wp.float64,
    # Out:
    sigma_out: wp.array(dtype=wp.float64),
):
    i = wp.tid()
    one = wp.float64(1.0)
    sigma_out[i] = sigma0(
        polarization,
        Spectrum.GAUSSIAN,
        Variant.STANDARD,
        wavenumber,
        cos_theta[i],
        one,
        eps_r,
        wp.float64(0.0),
        rms_height,
        length,
        length,
        one,
        tau,
    )


def curve_db(polarization: int, tau: float, surface: dict[str, float]) -> NDArray[np.float64]:
    """sigma0 [dB] at INCIDENCE_DEG; NaN where it underflows."""
    cos_theta = wp.array(np.cos(np.radians(INCIDENCE_DEG)), dtype=wp.float64, device="cpu")
    sigma = wp.zeros_like(cos_theta)
    wp.launch(
        curve_kernel,
        dim=INCIDENCE_DEG.size,
        inputs=[cos_theta, polarization, WAVENUMBER, *surface.values(), tau],
        outputs=[sigma],
        device="cpu",
    )
    linear = sigma.numpy()
    return 10.0 * np.log10(linear, out=np.full_like(linear, np.nan), where=linear > 0.0)


def label(name: str, value: float) -> str:
    match name:
        case "eps_r":
            return rf"$\varepsilon_r$ = {value:g}"
        case "rms_height":
            return f"$h$ = {value * 1e3:g} mm"
        case _:
            return f"$l$ = {value * 1e3:g} mm"


def draw_family(ax: Axes, name: str, values: tuple[float, ...], surface: dict[str, float], tau: float) -> None:
    for i, value in enumerate(values):
        varied = surface | {name: value}
        ax.plot(INCIDENCE_DEG, curve_db(Polarization.HH, tau, varied), color=f"C{i}", label=label(name, value))
        if tau < 1.0:
            ax.plot(INCIDENCE_DEG, curve_db(Polarization.VV, tau, varied), color=f"C{i}", linestyle="--")
    fixed = ", ".join(label(n, v) for n, v in surface.items() if n != name)
    model = "small perturbation, HH solid, VV dashed" if tau < 1.0 else "geometric optics, HH = VV"
    ax.set_title(f"{model}\n{fixed}", fontsize=9)
    ax.legend(fontsize=8)


def finish(ax: Axes, bottom_db: float, top_db: float) -> None:
    ax.set_xlim(0.0, 80.0)
    ax.set_ylim(bottom_db, top_db)
    ax.grid(alpha=0.3)
    ax.set_xlabel("incidence angle [deg]")
    ax.set_ylabel(r"$\sigma^0$ [dB]")


def figure_3(path: Path) -> None:
    figure, axes = plt.subplots(2, 3, figsize=(10.5, 6.4), layout="constrained")
    families = (
        (FACET_SURFACE, 1.0, (0.010, 0.020, 0.040), (0.100, 0.200, 0.400), (-50.0, 20.0)),
        (BRAGG_SURFACE, 0.0, (0.00025, 0.0005, 0.001), (0.004, 0.010, 0.014), (-70.0, 0.0)),
    )
    for row, (surface, tau, heights, lengths, limits) in zip(axes, families, strict=True):
        varied = {"rms_height": heights, "length": lengths, "eps_r": (3.0, 6.885, 25.0, 75.0)}
        for ax, (name, values) in zip(row, varied.items(), strict=True):
            draw_family(ax, name, values, surface, tau)
            finish(ax, *limits)
    figure.savefig(path, dpi=90)
    plt.close(figure)


def figure_4(path: Path) -> None:
    figure, axes = plt.subplots(1, 2, figsize=(9.0, 4.0), layout="constrained")
    for ax, polarization, channel in zip(axes, (Polarization.HH, Polarization.VV), ("HH", "VV"), strict=True):
        for i, tau in enumerate((0.0, 0.25, 0.5, 0.75, 1.0)):
            color = plt.get_cmap("viridis")(0.22 * i)
            ax.plot(
                INCIDENCE_DEG,
                curve_db(polarization, tau, MIXED_SURFACE),
                color=color,
                label=rf"$\tau$ = {tau:g}",
            )
        surface = ", ".join(label(n, v) for n, v in MIXED_SURFACE.items())
        ax.set_title(f"{channel}; {surface}", fontsize=9)
        ax.legend(fontsize=8)
        finish(ax, -40.0, 10.0)
    figure.savefig(path, dpi=90)
    plt.close(figure)


@click.command()
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="Folder of the PNGs.")
def main(out: Path) -> None:
    out.mkdir(parents=True, exist_ok=True)
    figure_3(out / "figure3.png")
    figure_4(out / "figure4.png")


if __name__ == "__main__":
    main()
