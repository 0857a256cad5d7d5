"""Memory that nobody has written to yet holds NaN, or -1 in whole numbers."""

import ctypes
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import warp as wp

EMPTY = ("empty", "empty_like")
"""Functions of NumPy and of Warp that give memory as it comes."""
BYTE = 0xFF
"""In every byte: NaN in floating point numbers of any length."""


class Poisoned:
    """How many arrays were filled."""

    def __init__(self) -> None:
        self.warp = self.numpy = 0

    def of_warp(self, make: Callable[..., Any]) -> Callable[..., Any]:
        """Fills what Warp gives on the CPU."""

        def filled(*given: Any, **options: Any) -> Any:
            array = make(*given, **options)
            if array.ptr and array.device.is_cpu:
                ctypes.memset(
                    array.ptr, BYTE, array.size * wp.types.type_size_in_bytes(array.dtype)
                )
                self.warp += 1
            return array

        return filled

    def of_numpy(self, make: Callable[..., Any]) -> Callable[..., Any]:
        """Fills what NumPy gives to phy124."""

        def filled(*given: Any, **options: Any) -> Any:
            array = make(*given, **options)
            asks = sys._getframe(1).f_globals.get("__name__", "")
            if asks.startswith("phy124") and not array.dtype.hasobject:
                array.view(np.uint8).fill(BYTE)
                self.numpy += 1
            return array

        return filled


@contextmanager
def poisoned() -> Iterator[Poisoned]:
    """Within this context, memory that is not initialised is filled."""
    count = Poisoned()
    usual = {(module, name): getattr(module, name) for module in (wp, np) for name in EMPTY}
    try:
        for (module, name), make in usual.items():
            setattr(module, name, (count.of_warp if module is wp else count.of_numpy)(make))
        yield count
    finally:
        for (module, name), make in usual.items():
            setattr(module, name, make)
