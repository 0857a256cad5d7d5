"""A barrier for CPU threads that run kernels in parallel.

Waiting spins inside a kernel, where Warp has released Python's global lock, for tens of
microseconds; the caller yields the core before it tries again.
"""

import warp as wp

from phy124.kernels.native import code, native_kernel


@native_kernel("phy124_barrier", code("barrier"))
def meet(
    # model
    parties: int,
    spins: int,
    # out
    counter_out: wp.array(dtype=int),
    ticket_out: wp.array(dtype=int),
):
    """One thread's attempt to pass in `spins` looks; `ticket_out[0]` is zero once it has."""
    ...
