// Threads of a GPU's block as threads of the processor, which run `store` of phy124/kernels/native/reduction.h:
//     warp_threads PARTICLES REVERSED
// stores two matrices of every particle and prints how many numbers are wrong, and how many matrices
// were written by their own thread.
#include <atomic>
#include <barrier>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#define __CUDA_ARCH__ 800
#define __shared__ static

namespace {

struct Index {
    int x;
};
struct Warp {
    std::barrier<> gate{32};
    std::atomic<long long> told[2][32];
    unsigned active;
};

thread_local Index threadIdx;
thread_local Warp* mine;
thread_local long long round;
const Index blockDim{256};
std::atomic<int> alone{0};

unsigned __activemask() { return mine->active; }
void __syncwarp() { mine->gate.arrive_and_wait(); }

// What every thread of the warp tells. As on a GPU, nothing else that they have written is certain to
// be seen thereafter.
std::vector<int> exchanged(int number)
{
    auto& told = mine->told[++round % 2];
    told[threadIdx.x & 31].store(round << 32 | unsigned(number), std::memory_order_relaxed);
    std::vector<int> found;
    for (auto& one : told) {
        long long seen;
        while ((seen = one.load(std::memory_order_relaxed)) >> 32 != round)
            std::this_thread::yield();
        found.push_back(int(seen));
    }
    return found;
}

int __shfl_sync(unsigned, int number, int from) { return exchanged(number)[from]; }

bool __all_sync(unsigned, bool told)
{
    bool every = true;
    for (int one : exchanged(told))
        every = every && one;
    return every;
}

namespace wp {
struct mat33 {
    float data[3][3];
};
struct Array {
    mat33* data;
};
void array_store(Array& matrices, int particle, const mat33& value)
{
    ++alone;
    matrices.data[particle] = value;
}
}

void store(wp::Array matrices, int particle, wp::mat33 value)
{
#include "store.inc"
}

float number(int which, int particle, int k) { return which + 10.0f * particle + k / 16.0f; }

wp::mat33 matrix(int which, int particle)
{
    wp::mat33 made;
    for (int k = 0; k < 9; ++k)
        made.data[k / 3][k % 3] = number(which, particle, k);
    return made;
}

}

int main(int, char** arguments)
{
    const int count = std::atoi(arguments[1]);
    const bool reversed = std::atoi(arguments[2]);
    std::vector<wp::mat33> kept[2] = {std::vector<wp::mat33>(count), std::vector<wp::mat33>(count)};
    for (int first = 0; first < count; first += blockDim.x) {
        std::vector<Warp> warps(8);
        std::vector<std::thread> threads;
        for (int at = 0; at < blockDim.x && first + at < count; ++at)
            warps[at / 32].active |= 1u << at % 32;
        for (int at = 0; at < blockDim.x && first + at < count; ++at)
            threads.emplace_back([&, at] {
                threadIdx.x = at;
                mine = &warps[at / 32];
                const int particle = reversed ? count - 1 - first - at : first + at;
                for (int which = 0; which < 2; ++which)
                    store(wp::Array{kept[which].data()}, particle, matrix(which, particle));
            });
        for (auto& thread : threads)
            thread.join();
    }
    int wrong = 0;
    for (int which = 0; which < 2; ++which)
        for (int particle = 0; particle < count; ++particle)
            for (int k = 0; k < 9; ++k)
                wrong += kept[which][particle].data[k / 3][k % 3] != number(which, particle, k);
    std::printf("%d %d\n", wrong, int(alone));
}
