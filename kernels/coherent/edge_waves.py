"""Waves from edge to edge along a thin plate: diffracted at one edge, and again at the edge that lies opposite.

Of a strip with half-planes at its edges, the magnetic field along the edges (Ross, IEEE TAP 14(3), 1966): two and three
diffractions, and the sum of all further ones. Uniform by the transition function of Kouyoumjian and Pathak (Proc. IEEE
62(11), 1974): along the plate all orders together are nothing, as they must be. The plate is thin, and both its edges
are parallel. Along the plate the first-order currents have no end then: the other edge ends them by what it diffracts.
"""

import warp as wp

from warpsar.kernels.coherent.edges import EDGES, HALF, PI, Edge, diffracted
from warpsar.kernels.coherent.numbers import product, sinc, turned
from warpsar.kernels.coherent.radiate import Four, keep, plus
from warpsar.kernels.coherent.tubes import TubeRadar, look

ENDLESS = wp.constant(wp.float64(1.0e9))
"""Length of a face without an end [m]."""
THIN = 0.1
"""Thickness of a plate over the wavelength, at most."""
LARGE = wp.constant(wp.float64(12.0))
"""Where the asymptotic series takes over: eight of its terms and sixty of the other one are right to 2e-5."""


@wp.struct
class Opposite:
    """What lies opposite to the rim of a plate."""

    piece: int  # which piece of an edge the rim is
    way: wp.float64  # to the opposite rim [m]
    begin: wp.float64  # where that begins and ends, along this one from its middle [m]
    end: wp.float64
    thickness: wp.float64  # 0 for a sheet, whose rim belongs to both sides


@wp.func
def transition(x: wp.float64) -> wp.vec2d:
    """F(x) / sqrt(x) of the transition function F: 2j e^{jx} times the integral of e^{-jt^2} from sqrt(x) on."""
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    total = wp.vec2d()
    if x >= LARGE:
        term = wp.vec2d(one, wp.float64(0.0))
        for n in range(1, 9):
            total += term
            term = wp.vec2d(-term[1], term[0]) * (wp.float64(2 * n - 1) / (two * x))
        return total / wp.sqrt(x)
    r = wp.sqrt(wp.max(x, wp.float64(0.0)))
    half = wp.sqrt(PI / wp.float64(8.0))  # sqrt(pi) / 2 by e^{-j pi / 4}
    total = wp.vec2d(half, -half)
    term = wp.vec2d(r, wp.float64(0.0))
    for n in range(60):
        total -= term / wp.float64(2 * n + 1)
        term = wp.vec2d(term[1], -term[0]) * (x / wp.float64(n + 1))
    found = product(turned(x), total)
    return two * wp.vec2d(-found[1], found[0])


@wp.func
def part_of(edge: Edge, low: wp.float64, high: wp.float64, reach: wp.float64) -> Edge:
    """The part of an edge between two places [m from its middle], on faces of another length if `reach` is not 0."""
    found = Edge()
    z = wp.normalize(edge.along)
    found.middle = edge.middle + wp.float64(0.5) * (low + high) * z
    found.along = (high - low) * z
    found.first = edge.first
    found.second = edge.second
    found.normal_first = edge.normal_first
    found.normal_second = edge.normal_second
    found.outer = edge.outer
    found.share = edge.share
    found.reach_first = wp.where(reach > wp.float64(0.0), reach, edge.reach_first)
    found.reach_second = wp.where(reach > wp.float64(0.0), reach, edge.reach_second)
    return found


@wp.func
def waved(radar: TubeRadar, k: wp.float64, edge: Edge, opposite: Opposite) -> Four:
    """What a piece of an edge sends back of the wave from the opposite edge, and of its own endless first order beyond
    `diffracted`.

    A wave that comes aslant leaves the other edge farther along: where that edge has no such place, there is no wave.
    Of a box the rims of the lit face alone count.
    """
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    two = wp.float64(2.0)
    half = wp.float64(0.5)
    s = look(radar, edge.middle, 0.0).s
    z = wp.normalize(edge.along)
    sz = wp.dot(s, z)
    sine = wp.sqrt(wp.max(one - sz * sz, wp.float64(0.0)))
    found = Four()
    height = wp.dot(s, edge.normal_first)
    if sine < wp.float64(1.0e-3) or wp.abs(height) < wp.float64(1.0e-6):
        return found  # along the plate all orders add up to nothing
    if opposite.thickness > zero and (height < zero or k * opposite.thickness > two * PI * wp.float64(THIN)):
        return found
    way = opposite.way
    aslant = way * sz / sine
    length = wp.length(edge.along)
    low = wp.max(-half * length, opposite.begin - aslant)
    high = wp.min(half * length, opposite.end - aslant)
    if high <= low:
        return found
    ended = part_of(edge, low, high, wp.float64(0.0))
    sight = look(radar, ended.middle, 0.0)
    across = k * sine * way
    cosine = wp.clamp(wp.dot(s, edge.first) / sine, -one, one)
    own = transition(across * (one + cosine))
    twice = product(own, transition(across * (one - cosine))) * wp.sqrt(two * PI * across)
    once_more = product(turned(-across - across * cosine - wp.float64(0.25) * PI), product(own, own))
    # Six diffractions and more: there and back again and again (Ross's resonance).
    again = turned(-two * across - HALF) / (two * PI * across)
    again = wp.vec2d(one - again[0], -again[1])
    again = wp.vec2d(again[0], -again[1]) / wp.dot(again, again)
    size = sight.spread * sight.spread * edge.share * (high - low) * sinc(k * wp.dot(s, ended.along))
    size /= two * PI * PI * sine * sine
    phase = turned(-two * k * sight.back + across * cosine - across - wp.float64(0.25) * PI)
    factor = product(product(phase, again), once_more - twice) * size
    h = wp.dot(z, wp.cross(s, radar.u))
    v = wp.dot(z, wp.cross(s, radar.v))
    first = diffracted(radar, k, part_of(edge, low, high, ENDLESS))
    less = diffracted(radar, k, ended)
    found.hh = h * h * factor + first.hh - less.hh
    found.hv = h * v * factor + first.hv - less.hv
    found.vh = v * h * factor + first.vh - less.vh
    found.vv = v * v * factor + first.vv - less.vv
    return found


@wp.kernel(enable_backward=False)
def edge_waves_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    rim_in: wp.array[Edge],
    opposite_in: wp.array[Opposite],
    seen_in: wp.array2d[wp.uint8],
    # Out:
    amplitude_out: wp.array4d[wp.vec2d],
):
    """As `edges_kernel`, of the rims of plates; `seen_in` is of all pieces of edges."""
    view, f, chunk = wp.tid()
    k = wavenumber_in[f]
    total = Four()
    for j in range(chunk * EDGES, wp.min((chunk + 1) * EDGES, rim_in.shape[0])):
        if seen_in[view, opposite_in[j].piece] != wp.uint8(0):
            total = plus(total, waved(radar_in[view], k, rim_in[j], opposite_in[j]))
    keep(view, f, chunk, total, amplitude_out)
