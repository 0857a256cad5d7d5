"""The driver of NVIDIA's GPUs: which CUDA it supports, and which Warp needs."""

from __future__ import annotations

import ctypes
from typing import NamedTuple

Version = tuple[int, int]
LIBRARIES = ("libcuda.so.1", "nvcuda.dll")
"""The driver's library on Linux and on Windows."""
RELEASES = {12: 525, 13: 580}
"""CUDA's major version -> the first release of the driver that supports it."""


class Driver(NamedTuple):
    """Versions of CUDA; None: no driver, or a Warp without CUDA."""

    found: Version | None
    needed: Version | None

    @property
    def problem(self) -> str | None:
        """A sentence if there is a driver that is too old."""
        if self.found is None or self.needed is None or self.found >= self.needed:
            return None
        release = RELEASES.get(self.needed[0])
        newer = f"to release {release} or later" if release else "to a later release"
        return (
            f"The NVIDIA driver supports CUDA {_text(self.found)}, and this Warp needs "
            f"{_text(self.needed)}: no GPU is used until the driver is updated {newer}."
        )

    def __str__(self) -> str:
        """What there is, in words."""
        if self.found is None:
            return "none"
        return f"CUDA {_text(self.found)}" if self.problem is None else self.problem


def driver() -> Driver:
    """The driver of this machine. Warp must have been started."""
    import warp as wp

    toolkit = wp.get_cuda_toolkit_version()
    needed = (toolkit[0], 0) if toolkit else None
    return Driver(wp.get_cuda_driver_version() or _stated(), needed)


def _stated() -> Version | None:
    """What the driver's library says itself: Warp does not load one that is too old."""
    version = ctypes.c_int()
    for name in LIBRARIES:
        try:
            if ctypes.CDLL(name).cuDriverGetVersion(ctypes.byref(version)) == 0:
                return version.value // 1000, version.value % 1000 // 10
        except (OSError, AttributeError):
            continue
    return None


def _text(version: Version) -> str:
    return ".".join(map(str, version))
