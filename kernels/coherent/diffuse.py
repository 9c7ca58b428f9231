"""What rough faces scatter of tubes that other faces mirror to them: complex Gaussian numbers that belong to places.

Nodes of a lattice on the surface have a number each. A tube takes those of the four nodes about it, by bilinear
weights. Nodes and not tubes are what is drawn, so another tracing of the same surface meets the same numbers.
"""

import warp as wp

from warpsar.kernels.coherent.bistatic import azimuth_cos2, diffuse_shares, first_order, mirrored
from warpsar.kernels.coherent.numbers import product, root, sinc, turned
from warpsar.kernels.coherent.radiate import FOUR_PI, HALF_PI, Four, Pair
from warpsar.kernels.coherent.reflection import Face
from warpsar.kernels.coherent.rough import RoughSurface
from warpsar.kernels.coherent.tubes import Hit, TubeRadar, look

NODES = wp.constant(wp.float64(6.0))
"""Of a wavelength, on the coordinate plane that is nearest to a face's own."""
HALF = wp.constant(wp.float64(0.5))
ONE = wp.constant(wp.float64(1.0))


@wp.struct
class NodeNumbers:
    """Two complex Gaussian numbers: of small perturbation, and of the higher powers of the correlation."""

    bragg: wp.vec2d
    mirror: wp.vec2d
    power: wp.float64  # of each at this point, in the mean: the sum of the squares of the weights


@wp.func
def gaussian(random: wp.uint32, number: int) -> wp.vec2d:
    """Of unit power, (real, imaginary part); `number` tells those of one node apart."""
    state = random + wp.uint32(number * 1013904223)
    re = wp.randn(state)
    im = wp.randn(state)
    return root(HALF) * wp.vec2d(wp.float64(re), wp.float64(im))


@wp.func
def plane_of(n: wp.vec3d) -> int:
    """The axis that is nearest to a normal."""
    axis = int(0)
    for i in range(1, 3):
        if wp.abs(n[i]) > wp.abs(n[axis]):
            axis = i
    return axis


@wp.func
def drawn_at(seed: int, point: wp.vec3d, axis: int, step: wp.float64) -> NodeNumbers:
    """The numbers of the four nodes about a point of a surface, by their weights."""
    x = point[(axis + 1) % 3] / step
    y = point[(axis + 2) % 3] / step
    low_x = wp.floor(x)
    low_y = wp.floor(y)
    found = NodeNumbers()
    for corner in range(4):
        i = corner % 2
        j = corner / 2
        weight = wp.where(i == 0, ONE - (x - low_x), x - low_x) * wp.where(j == 0, ONE - (y - low_y), y - low_y)
        random = wp.rand_init(3 * seed + axis, (int(low_x) + i) * 73856093 + (int(low_y) + j) * 19349663)
        found.bragg += weight * gaussian(random, 0)
        found.mirror += weight * gaussian(random, 1)
        found.power += weight * weight
    return found


@wp.func
def evened(q: wp.vec3d, n: wp.vec3d, axis: int, step: wp.float64) -> wp.float64:
    """What the phase's turn over the cells of the lattice leaves of a sum over them; `q`: its gradient [1/m]."""
    left = ONE
    for other in range(1, 3):
        i = (axis + other) % 3
        share = sinc(HALF * step * (q[i] - q[axis] * n[i] / n[axis]))
        left = left * share * share
    return left


@wp.func
def diffused(
    receiver: TubeRadar,
    k: wp.float64,
    rough: RoughSurface,
    fields: Pair,
    hit: Hit,
    seed: int,
    log_factorial: wp.array[wp.float64],
) -> Four:
    """What a rough face scatters of a tube to the receiver.

    In the mean it is the bistatic coefficient of `multibounce` in images of power.
    """
    sight = look(receiver, hit.point, 0.0)
    d = hit.d
    n = hit.normal
    s = sight.s
    u = receiver.u
    v = receiver.v
    q = k * (s - d)
    share = diffuse_shares(
        rough.spectrum,
        q,
        n,
        azimuth_cos2(q, n),
        k,
        rough.rms_height,
        rough.length[0],
        rough.length[1],
        rough.specular_fraction,
        log_factorial,
    )
    step = wp.float64(4.0) * HALF_PI / k / NODES
    axis = plane_of(n)
    drawn = drawn_at(seed, hit.point, axis, step)
    # A node stands for the area step^2 / |n_axis|; its tubes add up to that, less what their phases take. A tube that
    # is wider, after a curved face, has a number by itself.
    node = step * step / wp.abs(n[axis])
    wide = wp.length(wp.cross(hit.across_u, hit.across_v))
    size = sight.spread * hit.weight / root(FOUR_PI)
    if wide > node:
        size = size / root(wide * drawn.power)
    else:
        size = size / (root(node) * evened(q, n, axis, step))
    phase = size * turned(-k * (sight.back + hit.path) + wp.float64(hit.caustics) * HALF_PI)
    bragg = root(share[0]) * product(drawn.bragg, phase)
    mirror = root(share[1]) * product(drawn.mirror, phase)
    flat = Face()
    flat.conductor = 0
    flat.layer = 0
    flat.permittivity = rough.permittivity
    found = Four()
    found.hh = product(bragg, first_order(flat, k, fields.h, d, n, s, u))
    found.hh += product(mirror, mirrored(flat, k, fields.h, d, s, u))
    found.vv = product(bragg, first_order(flat, k, fields.v, d, n, s, v))
    found.vv += product(mirror, mirrored(flat, k, fields.v, d, s, v))
    found.hv = product(bragg, first_order(flat, k, fields.v, d, n, s, u))
    found.hv += product(mirror, mirrored(flat, k, fields.v, d, s, u))
    found.vh = product(bragg, first_order(flat, k, fields.h, d, n, s, v))
    found.vh += product(mirror, mirrored(flat, k, fields.h, d, s, v))
    return found


@wp.func
def there_and_back(one: Four) -> Four:
    """`diffused`, and the same way the other way round, which is as long where both antennas are one: as fields."""
    found = Four()
    found.hh = one.hh + one.hh
    found.vv = one.vv + one.vv
    found.hv = one.hv + one.vh
    found.vh = found.hv
    return found
