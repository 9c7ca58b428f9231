"""What Warp has no word for: elements of contiguous arrays moved at once and whole, and sums over lanes."""

import warp as wp

LANES = 8  # neighbouring threads of a CUDA warp that share a sum
NODE_LANES = 4  # the same for a node: of four numbers, and shorter
WARP = 32  # threads of a CUDA warp


# Warp's own index may be negative and goes by 64-bit strides: eight instructions where these take one.
@wp.func_native("return array.data[i];")
def read_float(array: wp.array(dtype=float), i: int) -> float: ...  # type: ignore[empty-body]


@wp.func_native("return array.data[i];")
def read_int(array: wp.array(dtype=int), i: int) -> int: ...  # type: ignore[empty-body]


@wp.func_native("return array.data[i];")
def read_int64(array: wp.array(dtype=wp.int64), i: int) -> wp.int64: ...  # type: ignore[empty-body]


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const float2 q = reinterpret_cast<const float2*>(array.data)[i];
    return wp::vec_t<2, wp::float32>(q.x, q.y);
#else
    return array.data[i];
#endif
"""
)
def read_vec2(array: wp.array(dtype=wp.vec2), i: int) -> wp.vec2: ...  # type: ignore[empty-body]


@wp.func_native(
    """
    const int* row = array.data + 3 * static_cast<size_t>(i);
    return wp::vec_t<3, wp::int32>(row[0], row[1], row[2]);
"""
)
def read_row(array: wp.array2d(dtype=int), i: int) -> wp.vec3i: ...  # type: ignore[empty-body]


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
    reinterpret_cast<float4*>(array_out.data)[i] = make_float4(value[0], value[1], value[2], value[3]);
#else
    array_out.data[i] = value;
#endif
"""
)
def write_vec4(array_out: wp.array(dtype=wp.vec4), i: int, value: wp.vec4): ...


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const unsigned lanes = 0xFFu << (threadIdx.x & 24);
    for (int far = 4; far > 0; far /= 2)
        value += __shfl_down_sync(lanes, value, far, 8);
#endif
    return value;
"""
)
def sum_of_lanes(value: float) -> float: ...  # type: ignore[empty-body]


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const unsigned lanes = 0xFu << (threadIdx.x & 28);
    for (int k = 0; k < 4; ++k)
        for (int far = 2; far > 0; far /= 2)
            value[k] += __shfl_down_sync(lanes, value[k], far, 4);
#endif
    return value;
"""
)
def sum_of_node(value: wp.vec4) -> wp.vec4: ...  # type: ignore[empty-body]


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    for (int k = 0; k < 4; ++k)
        for (int far = 16; far > 0; far /= 2)
            value[k] = fmin(value[k], __shfl_xor_sync(0xFFFFFFFFu, value[k], far));
#endif
    return value;
"""
)
def least_of_warp(value: wp.vec4d) -> wp.vec4d: ...  # type: ignore[empty-body]
