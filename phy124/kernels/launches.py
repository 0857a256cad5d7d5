"""Repeats kernel launches that Warp recorded, without copying their arguments again.

Warp copies all arguments in every launch, which takes 5 to 10 us. For a small body, most kernels
run for little longer than that.
"""

import ctypes
from collections.abc import Callable
from functools import cache
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.runtime.late_parsing import KNOWN


class Repeated(wp.Launch):
    """A recorded kernel launch on a CPU, with arguments that are copied only when they change."""

    def __init__(self, recorded: wp.Launch) -> None:
        self.__dict__.update(recorded.__dict__)
        self._names = tuple(argument.label for argument in self.kernel.adj.args)
        values = self.params[1 : 1 + len(self._names)]
        self._arguments = _structure(self._names, tuple(map(type, values)))(*values)
        self._forward = self.hooks.forward

    def launch(self, stream: Any = None) -> None:
        """Repeat the kernel launch, or add it to the graph that is being captured."""
        if self.device.runtime._apic_capture is not None:  # a graph records the launch
            super().launch(stream)
            return
        self._forward(ctypes.byref(self.bounds), ctypes.byref(self._arguments))

    def set_param_at_index(self, index: int, value: Any, adjoint: bool = False) -> None:
        """Set the argument with a certain index."""
        super().set_param_at_index(index, value, adjoint)
        setattr(self._arguments, self._names[index], self.params[1 + index])


def record(
    kernel: Any, dim: Any, inputs: list[Any], outputs: list[Any], device: str
) -> wp.Launch | None:
    """Record a kernel launch; return None if the launch would have no threads.

    `Repeated` uses internals of Warp. For an unknown version of Warp, the result is Warp's own
    launch.

    Args:
        kernel: The Warp kernel.
        dim: Number of threads, or the number of threads along each axis.
        inputs: Arguments that the kernel reads.
        outputs: Arguments that the kernel writes, passed after the inputs.
        device: Name of the device.
    """
    recorded = wp.launch(
        kernel, dim, inputs=inputs, outputs=outputs, device=device, record_cmd=True
    )
    alone = recorded is not None and recorded.device.is_cpu and recorded.block_dim == 1
    alone = alone and wp.config.version.startswith(KNOWN)
    return Repeated(recorded) if alone else cast("wp.Launch | None", recorded)


def put(array: wp.array, values: NDArray, at: NDArray[np.int64] | None = None) -> None:
    """Copy values [K,...] to an array's first elements, or to its elements `at` [K]."""
    if str(array.device) == "cpu":
        array.numpy()[slice(len(values)) if at is None else at] = values
    elif at is not None:
        every = array.numpy()
        every[at] = values
        array.assign(every)
    elif len(values):
        array[: len(values)].assign(values)


def reader(array: wp.array) -> Callable[[], NDArray[Any]]:
    """Return a function that returns an array's current values: a view on a CPU, else a copy.

    Creating a new view takes 3 us or more.
    """
    view: NDArray[Any] = array.numpy()
    return (lambda: view) if str(array.device) == "cpu" else array.numpy


@cache
def _structure(names: tuple[str, ...], types: tuple[type, ...]) -> type[ctypes.Structure]:
    fields = list(zip(names, types, strict=True))
    return type("Arguments", (ctypes.Structure,), {"_fields_": fields})
