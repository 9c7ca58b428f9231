"""Adam's update where the host cannot count its steps: inside of a captured graph."""

import warp as wp

FIRST_DECAY = wp.constant(0.9)
SECOND_DECAY = wp.constant(0.999)
ROUNDING = wp.constant(1.0e-8)


@wp.kernel(enable_backward=False)
def tick_kernel(
    # In:
    rate: float,
    settling: float,
    # In and out:
    done: wp.array(dtype=int),
    # Out:
    step_out: wp.array(dtype=float),
):
    """The next iteration's step (optimise.eased) over its first moment's bias, and the inverse of the second's."""
    t = wp.float64(done[0])
    one = wp.float64(1.0)
    eased = wp.float64(rate) / wp.sqrt(one + t / wp.float64(settling))
    step_out[0] = float(eased / (one - wp.pow(wp.float64(FIRST_DECAY), t + one)))
    step_out[1] = float(one / (one - wp.pow(wp.float64(SECOND_DECAY), t + one)))
    done[0] = done[0] + 1


@wp.kernel(enable_backward=False)
def adam_kernel(
    # In:
    gradient: wp.array(dtype=float),
    step: wp.array(dtype=float),
    low: wp.array(dtype=float),
    high: wp.array(dtype=float),
    # In and out:
    first: wp.array(dtype=float),
    second: wp.array(dtype=float),
    nodes: wp.array(dtype=float),
):
    """Kingma and Ba, arXiv:1412.6980, then the bounds; a node that is not learned has both at its value."""
    i = wp.tid()
    g = gradient[i]
    m = FIRST_DECAY * first[i] + (1.0 - FIRST_DECAY) * g
    v = SECOND_DECAY * second[i] + (1.0 - SECOND_DECAY) * g * g
    first[i] = m
    second[i] = v
    moved = nodes[i] - step[0] * m / (wp.sqrt(v * step[1]) + ROUNDING)
    nodes[i] = wp.clamp(moved, low[i], high[i])
