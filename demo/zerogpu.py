"""Run jobs on ZeroGPU, the shared GPUs of Hugging Face Spaces.

ZeroGPU refuses a job whose declared duration exceeds the visitor's remaining quota (about 120 s a
day for anonymous visitors), and ends a job that takes longer than declared. Each job therefore
declares a time that is based on its predicted time; the declared time is also the limit of the job.
Source: huggingface.co/docs/hub/spaces-zerogpu and the package `spaces` 0.51.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

from phy124.errors import InputError

from .progress import Done, Measured
from .work import Order, steps

MARGIN = 1.5
"""Declared time of a job divided by its predicted time. Frames are simulated during at most 70 % of
the declared time.
"""
SHORTEST = 15
"""Shortest time that a job declares to ZeroGPU, including the start of the forked process [s]."""
COMPILING = 20
"""Time for compiling CUDA kernels, which jobs declare until the first job has ended [s]."""
REMEDY = "Choose a coarser accuracy or fewer frames, sign in to Hugging Face, or try again later."

Work = Callable[[Order], Iterator[Any]]


class Durations:
    """Declares the duration of each job to ZeroGPU."""

    def __init__(self, longest: float) -> None:
        self.longest = longest
        self.compiled = False
        """Whether a job has ended, so that all CUDA kernels are probably compiled."""

    def __call__(self, order: Order) -> int:
        """Return the time that a job declares to ZeroGPU [s]."""
        compiling = 0 if self.compiled else COMPILING
        asked = max(MARGIN * order.expected, SHORTEST) + compiling
        return math.ceil(min(asked, self.longest))


def work_on_gpu(longest: float) -> Work:
    """Return the function that executes an order (the request for a run) on a GPU of ZeroGPU.

    Raises:
        InputError: ZeroGPU refuses a job. The returned function raises this error.
    """
    if find_spec("spaces") is None:
        return steps
    import spaces  # pyright: ignore[reportMissingImports]

    durations = Durations(longest)
    on_gpu: Work = spaces.GPU(duration=durations)(steps)
    if on_gpu is steps:  # a Space that does not have ZeroGPU
        return steps

    def work(order: Order) -> Iterator[Any]:
        import gradio as gr

        order = replace(order, seconds=min(order.seconds, durations(order)))
        try:
            for event in on_gpu(order):
                durations.compiled |= isinstance(event, Done | Measured)
                yield event
        except gr.Error as error:
            raise InputError(
                "gpu", "refused", f"{error.message.strip().rstrip('.')}.", REMEDY
            ) from error

    return work
