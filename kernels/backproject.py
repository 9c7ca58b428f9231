"""Phase history onto points (backprojection), and the points of a slant-plane grid on a mesh."""

import warp as wp

TWO_PI = wp.constant(6.283185307179586)


@wp.func
def cubic_sample(profiles: wp.array2d(dtype=wp.vec2), pulse: int, position: wp.float64) -> wp.vec2:
    """Four-point Lagrange interpolation of a periodic profile at `position` [bins]."""
    bins = profiles.shape[1]
    base = int(wp.floor(position))
    t = float(position - wp.float64(base))
    left = profiles[pulse, (base - 1 + bins) % bins]
    here = profiles[pulse, (base + bins) % bins]
    right = profiles[pulse, (base + 1 + bins) % bins]
    far = profiles[pulse, (base + 2 + bins) % bins]
    return (
        left * (-t * (t - 1.0) * (t - 2.0) / 6.0)
        + here * ((t + 1.0) * (t - 1.0) * (t - 2.0) / 2.0)
        + right * (-(t + 1.0) * t * (t - 2.0) / 2.0)
        + far * ((t + 1.0) * t * (t - 1.0) / 6.0)
    )


@wp.struct
class Pulses:
    """Range profiles, and where they were measured."""

    position: wp.array(dtype=wp.vec3d)  # [m]
    sender: wp.array(dtype=wp.vec3d)  # transmitters that stand apart, or none
    reference_range: wp.array(dtype=wp.float64)  # [m]
    turns_per_metre: wp.array(dtype=wp.float64)  # 2 f / c at the frequency to which the profile is demodulated
    bins_per_metre: wp.array(dtype=wp.float64)
    half_swath: wp.array(dtype=wp.float64)  # [m], beyond it a profile repeats itself
    profile: wp.array2d(dtype=wp.vec2)  # (pulse, bin), complex


@wp.kernel(enable_backward=False)
def backproject_kernel(
    # In:
    points: wp.array(dtype=wp.vec3d),
    pulses: Pulses,
    # In and out:
    image: wp.array(dtype=wp.vec2),  # complex, added to; NaN where a pulse's swath does not reach
):
    """One thread sums all pulses at one point.

    The distance is taken in float64: at 10 km one float32 step, 1 mm, is already 23 degrees of X-band phase.
    """
    i = wp.tid()
    point = points[i]
    total = image[i]
    for pulse in range(pulses.position.shape[0]):
        way = wp.length(pulses.position[pulse] - point)
        if pulses.sender.shape[0] > 0:
            way = wp.float64(0.5) * (way + wp.length(pulses.sender[pulse] - point))
        offset = way - pulses.reference_range[pulse]
        if wp.abs(offset) > pulses.half_swath[pulse]:
            total = wp.vec2(wp.nan, wp.nan)
        else:
            turns = offset * pulses.turns_per_metre[pulse]
            phase = TWO_PI * float(turns - wp.floor(turns))
            echo = cubic_sample(pulses.profile, pulse, offset * pulses.bins_per_metre[pulse])
            c = wp.cos(phase)
            s = wp.sin(phase)
            total += wp.vec2(echo[0] * c - echo[1] * s, echo[0] * s + echo[1] * c)
    image[i] = total


@wp.kernel(enable_backward=False)
def first_surface_kernel(
    # In:
    mesh: wp.uint64,
    waypoints: wp.array2d(dtype=wp.vec3),  # (curve, waypoint): polylines, walked from the first waypoint on
    # Out:
    fraction_out: wp.array(dtype=float),  # how far along [waypoints], -1 where nothing was met
):
    """Where each polyline first meets the mesh."""
    i = wp.tid()
    fraction_out[i] = -1.0
    for k in range(waypoints.shape[1] - 1):
        if fraction_out[i] < 0.0:
            step = waypoints[i, k + 1] - waypoints[i, k]
            length = wp.length(step)
            # A little further than the next waypoint: a surface through it must not fall between two chords.
            query = wp.mesh_query_ray(mesh, waypoints[i, k], step / length, 1.01 * length)
            if query.result:
                fraction_out[i] = float(k) + query.t / length
