"""Measured against modelled beta0, pixel by pixel; and the price of rough parameter fields and of known values."""

import warp as wp

from warpsar.kernels.codes import FRACTION_LIMIT, Coordinate, Scale

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


GAMMA = wp.constant(0)
MSE = wp.constant(1)
LOG = wp.constant(2)

# Partial sums of a loss: float64, spread over as many cells so that CUDA atomics seldom meet.
PARTIALS = wp.constant(4096)

# No modelled pixel counts as darker than this: keeps ln(mu), and 1 / mu^2 of the adjoint, finite in float32 where
# sigma0 underflows.
DARKEST = wp.constant(1.0e-18)


@wp.struct
class LossConstants:
    """How far a model lies from what was measured (`kind`: GAMMA, MSE or LOG), each pixel times `weight`.

    `bias` is psi(looks) - ln(looks), `log_gamma` ln Gamma(looks). Values of `top` or more were clipped there. A `bound`
    b over 0 turns a value t into b ln(1 + t / b).
    """

    kind: int
    looks: float
    weight: float
    bias: float
    bound: float
    top: float
    log_gamma: float


@wp.struct
class ObservedPixels:
    """Pixels that were measured, shape (n,). No pixel counts as darker than `darkest`: one a pixel, or one for all."""

    pixel: wp.array(dtype=int)
    measured: wp.array(dtype=float)
    darkest: wp.array(dtype=float)


@wp.kernel
def loss_kernel(
    # In:
    constants: LossConstants,
    observed: ObservedPixels,
    image: wp.array(dtype=float),
    gain: wp.array(dtype=float),
    gain_index: int,
    # Out:
    loss_out: wp.array(dtype=wp.float64),
):
    """GAMMA: L (I / mu - 1 - ln(I / mu)), half the deviance; MSE: (I - mu)^2 / 2 (equation 38);
    LOG: (ln I - ln mu - bias)^2 / 2. Of a pixel that was clipped the value of GAMMA is -ln P(I >= top). mu is the
    image, no darker than `darkest`, times the gain."""
    i = wp.tid()
    darkest = observed.darkest[wp.min(i, observed.darkest.shape[0] - 1)]
    mu = gain[gain_index] * wp.max(image[observed.pixel[i]], darkest)
    measured = observed.measured[i]
    looks = constants.looks
    value = float(0.0)
    if constants.kind == GAMMA:
        ratio = measured / mu
        value = looks * (ratio - 1.0 - wp.log(ratio))
        if measured >= constants.top:
            x = wp.float64(looks * constants.top / mu)
            value = float(minus_log_q(x, wp.float64(looks), wp.float64(constants.log_gamma)))
        if constants.bound > 0.0:
            value = constants.bound * wp.log(1.0 + value / constants.bound)
    elif constants.kind == MSE:
        value = 0.5 * (measured - mu) * (measured - mu)
    else:
        difference = wp.log(measured) - wp.log(mu) - constants.bias
        value = 0.5 * difference * difference
    wp.atomic_add(loss_out, i % PARTIALS, wp.float64(constants.weight * value))


@wp.kernel
def variation_kernel(
    # In:
    first: wp.array(dtype=int),
    second: wp.array(dtype=int),
    weight: wp.array(dtype=float),
    nodes: wp.array(dtype=float),
    rounding: float,
    # Out:
    loss_out: wp.array(dtype=wp.float64),
):
    """Total variation over pairs of neighbouring nodes, in their log coordinates (equation 39):
    weight * (sqrt(difference^2 + rounding^2) - rounding)."""
    i = wp.tid()
    difference = nodes[first[i]] - nodes[second[i]]
    value = weight[i] * (wp.sqrt(difference * difference + rounding * rounding) - rounding)
    wp.atomic_add(loss_out, i % PARTIALS, wp.float64(value))


@wp.func
def beyond(x: float) -> float:
    """Squared excess over 0."""
    excess = wp.max(x, 0.0)
    return excess * excess


@wp.kernel
def validity_kernel(
    # In:
    wavenumber: float,
    strength: float,
    weight: wp.array(dtype=float),
    cos_incidence: wp.array(dtype=float),
    zeta: wp.array(dtype=wp.vec4),
    # Out:
    loss_out: wp.array(dtype=wp.float64),
):
    """How far (ln, squared) a hit's surface lies outside the domain of the model it uses, times its lit area.

    SPM (19): kh < 0.3, sqrt(2) h / l < 0.3. KA (9, 12 corrected): kh cos(theta) > sqrt(10) / 2, kl > 6,
    l^2 > 2.76 h lambda. The two are mixed as tau mixes the models.
    """
    i = wp.tid()
    z = zeta[i]
    kh = wp.log(wavenumber) + z[Coordinate.HEIGHT]
    kl = wp.log(wavenumber) + z[Coordinate.LENGTH]
    spm = beyond(kh - wp.log(0.3)) + beyond(0.5 * wp.log(2.0) + kh - kl - wp.log(0.3))
    ka = (
        beyond(wp.log(0.5 * wp.sqrt(10.0)) - kh - wp.log(wp.max(cos_incidence[i], 1.0e-3)))
        + beyond(wp.log(6.0) - kl)
        + beyond(wp.log(2.76 * 2.0 * wp.pi) + kh - 2.0 * kl)
    )
    tau = 1.0 / (1.0 + wp.exp(-wp.clamp(z[Coordinate.FRACTION], -FRACTION_LIMIT, FRACTION_LIMIT)))
    value = strength * weight[i] * ((1.0 - tau) * spm + tau * ka)
    wp.atomic_add(loss_out, i % PARTIALS, wp.float64(value))


@wp.kernel(enable_backward=False)
def add_up_kernel(
    # In:
    part: wp.array(dtype=wp.float64),
    # Out:
    total_out: wp.array(dtype=wp.float64),
):
    """The sum of partial sums; zeros, of which most are, cost no atomic addition."""
    i = wp.tid()
    if part[i] != wp.float64(0.0):
        wp.atomic_add(total_out, 0, part[i])


@wp.kernel(enable_backward=False)
def prior_kernel(
    # In:
    node: wp.array(dtype=int),
    kind: wp.array(dtype=int),
    about: wp.array(dtype=wp.float64),
    sd: wp.array(dtype=wp.float64),
    nodes: wp.array(dtype=float),
    # Out:
    gradient_out: wp.array(dtype=float),
    loss_out: wp.array(dtype=wp.float64),
):
    """Half the squared deviation of each known value in standard deviations, and its slope, added to the gradient.

    `kind` is the `Scale` of its coordinate.
    """
    i = wp.tid()
    x = wp.float64(nodes[node[i]])
    one = wp.float64(1.0)
    value = x
    slope = one
    if kind[i] == Scale.LOGIT:
        value = one / (one + wp.exp(-x))
        slope = value * (one - value)
    elif kind[i] != Scale.LINEAR:
        value = wp.exp(x)
        slope = value
        if kind[i] == Scale.CONTRAST:
            value = one + value
    deviation = (value - about[i]) / sd[i]
    loss_out[i] = wp.float64(0.5) * deviation * deviation
    wp.atomic_add(gradient_out, node[i], float(deviation * slope / sd[i]))
