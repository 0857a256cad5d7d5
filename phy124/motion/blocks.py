"""Launches kernels over blocks of Gaussians; the blocks are divided among CPU threads."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import warp as wp

BLOCK = 1 << 15
"""Number of Gaussians that a CPU thread processes at a time."""
DEFORMATION = "F"
"""In the arguments of a step, this name stands for the deformation gradients of the Gaussians."""
THREADS = "shapes"


class Step(NamedTuple):
    """A kernel that processes the Gaussians, with its arguments."""

    kernel: Any
    mine: list[Any]
    """First arguments: arrays with one entry per Gaussian; `DEFORMATION` stands for F."""
    shared: list[Any]
    """Next arguments: arrays without an entry per Gaussian, which all threads may read."""
    out: list[Any]
    """Last arguments: the arrays that the kernel writes, with one entry per Gaussian."""
    each: int = 1
    """Number of Gaussians that one thread of the kernel processes."""


class BlockLauncher:
    """Launches kernels over the Gaussians in blocks that are divided among CPU threads.

    The deformation gradients of a block stay in the cache from one step to the next. The threads
    are reused, because new threads often start on the same core.
    """

    def __init__(self, count: int, device: str, threads: int) -> None:
        self.device, self._count = device, count
        threads = max(1, min(threads, count)) if device == "cpu" else 1
        self._runs = [
            range(count * k // threads, count * (k + 1) // threads) for k in range(threads)
        ]
        matrix: Any = wp.mat33d
        self.block = BLOCK if device == "cpu" else max(count, 1)
        most = min(self.block, max(len(run) for run in self._runs))
        self._deformation = [wp.empty(most, dtype=matrix, device=device) for _ in range(threads)]
        self._others = ThreadPoolExecutor(threads - 1, THREADS) if threads > 1 else None

    def run(self, steps: Sequence[Step]) -> None:
        """Launch the kernels of all steps for each block of Gaussians."""
        work = [
            [
                self._record(step, range(first, min(first + self.block, run.stop)), F)
                for first in range(run.start, run.stop, self.block)
                for step in steps
            ]
            for run, F in zip(self._runs, self._deformation, strict=True)
        ]
        # Recording a launch loads a kernel, which several threads must not do at the same time.
        first, *others = work
        started = [self._others.submit(_launch, items) for items in others] if self._others else []
        _launch(first)
        for future in started:
            future.result()

    def _record(self, step: Step, block: range, F: wp.array) -> Any:
        count = len(block)

        def part(array: Any) -> Any:
            if isinstance(array, str):
                return F[:count]
            whole = len(array) == self._count
            return array[block.start : block.stop] if whole else array[:count]

        mine, out = ([part(array) for array in arrays] for arrays in (step.mine, step.out))
        shared = [F[:count] if isinstance(array, str) else array for array in step.shared]
        return wp.launch(
            step.kernel,
            dim=-(-count // step.each),
            inputs=[*mine, *shared, *out],
            device=self.device,
            record_cmd=True,
        )


def _launch(launches: list[Any]) -> None:
    for launch in launches:
        launch.launch()
