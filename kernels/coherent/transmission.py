"""Tubes that enter a solid dielectric body: refracted, reflected inside, and what they send where they come out.

Snell's law by the real part of the index, its imaginary part as a loss on the way. Differentials of a refracted ray:
Igehy (SIGGRAPH 1999). Where a tube meets the body's surface from inside, the total tangential fields of the inside are
those of the outside, so their currents are what the surface sends, also beyond the angle of total reflection.
"""

import warp as wp

from warpsar.kernels.coherent.borders import FIRST, PRIME, Marked
from warpsar.kernels.coherent.cells import RAYS, Cells
from warpsar.kernels.coherent.numbers import product, quotient, root, sinc, square_root, turned
from warpsar.kernels.coherent.radiate import HALF_PI, Pair, scaled, unit
from warpsar.kernels.coherent.reflection import Face, Field, across_plane, mirrored, received
from warpsar.kernels.coherent.tubes import (
    Meeting,
    Tube,
    TubeMesh,
    TubeRadar,
    bounced,
    crossings,
    free,
    look,
    met,
    start_tube,
    way_to,
)

NEAR = wp.constant(wp.float64(0.499))
"""Where rays stand for the corners of a cell, over its width from the middle. On the border of a body they miss it."""


@wp.struct
class Inside:
    """A refracted tube with its fields."""

    tube: Tube
    fields: Pair


@wp.func
def along_both(e: Field, across: wp.vec3d, within: wp.vec3d, te: wp.vec2d, tm: wp.vec2d, after: wp.vec3d) -> Field:
    """A field whose parts along `across` and `within` take factors, the second one then along `after`."""
    a = product(te, wp.vec2d(wp.dot(e.re, across), wp.dot(e.im, across)))
    b = product(tm, wp.vec2d(wp.dot(e.re, within), wp.dot(e.im, within)))
    found = Field()
    found.re = a[0] * across + b[0] * after
    found.im = a[1] * across + b[1] * after
    return found


@wp.func
def entered(tube: Tube, at: Meeting, permittivity: wp.vec2d, index: wp.float64, fields: Pair) -> Inside:
    """The tube behind the surface of a body of an `index` that it meets from air."""
    one = wp.float64(1.0)
    n = at.normal
    d = tube.d
    eta = one / index
    c1 = wp.min(wp.dot(d, n), -wp.float64(1.0e-6))
    c2 = wp.sqrt(one - eta * eta * (one - c1 * c1))
    mu = eta * c1 + c2
    out = wp.normalize(eta * d - mu * n)
    slope = eta + eta * eta * c1 / c2
    du = eta * tube.du - mu * at.nu - slope * (wp.dot(tube.du, n) + wp.dot(d, at.nu)) * n
    dv = eta * tube.dv - mu * at.nv - slope * (wp.dot(tube.dv, n) + wp.dot(d, at.nv)) * n
    # coefficients of the tangential field, as in `reflection`
    unity = wp.vec2d(one, wp.float64(0.0))
    c = wp.vec2d(-c1, wp.float64(0.0))
    q = square_root(permittivity - wp.vec2d(one - c1 * c1, wp.float64(0.0)))
    along = quotient(q, permittivity)
    te = unity + quotient(c - q, c + q)
    tm = (unity + quotient(along - c, along + c)) * (-c1 / c2)
    across = across_plane(d, n)
    found = Inside()
    found.tube.point = at.point
    found.tube.d = out
    found.tube.pu = at.pu
    found.tube.pv = at.pv
    found.tube.du = du - wp.dot(du, out) * out
    found.tube.dv = dv - wp.dot(dv, out) * out
    found.tube.path = at.path
    found.tube.initial = tube.initial * wp.dot(at.flat, out) / wp.dot(at.flat, d)
    after = wp.cross(out, across)
    found.fields.h = along_both(fields.h, across, wp.cross(d, across), te, tm, after)
    found.fields.v = along_both(fields.v, across, wp.cross(d, across), te, tm, after)
    return found


@wp.func
def reflected_inside(e: Field, d: wp.vec3d, n: wp.vec3d, out: wp.vec3d, index: wp.vec2d) -> Field:
    """The field that stays inside where the body ends; n . d < 0. Beyond the critical angle all of it stays."""
    one = wp.float64(1.0)
    cosine = wp.min(-wp.dot(n, d), one)
    c = wp.vec2d(cosine, wp.float64(0.0))
    # outside the wave fades along e^{-jkqz}: the root with a negative imaginary part. Angles are the real index's
    q = square_root(wp.vec2d(one - index[0] * index[0] * (one - cosine * cosine), -wp.float64(1.0e-30)))
    te = quotient(product(index, c) - q, product(index, c) + q)
    tm = quotient(q - quotient(c, index), q + quotient(c, index))
    across = across_plane(d, n)
    return along_both(e, across, wp.cross(d, across), te, tm, wp.cross(across, out))


@wp.func
def sent_out(
    e: Field, back: Field, d: wp.vec3d, out: wp.vec3d, n: wp.vec3d, index: wp.vec2d, s: wp.vec3d, p: wp.vec3d
) -> wp.vec2d:
    """What the fields under a surface with the outward normal `n` send to `s` in the polarization `p`, per area."""
    h_re = wp.cross(d, e.re) + wp.cross(out, back.re)
    h_im = wp.cross(d, e.im) + wp.cross(out, back.im)
    re = received(e.re + back.re, index[0] * h_re - index[1] * h_im, n, s, p)
    return wp.vec2d(re, received(e.im + back.im, index[0] * h_im + index[1] * h_re, n, s, p))


@wp.func
def mark_inside(
    marked: Marked, radar: TubeRadar, place: wp.vec2d, stuff_in: wp.array2d[Face], material_in: wp.array[int]
) -> wp.uint64:
    """A number for the surfaces that a ray meets inside a solid, in their order, and which the radar sees it leave by.

    As `borders.mark_of` outside. It is the same for all rays that enter no solid.
    """
    body = marked.body
    mark = FIRST
    side = wp.vec2d()
    tube = start_tube(radar, place, side, side, marked.standoff, body.reach)
    query = wp.mesh_query_ray(body.tree, wp.vec3(tube.point), wp.vec3(tube.d), body.reach)
    if not query.result:
        return mark
    face = query.face
    stuff = stuff_in[0, material_in[face]]
    t = way_to(tube, body.vertices, body.faces, face)
    if stuff.conductor != 0 or stuff.layer != 0 or t <= wp.float64(0.0):
        return mark
    mark = (mark ^ wp.uint64(marked.surface[face] + 1)) * PRIME
    at = met(tube, t, body.vertices, body.faces, body.normals, body.curved[face], face)
    tube = entered(tube, at, stuff.permittivity, square_root(stuff.permittivity)[0], Pair()).tube
    start = at.point - body.offset * at.flat
    for _b in range(marked.most):
        inner = wp.mesh_query_ray(body.tree, wp.vec3(start), wp.vec3(tube.d), body.reach)
        if not inner.result:
            break
        face = inner.face
        t = way_to(tube, body.vertices, body.faces, face)
        if t <= wp.float64(0.0):
            break
        at = met(tube, t, body.vertices, body.faces, body.normals, body.curved[face], face)
        seen = int(0)
        if wp.dot(at.flat, look(radar, at.point, body.reach).s) < wp.float64(0.0):
            seen = free(body, radar, at.point, -at.flat)
        mark = (mark ^ wp.uint64(2 * marked.surface[face] + seen + 1)) * PRIME
        tube = bounced(tube, at)
        start = at.point + body.offset * at.flat
    return mark


@wp.kernel(enable_backward=False)
def halves_kernel(
    # In:
    marked: Marked,
    radar_in: wp.array[TubeRadar],
    stuff_in: wp.array2d[Face],
    material_in: wp.array[int],
    cells: Cells,
    finest: wp.float64,
    # Out:
    kept_out: wp.array[int],
    cut_out: wp.array[wp.vec2d],
    parts_out: wp.array[int],
):
    """Which cells stay. The others are halved along u or v, wherever rays near their corners have other marks.

    `cut_out`: 1 where a cell is halved, else 0. Those up to `finest` [m] wide are not.
    """
    i = wp.tid()
    size = cells.size[i]
    zero = wp.float64(0.0)
    one = wp.float64(1.0)
    cut = wp.vec2d()
    if size[0] > finest or size[1] > finest:
        radar = radar_in[cells.view[i]]
        place = cells.place[i]
        near = NEAR * size
        across = wp.vec2d(near[0], -near[1])
        low = mark_inside(marked, radar, place - near, stuff_in, material_in)
        along_u = mark_inside(marked, radar, place + across, stuff_in, material_in)
        along_v = mark_inside(marked, radar, place - across, stuff_in, material_in)
        high = mark_inside(marked, radar, place + near, stuff_in, material_in)
        if low != along_u or along_v != high:
            cut[0] = one
        if low != along_v or along_u != high:
            cut[1] = one
        if cut[0] + cut[1] == zero and mark_inside(marked, radar, place, stuff_in, material_in) != low:
            cut = wp.vec2d(one, one)
        if size[0] <= finest:
            cut[0] = zero
        if size[1] <= finest:
            cut[1] = zero
    parts = (1 + int(cut[0])) * (1 + int(cut[1]))
    kept_out[i] = wp.where(parts == 1 and size[0] > zero and size[1] > zero, 1, 0)
    cut_out[i] = cut
    parts_out[i] = wp.where(parts > 1, parts, 0)


@wp.kernel(enable_backward=False)
def transmission_kernel(
    # In:
    body: TubeMesh,
    radar_in: wp.array[TubeRadar],
    wavenumber_in: wp.array[wp.float64],
    stuff_in: wp.array2d[Face],
    material_in: wp.array[int],
    cells: Cells,
    kept_in: wp.array[int],
    standoff: wp.float64,
    most: int,
    # Out:
    amplitude_out: wp.array4d[wp.vec2d],
):
    """Each thread adds up RAYS rays of one view at one frequency: (chunks, frequencies, 1, (HH, HV, VH, VV)).

    A ray counts whose first hit is on a solid dielectric. It meets up to `most` faces inside. It ends where it gets to
    -80 dB.
    """
    chunk, f = wp.tid()
    k = wavenumber_in[f]
    zero = wp.float64(0.0)
    half = wp.float64(0.5)
    hh = wp.vec2d()
    hv = wp.vec2d()
    vh = wp.vec2d()
    vv = wp.vec2d()
    for ray in range(chunk * RAYS, (chunk + 1) * RAYS):
        size = cells.size[ray]
        if kept_in[ray] != 0:
            radar = radar_in[cells.view[ray]]
            tube = start_tube(
                radar, cells.place[ray], wp.vec2d(size[0], zero), wp.vec2d(zero, size[1]), standoff, body.reach
            )
            query = wp.mesh_query_ray(body.tree, wp.vec3(tube.point), wp.vec3(tube.d), body.reach)
            solid = int(0)
            t = zero
            if query.result:
                stuff = stuff_in[f, material_in[query.face]]
                t = way_to(tube, body.vertices, body.faces, query.face)
                if stuff.conductor == 0 and stuff.layer == 0 and t > zero:
                    solid = 1
            if solid != 0:
                eps = stuff_in[f, material_in[query.face]].permittivity
                complex_index = square_root(eps)
                index = complex_index[0]
                fade = -k * complex_index[1]
                at = met(tube, t, body.vertices, body.faces, body.normals, body.curved[query.face], query.face)
                fields = Pair()
                fields.h = unit(radar.u)
                fields.v = unit(radar.v)
                inside = entered(tube, at, eps, index, fields)
                tube = inside.tube
                fields = inside.fields
                start = at.point - body.offset * at.flat
                caustics = int(0)
                loss = wp.float64(1.0)
                alive = int(1)
                for _b in range(most):
                    if alive != 0:
                        inner = wp.mesh_query_ray(body.tree, wp.vec3(start), wp.vec3(tube.d), body.reach)
                        alive = 0
                        if inner.result:
                            face = inner.face
                            way = way_to(tube, body.vertices, body.faces, face)
                            if way > zero:
                                alive = 1
                        if alive != 0:
                            area0 = wp.dot(tube.d, wp.cross(tube.pu, tube.pv))
                            area1 = wp.dot(tube.d, wp.cross(tube.du, tube.pv) + wp.cross(tube.pu, tube.dv))
                            area2 = wp.dot(tube.d, wp.cross(tube.du, tube.dv))
                            caustics += crossings(area0, area1, area2, way)
                            path = tube.path + index * way
                            loss = loss * wp.exp(-fade * way)
                            at = met(tube, way, body.vertices, body.faces, body.normals, body.curved[face], face)
                            out = wp.normalize(at.out)
                            d = tube.d
                            n = at.normal
                            back = Pair()
                            ends = stuff_in[f, material_in[face]]
                            if ends.conductor != 0:
                                back.h = mirrored(fields.h, n)
                                back.v = mirrored(fields.v, n)
                            else:
                                back.h = reflected_inside(fields.h, d, n, out, complex_index)
                                back.v = reflected_inside(fields.v, d, n, out, complex_index)
                                sight = look(radar, at.point, body.reach)
                                if wp.dot(at.flat, sight.s) < zero:
                                    if free(body, radar, at.point, -at.flat) != 0:
                                        s = sight.s
                                        area = wp.abs(wp.dot(d, wp.cross(at.pu, at.pv)))
                                        weight = root(tube.initial * area) / -wp.dot(at.flat, d)
                                        turn = half * k * (s - index * d)
                                        weight = weight * sinc(wp.dot(turn, at.pu)) * sinc(wp.dot(turn, at.pv))
                                        phase = -k * (sight.back + path) + wp.float64(caustics) * HALF_PI
                                        factor = scaled(k, sight.spread * weight * loss * turned(phase))
                                        m = complex_index
                                        u = radar.u
                                        v = radar.v
                                        hh += product(factor, sent_out(fields.h, back.h, d, out, -n, m, s, u))
                                        vh += product(factor, sent_out(fields.h, back.h, d, out, -n, m, s, v))
                                        hv += product(factor, sent_out(fields.v, back.v, d, out, -n, m, s, u))
                                        vv += product(factor, sent_out(fields.v, back.v, d, out, -n, m, s, v))
                            fields = back
                            tube = bounced(tube, at)
                            tube.path = path
                            start = at.point + body.offset * at.flat
                            left = wp.length_sq(fields.h.re) + wp.length_sq(fields.h.im)
                            left += wp.length_sq(fields.v.re) + wp.length_sq(fields.v.im)
                            if left * loss * loss < wp.float64(1.0e-8):
                                alive = 0
    amplitude_out[chunk, f, 0, 0] = hh
    amplitude_out[chunk, f, 0, 1] = hv
    amplitude_out[chunk, f, 0, 2] = vh
    amplitude_out[chunk, f, 0, 3] = vv
