"""One heap for all threads of the server, so that its memory stays flat.

glibc opens a heap of its own for threads that meet in malloc, eight for each processor, and hardly
gives one back: every request and run in another thread leaves its pieces in another heap.
"""

from __future__ import annotations

import ctypes
import os
import platform

M_ARENA_MAX = -8
"""Of glibc's malloc.h."""
CHOSEN = "MALLOC_ARENA_MAX"


def share_heap() -> None:
    """Let all threads of this process use one heap, where there is glibc and nobody chose else.

    Heaps that are open already stay: call it before the first thread starts.
    """
    if platform.libc_ver()[0] == "glibc" and CHOSEN not in os.environ:
        ctypes.CDLL(None).mallopt(M_ARENA_MAX, 1)
