"""Chooses the computing device by name, and checks the version of NVIDIA's driver."""

import ctypes
import threading
import warnings
from collections.abc import Callable
from contextlib import nullcontext
from functools import wraps
from typing import Any, Concatenate, NamedTuple, ParamSpec, TypeVar

from phy124.errors import InputError

CHOICES = "auto, cpu, cuda:0 or another GPU."
"""Help text of the options that take a device."""
KEPT = 2**30
"""Largest amount of freed GPU memory that is kept for the next frame [bytes], since allocation is
slow."""
P = ParamSpec("P")
Made = TypeVar("Made")
Owner = TypeVar("Owner")
_gpu = threading.RLock()
Version = tuple[int, int]
LIBRARIES = ("libcuda.so.1", "nvcuda.dll")
"""File names of the NVIDIA driver's library on Linux and on Windows."""
RELEASES = {12: 525, 13: 580}
"""For each major version of CUDA, the first release of the NVIDIA driver that supports it."""


def pick_device(name: str) -> str:
    """Return Warp's name of the device; "auto" means CUDA if a GPU is available.

    Raises:
        InputError: This machine does not have the named device.
    """
    import warp as wp

    from phy124.runtime import startup

    startup.start()
    problem = None if wp.is_cuda_available() else driver().problem
    if name == "auto":
        if problem:
            warnings.warn(problem, stacklevel=2)
        name = "cuda:0" if wp.is_cuda_available() else "cpu"
    known = [str(device) for device in wp.get_devices()]
    if name not in known:
        remedy = problem or f"Choose {' or '.join(known)}."
        raise InputError("device", name, "this machine has no such device.", remedy)
    if name != "cpu" and wp.is_mempool_enabled(name):
        wp.set_mempool_release_threshold(name, KEPT)
    return name


def lock_gpu(
    method: Callable[Concatenate[Owner, P], Made],
) -> Callable[Concatenate[Owner, P], Made]:
    """Decorate methods so that, on a GPU, only one thread at a time runs any of these methods.

    While a thread captures a CUDA graph, Warp would record other threads' launches in the graph.
    """

    @wraps(method)
    def alone(self: Owner, *args: P.args, **kwargs: P.kwargs) -> Made:
        device: Any = getattr(self, "device", "cpu")
        with nullcontext() if str(device) == "cpu" else _gpu:
            return method(self, *args, **kwargs)

    return alone


class Driver(NamedTuple):
    """The CUDA version that the driver supports, and the CUDA version that Warp needs; None if
    unknown.
    """

    supported: Version | None
    needed: Version | None

    @property
    def problem(self) -> str | None:
        """A sentence that asks for an update if the driver is too old, otherwise None."""
        if self.supported is None or self.needed is None or self.supported >= self.needed:
            return None
        release = RELEASES.get(self.needed[0])
        newer = f"to release {release} or later" if release else "to a later release"
        return (
            f"The NVIDIA driver supports CUDA {_text(self.supported)}, and this Warp needs "
            f"{_text(self.needed)}: no GPU is used until the driver is updated {newer}."
        )

    def __str__(self) -> str:
        """The supported version of CUDA in words, or a description of the problem."""
        if self.supported is None:
            return "none"
        return f"CUDA {_text(self.supported)}" if self.problem is None else self.problem


def driver() -> Driver:
    """Return the CUDA version that this machine's driver supports, and the version that Warp needs.

    Warp must have been started.
    """
    import warp as wp

    toolkit = wp.get_cuda_toolkit_version()
    needed = (toolkit[0], 0) if toolkit else None
    return Driver(wp.get_cuda_driver_version() or _library_version(), needed)


def _library_version() -> Version | None:
    """Read the CUDA version that the driver supports from the driver's library.

    Warp does not report the version of an old driver, because Warp does not load such a driver.
    """
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
