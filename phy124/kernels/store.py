"""Writes matrices of particles: on a GPU 32 neighbouring ones at once.

A thread that writes the nine numbers of its own matrix leaves gaps of 36 bytes between its own and
its neighbours': 32 threads touch 36 sectors of 32 bytes nine times. Here they exchange their
numbers in shared memory first, and write 32 neighbouring numbers nine times, four or five sectors
each. Where some of a warp are elsewhere, or their particles are not neighbours, each writes its
own.
"""

import warp as wp

MOST_WARPS = 8
"""Warps of a block, which has 256 threads in every launch of phy124."""
STORE = f"""
#if defined(__CUDA_ARCH__)
const unsigned all = 0xffffffffu;
const int place = threadIdx.x & 31, warp = threadIdx.x >> 5;
if (__activemask() == all && blockDim.x <= 32 * {MOST_WARPS}
        && __all_sync(all, particle - place == __shfl_sync(all, particle, 0))) {{
    __shared__ float shared[{MOST_WARPS} * 9 * 32];
    float* own = shared + 9 * 32 * warp;
    for (int k = 0; k < 9; ++k) own[9 * place + k] = value.data[k / 3][k % 3];
    __syncwarp();
    float* rows = (float*)matrices.data + 9ll * (particle - place);
    for (int k = 0; k < 9; ++k) rows[32 * k + place] = own[32 * k + place];
    __syncwarp();  // before the next matrices take the place of these
    return;
}}
#endif
wp::array_store(matrices, particle, value);
"""


@wp.func_native(STORE)
def store(matrices: wp.array(dtype=wp.mat33), particle: int, value: wp.mat33):
    """Write a particle's matrix."""
    ...


@wp.func_native("wp::array_store(matrices, particle, value);")
def store(matrices: wp.array(dtype=wp.mat33d), particle: int, value: wp.mat33d):  # noqa: F811
    """Write a particle's matrix in float64."""
    ...
