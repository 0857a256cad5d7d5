"""Division: divides the threads of a kernel among all workers."""

from collections.abc import Callable
from typing import Any

import numpy as np

from phy124.mpm.model import Model
from phy124.mpm.threads import Team


class Division:
    """Records kernels whose threads are divided among all workers."""

    def __init__(self, model: Model, team: Team) -> None:
        """Store the constants of the run, and the threads that launch the kernels."""
        self._model, self._team = model, team

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
        team = self._team
        shares: list[Any] = [
            self._model.launch(kernel, most, [0, *inputs], outputs) for _ in range(team.size)
        ]

        def run(count: int) -> None:
            edges = np.linspace(0, count, team.size + 1).astype(int).tolist()
            for share, first, last in zip(shares, edges, edges[1:], strict=False):
                share.set_param_at_index(0, first)
                share.set_dim(max(1, last - first))

            def launch_share(member: int) -> None:
                if edges[member + 1] > edges[member]:
                    shares[member].launch()

            team.complete(launch_share)

        return run
