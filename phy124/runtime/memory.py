"""How much memory programs may still take."""

from __future__ import annotations

import math
import os
from pathlib import Path


def free_memory(device: str = "cpu") -> float:
    """Memory that programs may still take [bytes]; infinity where the system does not tell.

    Args:
        device: Warp's name of the device whose memory is meant.
    """
    if device != "cpu":
        import warp as wp

        return float(wp.get_device(device).free_memory)
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
    except OSError:
        pass
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    return math.inf
