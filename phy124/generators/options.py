"""Declares the options of all generators, and predicts a generator's run time.

The predicted time is the number of arithmetic operations of the networks, divided by the speed
measured on this machine.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from inspect import signature
from typing import Any, Literal, NamedTuple

from pydantic import Field

from phy124.errors import InputError
from phy124.schema.section import Section

Sampler = Literal["ddim", "dpmsolver++"]
SAMPLER: Sampler = "ddim"
"""Sampler of the DDIM paper and of LGM."""
Precision = Literal["float32", "bfloat16", "float16"]


class GeneratorOptions(Section):
    """Options of a generator; if an option is not set, the generator's default applies."""

    steps: int | None = Field(default=None, ge=1, le=500)
    """Number of steps of the generator's diffusion (lgm: 30) or of its fit (dreamgaussian: 500);
    fewer steps are faster but less exact.
    """
    sampler: Sampler | None = None
    """Solver for lgm's diffusion: ddim, which is of first order and used in the paper, or
    dpmsolver++, which is of second order.
    """
    precision: Precision | None = None
    """Floating-point precision of lgm's diffusion network. Default: float16 on a GPU, bfloat16 on a
    processor that supports it, float32 otherwise.
    """

    def select(self, factory: Callable[..., Any], name: str) -> dict[str, Any]:
        """Return the options that are set, as keywords for the factory of a generator.

        Raises:
            InputError: If the factory does not have a keyword for an option that is set.
        """
        options, known = self.model_dump(exclude_none=True), signature(factory).parameters
        for option, value in options.items():
            if option not in known:
                others = [other for other in type(self).model_fields if other in known]
                limit = f"{name} does not have this option."
                remedy = (
                    f"It has {', '.join(others)}."
                    if others
                    else "This generator has no options: remove this option."
                )
                raise InputError(option, value, limit, remedy)
        return options


UNCHANGED = GeneratorOptions()


ROUNDS = 2
"""Number of timed repetitions, after a warm-up."""


class Work(NamedTuple):
    """Numbers of floating-point operations, or numbers of operations per second."""

    linear: float
    convolution: float
    attention: float

    def at(self, speed: Work) -> float:
        """Return the time [s] of these operations; `speed` is in operations per second."""
        return sum(work / rate for work, rate in zip(self, speed, strict=True))

    def times(self, count: float) -> Work:
        """Return the work of `count` repetitions."""
        return Work(*(count * work for work in self))


@dataclass(frozen=True)
class Effort:
    """Predicted run time of a generator for one object, and settings of the generator."""

    seconds: float
    """Time [s] without the loading of weights."""
    settings: dict[str, Any]
    """Settings for the report."""
    words: str
    """Settings as text."""


def effort_of(generator: Any) -> Effort | None:
    """Return the predicted run time and the settings of a generator; None for fast generators."""
    effort: Callable[[], Effort] | None = getattr(generator, "effort", None)
    return effort() if effort is not None else None


def speed_of(device: str, dtype: Any) -> Work:
    """Measure how many floating-point operations of each kind torch performs per second.

    The arrays of the measurement are as large as in the networks; the measurement takes about a
    second.
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
    work()
    wait()
    start = time.perf_counter()
    for _ in range(ROUNDS):
        work()
    wait()
    return (time.perf_counter() - start) / ROUNDS
