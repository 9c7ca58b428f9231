"""Phase history: scatterers deposited into range bins, pulse by pulse, and the bins brought to frequencies.

A sample is S = sum sqrt(4 pi) A exp(-j 4 pi f (r - r0) / c), with the mean way r to a scatterer and r0 to the reference
point. |S|^2 of a single scatterer is its RCS [m2] (times the antenna's two-way pattern).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import ArrayLike, NDArray
from scipy import fft

from warpsar.coherent.records import upload
from warpsar.collection.antenna_file import AntennaPatternTable
from warpsar.collection.plan import MOST, Plan, boresight
from warpsar.collection.scatterers import TOGETHER, ScattererPart, Scatterers, Stream
from warpsar.errors import InputError
from warpsar.formats.base.acquisition import RecordedSignal
from warpsar.formats.base.data import PhaseHistory
from warpsar.kernels import collection as kernels
from warpsar.kernels import pulse_lanes
from warpsar.runtime import devices, threads
from warpsar.runtime.memory import default_gib
from warpsar.runtime.structs import fill
from warpsar.version import __version__
from warpsar.world.collection import AntennaChannels
from warpsar.world.frame import SPEED_OF_LIGHT

if TYPE_CHECKING:
    import xarray

OVERSAMPLING = 2
LANES = 4096
"""Threads for each pulse on CUDA."""
POINTS_TOGETHER = 4096
"""Of the adjoint, in a task of the CPU."""
PULSES_TOGETHER = {"cpu": 16, "cuda": 1024}


@dataclass(frozen=True)
class Collected:
    """The phase history of one view."""

    plan: Plan
    polarizations: tuple[str, ...]
    samples: NDArray[np.complex64]
    """(polarizations, frequencies, pulses)."""
    scatterers: int
    aliased: float

    def __repr__(self) -> str:
        _, frequencies, pulses = self.samples.shape
        pols = ", ".join(self.polarizations)
        return f"<Collected {self.plan.view.name}: {pols}, {frequencies} frequencies, {pulses} pulses>"

    @property
    def frequency_hz(self) -> NDArray[np.float64]:
        return np.asarray(self.plan.start_hz + self.plan.step_hz * np.arange(self.plan.frequencies), np.float64)

    def history(self, polarization: str) -> PhaseHistory:
        """One polarization as `warpsar.measured` knows it, its places in the frame of `Site`."""
        plan, pulses = self.plan, len(self.plan.track)
        return PhaseHistory(
            source=plan.view.name,
            samples=self.samples[self.polarizations.index(polarization)],
            frequency_start_hz=np.full(pulses, plan.start_hz),
            frequency_step_hz=np.full(pulses, plan.step_hz),
            position_m=plan.recorded.receiver_m,
            reference_range_m=plan.recorded.reference_m(),
            polarization=polarization,
            transmitter_m=plan.recorded.transmitter_m if plan.recorded.bistatic else None,
        )

    def signal(self) -> RecordedSignal:
        """All of it, as `warpsar.formats.cphd` writes it."""
        plan = self.plan
        samples = dict(zip(self.polarizations, self.samples, strict=True))
        return RecordedSignal(plan.acquisition, samples, 0.5 * MOST / plan.step_hz, plan.corners_m, plan.cells_m)

    def to_xarray(self) -> xarray.Dataset:
        """`samples` over polarization, frequency [Hz] and time [s] (extra `xarray`)."""
        try:
            import xarray
        except ImportError as error:
            raise InputError('xarray is needed: pip install "warpsar[xarray]"') from error
        track = self.plan.recorded
        place = ("time", "component")
        return xarray.Dataset(
            {
                "samples": (("polarization", "frequency", "time"), self.samples, {"units": "m"}),
                "receiver": (place, track.receiver_m, {"units": "m"}),
                "transmitter": (place, track.transmitter_m, {"units": "m"}),
                "reference_range": ("time", track.reference_m(), {"units": "m"}),
            },
            {
                "polarization": list(self.polarizations),
                "frequency": ("frequency", self.frequency_hz, {"units": "Hz"}),
                "time": ("time", track.time_s, {"units": "s"}),
                "component": ["east", "north", "up"],
            },
            {"title": "simulated phase history", "view": self.plan.view.name, "software": f"warpsar {__version__}"},
        )

    def arrays(self) -> dict[str, Any]:
        """What the .npz holds."""
        track = self.plan.recorded
        return {
            "samples": self.samples,
            "polarizations": np.array(self.polarizations),
            "frequency_hz": self.frequency_hz,
            "time_s": track.time_s,
            "receiver_m": track.receiver_m,
            "transmitter_m": track.transmitter_m,
            "reference_range_m": track.reference_m(),
            "reference_point_m": self.plan.site.reference_m,
        }


def phase_history(
    plan: Plan, scatterers: Scatterers | Stream, polarizations: tuple[str, ...], device: wp.Device
) -> Collected:
    """What a track and a band record of scatterers. Parts are held until they are deposited, `together` at most."""
    shape = (len(polarizations), len(plan.track), plan.frequencies)
    spectrum = np.zeros(shape, np.complex64)
    track = track_of(plan, device)
    if holds_bins(plan, len(polarizations), device):
        _add_all(plan, track, scatterers.parts, spectrum)
    else:
        for parts in _batches(scatterers.parts, getattr(scatterers, "together", TOGETHER)):
            add_spectra(plan, track, parts, spectrum)
    turn = plan.recorded_turn()
    if turn is not None:
        spectrum *= turn
    spectrum = mixed(plan, spectrum, polarizations)
    return Collected(
        plan, polarizations, np.ascontiguousarray(spectrum.swapaxes(1, 2)), scatterers.count, scatterers.aliased
    )


class PhaseHistoryMap:
    """The linear map from amplitudes of points to their samples, and its adjoint: for inversion and autofocus.

    At the places of pixels the adjoint is a backprojection without a taper, and the map is the adjoint of that one.
    Both have the antenna's beam and the phases of `plan.recorded_turn`; the map's error is that of `phase_history`.
    """

    def __init__(self, plan: Plan, points_m: ArrayLike, device: str | None = None) -> None:
        """`points_m`: (n, 3) about the reference point [m]. Raises InputError and DeviceError."""
        points = np.asarray(points_m, np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError(f"points_m: found the shape {points.shape}, or no numbers; must be (n, 3), finite")
        self.plan, self.points_m = plan, points
        self._device = devices.resolve_device(device)
        self._track, self._turn = track_of(plan, self._device), plan.recorded_turn()

    def forward(self, amplitude: ArrayLike) -> NDArray[np.complex64]:
        """Samples, (frequencies, pulses), of amplitudes (n,) [m]: a point's power is its RCS."""
        values = np.asarray(amplitude, np.complex64)
        if values.shape != (len(self.points_m),):
            raise InputError(f"amplitude: found the shape {values.shape}; must be ({len(self.points_m)},)")
        part = ScattererPart(self.points_m, values[None], np.ones(len(self.plan.track), np.float32))
        spectrum = np.zeros((1, len(self.plan.track), self.plan.frequencies), np.complex64)
        add_spectra(self.plan, self._track, [part], spectrum)
        found = spectrum[0] if self._turn is None else spectrum[0] * self._turn
        return np.ascontiguousarray(found.T)

    def adjoint(self, samples: ArrayLike) -> NDArray[np.complex64]:
        """Of samples (frequencies, pulses), (n,): the sum of each times the conjugate of what the point gives to it."""
        plan, device = self.plan, self._device
        given = np.asarray(samples, np.complex64)
        if given.shape != (plan.frequencies, len(plan.track)):
            raise InputError(f"samples: found the shape {given.shape}; must be ({plan.frequencies}, {len(plan.track)})")
        bins, step = bins_of(plan), PULSES_TOGETHER["cuda"]
        order = (np.arange(plan.frequencies) - plan.frequencies // 2) % bins
        points = upload(self.points_m, wp.vec3d, device)
        out = wp.zeros(len(points), dtype=wp.vec2d, device=device)
        for first in range(0, len(plan.track), step):
            some = slice(first, min(first + step, len(plan.track)))
            spectrum = given[:, some].T
            if self._turn is not None:
                spectrum = spectrum * self._turn[some].conj()
            whole = np.zeros((len(spectrum), bins), np.complex64)
            whole[:, order] = spectrum / spread_transform(bins, plan.frequencies)
            profiles = (fft.ifft(whole, axis=1) * np.float32(bins)).astype(np.complex64)
            rows = upload(np.arange(some.start, some.stop, dtype=np.int32), int, device)
            pairs = upload(profiles.view(np.float32).reshape(*profiles.shape, 2), wp.vec2, device)

            def launch(low: int, high: int, rows: wp.array = rows, pairs: wp.array = pairs) -> None:
                inputs = [rows, self._track, *scales(plan), points[low:high], pairs]
                wp.launch(kernels.gather_kernel, high - low, inputs=inputs, outputs=[out[low:high]], device=device)

            each = POINTS_TOGETHER if device.is_cpu else max(len(points), 1)
            tasks = [partial(launch, a, min(a + each, len(points))) for a in range(0, len(points), each)]
            for _ in threads.ordered(tasks, device):
                pass
        found: NDArray[np.complex64] = out.numpy().view(np.complex128)[:, 0].astype(np.complex64)
        return found


def mixed(plan: Plan, samples: NDArray[np.complex64], polarizations: Sequence[str]) -> NDArray[np.complex64]:
    """What the channels of both antennas make of polarizations, (polarizations, ...): R S T (Quegan 1994).

    HV is transmitted H, received V: the element of S in row V, column H.
    """
    errors = plan.table.errors
    if errors is None or (errors.transmit is None and errors.receive is None):
        return samples
    transmit, receive = _channels(errors.transmit).T, _channels(errors.receive)
    at = ["HV".index(name[0]) for name in polarizations], ["HV".index(name[1]) for name in polarizations]
    share = receive[np.ix_(at[1], at[1])] * transmit[np.ix_(at[0], at[0])].T
    found: NDArray[np.complex64] = np.tensordot(share.astype(np.complex64), samples, axes=1)
    return found


def _channels(channels: AntennaChannels | None) -> NDArray[np.complex128]:
    """Rows are channels, columns waves, (2, 2), horizontal first."""
    one = channels or AntennaChannels()
    return np.array([[1.0, complex(*one.v_in_h)], [complex(*one.h_in_v), complex(*one.imbalance)]])


def add_spectra(
    plan: Plan,
    track: Any,
    parts: Sequence[ScattererPart],
    spectrum: NDArray[np.complex64],
    pulses: slice | None = None,
) -> None:
    """Add what all pulses, or some, record of some parts to (polarizations, pulses, frequencies)."""
    device = track.time.device
    first, last, _ = (pulses or slice(None)).indices(len(plan.track))
    step = PULSES_TOGETHER["cpu" if device.is_cpu else "cuda"]
    there = [PartOnDevice.of(part, device) for part in parts]
    blocks = [slice(a, min(a + step, last)) for a in range(first, last, step)]
    blocks = [some for some in blocks if any(part.weight[some].any() for part in there)]
    tasks = [partial(_block, plan, track, there, spectrum.shape[0], some) for some in blocks]
    for some, values in zip(blocks, threads.ordered(tasks, device), strict=True):
        spectrum[:, some] += values


def holds_bins(plan: Plan, polarizations: int, device: wp.Device) -> bool:
    """Whether the range bins of all pulses stay on the device until all scatterers are in them."""
    return device.is_cuda and 8 * polarizations * len(plan.track) * bins_of(plan) <= default_gib(device) * 2**30


def _add_all(plan: Plan, track: Any, parts: Iterable[ScattererPart], spectrum: NDArray[np.complex64]) -> None:
    """`add_spectra` of all pulses, with their bins held on CUDA: however many parts there are, each pulse has one
    transform."""
    device = track.time.device
    step, pulses = PULSES_TOGETHER["cuda"], len(plan.track)
    blocks = [slice(a, min(a + step, pulses)) for a in range(0, pulses, step)]
    bins = [no_bins(plan, len(spectrum), some, device) for some in blocks]
    for part in parts:
        there = [PartOnDevice.of(part, device)]
        for some, out in zip(blocks, bins, strict=True):
            deposited(plan, track, there, some, out)
    for some in blocks:
        spectrum[:, some] += _spectra(plan, bins.pop(0))


def _batches(parts: Iterable[ScattererPart], together: int) -> Iterator[list[ScattererPart]]:
    """Parts that are deposited together: each batch takes the transforms of all pulses."""
    waiting: list[ScattererPart] = []
    for part in parts:
        waiting.append(part)
        if sum(map(len, waiting)) >= together:
            yield waiting
            waiting = []
    if waiting:
        yield waiting


def beam_of(plan: Plan, device: wp.Device) -> Any:
    """The antenna's beam at each pulse, as the kernels know it."""
    axes, widths = boresight(plan)
    beam: Any = kernels.Beam()
    beam.along, beam.up = upload(axes[0], wp.vec3d, device), upload(axes[1], wp.vec3d, device)
    beam.wide, beam.high = float(widths[0]), float(widths[1])
    pattern = plan.pattern or AntennaPatternTable((0.0, 0.0), (0.0, 0.0), np.zeros((0, 0), np.complex64))
    beam.pattern = upload(pattern.amplitude.view(np.float32).reshape(*pattern.amplitude.shape, 2), wp.vec2, device)
    beam.start = wp.vec2(*pattern.start_deg)
    beam.every = wp.vec2(*(1.0 / step if step else 0.0 for step in pattern.step_deg))
    return beam


def track_of(plan: Plan, device: wp.Device) -> Any:
    """A plan's track on a device, `kernels.SensorTrack`."""
    track = plan.track
    ends = {"receiver": track.receiver_m, "transmitter": track.transmitter_m}
    return fill(
        kernels.SensorTrack,
        time=upload(track.time_s, wp.float64, device),
        bistatic=int(track.bistatic),
        beam=beam_of(plan, device),
        **{name: upload(place, wp.vec3d, device) for name, place in ends.items()},
        **{f"{k}_own": upload(np.linalg.norm(place, axis=1), wp.float64, device) for k, place in ends.items()},
    )


@dataclass(frozen=True)
class PartOnDevice:
    """A part on a device: its weight in each pulse, and its scatterers (`kernels.MovingScatterers`)."""

    weight: NDArray[np.float32]
    scatterers: Any

    @classmethod
    def of(cls, part: ScattererPart, device: wp.Device) -> PartOnDevice:
        values = part.amplitude.view(np.float32).reshape(*part.amplitude.shape, 2)
        moving = np.empty((0, 3)) if part.velocity is None else part.velocity
        places = {"point": upload(part.point, wp.vec3d, device), "velocity": upload(moving, wp.vec3d, device)}
        return cls(part.weight, fill(kernels.MovingScatterers, **places, amplitude=upload(values, wp.vec2, device)))


def no_bins(plan: Plan, polarizations: int, some: slice, device: wp.Device) -> wp.array:
    """Empty range bins of some pulses: on CUDA complex numbers (polarizations, pulses, bins); on the CPU what
    `kernels/pulse_lanes.py` fills."""
    bins, pulses = bins_of(plan), some.stop - some.start
    if device.is_cpu:
        return wp.zeros((2, polarizations, pulses, bins + pulse_lanes.SPARE), dtype=float, device=device)
    return wp.zeros((polarizations, pulses, bins), dtype=wp.vec2, device=device)


def deposited(plan: Plan, track: Any, parts: list[PartOnDevice], some: slice, out: wp.array) -> wp.array:
    """`out`, the range bins of some pulses, with some parts added; `track` is that of `track_of`."""
    device = track.time.device
    pulses = np.arange(some.start, some.stop)
    rows = upload(pulses.astype(np.int32), int, device)
    for part in parts:
        weight = part.weight[some]
        if not weight.any():
            continue
        inputs = [rows, upload(weight, float, device), track, *scales(plan)]
        if device.is_cpu:
            inputs += [bins_of(plan), part.scatterers, upload(_weights_table(), float, device)]
            wp.launch(pulse_lanes.pulse_deposit_kernel, 1, inputs=inputs, outputs=[out], device=device)
        else:
            inputs += [part.scatterers, LANES]
            wp.launch(kernels.deposit_kernel, (len(pulses), LANES), inputs=inputs, outputs=[out], device=device)
    return out


def scales(plan: Plan) -> list[float]:
    """Turns of phase of the middle frequency, and bins, for each metre of a mean way."""
    middle = plan.start_hz + plan.frequencies // 2 * plan.step_hz
    return [2.0 * middle / SPEED_OF_LIGHT, 2.0 * plan.step_hz * bins_of(plan) / SPEED_OF_LIGHT]


def bins_of(plan: Plan) -> int:
    """Range bins of a pulse: an even number."""
    return OVERSAMPLING * fft.next_fast_len(plan.frequencies)


@cache
def _weights_table() -> NDArray[np.float32]:
    return pulse_lanes.weights_table().ravel()


def _block(plan: Plan, track: Any, parts: list[PartOnDevice], polarizations: int, some: slice) -> Any:
    """Spectra of some pulses, (polarizations, pulses, frequencies)."""
    return _spectra(plan, deposited(plan, track, parts, some, no_bins(plan, polarizations, some, track.time.device)))


def _spectra(plan: Plan, bins: wp.array) -> NDArray[np.complex64]:
    """Of range bins on a device, (polarizations, pulses, frequencies)."""
    found = np.ascontiguousarray(bins.numpy())
    on_cpu = wp.get_device(bins.device).is_cpu  # where blocks have a thread each
    profiles = _gone_round(found, bins_of(plan)) if on_cpu else found.view(np.complex64)[..., 0]
    spectra = fft.fft(profiles, axis=-1, workers=1 if on_cpu else threads.thread_count(), overwrite_x=True)
    return undeposited(spectra, plan.frequencies).astype(np.complex64)


def _gone_round(rows: NDArray[np.float32], bins: int) -> NDArray[np.complex64]:
    """The bins of the CPU's rows (2, ..., bins + SPARE), (..., bins)."""
    rows[..., : pulse_lanes.SPARE] += rows[..., bins:]
    found = np.empty((*rows.shape[1:-1], bins), np.complex64)
    found.real, found.imag = np.roll(rows[..., :bins], -3, axis=-1)
    return found


def undeposited(spectrum: NDArray[np.complex64], count: int) -> NDArray[np.complex64]:
    """The middle `count` frequencies, ascending, with the transform of the deposit divided out, along the last axis."""
    bins = spectrum.shape[-1]
    order = np.arange(count) - count // 2
    found: NDArray[np.complex64] = spectrum[..., order % bins] / spread_transform(bins, count)
    return found


@cache
def spread_transform(bins: int, count: int) -> NDArray[np.float32]:
    """The transform of the deposit's weights at the middle `count` of `bins` frequencies, (count,)."""
    order = np.arange(count) - count // 2
    return spread_transform_at(order / bins).astype(np.float32)


def spread_transform_at(turns_per_bin: NDArray[np.float64]) -> NDArray[np.float64]:
    """The transform of the deposit's weights at some frequencies, (n,), by quadrature."""
    node, weight = _nodes()
    half = 0.5 * int(kernels.WIDTH)
    found: NDArray[np.float64] = half * weight @ np.cos(2.0 * np.pi * half * node[:, None] * turns_per_bin)
    return found


@cache
def _nodes() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places on one half of a deposit, in its halves, and the weights of their cosines."""
    node, weight = np.polynomial.legendre.leggauss(64)
    value = np.exp(float(kernels.BETA) * (np.sqrt(1.0 - node**2) - 1.0))
    return node[32:], 2.0 * (weight * value)[32:]
