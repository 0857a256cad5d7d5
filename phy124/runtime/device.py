"""The computing device, by the name a user gives it."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Callable
from contextlib import nullcontext
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

from phy124.errors import InputError
from phy124.runtime.driver import driver

CHOICES = "auto, cpu, cuda:0 or another GPU."
"""The names a user may give, for every option that takes a device."""
KEPT = 2**30
"""Freed memory of a GPU that is kept for the next frame [bytes]; to get it anew is slow."""
P = ParamSpec("P")
Made = TypeVar("Made")
Owner = TypeVar("Owner")
_gpu = threading.RLock()


def pick_device(name: str) -> str:
    """Warp's name of the device; "auto" is CUDA if there is one.

    Raises:
        InputError: If there is no such device.
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


def one_at_a_time(
    method: Callable[Concatenate[Owner, P], Made],
) -> Callable[Concatenate[Owner, P], Made]:
    """Decorator: on a GPU, no two threads are in such methods of objects with a `device`.

    While one thread captures a graph, Warp would record in it what another one launches.
    """

    @wraps(method)
    def alone(self: Owner, *args: P.args, **kwargs: P.kwargs) -> Made:
        device: Any = getattr(self, "device", "cpu")
        with nullcontext() if str(device) == "cpu" else _gpu:
            return method(self, *args, **kwargs)

    return alone
