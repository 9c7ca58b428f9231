"""Scatterers of a collection: what the places of a body send back, and its deposit into range bins and images.

A deposit spreads each scatterer over WIDTH bins of a grid twice as fine as the samples' spectrum needs, with the
"exponential of a semicircle" (Barnett, Magland, af Klinteberg, SIAM J. Sci. Comput. 41(5), 2019). Its transform is
divided out after the FFT. What is left of the error stands in docs/coherent-checks.md.
"""

import numpy as np
import warp as wp
from numpy.typing import NDArray

from warpsar.kernels.coherent.coated_edges import diffracted_of
from warpsar.kernels.coherent.diffuse import diffused, there_and_back
from warpsar.kernels.coherent.edges import Edge, diffracted
from warpsar.kernels.coherent.numbers import product, turned
from warpsar.kernels.coherent.placing import Patches
from warpsar.kernels.coherent.radiate import Four, Pair, bounced_fields, plus, sent, tube_factor, unit
from warpsar.kernels.coherent.reflection import Face
from warpsar.kernels.coherent.rough import RoughSurface, Scatterer, scattered_between, scattered_toward
from warpsar.kernels.coherent.tubes import Hit, TubeRadar, look

WIDTH = wp.constant(6)
"""Bins of a deposit."""
HALF = wp.constant(wp.float64(3.0))
"""Half of WIDTH."""
BETA = wp.constant(13.8)
"""Exponent of the spread: 2.3 for each bin."""
TWO_PI = wp.constant(6.283185307179586)


@wp.struct
class Beam:
    """Unit vectors across the beam of each pulse, and the sine of its half-power widths; 0 is even.

    Or a measured two-way pattern over azimuth and elevation off its axis, from `start` [deg] on, `every` to a degree.
    """

    along: wp.array[wp.vec3d]
    up: wp.array[wp.vec3d]
    wide: float
    high: float
    pattern: wp.array2d[wp.vec2]
    start: wp.vec2
    every: wp.vec2


@wp.struct
class SensorTrack:
    """Where the sensor is at each pulse."""

    time: wp.array[wp.float64]  # [s]
    receiver: wp.array[wp.vec3d]  # about the reference point [m]
    transmitter: wp.array[wp.vec3d]
    receiver_own: wp.array[wp.float64]  # distances to the reference point [m]
    transmitter_own: wp.array[wp.float64]
    bistatic: int
    beam: Beam


@wp.struct
class MovingScatterers:
    """Scatterers about the reference point."""

    point: wp.array[wp.vec3d]  # [m]
    velocity: wp.array[wp.vec3d]  # [m/s], or none where all stand
    amplitude: wp.array2d[wp.vec2]  # (polarizations, n)


@wp.func
def in_float(value: wp.vec2d) -> wp.vec2:
    return wp.vec2(float(value[0]), float(value[1]))


@wp.func
def unphased(value: wp.vec2d, turn: wp.vec2d) -> wp.vec2:
    """The amplitude times `turn`, which takes the phase of its place away, in float32."""
    return in_float(product(value, turn))


@wp.func
def keep_without_phase(
    amplitude_out: wp.array2d[wp.vec2], i: int, four: Four, radar: TubeRadar, k: wp.float64, point: wp.vec3d
):
    """Store four amplitudes of a place without the phase of the way to it."""
    turn = turned(wp.float64(2.0) * k * look(radar, point, 0.0).back)
    amplitude_out[i, 0] = unphased(four.hh, turn)
    amplitude_out[i, 1] = unphased(four.hv, turn)
    amplitude_out[i, 2] = unphased(four.vh, turn)
    amplitude_out[i, 3] = unphased(four.vv, turn)


@wp.func
def keep_in_float(amplitude_out: wp.array2d[wp.vec2], i: int, four: Four):
    amplitude_out[i, 0] = in_float(four.hh)
    amplitude_out[i, 1] = in_float(four.hv)
    amplitude_out[i, 2] = in_float(four.vh)
    amplitude_out[i, 3] = in_float(four.vv)


@wp.kernel(enable_backward=False)
def rough_places_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    k: wp.float64,
    surface_in: wp.array[RoughSurface],
    variant: int,
    scatterer_in: wp.array[Scatterer],
    seen_in: wp.array2d[wp.uint8],
    # Out:
    amplitude_out: wp.array2d[wp.vec2],
):
    """Amplitudes of rough places without the phase of the way, (n, 4) [m]."""
    i = wp.tid()
    if seen_in[0, i] == wp.uint8(0):
        return
    place = scatterer_in[i]
    radar = radar_in[0]
    sight = look(radar, place.point, 0.0)
    spread = wp.vec2d(sight.spread * sight.spread, wp.float64(0.0))
    four = scattered_toward(sight.s, spread, radar, k, surface_in[place.material], variant, place)
    keep_in_float(amplitude_out, i, four)


@wp.kernel(enable_backward=False)
def rough_places_apart_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    k: wp.float64,
    surface_in: wp.array[RoughSurface],
    scatterer_in: wp.array[Scatterer],
    seen_in: wp.array2d[wp.uint8],
    # Out:
    amplitude_out: wp.array2d[wp.vec2],
):
    """`rough_places_kernel` of two antennas, which both must see the place: transmitter and receiver."""
    i = wp.tid()
    if seen_in[0, i] == wp.uint8(0) or seen_in[1, i] == wp.uint8(0):
        return
    place = scatterer_in[i]
    four = scattered_between(radar_in[0], radar_in[1], k, surface_in[place.material], place)
    keep_in_float(amplitude_out, i, four)


@wp.kernel(enable_backward=False)
def edge_places_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    k: wp.float64,
    edge_in: wp.array[Edge],
    seen_in: wp.array2d[wp.uint8],
    # Out:
    amplitude_out: wp.array2d[wp.vec2],
):
    """Amplitudes of pieces of edges without the phase of the way to their middle, (n, 4) [m]."""
    i = wp.tid()
    if seen_in[0, i] == wp.uint8(0):
        return
    edge = edge_in[i]
    four = diffracted(radar_in[0], k, edge)
    keep_without_phase(amplitude_out, i, four, radar_in[0], k, edge.middle)


@wp.kernel(enable_backward=False, module="unique")
def coated_edge_places_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    k: wp.float64,
    edge_in: wp.array[Edge],
    seen_in: wp.array2d[wp.uint8],
    stuff_in: wp.array2d[Face],
    # Out:
    amplitude_out: wp.array2d[wp.vec2],
):
    """As `edge_places_kernel`, with coats."""
    i = wp.tid()
    if seen_in[0, i] == wp.uint8(0):
        return
    edge = edge_in[i]
    four = diffracted_of(radar_in[0], k, edge, stuff_in, 0)
    keep_without_phase(amplitude_out, i, four, radar_in[0], k, edge.middle)


@wp.struct
class Rates:
    """How fast the directions to both antennas turn: changes of the unit vectors, per pulse; zero for one antenna."""

    transmitter: wp.vec3d
    receiver: wp.vec3d


@wp.struct
class Antennas:
    """The two that see a body, one record each, and how fast the directions to them turn."""

    transmitter: wp.array[TubeRadar]
    receiver: wp.array[TubeRadar]
    rates: Rates


@wp.struct
class SentFields:
    """What faces are made of, and which of the fields that they send count.

    `single`: of first hits, on smooth faces. `more`: the currents of further ones. `diffuse`: what rough faces scatter
    further on, 1 on the way back as well, 2 on the way there alone.
    """

    k: wp.float64
    stuff: wp.array2d[Face]  # (1, materials)
    material: wp.array[int]  # of each face
    surface: wp.array[RoughSurface]
    log_factorial: wp.array[wp.float64]
    single: int
    more: int
    diffuse: int
    seed: int


@wp.func
def effective_place(
    radar: TubeRadar, receiver: TubeRadar, rates: Rates, entry: wp.vec3d, leave: wp.vec3d, way: wp.float64
) -> wp.vec3d:
    """Where a single bounce would have the same way, and the same change of it as the antennas move.

    The way changes by -(change of the direction to the transmitter) . entry, and likewise for the receiver and
    `leave`. Of one antenna the place lies halfway between them across the look direction.
    """
    turning = rates.transmitter + rates.receiver
    place = wp.float64(0.5) * (entry + leave)
    for _ in range(3):
        there = look(radar, place, 0.0)
        back = look(receiver, place, 0.0)
        both = there.s + back.s
        size = wp.dot(both, both)
        across = turning - wp.dot(turning, both) / size * both
        if wp.length(across) > wp.float64(1.0e-6) * wp.length(turning):
            missing = wp.dot(rates.transmitter, entry - place) + wp.dot(rates.receiver, leave - place)
            place = place + missing / wp.dot(across, across) * across
            there = look(radar, place, 0.0)
            back = look(receiver, place, 0.0)
        place = place - (way - there.back - back.back) / size * both
    return place


@wp.kernel(enable_backward=False)
def tube_places_kernel(
    # In:
    antennas: Antennas,
    of: SentFields,
    hits_in: wp.array2d[Hit],
    count_in: wp.array[int],
    # Out:
    place_out: wp.array2d[wp.vec3d],
    amplitude_out: wp.array3d[wp.vec2],
    face_out: wp.array2d[int],
):
    """Of every hit of a ray its effective place (rays, bounces) [m], its amplitude (rays, bounces, 4) [m], its face.

    The first hit counts on smooth faces alone: rough faces have places of their own. Further ones send by their
    currents. Those on rough faces scatter, too, on the way back as well where the receiver is the transmitter: it is
    then as long.
    """
    ray = wp.tid()
    k = of.k
    radar = antennas.transmitter[0]
    receiver = antennas.receiver[0]
    fields = Pair()
    fields.h = unit(radar.u)
    fields.v = unit(radar.v)
    for b in range(count_in[ray]):
        hit = hits_in[b, ray]
        stuff = of.stuff[0, of.material[hit.face]]
        back = bounced_fields(stuff, k, fields, hit.d, hit.normal)
        rough = stuff.rms_height > wp.float64(0.0)
        counts = hit.seen
        currents = of.more
        if b == 0:
            currents = of.single
            if rough:
                counts = 0
        if currents == 0 and (of.diffuse == 0 or b == 0 or not rough):
            counts = 0
        if counts != 0:
            sight = look(receiver, hit.point, 0.0)
            four = Four()
            if currents != 0:
                factor = tube_factor(k, hit, sight)
                four = sent(factor, fields, back, hit.d, hit.normal, sight.s, receiver.u, receiver.v)
            if b > 0 and of.diffuse != 0 and rough:
                surface = of.surface[of.material[hit.face]]
                scattered = diffused(receiver, k, surface, fields, hit, of.seed, of.log_factorial)
                if of.diffuse == 1:
                    scattered = there_and_back(scattered)
                four = plus(four, scattered)
            way = sight.back + hit.path
            turn = turned(k * way)
            place_out[ray, b] = effective_place(radar, receiver, antennas.rates, hits_in[0, ray].point, hit.point, way)
            face_out[ray, b] = hit.face
            amplitude_out[ray, b, 0] = unphased(four.hh, turn)
            amplitude_out[ray, b, 1] = unphased(four.hv, turn)
            amplitude_out[ray, b, 2] = unphased(four.vh, turn)
            amplitude_out[ray, b, 3] = unphased(four.vv, turn)
        fields = back


Six = wp.types.vector(length=6, dtype=float)
"""Weights of a deposit along one axis."""
DEGREE = 10


def _fitted() -> NDArray[np.float64]:
    """The weights of the first three bins as polynomials of the offset from the middle of its range, (3, DEGREE + 1),
    ascending: to 2e-7 of the largest weight."""
    x = 0.5 * np.cos(np.pi * (np.arange(200) + 0.5) / 200)
    distance = (x[None] - 2.5 + np.arange(3)[:, None]) / 3.0
    value = np.exp(BETA * (np.sqrt(np.maximum(1.0 - distance**2, 0.0)) - 1.0))
    return np.array([np.polynomial.polynomial.polyfit(x, row, DEGREE) for row in value])


_POWERS = _fitted()
_EVEN = [wp.constant(wp.vec3(*_POWERS[:, k].tolist())) for k in range(0, DEGREE + 1, 2)]
_ODD = [wp.constant(wp.vec3(*_POWERS[:, k].tolist())) for k in range(1, DEGREE, 2)]


@wp.func
def weights_from(first: float) -> Six:
    """Weights of WIDTH bins, of which the first lies at `first`, -3 to -2 from the deposit.

    Bins as far on the other side have the same weights for the opposite offset: even and odd powers serve both.
    """
    x = first + 2.5
    z = x * x
    even = wp.static(_EVEN[5])
    even = even * z + wp.static(_EVEN[4])
    even = even * z + wp.static(_EVEN[3])
    even = even * z + wp.static(_EVEN[2])
    even = even * z + wp.static(_EVEN[1])
    even = even * z + wp.static(_EVEN[0])
    odd = wp.static(_ODD[4])
    odd = odd * z + wp.static(_ODD[3])
    odd = odd * z + wp.static(_ODD[2])
    odd = odd * z + wp.static(_ODD[1])
    odd = (odd * z + wp.static(_ODD[0])) * x
    low = even + odd
    high = even - odd
    return Six(low[0], low[1], low[2], high[2], high[1], high[0])


@wp.func
def turn(turns: wp.float64) -> wp.vec2:
    """Cosine and sine of so many turns, to 2e-7: Taylor's series about the nearest quarter."""
    rest = float(turns - wp.round(turns))
    quarter = wp.rint(4.0 * rest)
    x = TWO_PI * (rest - 0.25 * quarter)
    y = x * x
    s = x * (1.0 + y * (-1.0 / 6.0 + y * (1.0 / 120.0 + y * (-1.0 / 5040.0 + y * (1.0 / 362880.0)))))
    c = 1.0 + y * (-0.5 + y * (1.0 / 24.0 + y * (-1.0 / 720.0 + y * (1.0 / 40320.0))))
    which = int(quarter) & 3
    if which == 1:
        return wp.vec2(-s, c)
    if which == 2:
        return wp.vec2(-c, -s)
    if which == 3:
        return wp.vec2(s, -c)
    return wp.vec2(c, s)


@wp.func
def way_less_reference(place: wp.vec3d, point: wp.vec3d, own: wp.float64) -> wp.float64:
    """Distance of a point less that of the reference point, `own` [m], whatever both are: no difference of ranges."""
    two = wp.float64(2.0)
    return (wp.dot(point, point) - two * wp.dot(place, point)) / (wp.length(place - point) + own)


@wp.func
def gain(beam: Beam, pulse: int, place: wp.vec3d, point: wp.vec3d) -> float:
    """One-way amplitude of a rectangular antenna."""
    if beam.wide == 0.0 and beam.high == 0.0:
        return 1.0
    to = wp.normalize(point - place)
    total = float(1.0)
    if beam.wide > 0.0:
        x = 2.7834312 * float(wp.dot(to, beam.along[pulse])) / beam.wide  # 2 pi 0.443
        if wp.abs(x) > 1.0e-4:
            total *= wp.sin(x) / x
    if beam.high > 0.0:
        y = 2.7834312 * float(wp.dot(to, beam.up[pulse])) / beam.high
        if wp.abs(y) > 1.0e-4:
            total *= wp.sin(y) / y
    return total


_ADD_TO_BINS = """
    const int bins = bins_out.shape[2];
    float* const first = (float*)&wp::index(bins_out, p, row, 0);
    const int odd = low & 1;
    int at = low - odd;
    float share[8];
    for (int k = 0; k < 8; ++k) {
        const float even_share = k < 6 ? weights.c[k < 6 ? k : 0] : 0.0f;
        const float odd_share = k > 0 && k < 7 ? weights.c[k > 0 && k < 7 ? k - 1 : 0] : 0.0f;
        share[k] = odd ? odd_share : even_share;
    }
    for (int k = 0; k < 6 + 2 * odd; k += 2) {
        float* const there = first + 2 * at;
        const float a = share[k] * value.c[0], b = share[k] * value.c[1];
        const float c = share[k + 1] * value.c[0], d = share[k + 1] * value.c[1];
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
        asm volatile("red.relaxed.gpu.global.add.v4.f32 [%0], {%1, %2, %3, %4};"
                     :: "l"(__cvta_generic_to_global(there)), "f"(a), "f"(b), "f"(c), "f"(d) : "memory");
#elif defined(__CUDA_ARCH__)
        atomicAdd(there, a);
        atomicAdd(there + 1, b);
        atomicAdd(there + 2, c);
        atomicAdd(there + 3, d);
#else
        there[0] += a;
        there[1] += b;
        there[2] += c;
        there[3] += d;
#endif
        at = at + 2 < bins ? at + 2 : 0;
    }
"""


@wp.func_native(_ADD_TO_BINS)
def add_to_bins(p: int, row: int, low: int, weights: Six, value: wp.vec2, bins_out: wp.array3d[wp.vec2]):  # type: ignore[no-untyped-def]
    """Weights times a value into WIDTH bins from `low` on, two bins to an atomic sum of four numbers where CUDA has it.

    The number of bins is even, and they go round.
    """
    ...


@wp.func
def angle_deg(sine: wp.float64) -> float:
    return 57.29577951 * wp.asin(float(sine))


@wp.func
def measured_gain(beam: Beam, pulse: int, place: wp.vec3d, point: wp.vec3d) -> wp.vec2:
    """Two-way complex amplitude of a measured pattern; 1 without one."""
    rows = beam.pattern.shape[0]
    columns = beam.pattern.shape[1]
    if rows == 0:
        return wp.vec2(1.0, 0.0)
    to = wp.normalize(point - place)
    x = (angle_deg(wp.dot(to, beam.along[pulse])) - beam.start[0]) * beam.every[0]
    y = (angle_deg(wp.dot(to, beam.up[pulse])) - beam.start[1]) * beam.every[1]
    if x < 0.0 or y < 0.0 or x > float(rows - 1) or y > float(columns - 1):
        return wp.vec2()
    i = wp.min(int(x), rows - 2)
    j = wp.max(wp.min(int(y), columns - 2), 0)
    k = wp.min(j + 1, columns - 1)
    u = x - float(i)
    v = y - float(j)
    low = (1.0 - v) * beam.pattern[i, j] + v * beam.pattern[i, k]
    high = (1.0 - v) * beam.pattern[i + 1, j] + v * beam.pattern[i + 1, k]
    return (1.0 - u) * low + u * high


@wp.func
def times(a: wp.vec2, b: wp.vec2) -> wp.vec2:
    return wp.vec2(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@wp.struct
class Echo:
    """What a pulse has of a point."""

    way: wp.float64  # mean of both, less that of the reference point [m]
    phase: wp.vec2  # e^{-j 2 pi turns} times the antenna's two-way amplitude


@wp.func
def echo_of(track: SensorTrack, pulse: int, point: wp.vec3d, turns_per_metre: wp.float64) -> Echo:
    receiver = track.receiver[pulse]
    echo = Echo()
    echo.way = way_less_reference(receiver, point, track.receiver_own[pulse])
    one = gain(track.beam, pulse, receiver, point)
    if track.bistatic != 0:
        transmitter = track.transmitter[pulse]
        other = way_less_reference(transmitter, point, track.transmitter_own[pulse])
        echo.way = wp.float64(0.5) * (echo.way + other)
        one = one * gain(track.beam, pulse, transmitter, point)
    else:
        one = one * one
    measured = measured_gain(track.beam, pulse, receiver, point)
    echo.phase = one * times(turn(-echo.way * turns_per_metre), measured)
    return echo


@wp.kernel(enable_backward=False)
def deposit_kernel(
    # In:
    pulse_in: wp.array[int],
    weight_in: wp.array[float],
    track: SensorTrack,
    turns_per_metre: wp.float64,
    bins_per_metre: wp.float64,
    scatterers: MovingScatterers,
    lanes: int,
    # Out:
    bins_out: wp.array3d[wp.vec2],
):
    """Range-compressed pulses, (polarizations, pulses, bins): each scatterer e^{-j 2 pi turns} into WIDTH bins.

    A thread takes every `lanes`-th scatterer of one pulse. The way is worked out in float64, from differences. The
    number of bins is even. On the CPU kernels/pulse_lanes.py does the same.
    """
    row, lane = wp.tid()
    pulse = pulse_in[row]
    weight = weight_in[row]
    if weight == 0.0:
        return
    bins = bins_out.shape[2]
    for step in range((scatterers.point.shape[0] - lane + lanes - 1) // lanes):
        i = lane + step * lanes
        point = scatterers.point[i]
        if scatterers.velocity.shape[0] > 0:
            point = point + track.time[pulse] * scatterers.velocity[i]
        echo = echo_of(track, pulse, point, turns_per_metre)
        c = weight * echo.phase[0]
        s = weight * echo.phase[1]
        at = echo.way * bins_per_metre
        first = int(wp.ceil(at - HALF))
        weights = weights_from(float(wp.float64(first) - at))
        low = first % bins
        if low < 0:
            low = low + bins
        for p in range(bins_out.shape[0]):
            a = scatterers.amplitude[p, i]
            value = wp.vec2(a[0] * c - a[1] * s, a[0] * s + a[1] * c)
            add_to_bins(p, row, low, weights, value, bins_out)


@wp.kernel(enable_backward=False)
def gather_kernel(
    # In:
    pulse_in: wp.array[int],
    track: SensorTrack,
    turns_per_metre: wp.float64,
    bins_per_metre: wp.float64,
    point_in: wp.array[wp.vec3d],
    bins_in: wp.array2d[wp.vec2],
    # In and out:
    amplitude: wp.array[wp.vec2d],
):
    """The adjoint of a deposit of one polarization: a point takes from bins what it gave to them, turned back."""
    i = wp.tid()
    total = amplitude[i]
    bins = bins_in.shape[1]
    for row in range(pulse_in.shape[0]):
        echo = echo_of(track, pulse_in[row], point_in[i], turns_per_metre)
        at = echo.way * bins_per_metre
        first = int(wp.ceil(at - HALF))
        weights = weights_from(float(wp.float64(first) - at))
        low = first % bins
        if low < 0:
            low = low + bins
        value = wp.vec2()
        for w in range(WIDTH):
            value += weights[w] * bins_in[row, (low + w) % bins]
        c = echo.phase[0]
        s = echo.phase[1]
        total += wp.vec2d(
            wp.float64(value[0] * c + value[1] * s),
            wp.float64(value[1] * c - value[0] * s),
        )
    amplitude[i] = total


@wp.struct
class ImageFrame:
    """The fine grid of a direct image or of one of its tiles, and where the sensor is."""

    place: wp.vec3d  # of the sensor, abeam of the reference point [m]
    slant: wp.float64  # its distance [m]
    centre: wp.vec3d  # of the track [m]
    centre_slant: wp.float64
    u: wp.vec3d  # along azimuth
    start: wp.vec2d  # of the grid's rows and columns [m]
    step: wp.vec2d
    core: wp.vec4d  # first and last row, and first and last column, between which a scatterer is the tile's own
    turns_per_metre: wp.float64
    stripmap: int
    beam: Beam
    receiver: wp.vec3d  # of the pulse in the middle
    pulse: int


@wp.func
def place_in_image(frame: ImageFrame, point: wp.vec3d) -> wp.vec2d:
    """Range from the track and azimuth [m]."""
    azimuth = wp.dot(point, frame.u)
    return wp.vec2d(way_less_reference(frame.place, point - azimuth * frame.u, frame.slant), azimuth)


@wp.kernel(enable_backward=False)
def patch_reaches_kernel(
    # In:
    frame: ImageFrame,
    patches: Patches,
    low: wp.vec2d,
    high: wp.vec2d,
    # Out:
    reaches_out: wp.array[wp.uint8],
):
    """Which patches have a part between two ends of range and azimuth [m]; a few more may be told.

    Within a patch the range may be less than at its corners, by the sag of an arc over its sides.
    """
    i = wp.tid()
    start = patches.site_start[i]
    a = place_in_image(frame, start)
    b = place_in_image(frame, start + patches.site_first[i])
    c = place_in_image(frame, start + patches.site_second[i])
    least = wp.min(wp.min(a, b), c)
    largest = wp.max(wp.max(a, b), c)
    side = patches.site_first[i]
    other = patches.site_second[i]
    sag = (wp.dot(side, side) + wp.dot(other, other)) / frame.slant
    reaches = wp.uint8(1)
    if largest[0] < low[0] or largest[1] < low[1] or least[0] - sag > high[0] or least[1] > high[1]:
        reaches = wp.uint8(0)
    reaches_out[i] = reaches


@wp.kernel(enable_backward=False)
def image_deposit_kernel(
    # In:
    frame: ImageFrame,
    point_in: wp.array[wp.vec3d],  # about the reference point [m]
    amplitude_in: wp.array2d[wp.vec2],
    column_in: wp.array[int],  # of amplitude_in, for each polarization
    scale: float,
    # Out:
    grid_out: wp.array3d[wp.vec2],
    count_out: wp.array[int],
):
    """Scatterers times e^{-j 2 pi turns} into WIDTH x WIDTH cells of a grid, (polarizations, rows, columns).

    Rows are ranges from the track, columns azimuths, of an even number. Scatterers near the border are left out. Those
    of the core are counted, into several places: one alone would be waited for.
    """
    i = wp.tid()
    some = float(0.0)
    for p in range(column_in.shape[0]):
        some += wp.length_sq(amplitude_in[i, column_in[p]])
    if some == 0.0:
        return
    point = point_in[i]
    place = place_in_image(frame, point)
    way = place[0]
    row_at = (way - frame.start[0]) / frame.step[0]
    column_at = (place[1] - frame.start[1]) / frame.step[1]
    rows = grid_out.shape[1]
    columns = grid_out.shape[2]
    three = wp.float64(3.0)
    if row_at <= three or row_at >= wp.float64(rows - 4) or column_at <= three or column_at >= wp.float64(columns - 4):
        return
    core = frame.core
    if row_at >= core[0] and row_at < core[1] and column_at >= core[2] and column_at < core[3]:
        wp.atomic_add(count_out, i % count_out.shape[0], 1)
    # A stripmap's beam passes over every point: its phase is that abeam, and its gain what lies across the track.
    aimed = point - place[1] * frame.u
    if frame.stripmap == 0:
        way = way_less_reference(frame.centre, point, frame.centre_slant)
        aimed = point
    one_way = gain(frame.beam, frame.pulse, frame.receiver, aimed)
    measured = measured_gain(frame.beam, frame.pulse, frame.receiver, aimed)
    phase = scale * one_way * one_way * times(turn(-way * frame.turns_per_metre), measured)
    c = phase[0]
    s = phase[1]
    row = int(wp.ceil(row_at - HALF))
    column = int(wp.ceil(column_at - HALF))
    down = weights_from(float(wp.float64(row) - row_at))
    aside = weights_from(float(wp.float64(column) - column_at))
    for p in range(column_in.shape[0]):
        a = amplitude_in[i, column_in[p]]
        value = wp.vec2(a[0] * c - a[1] * s, a[0] * s + a[1] * c)
        for r in range(WIDTH):
            add_to_bins(p, row + r, column, aside, down[r] * value, grid_out)


@wp.kernel(enable_backward=False)
def respond_kernel(
    # In:
    grid_in: wp.array3d[wp.vec2],
    first: int,  # the sample before the image's first one by half of the taps
    every: int,
    tap_in: wp.array[wp.vec2],
    along: int,  # 1: over columns; 0: over rows
    # Out:
    image_out: wp.array3d[wp.vec2],
):
    """The system's response along one axis, at every `every`-th sample: a sum over taps."""
    p, i, j = wp.tid()
    total = wp.vec2()
    start = first + every * wp.where(along != 0, j, i)
    for t in range(tap_in.shape[0]):
        value = wp.vec2()
        if along != 0:
            value = grid_in[p, i, start + t]
        else:
            value = grid_in[p, start + t, j]
        tap = tap_in[t]
        total += wp.vec2(value[0] * tap[0] - value[1] * tap[1], value[0] * tap[1] + value[1] * tap[0])
    image_out[p, i, j] = total
