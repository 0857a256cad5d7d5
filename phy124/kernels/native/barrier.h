// A barrier for CPU threads: arrive once, then look whether the others have.
// Plain form: none, since Warp has no loads that acquire.
// Test: tests/test_mpm_threads.py, test_nobody_leaves_a_barrier_before_all_have_come.

int* shared = counter_out.data;
int* mine = ticket_out.data;
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
