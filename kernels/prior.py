"""Surface nodes that are known to a tolerance."""

import warp as wp


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

    `kind` counts surface.KINDS: ln(value - 1), ln value twice, logit value.
    """
    i = wp.tid()
    x = wp.float64(nodes[node[i]])
    one = wp.float64(1.0)
    value = wp.exp(x)
    slope = value
    if kind[i] == 0:
        value = one + value
    elif kind[i] == 3:
        value = one / (one + wp.exp(-x))
        slope = value * (one - value)
    deviation = (value - about[i]) / sd[i]
    loss_out[i] = wp.float64(0.5) * deviation * deviation
    wp.atomic_add(gradient_out, node[i], float(deviation * slope / sd[i]))
