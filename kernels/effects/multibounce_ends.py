"""How surfaces answer the rays of a path: mirrors, and the end of it, as a wave with a phase or by its roughness.

Fields are those of a wave of 1 V/m in one of the radar's polarizations. Amplitudes are complex.
"""

import warp as wp

from warpsar.kernels.codes import Coordinate
from warpsar.kernels.coherent.bistatic import HEIGHTS, diffuse_shares, first_order, mirrored
from warpsar.kernels.coherent.reflection import Face, Field, reflected, seen
from warpsar.kernels.effects.multibounce import Bounce
from warpsar.kernels.geometry import cos2_azimuth_of
from warpsar.kernels.models.ka_spm import fraction_of


@wp.struct
class Stuff:
    """What the faces of a mesh are made of: `face_material` by face, the others by material.

    `has_length`: 0 where the backscatter model has no correlation length.
    """

    face_material: wp.array(dtype=int)
    eps_im: wp.array(dtype=float)
    spectrum: wp.array(dtype=int)
    aspect: wp.array(dtype=float)
    has_length: wp.array(dtype=int)


@wp.struct
class RadarWaves:
    """Wavenumber [rad/m], and the directions of H and V at the reference point."""

    wavenumber: float
    u: wp.vec3
    v: wp.vec3


@wp.struct
class Arriving:
    """The fields that arrive at surfaces, real and imaginary part [V/m]."""

    re: wp.array(dtype=wp.vec3)
    im: wp.array(dtype=wp.vec3)


@wp.func
def face_of(stuff: Stuff, face: int, zeta: wp.vec4) -> Face:
    """The face with its roughness; coordinates as in kernels/codes.py."""
    found = Face()
    found.conductor = 0
    found.layer = 0
    found.permittivity = wp.vec2d(
        wp.float64(1.0) + wp.exp(wp.float64(zeta[Coordinate.EPS])), -wp.float64(stuff.eps_im[stuff.face_material[face]])
    )
    found.rms_height = wp.exp(wp.float64(zeta[Coordinate.HEIGHT]))
    return found


@wp.func
def smooth(face: Face) -> Face:
    found = Face()
    found.conductor = 0
    found.layer = 0
    found.permittivity = face.permittivity
    found.rms_height = wp.float64(0.0)
    return found


@wp.func
def polarized(radar: RadarWaves, direction: wp.vec3, vertical: int) -> wp.vec3:
    """The radar's H, or its V across a ray."""
    if vertical == 0:
        return radar.u
    return wp.normalize(radar.v - wp.dot(radar.v, direction) * direction)


@wp.func
def field_of(arriving: Arriving, i: int) -> Field:
    field = Field()
    field.re = wp.vec3d(arriving.re[i])
    field.im = wp.vec3d(arriving.im[i])
    return field


@wp.kernel(enable_backward=False)
def incident_kernel(
    # In:
    radar: RadarWaves,
    arrival: wp.array(dtype=wp.vec3),
    vertical: int,
    # Out:
    re_out: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    re_out[i] = polarized(radar, arrival[i], vertical)


@wp.kernel
def reflect_kernel(
    # In:
    radar: RadarWaves,
    bounce: Bounce,
    stuff: Stuff,
    zeta: wp.array(dtype=wp.vec4),
    field: Arriving,
    # Out:
    re_out: wp.array(dtype=wp.vec3),
    im_out: wp.array(dtype=wp.vec3),
):
    """A surface before the last one: its coherent reflection, which is weaker by exp(-2 (k h cos theta)^2)."""
    i = wp.tid()
    d = wp.vec3d(bounce.direction[i])
    n = wp.vec3d(bounce.normal[i])
    out = d - wp.float64(2.0) * wp.dot(n, d) * n
    face = face_of(stuff, bounce.face[i], zeta[i])
    back = reflected(face, wp.float64(radar.wavenumber), field_of(field, i), d, n, out)
    re_out[i] = wp.vec3(back.re)
    im_out[i] = wp.vec3(back.im)


@wp.func
def answer(
    face: Face, k: wp.float64, field: Field, d: wp.vec3d, n: wp.vec3d, s: wp.vec3d, receive: wp.vec3d
) -> wp.vec2d:
    """What the currents that `field` makes on a face send to `s`, per area, in the polarization `receive`."""
    out = d - wp.float64(2.0) * wp.dot(n, d) * n
    return seen(field, reflected(face, k, field, d, n, out), d, out, n, s, receive)


@wp.kernel
def radiate_kernel(
    # In:
    radar: RadarWaves,
    received: int,  # 1: V
    sent: int,
    bounce: Bounce,
    home: wp.array(dtype=wp.vec3),
    stuff: Stuff,
    zeta: wp.array(dtype=wp.vec4),
    arriving: Arriving,
    arriving_other: Arriving,
    # Out:
    amplitude_out: wp.array(dtype=wp.vec2),
):
    """What the currents on the last surface send to the radar, per area, with the coherent share of its reflection.

    Of both ways over the same surfaces one may stand for both (`kernels.effects.multibounce_cells.ways_of`). The way
    back has the transposed amplitude, so a crossed channel is the mean of both. `arriving_other` is what arrives here
    when the radar sends the polarization it receives.
    """
    i = wp.tid()
    d = wp.vec3d(bounce.direction[i])
    n = wp.vec3d(bounce.normal[i])
    s = wp.vec3d(home[i])
    face = face_of(stuff, bounce.face[i], zeta[i])
    k = wp.float64(radar.wavenumber)
    amplitude = answer(face, k, field_of(arriving, i), d, n, s, wp.vec3d(polarized(radar, home[i], received)))
    if received != sent:
        other = answer(face, k, field_of(arriving_other, i), d, n, s, wp.vec3d(polarized(radar, home[i], sent)))
        amplitude = wp.float64(0.5) * (amplitude + other)
    amplitude_out[i] = wp.vec2(amplitude)


@wp.kernel
def sample_kernel(
    # In:
    first: wp.array(dtype=int),
    coupling: wp.array(dtype=wp.vec2),
    amplitude: wp.array(dtype=wp.vec2),
    # Out:
    field_out: wp.array(dtype=wp.vec2),
):
    """The field in each sample of the cells [m]: those of its paths, which lie together from `first` on."""
    i = wp.tid()
    total = wp.vec2()
    for k in range(first[i], first[i + 1]):
        a = coupling[k]
        b = amplitude[k]
        total += wp.vec2(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])
    field_out[i] = total


@wp.kernel
def cell_power_kernel(
    # In:
    p: wp.array(dtype=float),  # strength
    first: wp.array(dtype=int),
    sample: wp.array(dtype=int),
    field: wp.array(dtype=wp.vec2),
    # Out:
    power_out: wp.array(dtype=float),
):
    """A sample's power [m2], over 4 pi. The first of its paths stands for all of them."""
    i = wp.tid()
    j = sample[i]
    power = float(0.0)
    if first[j] == i:
        power = p[0] * wp.dot(field[j], field[j])
    power_out[i] = power


@wp.kernel
def diffuse_kernel(
    # In:
    p: wp.array(dtype=float),  # strength
    radar: RadarWaves,
    received: int,  # 1: V
    sent: int,
    bounce: Bounce,
    home: wp.array(dtype=wp.vec3),
    stuff: Stuff,
    log_factorial: wp.array(dtype=wp.float64),
    zeta: wp.array(dtype=wp.vec4),
    arriving: Arriving,
    arriving_other: Arriving,
    # Out:
    power_out: wp.array(dtype=float),
):
    """Bistatic coefficient of the last surface for the field that it meets, and its way back.

    The way back, from the radar to this surface and home over the mirrors, is as long and has the transposed amplitude:
    the two add as fields. `arriving_other` is what arrives here when the radar sends the polarization it receives.
    """
    i = wp.tid()
    k = wp.float64(radar.wavenumber)
    d = wp.vec3d(bounce.direction[i])
    n = wp.vec3d(bounce.normal[i])
    s = wp.vec3d(home[i])
    z = zeta[i]
    rough = face_of(stuff, bounce.face[i], z)
    face = smooth(rough)
    receive = wp.vec3d(polarized(radar, home[i], received))
    send = wp.vec3d(polarized(radar, home[i], sent))
    field = field_of(arriving, i)
    other = field_of(arriving_other, i)
    bragg = first_order(face, k, field, d, n, s, receive) + first_order(face, k, other, d, n, s, send)
    mirror = mirrored(face, k, field, d, s, receive) + mirrored(face, k, other, d, s, send)
    material = stuff.face_material[bounce.face[i]]
    spectrum = stuff.spectrum[material]
    aspect = wp.float64(stuff.aspect[material])
    h = rough.rms_height
    length = HEIGHTS * h
    if stuff.has_length[material] != 0:
        length = wp.exp(wp.float64(z[Coordinate.LENGTH]))
    cos2 = wp.float64(cos2_azimuth_of(bounce.normal[i], wp.vec3(s - d)))
    tau = fraction_of(wp.float64(z[Coordinate.FRACTION]))
    share = diffuse_shares(spectrum, k * (s - d), n, cos2, k, h, length, length * aspect, tau, log_factorial)
    power_out[i] = p[0] * float(share[0] * wp.dot(bragg, bragg) + share[1] * wp.dot(mirror, mirror))
