"""Reflection at a face, and the currents on it. Time e^{+jwt}, lossy permittivity eps' - j eps''.

The coefficients are those of the tangential electric field in TE and in TM, so a conductor has -1 in both.
"""

import warp as wp

from warpsar.kernels.coherent.numbers import exponential, faded, product, quotient, square_root

UNDER = wp.constant(7)
"""Most layers below the outermost one."""
Under = wp.types.matrix(shape=(7, 5), dtype=wp.float64)
"""A row for each layer below: eps', -eps'', mu', -mu'', thickness [m]."""


@wp.struct
class Face:
    """What a face is made of at one frequency. Without `layer` a half-space, or a conductor."""

    conductor: int
    layer: int  # how many: on the conductor, or in air
    permittivity: wp.vec2d  # of the outermost layer, or of the half-space
    permeability: wp.vec2d  # of the outermost layer
    thickness: wp.float64  # [m]
    rms_height: wp.float64  # [m]
    under: Under


@wp.struct
class Field:
    """A complex electric field [V/m]."""

    re: wp.vec3d
    im: wp.vec3d


@wp.struct
class Coefficients:
    te: wp.vec2d
    tm: wp.vec2d


@wp.struct
class Load:
    """Tangential electric and magnetic field (times eta) at the top of a stack, each to a factor of its own."""

    te_e: wp.vec2d
    te_h: wp.vec2d
    tm_e: wp.vec2d
    tm_h: wp.vec2d


@wp.func
def on_top(
    below: Load,
    permittivity: wp.vec2d,
    permeability: wp.vec2d,
    thickness: wp.float64,
    k: wp.float64,
    cosine: wp.float64,
) -> Load:
    """What a layer makes of the stack below it. The wave in it fades both ways, so a thick layer cannot overflow."""
    one = wp.vec2d(wp.float64(1.0), wp.float64(0.0))
    q = square_root(product(permittivity, permeability) - (wp.float64(1.0) - cosine * cosine) * one)
    way = wp.float64(2.0) * k * thickness
    passed = exponential(wp.vec2d(way * q[1], -way * q[0]))
    admittance = quotient(q, permeability)
    impedance = quotient(q, permittivity)
    te = product(admittance, below.te_e)
    te = product(quotient(te - below.te_h, te + below.te_h), passed)
    tm = product(impedance, below.tm_h)
    tm = product(quotient(below.tm_e - tm, below.tm_e + tm), passed)
    found = Load()
    found.te_e = one + te
    found.te_h = product(admittance, one - te)
    found.tm_e = product(impedance, one + tm)
    found.tm_h = one - tm
    return found


@wp.func
def load_of(face: Face, k: wp.float64, cosine: wp.float64) -> Load:
    """The fields on a stack of layers by their transfer matrices, from the lowest up (Born and Wolf, 1.6)."""
    one = wp.vec2d(wp.float64(1.0), wp.float64(0.0))
    load = Load()
    load.te_h = one
    load.tm_h = one
    if face.conductor == 0:  # air
        load.te_e = one
        load.te_h = cosine * one
        load.tm_e = cosine * one
    for i in range(UNDER):
        row = UNDER - 1 - i
        if row + 1 < face.layer:
            eps = wp.vec2d(face.under[row, 0], face.under[row, 1])
            mu = wp.vec2d(face.under[row, 2], face.under[row, 3])
            load = on_top(load, eps, mu, face.under[row, 4], k, cosine)
    return on_top(load, face.permittivity, face.permeability, face.thickness, k, cosine)


@wp.func
def of_layers(face: Face, k: wp.float64, cosine: wp.float64) -> Coefficients:
    """Reflection of a stack of layers."""
    load = load_of(face, k, cosine)
    found = Coefficients()
    found.te = quotient(cosine * load.te_e - load.te_h, cosine * load.te_e + load.te_h)
    found.tm = quotient(load.tm_e - cosine * load.tm_h, load.tm_e + cosine * load.tm_h)
    return found


@wp.func
def coefficients(face: Face, k: wp.float64, cosine: wp.float64) -> Coefficients:
    """Fresnel's coefficients, of layers their whole stack's; with the loss of a rough face."""
    minus = wp.vec2d(wp.float64(-1.0), wp.float64(0.0))
    te = minus
    tm = minus
    if face.layer != 0:
        both = of_layers(face, k, cosine)
        te = both.te
        tm = both.tm
    elif face.conductor == 0:
        eps = face.permittivity
        c = wp.vec2d(cosine, wp.float64(0.0))
        q = square_root(eps - wp.vec2d(wp.float64(1.0) - cosine * cosine, wp.float64(0.0)))
        along = quotient(q, eps)
        te = quotient(c - q, c + q)
        tm = quotient(along - c, along + c)
    height = k * face.rms_height * cosine
    loss = wp.exp(-wp.float64(2.0) * height * height)
    found = Coefficients()
    found.te = loss * te
    found.tm = loss * tm
    return found


@wp.func
def across_plane(d: wp.vec3d, n: wp.vec3d) -> wp.vec3d:
    """Unit vector across the plane of incidence; any one across `d` where that is no plane."""
    across = wp.cross(d, n)
    if wp.length(across) < wp.float64(1.0e-9):
        across = wp.cross(d, wp.vec3d(n[1], n[2], n[0]) + wp.vec3d(wp.float64(0.3), wp.float64(-0.7), wp.float64(0.1)))
    return wp.normalize(across)


@wp.func
def mirrored(field: Field, n: wp.vec3d) -> Field:
    """The field that a smooth bare conductor sends back."""
    found = Field()
    found.re = wp.float64(2.0) * wp.dot(n, field.re) * n - field.re
    found.im = wp.float64(2.0) * wp.dot(n, field.im) * n - field.im
    return found


@wp.func
def reflected(face: Face, k: wp.float64, field: Field, d: wp.vec3d, n: wp.vec3d, out: wp.vec3d) -> Field:
    """The field that leaves along `out` where `field` meets a face along `d`; n . d < 0."""
    found = Field()
    if face.conductor != 0 and face.layer == 0 and face.rms_height == wp.float64(0.0):
        return mirrored(field, n)
    cosine = wp.min(-wp.dot(n, d), wp.float64(1.0))
    both = coefficients(face, k, cosine)
    across = across_plane(d, n)
    within = wp.cross(d, across)
    after = wp.cross(across, out)  # its tangential part is that of `within`
    te = product(both.te, wp.vec2d(wp.dot(field.re, across), wp.dot(field.im, across)))
    tm = product(both.tm, wp.vec2d(wp.dot(field.re, within), wp.dot(field.im, within)))
    found.re = te[0] * across + tm[0] * after
    found.im = te[1] * across + tm[1] * after
    return found


@wp.func
def received(e: wp.vec3d, h: wp.vec3d, n: wp.vec3d, s: wp.vec3d, p: wp.vec3d) -> wp.float64:
    """p . [eta J_t - s x M] of the fields `e` and `h` (eta H) on a face, J = n x H, M = E x n."""
    return wp.dot(p, wp.cross(n, h)) - wp.dot(p, wp.cross(s, wp.cross(e, n)))


@wp.func
def seen(field: Field, back: Field, d: wp.vec3d, out: wp.vec3d, n: wp.vec3d, s: wp.vec3d, p: wp.vec3d) -> wp.vec2d:
    """What the currents of an incoming and a reflected field send to `s` in the polarization `p`, per area."""
    re = received(field.re + back.re, wp.cross(d, field.re) + wp.cross(out, back.re), n, s, p)
    im = received(field.im + back.im, wp.cross(d, field.im) + wp.cross(out, back.im), n, s, p)
    return wp.vec2d(re, im)


@wp.func
def slab_seen(face: Face, k: wp.float64, e: wp.vec3d, d: wp.vec3d, n: wp.vec3d, s: wp.vec3d, p: wp.vec3d) -> wp.vec2d:
    """As `seen`, of a slab's polarization currents: jk (eps - 1) p . INT E e^{jk s.z} dz over its thickness, in air.

    Of one layer that is not magnetic. E is that of an endless slab that a wave `e` meets along `d`: of the wave that
    goes down, and of the one that comes up. Its normal part is what a surface with a coefficient of reflection has not
    (Le Vine, Schneider, Lang, Carter, IEEE TAP 33(12), 1985, for thin plates). In the mirror direction both are one.
    """
    one = wp.vec2d(wp.float64(1.0), wp.float64(0.0))
    eps = face.permittivity
    cosine = wp.min(-wp.dot(n, d), wp.float64(1.0))
    c = wp.vec2d(cosine, wp.float64(0.0))
    q = square_root(eps - wp.vec2d(wp.float64(1.0) - cosine * cosine, wp.float64(0.0)))
    along = quotient(q, eps)
    te = quotient(c - q, c + q)
    tm = quotient(along - c, along + c)
    kd = k * face.thickness
    passed = exponential(wp.float64(2.0) * kd * wp.vec2d(q[1], -q[0]))
    # j k d (s_n + q) and j k d (s_n - q): how the phase to the radar turns over the thickness.
    normal = wp.dot(s, n)
    down_x = kd * wp.vec2d(-q[1], normal + q[0])
    up_x = kd * wp.vec2d(q[1], normal - q[0])
    down = faded(down_x)
    up = product(passed, faded(up_x))
    if wp.dot(up_x, up_x) > wp.float64(1.0):  # without the large e^{-x} of a thick slab with losses
        up = quotient(passed - exponential(-down_x), up_x)
    down_te = quotient(one + te, one - product(product(te, te), passed))
    down_tm = quotient(one + tm, one - product(product(tm, tm), passed))
    across = across_plane(d, n)
    within = wp.cross(d, across)
    level = within - wp.dot(n, within) * n
    sum_te = product(down_te, down - product(te, up))
    sum_tm = product(down_tm, down - product(tm, up))
    normal_tm = quotient(product(down_tm, down + product(tm, up)), q)
    total = wp.dot(e, across) * wp.dot(p, across) * sum_te
    total += wp.dot(e, within) * wp.dot(p, level) * sum_tm
    total += wp.dot(e, within) * wp.dot(p, n) * wp.dot(n, within) * cosine * normal_tm
    height = k * face.rms_height * cosine
    loss = wp.exp(-wp.float64(2.0) * height * height)
    polarized = product(eps - one, total)
    return loss * kd * wp.vec2d(-polarized[1], polarized[0])
