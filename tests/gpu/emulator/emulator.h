// CUDA's language on a CPU: each translated kernel is compiled with this header by g++, and its blocks run one after another. Each
// thread of a block is a fiber, which gives way at barriers. Blocks take turns in running their fibers in several orders, all of them
// legal, so that a missing barrier changes results. Shared memory starts with NaN, and accesses outside of buffers are errors.
#pragma once
#include <math.h>
#include <setjmp.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <ucontext.h>

#define __device__
#define __global__
#define __forceinline__ inline
#define __launch_bounds__(N)
#define __grid_constant__
#define __constant__ static const
#define __shared__ static __attribute__((section("shared_memory")))
#define __align__(N) alignas(N)
#define STORAGE(T) emulator::Checked<T>

struct Dimensions {
    unsigned x, y, z;
};
static Dimensions threadIdx, blockIdx, blockDim, gridDim;
static const int warpSize = 32;
extern "C" char __start_shared_memory[] __attribute__((weak, visibility("hidden")));
extern "C" char __stop_shared_memory[] __attribute__((weak, visibility("hidden")));

namespace emulator {

const unsigned MOST_THREADS = 1024;
const size_t STACK = 256 << 10;
const size_t MOST_SHARED = 48 << 10;
// Threads one after another, from the first or the last; one warp runs until it waits for others; a random half of the threads.
enum Order { FORWARDS, BACKWARDS, WARP_AHEAD, RANDOM, ORDERS };

struct Barrier {
    unsigned arrived, generation, alive;
};
struct Fiber {
    jmp_buf state;
    ucontext_t start;
    char* stack;
    bool has_begun, is_done;
    float exchanged;
};
static Fiber fibers[MOST_THREADS];
static Barrier block_barrier, warp_barriers[MOST_THREADS / warpSize];
static jmp_buf scheduler;
static ucontext_t unused;
static unsigned current, steps;
static size_t (*bytes_at)(const void*);
static const char* fault;
static void (*body)();

static void give_way() {
    if (!_setjmp(fibers[current].state)) { _longjmp(scheduler, 1); }
}
static void release(Barrier& barrier) {
    barrier.arrived = 0;
    barrier.generation++;
    steps++;
}
static void wait_at(Barrier& barrier) {
    const unsigned generation = barrier.generation;
    steps++;
    if (++barrier.arrived == barrier.alive) { release(barrier); }
    while (barrier.generation == generation) { give_way(); }
}
static void leave(Barrier& barrier) {
    if (--barrier.alive && barrier.arrived == barrier.alive) { release(barrier); }
}
static void run_fiber() {
    body();
    fibers[current].is_done = true;
    steps++;
    leave(block_barrier);
    leave(warp_barriers[current / warpSize]);
    _longjmp(scheduler, 1);
}
static void resume(unsigned thread) {
    Fiber& fiber = fibers[thread];
    current = thread;
    threadIdx = {thread, 0, 0};
    if (_setjmp(scheduler)) { return; }
    if (fiber.has_begun) { _longjmp(fiber.state, 1); }
    fiber.has_begun = true;
    getcontext(&fiber.start);
    fiber.start.uc_stack.ss_sp = fiber.stack;
    fiber.start.uc_stack.ss_size = STACK;
    fiber.start.uc_link = &unused;
    makecontext(&fiber.start, run_fiber, 0);
    setcontext(&fiber.start);
}
static void run_all(unsigned threads, bool backwards) {
    for (unsigned k = 0; k < threads; k++) {
        const unsigned thread = backwards ? threads - 1 - k : k;
        if (!fibers[thread].is_done) { resume(thread); }
    }
}
static void run_warp(unsigned warp, unsigned threads) {
    unsigned before;
    do {
        before = steps;
        for (unsigned k = warp * warpSize; k < threads && k < (warp + 1) * warpSize; k++) {
            if (!fibers[k].is_done) { resume(k); }
        }
    } while (steps != before);
}
static void run_some(unsigned threads, unsigned& seed) {
    for (unsigned k = 0; k < threads; k++) {
        seed = 1664525 * seed + 1013904223;
        const unsigned thread = (seed >> 8) % threads;
        if (!fibers[thread].is_done) { resume(thread); }
    }
}
static void run_block(unsigned threads, Order order, unsigned seed) {
    memset(__start_shared_memory, 0xff, __stop_shared_memory - __start_shared_memory);
    block_barrier = {0, 0, threads};
    for (unsigned k = 0; k < threads; k++) {
        if (!fibers[k].stack) { fibers[k].stack = (char*)malloc(STACK); }
        fibers[k].has_begun = fibers[k].is_done = false;
        if (k % warpSize == 0) { warp_barriers[k / warpSize] = {0, 0, threads - k < 32 ? threads - k : 32}; }
    }
    const unsigned ahead = seed % ((threads + warpSize - 1) / warpSize);
    while (block_barrier.alive && !fault) {
        steps = 0;
        if (order == WARP_AHEAD) { run_warp(ahead, threads); }
        if (order == RANDOM) { run_some(threads, seed); }
        if (order != RANDOM || !steps) { run_all(threads, order == BACKWARDS); }
        if (!steps) { fault = "threads wait at different barriers"; }
    }
}

// A buffer that knows its length.
template <class T> struct Checked {
    T* begin;
    size_t length;
    Checked(T* begin) : begin(begin), length(bytes_at(begin) / sizeof(T)) {}
    T& operator[](size_t k) const {
        if (k < length) { return begin[k]; }
        static char outside[sizeof(T)] __attribute__((aligned(16)));
        fault = "a kernel reads or writes outside of a buffer";
        return *(T*)outside;
    }
};

// Kernel and arguments of the launch, and a call of one thread.
template <class... A> struct Launch {
    static inline void (*kernel)(A...);
    static inline void** arguments;
    template <int... K> struct Places {};
    template <int N, int... K> struct Count : Count<N - 1, N - 1, K...> {};
    template <int... K> struct Count<0, K...> { using type = Places<K...>; };
    template <int... K> static void call(Places<K...>) {
        const void* found[] = {arguments[K]...};
        kernel(*(A*)found[K]...);
    }
    static void run() { call(typename Count<sizeof...(A)>::type()); }
};

// Run all blocks, in one order, or in all orders in turn (ORDERS). Returns what went wrong, or null.
template <class... A>
const char* run(void (*kernel)(A...), void** arguments, Dimensions grid, Dimensions block, size_t (*bytes)(const void*),
                int order) {
    if (block.x > MOST_THREADS || block.y != 1 || block.z != 1) { return "the block has too many threads"; }
    if (size_t(__stop_shared_memory - __start_shared_memory) > MOST_SHARED) { return "there is too much shared memory"; }
    if (grid.y > 65535 || grid.z > 65535) { return "the grid is too large"; }
    Launch<A...>::kernel = kernel;
    Launch<A...>::arguments = arguments;
    body = Launch<A...>::run;
    bytes_at = bytes;
    fault = nullptr;
    blockDim = block;
    gridDim = grid;
    unsigned number = 0;
    for (unsigned z = 0; z < grid.z; z++) {
        for (unsigned y = 0; y < grid.y; y++) {
            for (unsigned x = 0; x < grid.x && !fault; x++, number++) {
                blockIdx = {x, y, z};
                run_block(block.x, Order(order == ORDERS ? number % ORDERS : order), number / ORDERS);
            }
        }
    }
    return fault;
}

}  // namespace emulator

inline void __syncthreads() { emulator::wait_at(emulator::block_barrier); }
inline float __shfl_xor_sync(unsigned, float value, int step) {
    emulator::Barrier& barrier = emulator::warp_barriers[threadIdx.x / warpSize];
    emulator::fibers[threadIdx.x].exchanged = value;
    emulator::wait_at(barrier);
    const float other = emulator::fibers[threadIdx.x ^ step].exchanged;
    emulator::wait_at(barrier);
    return other;
}
inline unsigned atomicAdd(unsigned* place, unsigned value) {
    const unsigned before = *place;
    *place += value;
    return before;
}
inline unsigned atomicMax(unsigned* place, unsigned value) {
    const unsigned before = *place;
    if (value > before) { *place = value; }
    return before;
}
inline unsigned __float_as_uint(float value) {
    unsigned bits;
    memcpy(&bits, &value, 4);
    return bits;
}
inline float __uint_as_float(unsigned bits) {
    float value;
    memcpy(&value, &bits, 4);
    return value;
}
