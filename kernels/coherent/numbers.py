"""Complex numbers as vec2d (real, imaginary part), in double precision."""

import warp as wp


@wp.func
def product(a: wp.vec2d, b: wp.vec2d) -> wp.vec2d:
    return wp.vec2d(a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0])


@wp.func
def quotient(a: wp.vec2d, b: wp.vec2d) -> wp.vec2d:
    return wp.vec2d(a[0] * b[0] + a[1] * b[1], a[1] * b[0] - a[0] * b[1]) / wp.dot(b, b)


@wp.func
def turned(phase: wp.float64) -> wp.vec2d:
    """e^{j phase}. In double precision: phases are thousands of radians, of which float32 keeps three decimals."""
    return wp.vec2d(wp.cos(phase), wp.sin(phase))


@wp.func
def square_root(a: wp.vec2d) -> wp.vec2d:
    """The root with a real part that is not negative."""
    size = wp.length(a)
    re = wp.sqrt(wp.max(wp.float64(0.5) * (size + a[0]), wp.float64(0.0)))
    im = wp.sqrt(wp.max(wp.float64(0.5) * (size - a[0]), wp.float64(0.0)))
    if a[1] < wp.float64(0.0):
        im = -im
    return wp.vec2d(re, im)


@wp.func_grad(square_root)
def _adjoint_of_square_root(a: wp.vec2d, adj_ret: wp.vec2d):
    """1 / (2 root): the parts by themselves have no derivative on the real axis."""
    twice = wp.float64(2.0) * square_root(a)
    wp.adjoint[a] += quotient(adj_ret, wp.vec2d(twice[0], -twice[1]))


@wp.func
def exponential(a: wp.vec2d) -> wp.vec2d:
    return wp.exp(a[0]) * turned(a[1])


@wp.func
def faded(x: wp.vec2d) -> wp.vec2d:
    """The mean of e^{-x t} over t from 0 to 1: (1 - e^{-x}) / x."""
    one = wp.vec2d(wp.float64(1.0), wp.float64(0.0))
    if wp.dot(x, x) < wp.float64(1.0e-8):
        return one - wp.float64(0.5) * x + product(x, x) / wp.float64(6.0)
    return quotient(one - exponential(-x), x)


@wp.func
def root(x: wp.float64) -> wp.float64:
    """The square root, with a derivative of 0 at 0 in place of an infinite one."""
    if x <= wp.float64(0.0):
        return wp.float64(0.0)
    return wp.sqrt(x)


@wp.func
def sinc(x: wp.float64) -> wp.float64:
    """sin x / x."""
    if wp.abs(x) < wp.float64(1.0e-4):
        return wp.float64(1.0) - x * x / wp.float64(6.0)
    return wp.sin(x) / x
