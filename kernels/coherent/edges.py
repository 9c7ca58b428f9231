"""What edges add to physical optics: fringe currents along them, first order.

Michaeli's equivalent currents (IEEE TAP 32(3), 1984): the transform of the exact currents on the faces of a conducting
wedge, less that of the currents of physical optics.

The faces of that wedge have no end. A wave that comes along a face is sent back along it by the edge, and what the
current on an endless face sends is infinite there. So that part is cut off at the end of the face (Breinbjerg, IEEE
TAP 40(12), 1992; Johansen, IEEE TAP 44(7), 1996): far from the edge the current goes as e^{-jkx} / sqrt(x), and over a
face of length l its transform is erf(sqrt(j y)) times that of an endless one, y = k_t l (1 - cos phi). The root of
1 - e^{-4 y / pi} stands for it: its modulus where y is small or large, without the ripples between (up to 37 %) that
the other end of the face would have a share in.
"""

import warp as wp

from warpsar.kernels.coherent.numbers import sinc, turned
from warpsar.kernels.coherent.radiate import Four, keep, plus, scaled
from warpsar.kernels.coherent.tubes import TubeRadar, look

EDGES = wp.constant(16)
"""Pieces of edges that one thread adds up."""
POLE = wp.constant(wp.float64(2.0e-3))
"""Angle [rad] within which a direction is moved off the poles, where both transforms are infinite."""
PI = wp.constant(wp.float64(3.141592653589793))
HALF = wp.constant(wp.float64(1.5707963267948966))


@wp.struct
class Edge:
    """A straight piece of a wedge's edge."""

    middle: wp.vec3d  # [m]
    along: wp.vec3d  # [m], its whole length
    first: wp.vec3d  # unit vectors in the two faces, away from the edge
    second: wp.vec3d
    normal_first: wp.vec3d  # unit normals on the outer side
    normal_second: wp.vec3d
    outer: wp.float64  # outer angle over pi: 2 for the border of a sheet
    share: wp.float64  # 1; 1/2 where both faces state the edge
    reach_first: wp.float64  # how far the two surfaces go from the edge [m]
    reach_second: wp.float64
    material_first: int  # what the two faces are made of
    material_second: int


@wp.struct
class Transforms:
    """Of the fields on a face of a conducting wedge, along it: H_z (hard) and dE_z / dy (soft), and what physical
    optics has of them. The hard ones are without their factor 2j / k_t."""

    hard: wp.float64
    soft: wp.float64
    hard_po: wp.float64
    soft_po: wp.float64
    cosine: wp.float64  # of the angle to the face that they are taken at


@wp.func
def sine_to(s: wp.vec3d, z: wp.vec3d) -> wp.float64:
    """Of the angle between a direction and an edge along z; 0 along the edge, where no current is of first order."""
    sz = wp.dot(s, z)
    sine = wp.sqrt(wp.max(wp.float64(1.0) - sz * sz, wp.float64(0.0)))
    return wp.where(sine < wp.float64(1.0e-3), wp.float64(0.0), sine)


@wp.func
def angle_from(s: wp.vec3d, x: wp.vec3d, n: wp.vec3d, outer: wp.float64) -> wp.float64:
    """Of a direction from a face [rad], 0 to the outer angle. Negative in the inner angle of a corner, where tubes go
    from face to face."""
    phi = wp.atan2(wp.dot(s, n), wp.dot(s, x))
    if phi < wp.float64(-1.0e-7):
        phi = phi + wp.float64(2.0) * PI
    if phi > outer * PI + wp.float64(1.0e-6):
        return wp.float64(-1.0)
    return wp.clamp(phi, wp.float64(0.0), outer * PI)


@wp.func
def grazing_share(phi: wp.float64, outer: wp.float64) -> wp.float64:
    """1; 1/2 along a face, where both sides of it count."""
    if phi < wp.float64(1.0e-6) or outer * PI - phi < wp.float64(1.0e-6):
        return wp.float64(0.5)
    return wp.float64(1.0)


@wp.func
def off_poles(phi: wp.float64) -> wp.float64:
    """Off the poles: phi = pi / 2 (the strip's specular direction), and pi (the border of light)."""
    if wp.abs(phi - HALF) < POLE:
        phi = HALF + POLE
    if wp.abs(phi - PI) < POLE:
        phi = wp.where(phi < PI, PI - POLE, PI + POLE)
    return phi


@wp.func
def transforms(kt: wp.float64, phi: wp.float64, outer: wp.float64, reach: wp.float64) -> Transforms:
    """Of a face that the wave meets at an angle off the poles; `kt`: the wavenumber across the edge, `reach` [m]."""
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    lit = wp.where(phi < PI, one, zero)
    cosine = wp.cos(phi)
    alpha = wp.where(phi < PI, phi, two * PI - phi)
    wide = wp.cos((PI - alpha) / outer) - wp.cos(phi / outer)
    sin_alpha = wp.max(wp.sin(alpha), wp.float64(1.0e-6))
    hard = -wp.sin((PI - alpha) / outer) / (outer * sin_alpha * wide)
    soft = two * wp.sin(phi / outer) / (outer * wide)
    y = kt * reach * (one - cosine)
    kept = wp.sqrt(one - wp.exp(-wp.float64(4.0) / PI * wp.max(y, wp.float64(1.0e-12))))
    half = wp.max(wp.tan(alpha / two), wp.float64(5.0e-7))
    side = wp.where(phi < PI, one, -one)  # of a sheet both faces have a grazing direction
    hard -= side * (one - kept) / (two * outer * wp.tan(HALF / outer) * half)
    found = Transforms()
    found.hard = hard
    found.soft = soft
    found.hard_po = lit / (cosine + cosine)
    found.soft_po = -two * lit * wp.sin(phi) / (cosine + cosine)
    found.cosine = cosine
    return found


@wp.func
def fringe(
    e: wp.vec3d, k: wp.float64, s: wp.vec3d, x: wp.vec3d, n: wp.vec3d, outer: wp.float64, reach: wp.float64
) -> wp.vec3d:
    """Imaginary unit aside: the two fringe currents (eta J) of one face, as a vector without its factor j.

    `e` is the field at the edge, `x` the direction in the face away from the edge, `n` its normal, `reach` its length
    along x [m]. The wave comes from s and goes back to it. The result is j times a real vector: INT J over the face
    across the edge [V].
    """
    two = wp.float64(2.0)
    z = wp.cross(x, n)
    sine = sine_to(s, z)
    phi = angle_from(s, x, n, outer)
    if sine == wp.float64(0.0) or phi < wp.float64(0.0):
        return wp.vec3d()
    kt = k * sine
    of = transforms(kt, off_poles(phi), outer, reach)
    h = -wp.cross(s, e)  # eta H, as the wave travels along -s
    hz = wp.dot(h, z)
    ez = wp.dot(e, z)
    kz = -wp.dot(s, z)  # k_z / k of the wave that comes in
    across = two / kt * (of.hard - of.hard_po) * hz
    along = -(of.soft - of.soft_po) * ez / (k * sine * sine)
    along += kz / sine * two / kt * (of.cosine * of.hard + of.cosine * of.hard_po) * hz
    return grazing_share(phi, outer) * (across * x + along * z)


@wp.func
def diffracted(radar: TubeRadar, k: wp.float64, edge: Edge) -> Four:
    """What a piece of an edge sends back."""
    u = radar.u
    v = radar.v
    sight = look(radar, edge.middle, 0.0)
    s = sight.s
    size = sight.spread * sight.spread * edge.share * wp.length(edge.along) * sinc(k * wp.dot(s, edge.along))
    phase = turned(-wp.float64(2.0) * k * sight.back)
    factor = scaled(k, size * wp.vec2d(-phase[1], phase[0]))
    h = fringe(u, k, s, edge.first, edge.normal_first, edge.outer, edge.reach_first)
    h += fringe(u, k, s, edge.second, edge.normal_second, edge.outer, edge.reach_second)
    w = fringe(v, k, s, edge.first, edge.normal_first, edge.outer, edge.reach_first)
    w += fringe(v, k, s, edge.second, edge.normal_second, edge.outer, edge.reach_second)
    found = Four()
    found.hh = wp.dot(h, u) * factor
    found.vh = wp.dot(h, v) * factor
    found.hv = wp.dot(w, u) * factor
    found.vv = wp.dot(w, v) * factor
    return found


@wp.kernel(enable_backward=False)
def edges_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    edge_in: wp.array[Edge],
    seen_in: wp.array2d[wp.uint8],
    # Out:
    amplitude_out: wp.array4d[wp.vec2d],
):
    """Fringe currents of EDGES pieces of edges, shape (views, frequencies, chunks, 4)."""
    view, f, chunk = wp.tid()
    k = wavenumber_in[f]
    total = Four()
    for i in range(EDGES):
        j = chunk * EDGES + i
        if j < edge_in.shape[0]:
            if seen_in[view, j] != wp.uint8(0):
                total = plus(total, diffracted(radar_in[view], k, edge_in[j]))
    keep(view, f, chunk, total, amplitude_out)


@wp.kernel(enable_backward=False)
def pieces_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    k: wp.float64,
    edge_in: wp.array[Edge],
    seen_in: wp.array2d[wp.uint8],
    # Out:
    amplitude_out: wp.array2d[wp.vec2d],
):
    """Fringe currents of each piece of an edge by itself, (pieces, 4)."""
    i = wp.tid()
    four = Four()
    if seen_in[0, i] != wp.uint8(0):
        four = diffracted(radar_in[0], k, edge_in[i])
    amplitude_out[i, 0] = four.hh
    amplitude_out[i, 1] = four.hv
    amplitude_out[i, 2] = four.vh
    amplitude_out[i, 3] = four.vv
