"""Limits of a process's addresses (`ulimit -v`): refused where they are too narrow.

OpenBLAS, on which NumPy and SciPy stand, asks for its buffers again and again until it gets them,
so a process without room for them never ends. Nothing heavy may be imported here: the limit has to
be known before NumPy is imported.
"""

from __future__ import annotations

import os

try:
    import resource
except ImportError:  # Windows
    resource = None

NEEDED = 1.2e9
"""Addresses that the libraries, the kernels and a small object take, measured [bytes]."""
THREADS = "OPENBLAS_NUM_THREADS"


def refuse_narrow() -> None:
    """Refuse a limit that is too narrow; under any other one, save addresses and take the buffers.

    Each thread of OpenBLAS takes buffers of its own.

    Raises:
        MemoryError: The limit is too narrow.
    """
    if resource is None:
        return
    most, _ = resource.getrlimit(resource.RLIMIT_AS)
    if most == resource.RLIM_INFINITY:
        return
    if most < NEEDED:
        allowed, needed = f"{most / 1e9:.1f} GB", f"{NEEDED / 1e9:.1f} GB"
        raise MemoryError(
            f"`ulimit -v` allows {allowed} of addresses, and {needed} are needed: raise it"
        )
    os.environ.setdefault(THREADS, "1")
    _take_buffers()


def _take_buffers() -> None:
    """Multiply two matrices with each copy of OpenBLAS, which keeps its buffers from then on."""
    import numpy as np
    import scipy.linalg

    square = np.eye(128)
    scipy.linalg.lu_factor(square @ square)
