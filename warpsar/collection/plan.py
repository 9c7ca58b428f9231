"""How a view is collected: its track, its band and its system, checked before any work."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import cast

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy import fft

from warpsar.coherent.left_out import refuse_left_out
from warpsar.coherent.rough_models import backscatter_alone
from warpsar.collection import antenna_file, track_file
from warpsar.collection.antenna_file import AntennaPatternTable
from warpsar.collection.presets import BANDS_HZ
from warpsar.collection.response import asked, band_weights
from warpsar.effects.base.effect import DeclaredEffect
from warpsar.effects.base.phase import Copy, Response
from warpsar.effects.base.product import Product
from warpsar.effects.registry import declared, response_of
from warpsar.errors import InputError
from warpsar.formats.base.acquisition import Acquisition
from warpsar.kernels.backproject import first_surface_kernel
from warpsar.kernels.codes import Variant
from warpsar.measured.ground import pixel_centres
from warpsar.measured.placed import frame_of
from warpsar.world.collection import Collection, CollectionErrors
from warpsar.world.frame import SPEED_OF_LIGHT, ViewGeometry
from warpsar.world.sensors import noise_beta0
from warpsar.world.site import Site
from warpsar.world.tables import Polarization, View
from warpsar.world.taper import taper, width_in_cells
from warpsar.world.track import Track, along, circle, straight
from warpsar.world.world import World, geometry_of, refuse_without_views

F64 = NDArray[np.float64]
SPEED_M_S = 7500.0
TURNTABLE_S = 60.0
"""Of a turntable's turn through its aperture, where no `prf_hz` says it."""
SPARE = 0.7
"""Share of what is unambiguous that the scene takes, where the number of samples is free."""
MOST = 0.8
"""Share that it may take at most: CPHD asks for samples of frequency a little denser than needed."""
FEWEST, MOST_PULSES = 32, 10_000_000
HALFWAY_DEG = 12.0
"""Between transmitter and receiver. Up to it what has backscatter alone is that of one antenna halfway between them.
Physical optics of a face tilted by 45 degrees to it would be wrong by tan(45) tan(6 degrees), 1 dB."""
FORWARD_DEG = 150.0
"""Within 30 degrees of the forward direction the shadow of a body of two wavelengths and more sends: its lobe's first
null lies at lambda / D. Faces that both antennas see do not have it."""
NEAREST_M = 1e-3
"""Of a transmitter to the reference point, which it sees in some direction."""
ROUNDED = 1e-3
"""Share by which a stated width may be below what band or aperture hold: files round it."""
FINER = 0.05
"""Share by which it may be above, where an effect states it: that to which headers of images know their widths."""
_SHOWN = 200
"""Pulses that are looked at for ambiguity, with the one after each."""


@dataclass(frozen=True)
class Plan:
    """Track, band and system of one view. Lengths about the reference point are those of `Site`."""

    view: View
    table: Collection
    """With what its preset states."""
    geometry: ViewGeometry
    site: Site
    track: Track
    start_hz: float
    step_hz: float
    frequencies: int
    corners_m: F64
    """Corners of the box about the mesh, (8, 3); wider by what effects shift."""
    response: Response = field(default_factory=Response)
    """What was asked of the widths, and the tapers."""
    effects: tuple[DeclaredEffect, ...] = ()
    """That act in this view, in their order."""
    track_error: Track | None = None
    """The recorded track, where it is not the true one."""
    pattern: AntennaPatternTable | None = None
    """The antenna's two-way pattern, where it was measured."""

    @property
    def recorded(self) -> Track:
        """The track as files and focusing know it."""
        return self.track if self.track_error is None else self.track_error

    @property
    def middle(self) -> int:
        """The pulse in the middle."""
        return len(self.track) // 2

    @property
    def centre_hz(self) -> float:
        """Middle of the band."""
        return self.start_hz + 0.5 * (self.frequencies - 1) * self.step_hz

    @property
    def bandwidth_hz(self) -> float:
        return self.frequencies * self.step_hz

    @property
    def stripmap(self) -> bool:
        return self.table.mode == "stripmap"

    @property
    def ground(self) -> bool:
        """Whether an image lies in the level plane: where the track is not straight, the slant plane defocuses."""
        return self.track.straight is None

    @property
    def slant_range_m(self) -> float:
        """From the reference point to the middle of the track."""
        return float(self.track.centre().reference_m()[0])

    @cached_property
    def beam_gain(self) -> F64:
        """Two-way amplitude of the antenna toward the reference point, (p,)."""
        return beam(self, np.zeros((1, 3)), np.arange(len(self.track)))[:, 0]

    @property
    def acquisition(self) -> Acquisition:
        """What files of the standards say of it."""
        return Acquisition(
            self.view.name, self.stripmap, self.site, self.recorded, self.start_hz, self.step_hz, self.frequencies
        )

    @property
    def windows(self) -> tuple[str, str]:
        """Of range and azimuth. The beam of a stripmap is its taper."""
        band, aperture = self.response.taper
        return str(band), "none" if self.stripmap else str(aperture)

    def noise_of(self, polarization: str) -> float:
        """Mean beta0 of the receiver's noise in a focused image."""
        level = self.table.noise_beta0 + sum(one.effect.noise_beta0(one.values) for one in self.effects)
        nesz_db = self.table.nesz_db.get(cast(Polarization, polarization))
        return level if nesz_db is None else level + noise_beta0(nesz_db, self.view.incidence_deg)

    @cached_property
    def shift_m(self) -> F64:
        """How far scatterers lie beside their places, (3,) [m]: along range and azimuth in the image's plane."""
        moved = [one.effect.shift_m(one.values, self.geometry) for one in self.effects]
        along, across = np.sum(moved, axis=0) if moved else np.zeros(2)
        row, column = plan_axes(self)
        found: F64 = along / float(row @ self.geometry.d) * row + across * column
        return found

    @cached_property
    def copies(self) -> tuple[Copy, ...]:
        """Further images of all scatterers that lie in the image."""
        return tuple(copy for one in self.effects for copy in one.effect.copies(one.values))

    @property
    def moves_scatterers(self) -> bool:
        """Whether an effect changes scatterers: their power, their places or their number."""
        return bool(self.copies) or any(one.effect.stage in ("gain", "position") for one in self.effects)

    def geometry_at(self, pulse: int) -> ViewGeometry:
        """Axes of the view as a pulse sees the reference point; those of a stripmap are those of its track."""
        if self.stripmap or pulse == self.middle:
            return self.geometry
        s = self.track.towards()[pulse]
        u = np.cross([0.0, 0.0, 1.0], -s)
        u /= np.linalg.norm(u)
        return replace(self.geometry, s=s, d=-s, u=u, v=np.cross(u, -s))

    @cached_property
    def cells_m(self) -> tuple[float, float]:
        """Cells of the whole band in slant range, c / 2B, and of the whole track in azimuth, lambda / 2 aperture.

        Of two antennas both are those along and across the direction halfway between them.
        """
        mean = self.track.mean_towards()
        turn = mean @ np.linalg.svd(mean - mean.mean(axis=0), full_matrices=False)[2][0]
        width = float(np.ptp(turn)) * len(turn) / (len(turn) - 1)
        band = self.bandwidth_hz * float(np.linalg.norm(mean[self.middle]))
        return SPEED_OF_LIGHT / (2.0 * band), SPEED_OF_LIGHT / self.centre_hz / (2.0 * width)

    @cached_property
    def cosine(self) -> F64:
        """Cosine of the angle between the sensor and azimuth, (p,), as the reference point sees them."""
        towards = self.track.towards()
        axis = np.linalg.svd(towards - towards.mean(axis=0), full_matrices=False)[2][0]
        return towards @ axis

    @cached_property
    def _place(self) -> F64:
        """Of each pulse along the aperture, (p,), -1/2 to 1/2."""
        place = (self.cosine - 0.5 * (self.cosine.max() + self.cosine.min())) / np.ptp(self.cosine)
        return np.asarray(place * (len(place) - 1) / len(place))

    @cached_property
    def azimuth_taper(self) -> F64:
        """The taper of each pulse, (p,), as `measured.focus` applies it."""
        return taper(self.windows[1], self._place)

    @cached_property
    def phase_error(self) -> F64 | None:
        """By how much effects turn each pulse, (p,) [rad]; None where none does."""
        ends = self.track.towards()[[int(self._place.argmin()), int(self._place.argmax())]] @ self.geometry.u
        place = 2.0 * self._place * (1.0 if ends[1] >= ends[0] else -1.0)  # along azimuth, whatever way it is flown
        found = [one.effect.phase(one.values, one.settings, place) for one in self.effects]
        turned = [one for one in found if one is not None]
        return np.sum(turned, axis=0) if turned else None

    def recorded_turn(self) -> NDArray[np.complex64] | None:
        """What the system does to samples, (pulses, frequencies): effects' phases, and errors of `[collection]`; None
        where nothing.

        Echoes that come late by t are turned by -2 pi f t, and so by the way to the reference point that the recorded
        track has too little. Oscillators that differ turn them by 2 pi in each of their periods.
        """
        errors = self.table.errors or CollectionErrors()
        late = np.full(len(self.track), errors.timing_s)
        late += 2.0 / SPEED_OF_LIGHT * (self.track.reference_m() - self.recorded.reference_m())
        turns = errors.frequency_hz * (self.track.time_s - self.track.centre().time_s)
        if self.phase_error is not None:
            turns = turns + self.phase_error / (2.0 * np.pi)
        if not (late.any() or turns.any()):
            return None
        whole = turns[:, None] - late[:, None] * (self.start_hz + self.step_hz * np.arange(self.frequencies))
        return np.exp(2j * np.pi * (whole - np.round(whole))).astype(np.complex64)

    @property
    def smeared_cells(self) -> float:
        """Cells by which `phase_error` moves power at most: its slope over pi, along the aperture of -1 to 1."""
        if self.phase_error is None:
            return 0.0
        return float(np.abs(np.gradient(self.phase_error, 2.0 * self._place)).max() / np.pi)

    @cached_property
    def azimuth_weights(self) -> F64:
        """The taper times the antenna's pattern, (p,)."""
        weights: F64 = self.azimuth_taper * self.beam_gain
        return weights

    @cached_property
    def response_m2(self) -> float:
        """Integral of a point's power over its peak, over slant range and azimuth [m2].

        Parseval: sum w^2 / dA over (sum w)^2, where each sample with its weight w stands for an area dA of the spatial
        frequencies [1/m2]. It holds for any track.
        """
        row, column = plan_axes(self)
        both = [
            place / np.linalg.norm(place, axis=1)[:, None]
            for place in (self.track.receiver_m, self.track.transmitter_m)
        ]
        along = (both[0] + both[1]) @ np.stack([row, column], axis=1) / SPEED_OF_LIGHT
        step = np.gradient(along, axis=0)
        area = np.abs(along[:, 0] * step[:, 1] - along[:, 1] * step[:, 0])  # of 1 Hz at 1 Hz
        frequency = self.start_hz + self.step_hz * np.arange(self.frequencies)
        band = band_weights(self.windows[0], self.frequencies)
        weights = self.azimuth_weights
        used = area > 1e-9 * area.max()
        power = (band**2 / (frequency * self.step_hz)).sum() * (weights[used] ** 2 / area[used]).sum()
        found = power / (band.sum() * weights.sum()) ** 2
        sine = float(np.hypot(*self.geometry.d[:2]))
        return float(found * (sine if self.ground else 1.0))

    def knots(self, step_deg: float) -> NDArray[np.int64]:
        """Pulses from which scatterers are seen, about `step_deg` apart: the middle one of a narrow aperture."""
        steps = np.max([np.linalg.norm(np.diff(end, axis=0), axis=1) for end in self.track.ends()], axis=0)
        way = np.concatenate([[0.0], np.cumsum(steps)])
        count = round(np.rad2deg(way[-1]) / step_deg)
        if count < 1:
            return np.array([self.middle])
        return np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], count + 1)).clip(0, len(way) - 1))


def beam(plan: Plan, points_m: F64, pulses: NDArray[np.int64]) -> F64:
    """Two-way amplitude of the antenna toward points (n, 3) [m], (pulses, n); 1 without an antenna."""
    axes, widths = boresight(plan)
    total = np.ones((len(pulses), len(points_m)))
    if plan.pattern is not None:
        to = points_m[None] - plan.track.receiver_m[pulses][:, None]
        to /= np.linalg.norm(to, axis=2, keepdims=True)
        aside = [np.rad2deg(np.arcsin(np.einsum("pnk,pk->pn", to, axis).clip(-1.0, 1.0))) for axis in axes[:, pulses]]
        return np.abs(plan.pattern.at(*aside))
    if not widths.any():
        return total
    for place in (plan.track.receiver_m[pulses], plan.track.transmitter_m[pulses]):
        to = points_m[None] - place[:, None]
        to /= np.linalg.norm(to, axis=2, keepdims=True)
        for axis, width in zip(axes[:, pulses], widths, strict=True):
            if width > 0.0:  # numpy's sinc is sin(pi x) / (pi x), of half power at x = 0.443
                total *= np.sinc(0.443 * 2.0 * np.einsum("pnk,pk->pn", to, axis) / width)
    return total


def boresight(plan: Plan) -> tuple[F64, F64]:
    """Unit vectors across the beam, (2, p, 3): level and forward along the flight, and up; and the sines of the
    half-power widths, (2,).

    The beam of a spotlight follows the reference point. That of a stripmap stays abeam, or squinted.
    """
    antenna = plan.table.antenna
    if antenna is None:
        return np.zeros((2, len(plan.track), 3)), np.zeros(2)
    if plan.stripmap:
        look = np.broadcast_to(plan.geometry.d, (len(plan.track), 3))
    else:
        look = -plan.track.receiver_m / np.linalg.norm(plan.track.receiver_m, axis=1, keepdims=True)
    level = np.cross([0.0, 0.0, 1.0], look)
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    flight = np.einsum("pk,pk->p", level, np.gradient(plan.track.receiver_m, axis=0))
    level *= np.where(flight < 0.0, -1.0, 1.0)[:, None]
    up = np.array([0.0, 0.0, 1.0]) - look * look[:, 2:]
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    widths = [antenna.azimuth_deg or 0.0, antenna.elevation_deg or 0.0]
    return np.stack([level, up]), np.sin(np.deg2rad(widths))


def plans_of(world: World, device: wp.Device, product: Product = "slc") -> list[Plan]:
    """The plans of all views. Raises InputError as `plan_of` does, and for what the product does not have."""
    refuse_without_views(world)
    for term in {"transmission", "edge_waves"} & set(world.radar.terms):
        raise InputError(
            f'{world.name}: radar.terms: found "{term}", which an RCS alone has; leave it out for a product '
            "along a track"
        )
    if world.collection is not None:
        refuse_left_out(world, product)
    return [plan_of(world, view, device) for view in world.views]


def plan_of(world: World, view: View, device: wp.Device) -> Plan:
    """The plan of a view. Raises InputError, one message, for a collection that cannot be."""
    if world.collection is None:
        raise InputError(f"{world.name}: found no [collection]; a product with phase needs one")
    effects = tuple(declared(world, view))
    table, response = asked(world, effects)
    carrier = view.frequency_hz or world.radar.frequency_hz
    if table.preset is not None and not BANDS_HZ[table.preset][0] <= carrier <= BANDS_HZ[table.preset][1]:
        low, high = BANDS_HZ[table.preset]
        raise InputError(
            f"{world.name}: collection.preset: found {table.preset!r} with a carrier of {carrier:g} Hz; must be "
            f"{low:g} to {high:g}"
        )
    low, high = _band(table, response, carrier, world.name)
    site = Site(np.asarray(world.reference_point_m, np.float64), frame_of(world))
    vertices = site.about(world.mesh.vertices)
    geometry = geometry_of(world, view)
    reach = sum(float(np.linalg.norm(one.effect.shift_m(one.values, geometry))) for one in effects)
    ends = np.stack([vertices.min(axis=0) - reach, vertices.max(axis=0) + reach])
    corners = np.stack(np.meshgrid(*ends.T, indexing="ij"), axis=-1).reshape(-1, 3)
    made = Plan(view, table, geometry, site, _dot(), low, high - low, 2, corners, response, effects)
    made = _pointed(world, made)
    made = replace(made, track=_track(world, made, 0.5 * (low + high)))
    if made.track.bistatic:
        _refuse_wide(world, made)  # near the forward direction no band resolves ranges
        low, high = _band(table, response, carrier, world.name, _shortened(made))
        made = replace(made, start_hz=low, step_hz=high - low)
        made = replace(made, track=_track(world, made, 0.5 * (low + high), _azimuth_m(made)))
    made = _misrecorded(made)
    _refuse_channels(world, table)
    _refuse_wide(world, made)
    _refuse_narrow(world, made)
    _refuse_ground(world, made, device)
    made = _sampled_band(world, made, low, high)
    _refuse_coarse(world, made)
    _refuse_finer(world, made)
    _refuse_gaps(world, made)
    return made


def _dot() -> Track:
    return Track(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))


def _key(effects: Sequence[DeclaredEffect], axis: int) -> str:
    """The key that states the width along an axis."""
    name = next((one.effect.name for one in effects if response_of([one]) != Response()), None)
    return "collection.resolution_m" if name is None else f"effects.{name}.{('range', 'azimuth')[axis]}_fwhm_m"


def _shortened(plan: Plan) -> float:
    """Cosine of half the angle between both antennas in the middle of the track: the share of the band that counts."""
    return float(np.linalg.norm(plan.track.mean_towards()[plan.middle]))


def _azimuth_m(plan: Plan) -> float:
    """Width in azimuth that the track holds [m]."""
    return width_in_cells(plan.windows[1]) * plan.cells_m[1]


def _refuse_coarse(world: World, plan: Plan) -> None:
    """Raise InputError for a band that does not hold the resolution asked for."""
    width = plan.response.width_m[0]
    held = width_in_cells(plan.windows[0]) * SPEED_OF_LIGHT / (2.0 * plan.bandwidth_hz * _shortened(plan))
    if width is not None and held > width * (1.0 + ROUNDED):
        raise InputError(
            f"{world.name}: {_key(plan.effects, 0)}: found {width:g} m in range, but a band of "
            f"{plan.bandwidth_hz:.4g} Hz with the window {plan.windows[0]!r} holds {held:.3g} m; must be at least "
            "that, or a wider band"
        )


def _band(
    table: Collection, response: Response, carrier: float, name: str, shortened: float = 1.0
) -> tuple[float, float]:
    """The first and the last frequency. `shortened`: the share of a band that counts where it follows from a width."""
    if table.start_hz is not None and table.stop_hz is not None:
        if not table.start_hz <= carrier <= table.stop_hz:
            raise InputError(
                f"{name}: collection.start_hz, stop_hz: found {table.start_hz:g} to {table.stop_hz:g}; must hold the "
                f"carrier frequency, {carrier:g}"
            )
        return table.start_hz, table.stop_hz
    width = table.bandwidth_hz
    if width is None and response.width_m[0] is not None:
        width = width_in_cells(str(response.taper[0])) * SPEED_OF_LIGHT / (2.0 * response.width_m[0] * shortened)
    if width is None:
        raise InputError(
            f"{name}: collection.bandwidth_hz: missing; must be stated, or effects.point_spread.range_fwhm_m, or a "
            "preset"
        )
    if width >= carrier:
        raise InputError(f"{name}: collection.bandwidth_hz: found {width:.4g}; must be below the carrier, {carrier:g}")
    return carrier - 0.5 * width, carrier + 0.5 * width


def _track(world: World, plan: Plan, frequency: float, held_m: float | None = None) -> Track:
    """The track of the plan's table; `held_m`: the azimuth width that a first one held with a transmitter apart."""
    table, name = plan.table, world.name
    if table.trajectory is not None:
        return track_file.read(table.trajectory, plan.site.reference_m, plan.site.frame)
    slant = table.slant_range_m or world.slant_range_m(plan.view)
    if slant is None:
        raise InputError(f"{name}: collection.slant_range_m: missing; must be stated here, in the view or in [radar]")
    aperture = _aperture(world, plan, frequency, held_m)
    speed = table.speed_m_s or SPEED_M_S

    def flown(count: int, whole: bool = False) -> Track:
        """`whole`: as long as the aperture takes, however often pulses come."""
        if table.mode in ("circular", "inverse"):
            sine = float(np.hypot(*plan.geometry.s[:2]))
            lasts = slant * sine * np.deg2rad(aperture) / speed if table.mode == "circular" else TURNTABLE_S
            if table.mode == "inverse" and table.prf_hz is not None:
                lasts = count / table.prf_hz
            return circle(plan.view.azimuth_deg, plan.geometry, slant, table.side, aperture, lasts, count)
        way = along(plan.geometry, table.side, table.squint_deg)
        if way is None or aperture >= 180.0:
            raise InputError(
                f"{name}: collection: found squint_deg = {table.squint_deg:g}, aperture_deg = {aperture:.4g}; level "
                f"flight at an incidence of {plan.view.incidence_deg:g} degrees has neither"
            )
        length = 2.0 * slant * math.tan(0.5 * np.deg2rad(aperture)) / math.cos(np.deg2rad(table.squint_deg))
        if table.mode == "stripmap":  # every point of the image within the aperture passes through the beam
            length += world.grid.shape[1] * world.grid.spacing_m[1]
        if table.prf_hz is None or whole:
            return straight(plan.geometry, slant, way, length, speed, count)
        if table.pulses is None:  # a part of a pulse longer, so that pulses come as often as stated
            return straight(plan.geometry, slant, way, count * speed / table.prf_hz, speed, count)
        return straight(plan.geometry, slant, way, length, length * table.prf_hz / count, count)

    count = table.pulses
    if count is None and table.prf_hz is not None and table.mode != "inverse":
        long = flown(FEWEST, whole=True).time_s
        lasts_s = (long[-1] - long[0]) * FEWEST / (FEWEST - 1)
        if not 2.0 <= lasts_s * table.prf_hz + 1e-6 <= MOST_PULSES:
            raise InputError(
                f"{name}: collection.prf_hz: found {table.prf_hz:g}, which gives {lasts_s * table.prf_hz:.3g} pulses "
                f"in the {lasts_s:.3g} s of the track; must give 2 to {MOST_PULSES}"
            )
        count = math.ceil(lasts_s * table.prf_hz - 1e-6)
    if count is None:
        trial = replace(plan, track=_sent(flown(1024), table, name))
        count = max(FEWEST, fft.next_fast_len(math.ceil(1024 * _turns(world, trial, frequency).max() / SPARE)))
    return _sent(flown(count), table, name)


def _pointed(world: World, plan: Plan) -> Plan:
    """The plan with the pattern of its antenna, where it was measured."""
    antenna = plan.table.antenna
    if antenna is None or antenna.pattern is None:
        return plan
    if plan.table.transmitter is not None:
        raise InputError(
            f"{world.name}: collection.antenna.pattern: found a two-way pattern beside a transmitter; must be "
            "azimuth_deg there"
        )
    return replace(plan, pattern=antenna_file.read(antenna.pattern))


def _misrecorded(plan: Plan) -> Plan:
    """The plan with its recorded track, and a box of corners wider by what errors of the system shift."""
    errors = plan.table.errors
    if errors is None:
        return plan
    far = 0.5 * SPEED_OF_LIGHT * abs(errors.timing_s)
    if errors.frequency_hz:
        speed = float(np.linalg.norm(plan.track.velocity_m_s()[0][plan.middle]))
        wavelength = SPEED_OF_LIGHT / plan.centre_hz
        far += 0.5 * wavelength * plan.slant_range_m * abs(errors.frequency_hz) / max(speed, 1e-9)
    if errors.track is not None:
        aside = track_file.read_error(errors.track, plan.track.time_s)
        far += float(np.linalg.norm(aside, axis=1).max())
        track = plan.track
        plan = replace(
            plan,
            track_error=replace(track, receiver_m=track.receiver_m + aside, transmitter_m=track.transmitter_m + aside),
        )
    middle = plan.corners_m.mean(axis=0)
    return replace(plan, corners_m=plan.corners_m + far * np.sign(plan.corners_m - middle))


def _refuse_channels(world: World, table: Collection) -> None:
    """Raise InputError for channels whose waves the scene does not have."""
    names = world.radar.polarizations
    errors = table.errors or CollectionErrors()
    for key in ("transmit", "receive"):
        channels = getattr(errors, key)
        if channels is not None and channels.crosstalk and set(names) != {"HH", "HV", "VH", "VV"}:
            raise InputError(
                f"{world.name}: collection.errors.{key}: found crosstalk beside radar.polarizations = {list(names)}; "
                "must be all four, which mix"
            )
    if unknown := set(table.nesz_db) - set(names):
        raise InputError(
            f"{world.name}: collection.nesz_db: found {', '.join(sorted(unknown))}; must be of radar.polarizations = "
            f"{list(names)}"
        )


def _sent(track: Track, table: Collection, name: str) -> Track:
    """The track with the transmitter that stands apart."""
    if table.transmitter is None:
        return track
    place = np.asarray(table.transmitter.position_m) + track.time_s[:, None] * table.transmitter.velocity_m_s
    if (nearest := float(np.linalg.norm(place, axis=1).min())) < NEAREST_M:
        raise InputError(
            f"{name}: collection.transmitter: found a place {nearest:.3g} m from the reference point; must be "
            f"{NEAREST_M:g} m away or more"
        )
    return replace(track, transmitter_m=place, straight=None)


def _aperture(world: World, plan: Plan, frequency: float, held_m: float | None = None) -> float:
    """Angle of the aperture [deg]; refuses one that does not hold the resolution asked for. `held_m` as in `_track`:
    where one of two antennas stands still, the direction between them turns half as far."""
    table = plan.table
    given = table.aperture_deg
    if given is None and table.mode in ("circular", "inverse"):
        given = 360.0 if table.mode == "circular" else None
    asked_m = plan.response.width_m[1]
    if asked_m is None:
        if given is None:
            raise InputError(
                f"{world.name}: collection.aperture_deg: missing; must be stated, or "
                "effects.point_spread.azimuth_fwhm_m, or a preset"
            )
        return given
    needed = width_in_cells(plan.windows[1]) * SPEED_OF_LIGHT / frequency / (2.0 * asked_m)
    if held_m is not None:
        needed *= held_m / asked_m
    needed = np.rad2deg(2.0 * math.asin(min(1.0, 0.5 * needed)))
    if given is not None and given < needed * (1.0 - ROUNDED):
        raise InputError(
            f"{world.name}: {_key(plan.effects, 1)}: found {asked_m:g} m in azimuth, which takes an "
            f"aperture of {needed:.3g} degrees; aperture_deg is {given:g}; must be at least that"
        )
    return float(needed) if given is None else given


def _refuse_wide(world: World, plan: Plan) -> None:
    """Raise InputError for antennas farther apart than what is declared holds for."""
    angle = plan.track.bistatic_deg()
    if angle <= HALFWAY_DEG:
        return
    materials = (world.materials[name] for name in world.mesh.materials)
    why = [f"{what}, of backscatter" for what in ['radar.terms "edges"'] if "edges" in world.radar.terms]
    if "rough" in world.radar.terms:
        variant = int(Variant[world.radar.variant.upper()])
        why += [f"{what}, of backscatter" for what in backscatter_alone(materials, variant)]
    most = HALFWAY_DEG if why else FORWARD_DEG
    if angle > most:
        if not why:
            why = ["forward scatter, which has the field of shadows"]
        key = "trajectory" if plan.table.trajectory is not None else "transmitter"
        raise InputError(
            f"{world.name}: collection.{key}: found the transmitter {angle:.3g} degrees from the receiver, as the "
            f"reference point sees them in view {plan.view.name}; must be at most {most:g} with {'; '.join(why)}"
        )


def _refuse_narrow(world: World, plan: Plan) -> None:
    """Raise InputError for a track from a file whose aperture is none, or does not hold the resolution asked for; or
    with a transmitter apart, which the stated aperture does not know."""
    table = plan.table
    if table.trajectory is None and table.transmitter is None:
        return
    if table.trajectory is not None and np.ptp(plan.cosine) < 1e-12:
        raise InputError(
            f"{world.name}: collection.trajectory: found {table.trajectory}, whose sensor the reference point sees in "
            "one direction all the time; must move across it"
        )
    if (asked_m := plan.response.width_m[1]) is not None:
        held = _azimuth_m(plan)
        if held > asked_m * (1.0 + (ROUNDED if table.transmitter is None else FINER)):
            which = f"of {table.trajectory}" if table.trajectory is not None else "beside the transmitter"
            raise InputError(
                f"{world.name}: {_key(plan.effects, 1)}: found {asked_m:g} m in azimuth, but the track {which} with "
                f"the window {plan.windows[1]!r} holds {held:.3g} m; must be at least that"
            )


def _refuse_finer(world: World, plan: Plan) -> None:
    """Raise InputError where a stated band or aperture is finer than the width that an effect gives images of power.

    The image would be another one than the scene declares. `resolution_m` only asks for what they hold at least.
    """
    table = plan.table
    aperture = "trajectory" if table.trajectory is not None else "aperture_deg" if table.aperture_deg else None
    band = "bandwidth_hz" if table.bandwidth_hz else "start_hz" if table.start_hz else None
    for axis, key in enumerate((band, None if plan.stripmap else aperture)):
        if key is None:
            continue
        held = width_in_cells(plan.windows[axis]) * plan.cells_m[axis]
        width = response_of(plan.effects).width_m[axis]
        if width is not None and width > held * (1.0 + FINER):
            raise InputError(
                f"{world.name}: {_key(plan.effects, axis)}: found {width:g} m beside collection.{key}, which holds "
                f"{held:.3g} m; must be that, or leave collection.{key} out"
            )


def _places(world: World, plan: Plan) -> F64:
    """The scene's corners and points between them, and the image's corners, (n, 3)."""
    low, high = plan.corners_m.min(axis=0), plan.corners_m.max(axis=0)
    part = np.stack(np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9), [0.0, 1.0], indexing="ij"), axis=-1)
    return np.concatenate([low + part.reshape(-1, 3) * (high - low), _ends(world, plan)])


def _ends(world: World, plan: Plan) -> F64:
    """The image's corners, (4, 3) [m]."""
    axes = pixel_centres(world.grid.shape, world.grid.spacing_m, (1, 1))
    row, column = plan_axes(plan)
    return np.array([r * row + a * column for r in axes[0][[0, -1]] for a in axes[1][[0, -1]]])


def _turns(world: World, plan: Plan, frequency: float) -> F64:
    """From pulse to pulse: how many turns more the phase of one part of scene or image makes than that of another.

    Parts outside the main lobe of the beam do not count.
    """
    first = np.unique(np.linspace(0, len(plan.track) - 2, min(_SHOWN, len(plan.track) - 1)).astype(int))
    places = _places(world, plan)
    change = plan.track.ranges_less_reference(places, first + 1) - plan.track.ranges_less_reference(places, first)
    seen = np.abs(beam(plan, places, first)) > 0.05
    high = np.where(seen, change, -np.inf).max(axis=1)
    low = np.where(seen, change, np.inf).min(axis=1)
    return np.maximum(high - low, 0.0) * 2.0 * frequency / SPEED_OF_LIGHT


def _refuse_gaps(world: World, plan: Plan) -> None:
    """Raise InputError where pulses are too far apart for the scene."""
    turns = _turns(world, plan, plan.centre_hz + 0.5 * plan.bandwidth_hz)
    if turns.max() >= 1.0 and not plan.table.azimuth_ambiguities:
        table, times = plan.table, turns.max() / SPARE
        found = f"{table.pulses}", "pulses", f"{math.ceil(len(plan.track) * times)} pulses"
        if table.pulses is None and table.prf_hz is not None:
            found = f"{table.prf_hz:g}, {len(plan.track)} pulses", "prf_hz", f"{table.prf_hz * times:.3g} 1/s"
        elif table.trajectory is not None:
            found = f"{len(plan.track)} pulses", "trajectory", f"{math.ceil(len(plan.track) * times)} pulses"
        raise InputError(
            f"{world.name}: collection.{found[1]}: found {found[0]}, so far apart that the ends of scene or image "
            f"differ by {turns.max():.3g} turns of phase from one to the next (ambiguous); must be below 1: "
            f"about {found[2]}"
        )


def swath_m(world: World, plan: Plan) -> float:
    """Largest way of the scene or the image from the reference point, in range [m]."""
    pulses = np.unique(np.linspace(0, len(plan.track) - 1, 33).astype(int))
    ends = np.concatenate([plan.corners_m, _ends(world, plan)])
    return float(np.abs(plan.track.ranges_less_reference(ends, pulses)).max())


def plan_axes(plan: Plan) -> tuple[F64, F64]:
    """Unit vectors along the rows' and the columns' direction of an image's plane."""
    if not plan.ground:
        return plan.geometry.d, plan.geometry.u
    return np.array([*plan.geometry.d[:2], 0.0]) / np.hypot(*plan.geometry.d[:2]), plan.geometry.u


def _sampled_band(world: World, plan: Plan, low: float, high: float) -> Plan:
    """The band in as many samples as the scene needs, or as many as are stated, which must be enough."""
    swath = swath_m(world, plan)
    needed = 4.0 * swath * (high - low) / SPEED_OF_LIGHT
    count = plan.table.frequencies or max(FEWEST, fft.next_fast_len(math.ceil(needed / SPARE)))
    if needed > MOST * count:
        raise InputError(
            f"{world.name}: collection.frequencies: found {count} in {high - low:.4g} Hz, which tell ranges "
            f"within {MOST * SPEED_OF_LIGHT * count / (4.0 * (high - low)):.4g} m of the reference point; the "
            f"scene or the image reaches {swath:.4g} m; must be at least {math.ceil(needed / MOST)}"
        )
    step = (high - low) / count
    return replace(plan, start_hz=low + 0.5 * step, step_hz=step, frequencies=count)


def _refuse_ground(world: World, plan: Plan, device: wp.Device) -> None:
    """Raise InputError where the track leads under the mesh, or below all of it."""
    low, high = plan.corners_m[:, 2].min(), plan.corners_m[:, 2].max()
    for what, place in (("sensor", plan.track.receiver_m), ("transmitter", plan.track.transmitter_m)):
        deep = np.flatnonzero(place[:, 2] < high)
        if not len(deep):
            continue
        top = np.array([0.0, 0.0, high + 1.0])
        waypoints = np.stack([place[deep] * [1.0, 1.0, 0.0] + top, place[deep]], axis=1).astype(np.float32)
        mesh = wp.Mesh(
            wp.array(plan.site.about(world.mesh.vertices).astype(np.float32), dtype=wp.vec3, device=device),
            wp.array(world.mesh.faces.astype(np.int32).ravel(), dtype=int, device=device),
        )
        under = wp.empty(len(deep), dtype=float, device=device)
        inputs = [mesh.id, wp.array(waypoints, dtype=wp.vec3, device=device)]
        wp.launch(first_surface_kernel, len(deep), inputs=inputs, outputs=[under], device=device)
        bad = deep[(under.numpy() >= 0.0) | (place[deep, 2] < low)]
        if len(bad):
            x, y, z = place[bad[0]] + plan.site.reference_m
            raise InputError(
                f"{world.name}: collection: found the {what} under the ground at {len(bad)} of {len(place)} pulses, "
                f"first at ({x:.1f}, {y:.1f}, {z:.1f}) m; must be above the mesh"
            )
