"""How fast and how exact backprojection onto a plane is: the ways of `focus` and `focus_plane`.

    python benchmarks/backprojection.py [--device cuda] [--pixels 8192] [--pulses 2048] [--out backprojection.json]
    [--write]

The geometry is that of the table of NVIDIA MatX's `sar_bp` (README of its example `sarbp`): X band,
770 km, a grazing angle of 43 degrees, pixels of 0.7 m on level ground, an aperture of a degree. The rate is that of
the kernels alone, as there: pixels times pulses in a second, without the FFT of range profiles and without transfers.
The signal-to-error ratio is that of a piece of 64 x 64 pixels, against float64 with the same interpolation.

On a CPU it is the factorised way, whole, beside the exact one on one thread. What the processor spent compares them,
whatever else the machine does.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import tables
import warp as wp
from collection import timed
from simulate import machine

from warpsar.formats.base.data import PhaseHistory
from warpsar.kernels.backproject import backproject_kernel
from warpsar.kernels.backproject_plane import COLUMNS, EACH, ROWS
from warpsar.measured import focus as focusing
from warpsar.measured import plane as planes
from warpsar.measured.plane import Plane
from warpsar.runtime import devices
from warpsar.world.frame import SPEED_OF_LIGHT

RUNS = 3

BLOCK = 256
"""Pulses of one launch."""


def history(pulses: int, swath_m: float, slant: float = 770e3) -> PhaseHistory:
    """Noise of a spotlight whose unambiguous swath holds the image, from a slant range [m]."""
    random = np.random.default_rng(0)
    angle = np.deg2rad(np.linspace(-0.5, 0.5, pulses))
    grazing = np.deg2rad(43.0)
    level, height = slant * np.cos(grazing), slant * np.sin(grazing)
    place = np.stack([-level * np.cos(angle), level * np.sin(angle), np.full(pulses, height)], axis=1)
    band = 0.6e9
    count = int(2 ** np.ceil(np.log2(1.5 * 2.0 * swath_m * band / SPEED_OF_LIGHT)))
    drawn = random.standard_normal((count, pulses, 2), dtype=np.float32).view(np.complex64)[..., 0]
    return PhaseHistory(
        source="noise",
        samples=drawn,
        frequency_start_hz=np.full(pulses, 9.6e9 - 0.5 * band),
        frequency_step_hz=np.full(pulses, band / count),
        position_m=place,
        reference_range_m=np.linalg.norm(place, axis=1),
        polarization="HH",
    )


def plane(pixels: int, step_m: float = 0.7) -> Plane:
    row, column = np.array([step_m, 0.0, 0.0]), np.array([0.0, step_m, 0.0])
    return Plane(-0.5 * pixels * (row + column), row, column, (pixels, pixels))


def double(profiles: np.ndarray, frequency: np.ndarray, per_metre: np.ndarray, one: PhaseHistory, points: Any) -> Any:
    """The sum in float64, with cubic and with linear interpolation."""
    image, linear, bins = np.zeros(points.shape[:-1], complex), np.zeros(points.shape[:-1], complex), profiles.shape[1]
    for p in range(len(profiles)):
        way = np.linalg.norm(points - one.position_m[p], axis=-1) - one.reference_range_m[p]
        at = way * per_metre[p]
        base = np.floor(at).astype(int)
        t = at - base
        four = [profiles[p, (base + k) % bins].astype(complex) for k in (-1, 0, 1, 2)]
        turn = np.exp(2j * np.pi * np.mod(way * 2.0 * frequency[p] / SPEED_OF_LIGHT, 1.0))
        weights = (
            -t * (t - 1) * (t - 2) / 6,
            (t + 1) * (t - 1) * (t - 2) / 2,
            -(t + 1) * t * (t - 2) / 2,
            (t + 1) * t * (t - 1) / 6,
        )
        image += turn * sum(weight * each for weight, each in zip(weights, four, strict=True))
        linear += turn * (four[1] + t * (four[2] - four[1]))
    return image, linear


def measured(options: argparse.Namespace, device: wp.Device) -> dict[str, Any]:
    pixels, pulses, variants = options.pixels, options.pulses, options.variants
    grid = plane(pixels, options.step)
    one = history(pulses, 0.75 * pixels * options.step, options.slant_range)
    blocks = [np.arange(a, min(a + BLOCK, pulses)) for a in range(0, pulses, BLOCK)]
    there = [focusing.uploaded(one, some, np.ones(len(some)), "none", device) for some in blocks]
    side = min(64, pixels)
    piece = (slice(0, side), slice(pixels - side, pixels))
    small = Plane(
        grid.origin_m + (pixels - side) * grid.column_m, grid.row_m, grid.column_m, (side, side)
    )  # fmt: skip
    points = small.points()
    exact = sum(
        np.array(double(*focusing.range_profiles(one, some, np.ones(len(some)), "none"), _some(one, some), points))
        for some in blocks
    )
    size = planes.block_size(one, grid)
    struct = planes.grid_of(grid, *(size or (ROWS, COLUMNS)))
    found: dict[str, Any] = {"pixels": pixels**2, "pulses": pulses, "bins": focusing.profile_bins(one), "ways": {}}
    if device.is_cpu:  # the whole of it, with the transforms of the pulses and their threads
        kept: list[Any] = []

        def factorised() -> None:
            kept[:] = [planes.focus_plane(one, grid, reference_point_m=np.zeros(3), device=device.alias)]

        spent = timed(factorised, 1)
        ratio = _signal_to_error_db(pulses * kept[0][piece], exact[0])
        part = planes.part_of(one, grid)
        name = "blocks" if part is None else f"factorised, parts of {part.pulses} pulses"
        found["ways"][name] = _way(spent, pixels**2 * pulses, ratio)
        print(name, found["ways"][name], flush=True)
    for each in (1, 2, 4, 8, 16) if variants else (int(EACH),) if device.is_cuda else ():
        for cubic in (True, False) if variants else (True,):
            image = wp.zeros((pixels, pixels), dtype=wp.vec2, device=device)

            def work(each: int = each, cubic: bool = cubic, image: Any = image) -> None:
                for pulses_there in there:
                    planes.add_blocks(struct, pulses_there, image, device, each, cubic)

            work()
            made = image.numpy()[piece]
            ratio = _signal_to_error_db(made[..., 0] + 1j * made[..., 1], exact[0 if cubic else 1])
            name = f"{each} rows, {'cubic' if cubic else 'linear'}"
            found["ways"][name] = _way(timed(work, RUNS), pixels**2 * pulses, ratio)
            print(name, found["ways"][name], flush=True)
    flat = wp.array(grid.points()[: max(1, pixels // 16)].reshape(-1, 3), dtype=wp.vec3d, device=device)
    image = wp.zeros(flat.shape[0], dtype=wp.vec2, device=device)

    def plain() -> None:
        for pulses_there in there[:2]:
            wp.launch(backproject_kernel, flat.shape[0], inputs=[flat, pulses_there], outputs=[image], device=device)

    spent = timed(plain, RUNS if device.is_cuda else 1)
    dots = wp.array(points.reshape(-1, 3), dtype=wp.vec3d, device=device)
    image = wp.zeros(dots.shape[0], dtype=wp.vec2, device=device)
    for pulses_there in there:
        wp.launch(backproject_kernel, dots.shape[0], inputs=[dots, pulses_there], outputs=[image], device=device)
    values = image.numpy()
    count = sum(len(some) for some in blocks[:2])
    ratio = _signal_to_error_db((values[:, 0] + 1j * values[:, 1]).reshape(side, side), exact[0])
    found["ways"]["exact"] = _way(spent, pixels**2 * pulses, ratio, flat.shape[0] * count)
    print("exact", found["ways"]["exact"], flush=True)
    return found


def _way(spent: dict[str, Any], sums: int, ratio_db: float, timed_sums: int | None = None) -> dict[str, Any]:
    """Times of all pixels and pulses, from those of `timed_sums` of them."""
    share = sums / (timed_sums or sums)
    return {
        "s": share * spent["best_s"],
        "processor_s": share * spent["processor_s"],
        "per_s": sums / (share * spent["best_s"]),
        "signal_to_error_db": ratio_db,
    }


def _some(one: PhaseHistory, some: np.ndarray) -> Any:
    from dataclasses import replace

    return replace(
        one,
        samples=one.samples[:, some],
        position_m=one.position_m[some],
        reference_range_m=one.reference_range_m[some],
        frequency_start_hz=one.frequency_start_hz[some],
        frequency_step_hz=one.frequency_step_hz[some],
    )


def _signal_to_error_db(found: np.ndarray, exact: np.ndarray) -> float:
    return float(10.0 * np.log10((np.abs(exact) ** 2).sum() / (np.abs(found - exact) ** 2).sum()))


def written(found: dict[str, Any], cpu: bool) -> list[tuple[str, str, str, str]]:
    def time(one: dict[str, Any]) -> str:
        return f"{one['s']:.3g} s" + (f" ({one['processor_s']:.3g} s of the processor)" if cpu else "")

    return [
        (name, time(one), f"{one['per_s'] / 1e9:.3g} x 10^9", f"{one['signal_to_error_db']:.1f} dB")
        for name, one in found["ways"].items()
    ]


def main() -> None:
    parser = tables.parser(__doc__)
    parser.add_argument("--device")
    parser.add_argument("--pixels", type=int, default=8192)
    parser.add_argument("--pulses", type=int, default=2048)
    parser.add_argument("--slant-range", type=float, default=770e3, help="[m]")
    parser.add_argument("--step", type=float, default=0.7, help="of pixels on level ground [m]")
    parser.add_argument("--variants", action="store_true", help="threads of other sizes, and linear interpolation")
    options = parser.parse_args()
    result = tables.result_of(
        options,
        lambda: {
            "backprojection": measured(options, devices.resolve_device(options.device)),
            "machine": machine(options.device),
        },
    )
    one = result["backprojection"]
    header = (f"{one['pixels']:,} pixels x {one['pulses']:,} pulses", "time", "pixel-pulses/s", "signal to error")
    kind = result["machine"]["device"].partition(":")[0]
    tables.publish(
        {f"backprojection.{kind}": tables.markdown(header, written(one, kind == "cpu"))}, result, options.write
    )


if __name__ == "__main__":
    main()
