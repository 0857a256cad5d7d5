"""How much memory this process may still take."""

from __future__ import annotations

import math
import os
from pathlib import Path

from phy124.runtime.cgroups import memory_left

try:
    import resource
except ImportError:  # Windows
    resource = None


def free_memory(device: str = "cpu") -> float:
    """Memory that this process may still take [bytes]; infinity where the system does not tell.

    On a CPU it is the least of what the machine has, what its control groups (containers, batch
    systems) leave it, and what `ulimit -v` leaves it.

    Args:
        device: Warp's name of the device whose memory is meant.
    """
    if device != "cpu":
        import warp as wp

        return float(wp.get_device(device).free_memory)
    return min(_of_machine(), memory_left(), _of_process())


def _of_machine() -> float:
    """Memory that all programs of the machine together may still take [bytes]."""
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
    """What the limit of this process's addresses leaves [bytes]."""
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
