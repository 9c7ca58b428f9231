"""What Warp has no word for: vectors of contiguous arrays moved as a whole, not float by float, and sums over lanes."""

import warp as wp

LANES = 8  # neighbouring threads of a CUDA warp that share a sum


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const float4 q = reinterpret_cast<const float4*>(array.data)[i];
    return wp::vec_t<4, wp::float32>(q.x, q.y, q.z, q.w);
#else
    return array.data[i];
#endif
"""
)
def read_vec4(array: wp.array(dtype=wp.vec4), i: int) -> wp.vec4: ...  # type: ignore[empty-body]


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const int4 q = reinterpret_cast<const int4*>(array.data)[i * array.shape[1] + j];
    return wp::vec_t<4, wp::int32>(q.x, q.y, q.z, q.w);
#else
    return array.data[i * array.shape[1] + j];
#endif
"""
)
def read_vec4i(array: wp.array2d(dtype=wp.vec4i), i: int, j: int) -> wp.vec4i: ...  # type: ignore[empty-body]


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    reinterpret_cast<float4*>(array.data)[i] = make_float4(value[0], value[1], value[2], value[3]);
#else
    array.data[i] = value;
#endif
"""
)
def write_vec4(array: wp.array(dtype=wp.vec4), i: int, value: wp.vec4): ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const unsigned lanes = 0xFFu << (threadIdx.x & 24);
    for (int k = 0; k < 4; ++k)
        for (int far = 4; far > 0; far /= 2)
            value[k] += __shfl_down_sync(lanes, value[k], far, 8);
#endif
    return value;
"""
)
def sum_of_lanes(value: wp.vec4) -> wp.vec4: ...  # type: ignore[empty-body]
