"""Surface nodes that are known to a tolerance."""

import warp as wp

from warpsar.kernels.codes import Scale


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
