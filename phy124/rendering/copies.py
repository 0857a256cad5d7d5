"""Copies a device's arrays to the host while the device continues to work."""

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray


class HostCopies:
    """Copies the results of one picture to the host; `wait` returns the copies.

    On a GPU, the host's memory is page-locked, so `start` does not wait for the device.
    """

    def __init__(self, device: Any) -> None:
        self._device = device
        self._memory: dict[str, wp.array] = {}
        self._started: dict[str, wp.array] = {}
        self._done = wp.Event(device) if device.is_cuda else None

    def start(self, **arrays: wp.array) -> None:
        """Copy one-dimensional arrays as soon as earlier kernel launches have computed these
        arrays.
        """
        self._started = {name: self._copy(name, array) for name, array in arrays.items()}
        if self._done is not None:
            self._device.stream.record_event(self._done)

    def wait(self) -> dict[str, NDArray[Any]]:
        """Return the copied arrays; the next call of `start` overwrites them."""
        if self._done is not None:
            wp.synchronize_event(self._done)
        return {name: np.asarray(array.numpy()) for name, array in self._started.items()}

    def _copy(self, name: str, array: wp.array) -> wp.array:
        memory = self._memory.get(name)
        if memory is None or memory.size < array.size:
            memory = wp.empty(
                array.size, dtype=array.dtype, device="cpu", pinned=self._device.is_cuda
            )
            self._memory[name] = memory
        copy: Any = memory[: array.size]
        wp.copy(copy, array)
        return copy
