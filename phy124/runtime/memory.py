"""Measures the memory available to this process, and checks that limits are large enough."""

import ctypes
import gc
import math
import mmap
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from phy124.errors import InputError
from phy124.runtime.cgroups import memory_left

try:
    import resource
except ImportError:  # Windows
    resource = None

MEMORY_FRACTION = 0.8
"""Maximum fraction of the free memory that a run may use."""
M_ARENA_MAX = -8
"""Number of the option for `mallopt`, from glibc's malloc.h."""
HEAPS = "MALLOC_ARENA_MAX"
"""Environment variable that limits the number of glibc's heaps."""


def release(array: object) -> None:
    """Return the memory of a memory-mapped array to the system after the array has been read.

    If the memory is not returned, a long run that reads all frames seems to need enough memory for
    all frames.
    """
    mapped: Any = getattr(array, "_mmap", None)
    if hasattr(mapped, "madvise") and hasattr(mmap, "MADV_DONTNEED"):
        mapped.madvise(mmap.MADV_DONTNEED)


def trim() -> None:
    """Return freed memory to the system.

    When the arrays of a frame are freed, they leave gaps between small objects, and the C library
    keeps these gaps. In a long run, the gaps add up to the size of all frames.
    """
    with suppress(OSError, AttributeError):  # only the GNU C library has this function
        ctypes.CDLL(None).malloc_trim(0)


def free_memory(device: str = "cpu") -> float:
    """Return the memory that this process may still allocate [bytes]; infinity if unknown.

    On a CPU, the result is the minimum of the machine's free memory, the limits of control groups
    (containers, batch systems), and `ulimit -v`. `device` is Warp's name of the device.
    """
    if device != "cpu":
        import warp as wp

        return float(wp.get_device(device).free_memory)
    return min(_of_machine(), memory_left(), _of_process())


def _of_machine() -> float:
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
    except OSError:
        pass
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    return math.inf


def _of_process() -> float:
    """Return the size of the address space that this process may still use [bytes]."""
    if resource is None:
        return math.inf
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most == resource.RLIM_INFINITY:
        return math.inf
    try:
        taken = float(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    except OSError:
        return float(most)
    return max(0.0, most - taken)


NEEDED = 1.2e9
"""Address space that the libraries, the kernels and a small object need [bytes], as measured."""
STACK = 512 << 10
"""Stack size for runs and compiling kernels [bytes]; with half this size, a run crashes."""
THREADS = "OPENBLAS_NUM_THREADS"


def share_heap() -> None:
    """Make all threads use one heap, so that repeated runs do not need more and more memory.

    By default glibc opens up to eight heaps per core, and rarely returns their memory. Call this
    function before the first thread starts, because heaps that already exist are kept.
    MALLOC_ARENA_MAX takes precedence if it is set.
    """
    if HEAPS not in os.environ and hasattr(os, "confstr"):
        with suppress(ValueError, OSError):
            if (os.confstr("CS_GNU_LIBC_VERSION") or "").startswith("glibc"):
                ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)


@contextmanager
def pause_collection() -> Iterator[None]:
    """Disable the garbage collector within this context, which is meant for importing modules.

    Later collections also skip the objects that exist at the end of the context. Without this
    context, collections take 0.9 s of a command that takes 6 s.
    """
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.freeze()
            gc.enable()


def refuse_narrow() -> None:
    """Before NumPy is imported, check that the limits of stack and address space are large enough.

    If the address space is limited but large enough, OpenBLAS gets a single thread, because each
    OpenBLAS thread allocates buffers.

    Raises:
        InputError: The limit of the stack is too small; native code would crash.
        MemoryError: The limit of the address space is too small.
    """
    if resource is None:
        return
    stack, _ = resource.getrlimit(resource.RLIMIT_STACK)
    if stack != resource.RLIM_INFINITY and stack < STACK:
        limit = f"a run needs a stack of at least {STACK >> 10} kB."
        remedy = "Start a new shell, or run `ulimit -s 8192`."
        raise InputError("ulimit -s", stack >> 10, limit, remedy)
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most == resource.RLIM_INFINITY:
        return
    if most < NEEDED:
        allowed, needed = f"{most / 1e9:.1f} GB", f"{NEEDED / 1e9:.1f} GB"
        raise MemoryError(
            f"`ulimit -v` allows {allowed} of address space, but {needed} are needed: raise the "
            f"limit"
        )
    os.environ.setdefault(THREADS, "1")
    _take_buffers()


def _take_buffers() -> None:
    """Call each copy of OpenBLAS once, to allocate its buffers now instead of under load."""
    import numpy as np
    import scipy.linalg

    square = np.eye(128)
    scipy.linalg.lu_factor(square @ square)
