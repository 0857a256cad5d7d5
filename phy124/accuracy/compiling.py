"""The time to compile the kernels that a scene needs and that are not in the cache."""

from __future__ import annotations

import warp as wp

from phy124.runtime.compiling import is_compiled
from phy124.runtime.cores import cores
from phy124.scene import Scene
from phy124.simulation.solver import kernels


def seconds_to_compile(scene: Scene, device: str = "cpu") -> float:
    """Time to compile a scene's kernels on all cores [s]; 0 if they are compiled, or on a GPU.

    Only one thread may call this at a time, and none while a solver is built, since kernels are
    created for it. Kernels of forces on a part of the object (0.3 s each) are not counted.
    """
    if device != "cpu" or wp.config.kernel_cache_dir is None:
        return 0.0
    needed = {kernel.module.name: kernel for kernel in kernels(scene)}
    seconds = [kernel.seconds for kernel in needed.values() if not is_compiled(kernel)]
    return max(sum(seconds) / cores(), max(seconds, default=0.0))
