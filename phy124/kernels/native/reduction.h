// Sums, maxima and stores that a GPU performs once per warp, or in one transaction.
// Python version: the lines outside `#if`.
// Test: tests/test_kernels_cuda.py, test_a_warp_reduces_before_it_writes.

//: add
#if defined(__CUDA_ARCH__) && __CUDA_ARCH__ >= 900
asm volatile("red.global.add.v4.f32 [%0], {%1, %2, %3, %4};"
    :: "l"((float*)grid.data + 4 * (long long)node),
       "f"(value[0]), "f"(value[1]), "f"(value[2]), "f"(value[3]) : "memory");
#else
wp::atomic_add(grid, node, value);
#endif

//: run
// Particles of neighbouring threads often touch the same nodes. Consecutive threads of a warp with
// equal `node` form a run; the first thread of a run adds the run's sum. The result contains three
// packed values: the number of threads that follow in the run, the largest such number in the warp,
// and whether the thread is not the first of its run.
#if defined(__CUDA_ARCH__)
const unsigned all = 0xffffffffu;
if (__activemask() != all) return 0;
const int lane = threadIdx.x & 31;
const int before = __shfl_up_sync(all, node, 1);
const bool first = lane == 0 || before != node;
const unsigned later = (__ballot_sync(all, first) >> lane) >> 1;
const int follow = later ? __ffs(later) - 1 : 31 - lane;
int most = follow;
for (int step = 16; step > 0; step >>= 1) {
    const int other = __shfl_xor_sync(all, most, step);
    most = other > most ? other : most;
}
return follow | most << 8 | (first ? 0 : 1 << 16);
#else
return 0;
#endif

//: sum_run
#if defined(__CUDA_ARCH__)
for (int step = 1; step <= ((run >> 8) & 255); step <<= 1)
    for (int i = 0; i < 4; ++i) {
        const auto other = __shfl_down_sync(0xffffffffu, value[i], step);
        if ((run & 255) >= step) value[i] += other;
    }
if (run >> 16) return;
#endif

//: load
#if defined(__CUDA_ARCH__)
const float4 q = *(const float4*)((const float*)grid.data + 4 * (long long)node);
return wp::vec_t<4, float>(q.x, q.y, q.z, q.w);
#else
return wp::index(grid, node);
#endif

//: sum
#define COMBINE whole + other

//: most
#define COMBINE other > whole ? other : whole

//: least
#define COMBINE other < whole ? other : whole

//: warp
auto whole = value;
#if defined(__CUDA_ARCH__)
if (__activemask() == 0xffffffffu) {
    for (int step = 16; step > 0; step >>= 1) {
        const auto other = __shfl_xor_sync(0xffffffffu, whole, step);
        whole = COMBINE;
    }
    if ((threadIdx.x & 31) != 0) return;
}
#endif
#undef COMBINE

//: add_to
if (whole != 0.0) wp::atomic_add(sums, index, whole);

//: raise_all
// A block reduces all maxima in shared memory; then one thread per maximum writes. Floats are
// compared as integers with the same bits: a maximum of positive floats is the maximum of signed
// integers, a maximum of negative floats the minimum of unsigned integers. All threads of a block
// must call this function.
enum { MAXIMA = sizeof(values.c) / sizeof(values.c[0]) };
#if defined(__CUDA_ARCH__)
enum { WARPS = 8 };  // warps in a block: every launch of phy124 has blocks of 256 threads
auto whole = values.c[0] + 0;
__shared__ decltype(whole) highest[WARPS * MAXIMA];
for (int i = 0; i < MAXIMA; ++i) {
    whole = values[i];
    for (int step = 16; step > 0; step >>= 1) {
        const auto other = __shfl_xor_sync(0xffffffffu, whole, step);
        whole = other > whole ? other : whole;
    }
    if ((threadIdx.x & 31) == 0) highest[MAXIMA * (threadIdx.x >> 5) + i] = whole;
}
__syncthreads();
const int mine = threadIdx.x;
if (mine < MAXIMA) {
    whole = highest[mine];
    for (int warp = 1; warp < (int)(blockDim.x >> 5); ++warp) {
        const auto other = highest[MAXIMA * warp + mine];
        whole = other > whole ? other : whole;
    }
    void* const to = &maxima.data[mine];
    if (sizeof(whole) == 4) {
        const int bits = __float_as_int((float)whole);
        if (bits >= 0) atomicMax((int*)to, bits);
        else atomicMin((unsigned*)to, (unsigned)bits);
    } else {
        const long long bits = __double_as_longlong((double)whole);
        if (bits >= 0) atomicMax((long long*)to, bits);
        else atomicMin((unsigned long long*)to, (unsigned long long)bits);
    }
}
#else
for (int i = 0; i < MAXIMA; ++i)
    if (values[i] > wp::index(maxima, i)) wp::atomic_max(maxima, i, values[i]);
#endif

//: raise_to
// A comparison first avoids most of the atomic operations.
if (whole > wp::index(maxima, index)) wp::atomic_max(maxima, index, whole);

//: lower_to
if (whole < wp::index(minima, index)) wp::atomic_min(minima, index, whole);

//: store
// If each thread wrote the nine numbers of its matrix, 32 threads would touch 36 sectors of 32
// bytes nine times, since neighbouring threads' numbers are 36 bytes apart. Instead the threads
// exchange their numbers in shared memory and write 32 consecutive numbers nine times, which touch
// four or five sectors each. If threads of the warp are inactive, or their particles are not
// consecutive, each thread writes its own numbers.
#if defined(__CUDA_ARCH__)
enum { WARPS = 8 };  // warps in a block: every launch of phy124 has blocks of 256 threads
const unsigned all = 0xffffffffu;
const int place = threadIdx.x & 31, warp = threadIdx.x >> 5;
if (__activemask() == all && blockDim.x <= 32 * WARPS
        && __all_sync(all, particle - place == __shfl_sync(all, particle, 0))) {
    __shared__ float shared[WARPS * 9 * 32];
    float* own = shared + 9 * 32 * warp;
    for (int k = 0; k < 9; ++k) own[9 * place + k] = value.data[k / 3][k % 3];
    __syncwarp();
    float* rows = (float*)matrices.data + 9ll * (particle - place);
    for (int k = 0; k < 9; ++k) rows[32 * k + place] = own[32 * k + place];
    __syncwarp();  // wait before the next matrices overwrite the present ones
    return;
}
#endif
wp::array_store(matrices, particle, value);

//: change
// Change of momentum and of kinetic energy of some particles whose velocities were `kept`. Warp's
// code for this loop takes three times as long on a CPU.
wp::vec_t<4, double> sums(0.0, 0.0, 0.0, 0.0);
for (int k = 0; k < each; ++k) {
    const int p = first + k * stride;
    if (p >= mass.shape[0]) break;
    const auto after = wp::index(v, p);
    const auto before = wp::index(kept, p);
    const auto change = after - before;
    const double m = wp::index(mass, p);
    for (int c = 0; c < 3; ++c) sums[c] += m * double(change[c]);
    sums[3] += m * double(wp::dot(change, after + before)) / 2.0;
}
return sums;

//: meet
// A barrier for CPU threads: arrive once, then check whether the others have arrived.
// Python version: none, since Warp has no atomic loads with acquire order.
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

//: fastest
// Largest |v|^2 and |C|^2 of some particles, and the number of non-finite particles; C++ for the
// same reason as `change`.
decltype(v.data[0].c[0] + 0) fast = 0, rate = 0, broken = 0;
for (int k = 0; k < each; ++k) {
    const int i = first + k * stride;
    if (i >= count) break;
    const int p = chosen.shape[0] > 0 ? wp::index(chosen, i) : i;
    const auto velocity = wp::index(v, p);
    const auto gradient = wp::index(C, p);
    const auto s = wp::dot(velocity, velocity), g = wp::ddot(gradient, gradient);
    if (!(s + g - (s + g) == 0)) broken += 1;
    fast = s > fast ? s : fast;
    rate = g > rate ? g : rate;
}
return {fast, rate, broken};

//: copy_row
// Loops over rows of nodes, which a CPU vectorises; on a GPU each thread has one node, which is
// processed before the loop.
// Python version: a loop over nodes.
// Test: tests/test_rows.py, test_wall_momentum_is_summed_over_changed_nodes.
if (count > 0) wp::array_store(nodes, at, wp::index(others, start));
for (int k = 1; k < count; ++k) nodes.data[at + k] = others.data[start + k];

//: clear_row
for (int k = 0; k < count; ++k) nodes.data[at + k] = {};

//: add_row
auto* sums = &nodes.data[at].c[0];
const auto* more = &others.data[start].c[0];
for (int k = 0; k < 4 * count; ++k) sums[k] += more[k];

//: next_changed
const auto differ = [](const auto& a, const auto& b) {
    return bool((a[0] != b[0]) | (a[1] != b[1]) | (a[2] != b[2]));
};
if (first >= end || differ(wp::index(nodes, at + first), wp::index(others, start + first)))
    return first;
for (int k = first + 1; k < end; ++k)
    if (differ(nodes.data[at + k], others.data[start + k])) return k;
return end;
