"""What edges of coated metal add to physical optics: fringe currents of a wedge whose faces have a surface impedance.

The transforms of the exact fields on the faces (Maliuzhinets, Sov. Phys. Dokl. 3, 1958) less those of physical optics
with the faces' coefficients of reflection: the physical theory of diffraction of impedance structures (Syed, Volakis,
IEEE TAP 44(7), 1996). The impedance of a face is that of its layers at the angle at which the wave meets it, so what
is taken off is what `radiate` adds, and the poles of both cancel. Both transforms are those of a conductor times a
factor, which is 1 without an impedance.

Maliuzhinets's spectrum on a face at theta (sin theta = Z for H along the edge, 1 / Z for E) is
s(Phi - x) = sin(mu phi) mu / (cos(mu x) - cos(mu phi)) Psi(Phi - x) / Psi(Phi - phi), x = |pi - phi|, 2 Phi = n pi the
outer angle, mu = 1 / n. It makes the transform of H_z -s / (sin x + sin theta), and that of dE_z / dy
2 s sin theta / (sin x + sin theta). The ratio of Psi is a product of cosines by an integral that fades as
e^{-pi s / 2} at least, for any impedance: psi(w + pi/2) psi(w - pi/2) ~ cos(w mu / 2).

All this is exact for waves across the edge. For a wave aslant to it the impedances are those times the sine of its
angle to the edge, and E and H along the edge do not couple. Where a face reflects the wave back across the edge, in the
plane through the edge and the face's normal, they do not. Currents have both fields' parts, as those of a conductor.
"""

import warp as wp

from warpsar.kernels.coherent.edges import (
    EDGES,
    HALF,
    PI,
    Edge,
    angle_from,
    diffracted,
    grazing_share,
    off_poles,
    sine_to,
    transforms,
)
from warpsar.kernels.coherent.numbers import exponential, product, quotient, sinc, square_root, turned
from warpsar.kernels.coherent.radiate import Four, keep, plus, scaled
from warpsar.kernels.coherent.reflection import Face, Field, load_of
from warpsar.kernels.coherent.tubes import TubeRadar, look

NODES = wp.constant(40)
"""Of the integral (midpoint rule, which converges exponentially): right to 1e-5."""
STEP = wp.constant(wp.float64(0.15))
LEAST = wp.constant(wp.float64(1.0e-6))
"""An impedance or admittance below that is as good as none, and the other one has an end."""


@wp.struct
class EdgeSurface:
    """What a face makes of fields along an edge, over what space does: E / H for H along it, H / E for E along it."""

    impedance: wp.vec2d
    admittance: wp.vec2d


@wp.struct
class Wedge:
    """A complex number for each face and polarization: E along the edge, H along it."""

    first_e: wp.vec2d
    first_h: wp.vec2d
    second_e: wp.vec2d
    second_h: wp.vec2d


@wp.func
def real(x: wp.float64) -> wp.vec2d:
    return wp.vec2d(x, wp.float64(0.0))


@wp.func
def ratio(a: wp.vec2d, b: wp.vec2d) -> wp.vec2d:
    """a / b, up to 1 / LEAST."""
    if wp.dot(b, b) < LEAST * LEAST * wp.dot(a, a):
        return real(wp.float64(1.0) / LEAST)
    return quotient(a, b)


@wp.func
def surface_of(face: Face, k: wp.float64, s: wp.vec3d, x: wp.vec3d, n: wp.vec3d) -> EdgeSurface:
    """Of a stack of layers under a wave from s; x across the edge. In the plane of incidence it is that of TM."""
    te = wp.vec2d()
    tm = wp.vec2d()
    if face.layer != 0:
        load = load_of(face, k, wp.min(wp.abs(wp.dot(s, n)), wp.float64(1.0)))
        te = ratio(load.te_e, load.te_h)
        tm = ratio(load.tm_e, load.tm_h)
    y_te = ratio(real(wp.float64(1.0)), te)
    y_tm = ratio(real(wp.float64(1.0)), tm)
    sx = wp.dot(s, x)
    sz = wp.dot(s, wp.cross(x, n))
    share = sx * sx / wp.max(sx * sx + sz * sz, wp.float64(1.0e-12))
    found = EdgeSurface()
    found.impedance = te + share * (tm - te)
    found.admittance = y_tm + share * (y_te - y_tm)
    return found


@wp.func
def arcsine(v: wp.vec2d) -> wp.vec2d:
    """Its real part is 0 to pi / 2 where that of v is not negative."""
    sign = wp.where(v[1] > wp.float64(0.0), wp.float64(-1.0), wp.float64(1.0))  # without a difference of large numbers
    w = sign * v
    inside = real(wp.float64(1.0)) - product(w, w)
    if wp.dot(inside, inside) < wp.float64(1.0e-20):
        inside = real(wp.float64(1.0e-10))  # where the root has no derivative
    root = square_root(inside) + wp.vec2d(-w[1], w[0])
    return sign * wp.vec2d(wp.atan2(root[1], root[0]), -wp.log(wp.length(root)))


@wp.func
def sinh_of(x: wp.float64) -> wp.float64:
    up = wp.exp(x)
    return wp.float64(0.5) * (up - wp.float64(1.0) / up)


@wp.func
def complex_sinh(z: wp.vec2d) -> wp.vec2d:
    up = wp.exp(z[0])
    down = wp.float64(1.0) / up
    half = wp.float64(0.5)
    return wp.vec2d(half * (up - down) * wp.cos(z[1]), half * (up + down) * wp.sin(z[1]))


@wp.func
def complex_cos(z: wp.vec2d) -> wp.vec2d:
    up = wp.exp(z[1])
    down = wp.float64(1.0) / up
    half = wp.float64(0.5)
    return wp.vec2d(half * (down + up) * wp.cos(z[0]), half * (down - up) * wp.sin(z[0]))


@wp.func
def integrals(theta: Wedge, phi: wp.float64, outer: wp.float64) -> Wedge:
    """Of the ratios of Psi. By itself: what a loop adds up has no adjoint in the function that goes on with it."""
    full = outer * PI
    other = full - phi
    x = wp.abs(PI - phi)
    y = wp.abs(PI - other)
    first_e = wp.vec2d()
    first_h = wp.vec2d()
    second_e = wp.vec2d()
    second_h = wp.vec2d()
    for i in range(NODES):
        s = (wp.float64(i) + wp.float64(0.5)) * STEP
        up = wp.exp(HALF * s)
        weight = STEP / (s * wp.float64(0.5) * (up + wp.float64(1.0) / up) * sinh_of(full * s))
        at_phi = sinh_of((phi - HALF) * s)
        at_other = sinh_of((other - HALF) * s)
        of_first = weight * (sinh_of((full - x - HALF) * s) - at_other)
        of_its_other = weight * (sinh_of((x - HALF) * s) - at_phi)
        of_second = weight * (sinh_of((full - y - HALF) * s) - at_phi)
        of_its_first = weight * (sinh_of((y - HALF) * s) - at_other)
        e1 = complex_sinh(s * theta.first_e)
        e2 = complex_sinh(s * theta.second_e)
        h1 = complex_sinh(s * theta.first_h)
        h2 = complex_sinh(s * theta.second_h)
        first_e += of_first * e1 + of_its_other * e2
        first_h += of_first * h1 + of_its_other * h2
        second_e += of_second * e2 + of_its_first * e1
        second_h += of_second * h2 + of_its_first * h1
    found = Wedge()
    found.first_e = first_e
    found.first_h = first_h
    found.second_e = second_e
    found.second_h = second_h
    return found


@wp.func
def lifted(own: wp.vec2d, across: wp.vec2d, integral: wp.vec2d, phi: wp.float64, outer: wp.float64) -> wp.vec2d:
    """Psi(Phi - x) / Psi(Phi - phi) of one face; `own` and `across`: theta of it, and of the other face."""
    full = outer * PI
    x = wp.abs(PI - phi)
    half = wp.float64(0.5) / outer
    above = product(complex_cos(half * (real(full - x) - own)), complex_cos(half * (real(x) - across)))
    below = product(complex_cos(half * (real(full - phi) - own)), complex_cos(half * (real(phi) - across)))
    return product(quotient(above, below), exponential(-integral))


@wp.func
def off_grazing(phi: wp.float64, y: wp.float64, v: wp.vec2d) -> wp.float64:
    """The angle at which a face sees a wave that comes along it [rad]; `y`: k_t times its length, `v`: sin theta.

    Over a short face a thin layer does not slow the wave down yet: its numerical distance y |v|^2 / 2 is small. So the
    angle is no less than that by which such a face spreads what comes along a conductor.
    """
    if phi >= HALF:
        return phi
    one = wp.float64(1.0)
    cosine = wp.cos(phi)
    way = (one - cosine) / wp.max(cosine * cosine, wp.float64(1.0e-12)) + wp.float64(0.5) * wp.dot(v, v)
    kept = wp.sqrt(one - wp.exp(-wp.clamp(wp.float64(4.0) / PI * y * way, wp.float64(1.0e-12), wp.float64(700.0))))
    return wp.min(wp.max(phi, wp.float64(1.0e-6)) / kept, HALF)


@wp.struct
class Side:
    """One face of a wedge: as in `Edge`, what it makes of fields, and how the wave meets it."""

    x: wp.vec3d
    n: wp.vec3d
    reach: wp.float64  # [m]
    of: EdgeSurface
    phi: wp.float64  # angle from the face [rad]; off the poles; and off grazing
    at: wp.float64
    off: wp.float64
    lift_e: wp.vec2d  # ratios of Psi there
    lift_h: wp.vec2d


@wp.func
def coated_fringe(e: wp.vec3d, k: wp.float64, s: wp.vec3d, outer: wp.float64, side: Side) -> Field:
    """As `fringe`, of electric and magnetic currents: INT J - s x M over the face across the edge, without a j."""
    two = wp.float64(2.0)
    z = wp.cross(side.x, side.n)
    sine = sine_to(s, z)
    kt = k * sine
    sine_e = sine * side.of.admittance
    sine_h = sine * side.of.impedance
    farther = wp.dot(sine_h, sine_h) / wp.max(two - two * wp.cos(side.at), wp.float64(1.0e-12))
    of = transforms(kt, side.at, outer, side.reach * (wp.float64(1.0) + farther))
    up = wp.abs(wp.sin(side.off))
    turn = wp.sin(side.off / outer) / wp.sin(wp.abs(PI - side.off) / outer)
    hard = of.hard * turn * up * quotient(side.lift_h, real(up) + sine_h)
    soft = of.soft * quotient(product(side.lift_e, sine_e), real(up) + sine_e)
    here = wp.abs(wp.sin(side.at))
    hard_po = of.hard_po * here * quotient(real(wp.float64(1.0)), real(here) + sine_h)
    soft_po = of.soft_po * quotient(sine_e, real(here) + sine_e)
    h = -wp.cross(s, e)  # eta H, as the wave travels along -s
    hz = two / kt * wp.dot(h, z)
    ez = -wp.dot(e, z) / (kt * sine)
    kz = -wp.dot(s, z) / sine * of.cosine  # k_z / k_t of the wave that comes in, by the cosine of its angle to the face
    # J = n x H and M = E x n of the fields that E and H along the edge have.
    across = hz * (hard - hard_po)
    level = ez * (soft - soft_po)
    along = level + kz * hz * (hard + hard_po)
    magnetic = product(side.of.impedance, across) - kz * ez * quotient(soft + soft_po, side.of.admittance)
    sideways = -quotient(level, side.of.admittance)
    share = grazing_share(side.phi, outer)
    sx = wp.cross(s, side.x)
    sz = wp.cross(s, z)
    found = Field()
    found.re = share * (across[0] * side.x + along[0] * z - sideways[0] * sx - magnetic[0] * sz)
    found.im = share * (across[1] * side.x + along[1] * z - sideways[1] * sx - magnetic[1] * sz)
    return found


@wp.func
def received(p: wp.vec3d, one: Field, other: Field, factor: wp.vec2d) -> wp.vec2d:
    return product(wp.vec2d(wp.dot(p, one.re + other.re), wp.dot(p, one.im + other.im)), factor)


@wp.func
def coated_diffracted(radar: TubeRadar, k: wp.float64, edge: Edge, first: Face, second: Face) -> Four:
    """As `diffracted`, of an edge between two conductors with layers, or without."""
    found = Four()
    sight = look(radar, edge.middle, 0.0)
    s = sight.s
    full = edge.outer * PI
    sine = sine_to(s, wp.cross(edge.first, edge.normal_first))
    phi = angle_from(s, edge.first, edge.normal_first, edge.outer)
    if sine == wp.float64(0.0) or phi < wp.float64(0.0):
        return found
    one = Side()
    one.x = edge.first
    one.n = edge.normal_first
    one.reach = edge.reach_first
    one.of = surface_of(first, k, s, edge.first, edge.normal_first)
    one.phi = phi
    two = Side()
    two.x = edge.second
    two.n = edge.normal_second
    two.reach = edge.reach_second
    two.of = surface_of(second, k, s, edge.second, edge.normal_second)
    two.phi = full - phi
    at = off_poles(full - off_poles(phi))
    two.at = at
    one.at = full - at
    off = full - off_grazing(at, k * sine * edge.reach_second, sine * two.of.impedance)
    off = off_grazing(off, k * sine * edge.reach_first, sine * one.of.impedance)
    one.off = off
    two.off = full - off
    theta = Wedge()
    theta.first_e = arcsine(sine * one.of.admittance)
    theta.first_h = arcsine(sine * one.of.impedance)
    theta.second_e = arcsine(sine * two.of.admittance)
    theta.second_h = arcsine(sine * two.of.impedance)
    of = integrals(theta, off, edge.outer)
    one.lift_e = lifted(theta.first_e, theta.second_e, of.first_e, off, edge.outer)
    one.lift_h = lifted(theta.first_h, theta.second_h, of.first_h, off, edge.outer)
    two.lift_e = lifted(theta.second_e, theta.first_e, of.second_e, full - off, edge.outer)
    two.lift_h = lifted(theta.second_h, theta.first_h, of.second_h, full - off, edge.outer)
    size = sight.spread * sight.spread * edge.share * wp.length(edge.along) * sinc(k * wp.dot(s, edge.along))
    phase = turned(-wp.float64(2.0) * k * sight.back)
    factor = scaled(k, size * wp.vec2d(-phase[1], phase[0]))
    h = coated_fringe(radar.u, k, s, edge.outer, one)
    g = coated_fringe(radar.u, k, s, edge.outer, two)
    found.hh = received(radar.u, h, g, factor)
    found.vh = received(radar.v, h, g, factor)
    v = coated_fringe(radar.v, k, s, edge.outer, one)
    w = coated_fringe(radar.v, k, s, edge.outer, two)
    found.hv = received(radar.u, v, w, factor)
    found.vv = received(radar.v, v, w, factor)
    return found


@wp.func
def diffracted_of(radar: TubeRadar, k: wp.float64, edge: Edge, stuff_in: wp.array2d[Face], f: int) -> Four:
    """What a piece of an edge sends back at the frequency `f`: `diffracted` where both faces are bare."""
    first = edge.material_first
    second = edge.material_second
    if stuff_in[f, first].layer == 0 and stuff_in[f, second].layer == 0:
        return diffracted(radar, k, edge)
    return coated_diffracted(radar, k, edge, stuff_in[f, first], stuff_in[f, second])


@wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 1})
def coated_edges_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    edge_in: wp.array[Edge],
    seen_in: wp.array2d[wp.uint8],
    stuff_in: wp.array2d[Face],
    # Out:
    amplitude_out: wp.array4d[wp.vec2d],
):
    """As `edges_kernel`, with coats."""
    view, f, chunk = wp.tid()
    total = Four()
    for i in range(EDGES):
        j = chunk * EDGES + i
        if j < edge_in.shape[0]:
            if seen_in[view, j] != wp.uint8(0):
                total = plus(total, diffracted_of(radar_in[view], wavenumber_in[f], edge_in[j], stuff_in, f))
    keep(view, f, chunk, total, amplitude_out)


@wp.kernel(enable_backward=False, module="unique")
def coated_pieces_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    k: wp.float64,
    edge_in: wp.array[Edge],
    seen_in: wp.array2d[wp.uint8],
    stuff_in: wp.array2d[Face],
    # Out:
    amplitude_out: wp.array2d[wp.vec2d],
):
    """As `pieces_kernel`, with coats."""
    i = wp.tid()
    four = Four()
    if seen_in[0, i] != wp.uint8(0):
        four = diffracted_of(radar_in[0], k, edge_in[i], stuff_in, 0)
    amplitude_out[i, 0] = four.hh
    amplitude_out[i, 1] = four.hv
    amplitude_out[i, 2] = four.vh
    amplitude_out[i, 3] = four.vv
