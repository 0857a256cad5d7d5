"""A barrier for CPU threads that run kernels in parallel.

Waiting spins inside a kernel, where Warp has released Python's global lock, for tens of
microseconds; the caller yields the core before it tries again.
"""

import warp as wp

from phy124.kernels.build import kernel

MEET = """
int* shared = (int*)counter.data;
int* mine = (int*)ticket.data;
int* generation = shared + 16;
if (mine[0] == 0) {
    const int now = __atomic_load_n(generation, __ATOMIC_ACQUIRE);
    if (__atomic_add_fetch(shared, 1, __ATOMIC_ACQ_REL) == parties) {
        __atomic_store_n(shared, 0, __ATOMIC_RELAXED);
        __atomic_store_n(generation, now + 1, __ATOMIC_RELEASE);
        return;
    }
    mine[0] = now + 1;
}
for (int i = 0; i < spins; ++i)
    if (__atomic_load_n(generation, __ATOMIC_ACQUIRE) != mine[0] - 1) {
        mine[0] = 0;
        return;
    }
"""


@wp.func_native(MEET)
def meet_native(
    counter: wp.array(dtype=int), ticket: wp.array(dtype=int), parties: int, spins: int
):  # fmt: skip
    """Arrive once, then check whether the others have; the ticket is non-zero until they have."""
    ...


@kernel("phy124_barrier")
def meet(
    # model
    parties: int, spins: int,
    # out
    counter_out: wp.array(dtype=int), ticket_out: wp.array(dtype=int),
):  # fmt: skip
    """One thread's attempt to pass, in so many looks; `ticket_out[0]` is zero once it has."""
    meet_native(counter_out, ticket_out, parties, spins)
