"""What a task needs of its machine, told from its scene before there are Gaussians."""

from __future__ import annotations

from typing import NamedTuple

from phy124.budget.cost import GAUSSIANS, count_nodes, count_particles, estimate_memory
from phy124.scene import Scene

PROCESS = 4e8
"""Memory of a worker before it has a clip [bytes]: Python, NumPy, Warp and its kernels."""
CONTEXT = 6e8
"""What CUDA keeps on the GPU per process [bytes]."""
UNSURE = 2.0
"""Factor for what a scene does not tell: how much of its cube an object fills."""
STEP = 1 << 28
"""Memory is asked for in multiples of so many bytes, so that tasks of one kind ask for the same."""
SHARERS = 8
"""Most tasks per GPU: more wait for each other."""


class Needs(NamedTuple):
    """What is reserved for one task."""

    memory: int
    """Bytes."""
    gpus: float
    """Part of a GPU."""


def needs_of(scene: Scene, gaussians: int | None, gpu_memory: float | None) -> Needs:
    """What the clip of a scene needs.

    Args:
        scene: What is run.
        gaussians: Largest number of them, if it is limited.
        gpu_memory: Memory of one GPU [bytes]; None: the work is for CPUs.
    """
    count = min(gaussians or GAUSSIANS, GAUSSIANS)
    particles, nodes = count_particles(scene, count), count_nodes(scene)
    memory, state = estimate_memory(scene, count, particles, nodes, scene.time.frames)
    steps = -(-(PROCESS + UNSURE * memory) // STEP)
    return Needs(int(steps) * STEP, 0.0 if gpu_memory is None else _part(state, gpu_memory))


def memory_of_gpu(device: str) -> float | None:
    """Memory of a device [bytes], which stands for those of all nodes; None for a CPU."""
    if device == "cpu":
        return None
    import warp as wp

    return float(wp.get_device(device).total_memory)


def _part(state: float, gpu_memory: float) -> float:
    """One of so many equal parts of a GPU as fit."""
    fit = int(gpu_memory // (CONTEXT + UNSURE * state))
    return 1.0 / max(1, min(SHARERS, fit))
