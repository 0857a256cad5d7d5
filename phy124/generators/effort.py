"""What a generator will take: its networks' arithmetic over this machine's measured speed."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

ROUNDS = 2
"""How often each kind of arithmetic is timed, after once to warm up."""


class Work(NamedTuple):
    """Floating point operations by kind, or how many a second of each."""

    linear: float
    convolution: float
    attention: float

    def at(self, speed: Work) -> float:
        """Seconds at a speed."""
        return sum(work / rate for work, rate in zip(self, speed, strict=True))

    def times(self, count: float) -> Work:
        """So many times as much."""
        return Work(*(count * work for work in self))


@dataclass(frozen=True)
class Effort:
    """What a generator is about to do for one object."""

    seconds: float
    """Predicted time, but for reading the weights [s]."""
    settings: dict[str, Any]
    """What it was told or has chosen, for the report."""
    words: str
    """The same in words."""


def effort_of(generator: Any) -> Effort | None:
    """What a generator will take; None if it does not tell, as quick ones do not."""
    told: Callable[[], Effort] | None = getattr(generator, "effort", None)
    return told() if told is not None else None


def speed_of(device: str, dtype: Any) -> Work:
    """Floating point operations per second of torch as busy as the machine is now, by kind.

    Measured in about a second, on arrays as large as in the networks.
    """
    import torch
    from torch.nn import functional as F

    on: dict[str, Any] = {"device": device, "dtype": dtype}
    rows, wide = torch.ones(1280, 1280, **on), torch.ones(2560, 1280, **on)
    maps, filters = torch.ones(5, 640, 16, 16, **on), torch.ones(640, 640, 3, 3, **on)
    heads = torch.ones(1, 5, 2560, 64, **on)
    kinds: list[tuple[float, Callable[[], Any]]] = [
        (2 * 1280 * 1280 * 2560, lambda: F.linear(rows, wide)),
        (2 * 9 * 640 * 640 * 5 * 16 * 16, lambda: F.conv2d(maps, filters, padding=1)),
        (4 * 5 * 2560**2 * 64, lambda: F.scaled_dot_product_attention(heads, heads, heads)),
    ]
    gpu = device.startswith("cuda")
    wait = partial(torch.cuda.synchronize, device) if gpu else (lambda: None)
    with torch.inference_mode():
        return Work(*(operations / _seconds(work, wait) for operations, work in kinds))


def _seconds(work: Callable[[], Any], wait: Callable[[], Any]) -> float:
    """Mean duration of some work once it is warm [s]."""
    work()
    wait()
    start = time.perf_counter()
    for _ in range(ROUNDS):
        work()
    wait()
    return (time.perf_counter() - start) / ROUNDS
