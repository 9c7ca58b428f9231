"""What faces send back to the radar: A [m] of E = A e^{-jkR} / R, in all four polarizations.

A = -j k / (4 pi) p . INT [eta J_t - s x M] e^{jk s.r} dS over the faces that the radar sees.
"""

import warp as wp

from warpsar.kernels.coherent.cells import RAYS
from warpsar.kernels.coherent.numbers import product, sinc, turned
from warpsar.kernels.coherent.reflection import Face, Field, mirrored, reflected, seen, slab_seen
from warpsar.kernels.coherent.tubes import Hit, Look, TubeRadar, look

REGIONS = wp.constant(16)
"""Flat regions that one thread adds up."""
HALF_PI = wp.constant(wp.float64(1.5707963267948966))
FOUR_PI = wp.constant(wp.float64(12.566370614359172))


@wp.func
def scaled(k: wp.float64, value: wp.vec2d) -> wp.vec2d:
    """-j k / (4 pi) times `value`."""
    return wp.vec2d(value[1], -value[0]) * (k / FOUR_PI)


@wp.func
def unit(p: wp.vec3d) -> Field:
    field = Field()
    field.re = p
    return field


@wp.struct
class Four:
    """Amplitudes in the four polarizations, received and transmitted."""

    hh: wp.vec2d
    hv: wp.vec2d
    vh: wp.vec2d
    vv: wp.vec2d


@wp.func
def plus(one: Four, other: Four) -> Four:
    found = Four()
    found.hh = one.hh + other.hh
    found.hv = one.hv + other.hv
    found.vh = one.vh + other.vh
    found.vv = one.vv + other.vv
    return found


@wp.func
def keep(view: int, f: int, chunk: int, four: Four, amplitude_out: wp.array4d[wp.vec2d]):
    """One sum of a direction, a frequency and a chunk of bodies' parts."""
    amplitude_out[view, f, chunk, 0] = four.hh
    amplitude_out[view, f, chunk, 1] = four.hv
    amplitude_out[view, f, chunk, 2] = four.vh
    amplitude_out[view, f, chunk, 3] = four.vv


@wp.struct
class Pair:
    """The fields of a tube whose incident wave is H, and V."""

    h: Field
    v: Field


@wp.func
def bounced_fields(stuff: Face, k: wp.float64, fields: Pair, d: wp.vec3d, n: wp.vec3d) -> Pair:
    """Both fields after a reflection."""
    out = d - wp.float64(2.0) * wp.dot(n, d) * n
    found = Pair()
    found.h = reflected(stuff, k, fields.h, d, n, out)
    found.v = reflected(stuff, k, fields.v, d, n, out)
    return found


@wp.func
def bounced_off(
    stuff_in: wp.array2d[Face], f: int, material: int, k: wp.float64, fields: Pair, d: wp.vec3d, n: wp.vec3d
) -> Pair:
    """As `bounced_fields`. A bare conductor is not copied with its empty rows of layers: that took a third longer."""
    found = Pair()
    bare = int(0)
    if stuff_in[f, material].conductor != 0 and stuff_in[f, material].layer == 0:
        if stuff_in[f, material].rms_height == wp.float64(0.0):
            bare = 1
    if bare != 0:
        found.h = mirrored(fields.h, n)
        found.v = mirrored(fields.v, n)
    else:
        found = bounced_fields(stuff_in[f, material], k, fields, d, n)
    return found


@wp.func
def sent(
    factor: wp.vec2d, fields: Pair, back: Pair, d: wp.vec3d, n: wp.vec3d, s: wp.vec3d, u: wp.vec3d, v: wp.vec3d
) -> Four:
    """What the currents of incoming and reflected fields on a face send to the radar."""
    out = d - wp.float64(2.0) * wp.dot(n, d) * n
    found = Four()
    found.hh = product(factor, seen(fields.h, back.h, d, out, n, s, u))
    found.vh = product(factor, seen(fields.h, back.h, d, out, n, s, v))
    found.hv = product(factor, seen(fields.v, back.v, d, out, n, s, u))
    found.vv = product(factor, seen(fields.v, back.v, d, out, n, s, v))
    return found


@wp.func
def tube_factor(k: wp.float64, hit: Hit, sight: Look) -> wp.vec2d:
    """Area, spread and phase of a tube's footprint, and the factor of the far field."""
    half = wp.float64(0.5)
    phase = -k * (sight.back + hit.path) + wp.float64(hit.caustics) * HALF_PI
    turn = half * k * (sight.s - hit.d)
    size = sight.spread * hit.weight * sinc(wp.dot(turn, hit.across_u)) * sinc(wp.dot(turn, hit.across_v))
    return scaled(k, size * turned(phase))


@wp.kernel(enable_backward=False)
def tubes_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    stuff_in: wp.array2d[Face],
    material_in: wp.array[int],
    region_in: wp.array[int],
    exact_in: wp.array2d[wp.uint8],
    view_in: wp.array[int],
    used_in: wp.array[int],
    hits_in: wp.array2d[Hit],
    count_in: wp.array[int],
    only: int,
    # Out:
    amplitude_out: wp.array4d[wp.vec2d],
):
    """Each thread adds up RAYS rays of one view at one frequency: (single, further bounces) x (HH, HV, VH, VV).

    `only`: the number of the one bounce that counts, from 0; all of them with -1.

    A first hit on a flat region that is lit as a whole is left to `regions_kernel`, which has its exact border. The
    eight sums, which a function could not give back, make it longer than others.
    """
    chunk, f = wp.tid()
    k = wavenumber_in[f]
    zero2 = wp.vec2d()
    one_hh = zero2
    one_hv = zero2
    one_vh = zero2
    one_vv = zero2
    more_hh = zero2
    more_hv = zero2
    more_vh = zero2
    more_vv = zero2
    for ray in range(chunk * RAYS, (chunk + 1) * RAYS):  # with constant ends Warp would write it out
        if used_in[ray] != 0:
            view = view_in[ray]
            u = radar_in[view].u
            v = radar_in[view].v
            fields = Pair()
            fields.h = unit(u)
            fields.v = unit(v)
            count = count_in[ray]
            if only >= 0:
                count = wp.where(only < count, only + 1, 0)
            for b in range(count):
                hit = hits_in[b, ray]
                back = bounced_off(stuff_in, f, material_in[hit.face], k, fields, hit.d, hit.normal)
                counts = hit.seen
                if only >= 0 and b != only:
                    counts = 0
                if b == 0:
                    region = region_in[hit.face]
                    if region >= 0:
                        if exact_in[view, region] != wp.uint8(0):
                            counts = 0
                if counts != 0:
                    sight = look(radar_in[view], hit.point, 0.0)
                    four = sent(tube_factor(k, hit, sight), fields, back, hit.d, hit.normal, sight.s, u, v)
                    if b == 0:
                        one_hh += four.hh
                        one_hv += four.hv
                        one_vh += four.vh
                        one_vv += four.vv
                    else:
                        more_hh += four.hh
                        more_hv += four.hv
                        more_vh += four.vh
                        more_vv += four.vv
                fields = back
    amplitude_out[chunk, f, 0, 0] = one_hh
    amplitude_out[chunk, f, 0, 1] = one_hv
    amplitude_out[chunk, f, 0, 2] = one_vh
    amplitude_out[chunk, f, 0, 3] = one_vv
    amplitude_out[chunk, f, 1, 0] = more_hh
    amplitude_out[chunk, f, 1, 1] = more_hv
    amplitude_out[chunk, f, 1, 2] = more_vh
    amplitude_out[chunk, f, 1, 3] = more_vv


@wp.func
def add_to(face: int, later: int, four: Four, total_out: wp.array3d[wp.vec2d]):
    wp.atomic_add(total_out, face, later, 0, four.hh)
    wp.atomic_add(total_out, face, later, 1, four.hv)
    wp.atomic_add(total_out, face, later, 2, four.vh)
    wp.atomic_add(total_out, face, later, 3, four.vv)


@wp.kernel(enable_backward=False)
def by_face_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    k: wp.float64,
    stuff_in: wp.array2d[Face],
    material_in: wp.array[int],
    region_in: wp.array[int],
    exact_in: wp.array2d[wp.uint8],
    view_in: wp.array[int],
    used_in: wp.array[int],
    hits_in: wp.array2d[Hit],
    count_in: wp.array[int],
    # Out:
    total_out: wp.array3d[wp.vec2d],
):
    """As `tubes_kernel` at one frequency, kept for the face that sends it: (faces, first or later bounce, 4)."""
    ray = wp.tid()
    if used_in[ray] == 0:
        return
    view = view_in[ray]
    u = radar_in[view].u
    v = radar_in[view].v
    fields = Pair()
    fields.h = unit(u)
    fields.v = unit(v)
    for b in range(count_in[ray]):
        hit = hits_in[b, ray]
        back = bounced_off(stuff_in, 0, material_in[hit.face], k, fields, hit.d, hit.normal)
        counts = hit.seen
        region = region_in[hit.face]
        if b == 0 and region >= 0:
            if exact_in[view, region] != wp.uint8(0):
                counts = 0
        if counts != 0:
            sight = look(radar_in[view], hit.point, 0.0)
            four = sent(tube_factor(k, hit, sight), fields, back, hit.d, hit.normal, sight.s, u, v)
            add_to(hit.face, wp.min(b, 1), four, total_out)
        fields = back


@wp.struct
class Region:
    """A flat part of the surface with its border, a list of straight edges around the normal."""

    normal: wp.vec3d
    centre: wp.vec3d  # [m]
    area: wp.float64  # [m2]
    reach: wp.float64  # largest extent [m]
    material: int
    first: int  # of its edges
    end: int


@wp.func
def phase_integral(
    region: Region,
    k: wp.float64,
    s: wp.vec3d,
    middle_in: wp.array[wp.vec3d],
    edge_in: wp.array[wp.vec3d],
) -> wp.vec2d:
    """INT e^{2jk s.r} dS over a plane polygon, exactly (Gordon, IEEE TAP 23(4), 1975)."""
    two_k = wp.float64(2.0) * k
    n = region.normal
    w = two_k * (s - wp.dot(s, n) * n)
    size = wp.dot(w, w)
    if wp.sqrt(size) * region.reach < wp.float64(1.0e-4):
        return region.area * turned(two_k * wp.dot(s, region.centre))
    total = wp.vec2d()
    for e in range(region.first, region.end):
        along = edge_in[e]
        across = wp.dot(w, wp.cross(along, n)) * sinc(wp.float64(0.5) * wp.dot(w, along))
        total += across * turned(two_k * wp.dot(s, middle_in[e]))
    return wp.vec2d(total[1], -total[0]) / size


@wp.func
def flat_sent(
    stuff: Face, k: wp.float64, integral: wp.vec2d, n: wp.vec3d, s: wp.vec3d, u: wp.vec3d, v: wp.vec3d
) -> Four:
    """What a plane surface with a phase integral sends back of a plane wave."""
    if wp.dot(n, s) < wp.float64(0.0):
        n = -n
    fields = Pair()
    fields.h = unit(u)
    fields.v = unit(v)
    back = bounced_fields(stuff, k, fields, -s, n)
    return sent(scaled(k, integral), fields, back, -s, n, s, u, v)


@wp.func
def slab_sent(
    stuff: Face, k: wp.float64, integral: wp.vec2d, n: wp.vec3d, s: wp.vec3d, u: wp.vec3d, v: wp.vec3d
) -> Four:
    """What the polarization of a slab in air sends back of a plane wave beyond `flat_sent`; nothing of other faces.

    Of a stack, and of a magnetic slab, too, nothing: they have the coefficient of reflection alone.
    """
    found = Four()
    if stuff.layer != 1 or stuff.conductor != 0:
        return found
    if stuff.permeability[0] != wp.float64(1.0) or stuff.permeability[1] != wp.float64(0.0):
        return found
    if wp.dot(n, s) < wp.float64(0.0):
        n = -n
    factor = scaled(k, integral)
    flat = flat_sent(stuff, k, integral, n, s, u, v)
    found.hh = product(factor, slab_seen(stuff, k, u, -s, n, s, u)) - flat.hh
    found.hv = product(factor, slab_seen(stuff, k, v, -s, n, s, u)) - flat.hv
    found.vh = product(factor, slab_seen(stuff, k, u, -s, n, s, v)) - flat.vh
    found.vv = product(factor, slab_seen(stuff, k, v, -s, n, s, v)) - flat.vv
    return found


@wp.kernel(enable_backward=False)
def regions_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    stuff_in: wp.array2d[Face],
    exact_in: wp.array2d[wp.uint8],
    region_in: wp.array[Region],
    middle_in: wp.array[wp.vec3d],
    edge_in: wp.array[wp.vec3d],
    slabs: int,
    # Out:
    amplitude_out: wp.array4d[wp.vec2d],
):
    """Physical optics of REGIONS flat regions that are lit as a whole, shape (views, frequencies, chunks, 4).

    With `slabs` what slabs in air send beyond that.
    """
    view, f, chunk = wp.tid()
    k = wavenumber_in[f]
    s = radar_in[view].s
    u = radar_in[view].u
    v = radar_in[view].v
    total = Four()
    for r in range(chunk * REGIONS, wp.min((chunk + 1) * REGIONS, region_in.shape[0])):
        if exact_in[view, r] != wp.uint8(0):
            region = region_in[r]
            integral = phase_integral(region, k, s, middle_in, edge_in)
            four = Four()
            if slabs != 0:
                four = slab_sent(stuff_in[f, region.material], k, integral, region.normal, s, u, v)
            else:
                four = flat_sent(stuff_in[f, region.material], k, integral, region.normal, s, u, v)
            total = plus(total, four)
    keep(view, f, chunk, total, amplitude_out)


@wp.kernel(enable_backward=False)
def by_triangle_kernel(
    # In:
    radar_in: wp.array[TubeRadar],
    k: wp.float64,
    stuff_in: wp.array2d[Face],
    region_in: wp.array[Region],
    middle_in: wp.array[wp.vec3d],
    edge_in: wp.array[wp.vec3d],
    face_in: wp.array[int],
    # Out:
    total_out: wp.array3d[wp.vec2d],
):
    """Physical optics of triangles that a flat region is made of, each a region by itself: to those of their faces."""
    i = wp.tid()
    region = region_in[i]
    s = radar_in[0].s
    integral = phase_integral(region, k, s, middle_in, edge_in)
    four = flat_sent(stuff_in[0, region.material], k, integral, region.normal, s, radar_in[0].u, radar_in[0].v)
    add_to(face_in[i], 0, four, total_out)
