"""Closed forms of trihedrals beside those of ISCE3 and GECORIS, and what windows and definitions of power cost.

    python benchmarks/reflectors_peers.py forms   # 20 attitudes
    python benchmarks/reflectors_peers.py power   # window, oversampling, definition of power
    python benchmarks/reflectors_peers.py time    # 20 sites x 30 dates

The peers' formulas are written here from their published equations, to be compared with; none of their code is used.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from reflectors_simulated import BANDWIDTH, CENTRE, SEARCH, SPACING_M, chips

import warpsar
from warpsar.calibration.attitude import Facing, trihedral_rcs_m2
from warpsar.calibration.engine import engine_rcs_m2
from warpsar.calibration.point import PointSettings, ResponseAxis, measure_point
from warpsar.calibration.sites import ReflectorSite
from warpsar.products.grid import LineGrid
from warpsar.products.orbit import Orbit
from warpsar.products.product import Product
from warpsar.world.frame import SPEED_OF_LIGHT

F64 = NDArray[np.float64]
WAVELENGTH, LEG = 0.0555, 1.5
FREQUENCY_HZ = SPEED_OF_LIGHT / WAVELENGTH
UPRIGHT = Facing(90.0)
SQUARE = np.array([[1, 0, 0], [1, 0, 1], [0, 0, 1], [0, 1, 1], [0, 1, 0], [1, 1, 0]], float)
TRIANGLE = np.array([[1, 0, 0], [0, 0, 1], [0, 1, 0]], float)


def db(area: float) -> float:
    return float(10.0 * np.log10(area))


def toward(azimuth_deg: float, incidence_deg: float) -> F64:
    a, i = np.deg2rad([azimuth_deg, incidence_deg])
    return np.array([np.sin(a) * np.sin(i), np.cos(a) * np.sin(i), np.cos(i)])


def isce3_former(cosines: F64) -> float:
    """ISCE3 until its pull request 176: p = cosines / sqrt(3), in both branches; area over leg^2."""
    low, middle, high = np.sort(cosines) / np.sqrt(3.0)
    total = low + middle + high
    if low + middle > high:
        return float(np.sqrt(3.0) * total - 2.0 / (np.sqrt(3.0) * total))
    return float(4.0 * low * middle / total)


def gecoris(aperture: F64, theta_deg: float, omega_deg: float) -> float:
    """GECORIS: the aperture and its inversion on axes of which the second is square at omega = 45 degrees alone."""
    from shapely.geometry import Polygon

    t, w = np.deg2rad([theta_deg, omega_deg])
    axes = np.array([[-np.sin(w), np.cos(w), 0.0], [-np.sin(w) * np.cos(t), -np.cos(w) * np.cos(t), np.sin(t)]])
    flat = aperture @ axes.T
    return float(Polygon(flat).intersection(Polygon(-flat)).area)


def forms() -> None:
    scale = 4.0 * np.pi * LEG**4 / WAVELENGTH**2
    looks = [(90.0 + off, 54.7356 + up) for off in (0.0, 5.0, 15.0, 25.0, 40.0) for up in (-30.0, -10.0, 0.0, 20.0)]
    print(
        "azimuth off, incidence, off boresight [deg]; triangular: ours [dBsm], ISCE3 former, GECORIS, engine less ours"
    )
    print("square: ours [dBsm], GECORIS, engine less ours [dB]")
    for azimuth, incidence in looks:
        look = toward(azimuth, incidence)
        cosines = UPRIGHT.cosines(look)
        words = [f"{azimuth - 90:.0f}", f"{incidence:.1f}", f"{UPRIGHT.off_boresight_deg(look):.1f}"]
        for shape, aperture in (("triangular", TRIANGLE), ("square", SQUARE)):
            ours = db(float(trihedral_rcs_m2(shape, LEG, UPRIGHT, look, WAVELENGTH)))
            theirs = db(scale * gecoris(aperture, incidence, 45.0 + azimuth - 90.0) ** 2)
            engine = db(float(engine_rcs_m2(shape, LEG, UPRIGHT, [(azimuth, incidence)], FREQUENCY_HZ, "VV", "cpu")[0]))
            words.append(f"{ours:.2f}")
            if shape == "triangular":
                words.append(f"{db(scale * isce3_former(cosines) ** 2) - ours:+.2f}")
            words += [f"{theirs - ours:+.2f}", f"{engine - ours:+.2f}"]
        print("| " + " | ".join(words) + " |")
    print("triangular, on the boresight, by its leg [m]: engine less ours [dB]")
    for leg in (1.0, 1.3, 1.5, 1.7, 2.5):
        look = (90.0, 54.7356)
        ours = float(trihedral_rcs_m2("triangular", leg, UPRIGHT, toward(*look), WAVELENGTH))
        engine = float(engine_rcs_m2("triangular", leg, UPRIGHT, [look], FREQUENCY_HZ, "VV", "cpu")[0])
        print(f"  {leg:g}: {db(engine / ours):+.2f}")


def power() -> None:
    for hamming in (1.0, 0.75):
        axes = ResponseAxis(BANDWIDTH[0], hamming), ResponseAxis(BANDWIDTH[1], hamming)
        rng = np.random.default_rng(0)
        made = [chips(rng, 1e9, (hamming, hamming)) for _ in range(20)]

        def error(values: list[float]) -> str:
            found = 10.0 * np.log10([v / rcs for v, (_, rcs, _) in zip(values, made, strict=True)])  # noqa: B023
            return f"{found.mean():+.2f} ({found.min():+.2f} to {found.max():+.2f})"

        print(f"Hamming coefficient {hamming}: mean error [dB] over 20 places within a pixel (least to most)")
        for half in (1.0, 1.5, 2.0, 3.0, 5.0):
            settings = PointSettings(window_cells=half, guard_cells=0.5, clutter_cells=max(10.0, half + 3))
            found = [measure_point(c, CENTRE, SEARCH, SPACING_M, axes, settings) for c, _, _ in made]
            plain, corrected = error([f.rcs_m2 * f.window_share for f in found]), error([f.rcs_m2 for f in found])
            print(f"  integral, +-{half:g} cells: as it is {plain}, over the window's share {corrected}")
        found = [measure_point(c, CENTRE, SEARCH, SPACING_M, axes) for c, _, _ in made]
        print(f"  peak x response's area: {error([f.peak_rcs_m2 for f in found])}")
        cells = 1.0 / BANDWIDTH[0] / BANDWIDTH[1]
        area = axes[0].peak_m * axes[1].peak_m
        print(f"  peak x 1 / bandwidths (GECORIS): {error([f.peak_rcs_m2 / area * cells for f in found])}")
        boxes = [
            f.peak_rcs_m2 / area * f.quality[0].width_m * f.quality[1].width_m for f in found if f.quality is not None
        ]
        print(f"  peak x 3 dB widths (ISCE3's box): {error(boxes)}")
        for factor in (1, 2, 4, 8, 16):
            peaks = [sampled_peak(c, factor) * area for c, _, _ in made]
            print(f"  peak of samples, {factor} times as fine, no parabola: {error(peaks)}")


def sampled_peak(chip: NDArray[np.complex128], factor: int) -> float:
    spectrum = np.fft.fftshift(np.fft.fft2(chip))
    n = chip.shape[0]
    whole = np.zeros((n * factor,) * 2, complex)
    start = n * factor // 2 - n // 2
    whole[start : start + n, start : start + n] = spectrum
    return float((np.abs(np.fft.ifft2(np.fft.ifftshift(whole)) * factor**2) ** 2).max())


def speed() -> None:
    """Chips of 20 reflectors on 30 dates, in memory: measured, predicted by rays and explained."""
    rng = np.random.default_rng(0)
    turn = 2.0 * np.pi / 5924.0

    def place(t: F64) -> F64:
        angle = 0.8 + turn * t
        return 7.07e6 * np.stack([np.cos(angle), 0.2 * np.sin(angle), np.sqrt(0.96) * np.sin(angle)], axis=-1)

    times = np.arange(-60.0, 61.0, 10.0)
    orbit = Orbit.of("made", times, place(times), (place(times + 0.01) - place(times - 0.01)) / 0.02)
    grid = LineGrid(2400, 1200, -2.4, 2e-3, 8.4e5, 2.33)
    image = (rng.normal(size=(2400, 1200, 2)) @ [0.2, 0.2j]).astype(np.complex64)
    base = Product(
        "made", "made", np.datetime64("2024-01-01", "us"), "VV", 5.405e9, "right", grid, orbit, image, "complex",
        "beta0", bandwidth_hz=(56.5e6, 327.0),
    )  # fmt: skip
    sites = []
    for k in range(20):
        line, pixel = 100.0 + 110.0 * k, 100.0 + 50.0 * k
        image[int(line), int(pixel)] += 60.0
        at = base.to_ground(int(line), int(pixel), 0.0)
        sites.append(ReflectorSite(f"CR{k}", *at, (Facing(base.to_image(at).azimuth_deg),), "triangular", 1.5))
    products = [replace(base, source=f"date {d}", epoch=base.epoch + np.timedelta64(12 * d, "D")) for d in range(30)]
    start = time.perf_counter()
    found = warpsar.reflectors(products, sites, device="cpu")
    passed = time.perf_counter() - start
    measured = sum(one.status == "measured" for one in found.observations)
    print(f"{len(found.observations)} chips, {measured} measured: {passed:.1f} s")


if __name__ == "__main__":
    {"forms": forms, "power": power, "time": speed}[sys.argv[1]]()
