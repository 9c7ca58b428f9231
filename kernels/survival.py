"""-ln of the regularised upper incomplete gamma function, with its exact derivative: the loss of clipped pixels."""

import warp as wp

ROUNDS = wp.constant(400)  # of a series or fraction: more than either takes to 1e-12 for the looks of images
SMALLEST = wp.constant(wp.float64(1.0e-300))


@wp.func
def series(x: wp.float64, looks: wp.float64) -> wp.float64:
    """sum x^k / (L (L + 1) ... (L + k)), k >= 0 (DLMF 8.7.1): P Gamma(L) e^x x^-L. Right for x < L + 1."""
    term = wp.float64(1.0) / looks
    total = term
    for k in range(1, ROUNDS):
        term = term * x / (looks + wp.float64(k))
        total = total + term
        if term < total * wp.float64(1.0e-13):
            break
    return total


@wp.func
def fraction(x: wp.float64, looks: wp.float64) -> wp.float64:
    """Q Gamma(L) e^x x^-L by its continued fraction (DLMF 8.9.2, Lentz's method). Right for x >= L + 1."""
    one = wp.float64(1.0)
    b = x + one - looks
    c = one / SMALLEST
    d = one / b
    found = d
    for k in range(1, ROUNDS):
        n = wp.float64(k)
        a = -n * (n - looks)
        b = b + wp.float64(2.0)
        d = a * d + b
        if wp.abs(d) < SMALLEST:
            d = SMALLEST
        c = b + a / c
        if wp.abs(c) < SMALLEST:
            c = SMALLEST
        d = one / d
        step = d * c
        found = found * step
        if wp.abs(step - one) < wp.float64(1.0e-13):
            break
    return found


@wp.func
def minus_log_q(x: wp.float64, looks: wp.float64, log_gamma: wp.float64) -> wp.float64:
    """-ln Q(L, x); `log_gamma` is ln Gamma(L)."""
    scale = looks * wp.log(x) - x - log_gamma
    if x < looks + wp.float64(1.0):
        return -wp.log(wp.float64(1.0) - wp.exp(scale) * series(x, looks))
    return -scale - wp.log(fraction(x, looks))


@wp.func_grad(minus_log_q)
def adj_minus_log_q(x: wp.float64, looks: wp.float64, log_gamma: wp.float64, adj_ret: wp.float64):
    """d / dx = x^(L - 1) e^-x / (Gamma(L) Q). Looks are given: they get no gradient."""
    scale = looks * wp.log(x) - x - log_gamma
    wp.adjoint[x] += adj_ret * wp.exp(scale + minus_log_q(x, looks, log_gamma)) / x
