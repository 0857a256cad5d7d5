"""Division: divides the threads of a kernel among all workers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from phy124.mpm.model import Model

DIVIDED = -7
"""Task of the workers: launch their shares of a kernel."""


class Division:
    """Records kernels whose threads are divided among all workers."""

    def __init__(
        self, model: Model, workers: Sequence[Any], complete: Callable[[int], None]
    ) -> None:
        """Store the workers that launch the kernels.

        Args:
            model: The constants of the run.
            workers: The workers (phy124/lattice/workers.py).
            complete: Function that runs a task on all workers.
        """
        self._model, self._workers, self._complete = model, workers, complete

    def record(
        self, kernel: Any, most: int, inputs: list[Any], outputs: list[Any]
    ) -> Callable[[int], None]:
        """Return a function that runs a kernel with a chosen number of threads.

        Args:
            kernel: The kernel; its first argument is the index of its first thread.
            most: Largest number of threads, at least 1.
            inputs: The other arguments that the kernel reads.
            outputs: Arguments that the kernel writes.
        """
        shares: list[Any] = [
            self._model.launch(kernel, most, [0, *inputs], outputs) for _ in self._workers
        ]

        def run(count: int) -> None:
            edges = np.linspace(0, count, len(shares) + 1).astype(int).tolist()
            for worker, share, first, last in zip(
                self._workers, shares, edges, edges[1:], strict=False
            ):
                worker.tasks[DIVIDED] = [("divided", share.launch)] if last > first else []
                share.set_param_at_index(0, first)
                share.set_dim(max(1, last - first))
            self._complete(DIVIDED)

        return run
