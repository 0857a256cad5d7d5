"""Memory in which kernels record their reads and writes.

The memory has the same address in every process, so that compiled kernels can contain the address
and be reused.
"""

import ctypes
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from math import gcd

import numpy as np
from numpy.typing import NDArray

ADDRESS = 0x6B00_0000_0000
CAPACITY = 2**25
"""Largest number of accesses of one launch."""
READ, WRITE, ATOMIC = range(3)
HEADER = np.dtype([(name, "u8") for name in ("on", "factor", "shift", "task", "count", "lost")])
ENTRY = np.dtype([("address", "u8"), ("task", "u4"), ("bytes", "u2"), ("kind", "u2")])
READABLE_AND_WRITABLE = 1 | 2
PRIVATE, ANONYMOUS, NOT_RESERVED, EXACTLY_THERE = 0x2, 0x20, 0x4000, 0x10_0000


def unusable() -> str | None:
    """Return why this machine cannot provide this memory, or None."""
    if not sys.platform.startswith("linux") or sys.maxsize < 2**47:
        return "needs Linux and addresses of 64 bits"
    return None


class Record:
    """The accesses of one launch, and the order of its threads."""

    def __init__(self) -> None:
        size = HEADER.itemsize + CAPACITY * ENTRY.itemsize
        memory = _mapped(size)
        self._header = np.frombuffer(memory, HEADER, 1)
        self._entries = np.frombuffer(memory, ENTRY, CAPACITY, HEADER.itemsize)

    @contextmanager
    def noting(self) -> Iterator[None]:
        """Within this context, record accesses."""
        self._header["on"], self._header["count"] = 1, 0
        try:
            yield
        finally:
            self._header["on"] = 0

    def entries(self) -> NDArray:
        """Return the record of the last launch."""
        if self._header["lost"][0]:
            raise MemoryError(f"a launch made more than {CAPACITY} accesses")
        return self._entries[: int(self._header["count"][0])]

    def in_order(self) -> None:
        """Run the threads of each launch one after another."""
        self._header["factor"] = 0

    def shuffled(self, threads: int, rng: np.random.Generator) -> None:
        """Run the threads of the next launch in a mixed order."""
        factor = int(rng.integers(1, max(threads, 2)))
        while gcd(factor, threads) > 1:
            factor += 1
        self._header["factor"], self._header["shift"] = factor, int(rng.integers(threads))


def _mapped(size: int) -> ctypes.Array:
    libc = ctypes.CDLL(None, use_errno=True)
    libc.mmap.restype = ctypes.c_void_p
    libc.mmap.argtypes = [ctypes.c_void_p, ctypes.c_size_t, *[ctypes.c_int] * 3, ctypes.c_long]
    how = PRIVATE | ANONYMOUS | NOT_RESERVED | EXACTLY_THERE
    if libc.mmap(ADDRESS, size, READABLE_AND_WRITABLE, how, -1, 0) != ADDRESS:
        raise OSError(ctypes.get_errno(), f"no memory at {ADDRESS:#x}")
    return (ctypes.c_char * size).from_address(ADDRESS)


NOTE = f"""
namespace seen {{
struct entry {{ unsigned long long address; unsigned task; unsigned short bytes, kind; }};
struct record {{
    unsigned long long on, factor, shift, task, count, lost;
    entry entries[1];
}};
inline record& here() {{ return *(record*){ADDRESS:#x}ull; }}
inline void note(const void* p, size_t bytes, int kind)
{{
    record& r = here();
    if (!r.on) return;
    if (r.count == {CAPACITY}ull) {{ r.lost = 1; return; }}
    r.entries[r.count++] = {{ (unsigned long long)p, (unsigned)r.task,
        (unsigned short)bytes, (unsigned short)kind }};
}}
inline size_t thread(size_t turn, size_t threads)
{{
    record& r = here();
    return r.task = r.factor ? (turn * r.factor + r.shift) % threads : turn;
}}
}}
"""
"""C++ that records an access, and chooses the next thread."""
