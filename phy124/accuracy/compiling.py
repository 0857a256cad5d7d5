"""The time to compile the kernels that a scene needs and that are not in the cache."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import warp as wp

from phy124.boundaries.held import Clamp
from phy124.kernels import deform, diagnostics, external_work, soundness, stretch, transfer
from phy124.kernels.collide import make_collider, make_contact
from phy124.kernels.grid import make_update
from phy124.kernels.profile import make_sampler
from phy124.mpm.model import PRECISIONS
from phy124.scene import Scene

Costed = tuple[Any, float]
"""A kernel, and the processor time to compile its module on one core of an AMD EPYC [s]."""


def seconds_to_compile(scene: Scene, device: str = "cpu") -> float:
    """Processor time to compile a scene's kernels [s]; 0 if they are compiled, or on a GPU.

    Only one thread may call this at a time, and none while a solver is built, since kernels are
    created for it. Kernels of forces on a part of the object (0.3 s each) are not counted.
    """
    if device != "cpu" or wp.config.kernel_cache_dir is None:
        return 0.0
    needed = {kernel.module.name: (kernel, seconds) for kernel, seconds in kernels(scene)}
    return sum(seconds for kernel, seconds in needed.values() if not is_compiled(kernel))


def is_compiled(kernel: Any) -> bool:
    """Whether a kernel's module is loaded, or its current version is in the cache."""
    if kernel.module.execs:
        return True
    folder = Path(str(wp.config.kernel_cache_dir)) / kernel.module.get_module_identifier(1)
    return any(folder.glob("*.o"))


def kernels(scene: Scene) -> Iterator[Costed]:
    """The kernels that a run of a scene launches in one thread."""
    real = PRECISIONS[scene.resolution.precision]
    form = "simd" if real is wp.float32 else "plain"
    yield from (
        (make_sampler(real), 0.65),
        (make_update(real), 0.15),
        (soundness.make_reset(real), 0.2),
        (deform.deform_shapes, 1.5),
    )
    laws = {material.device_law.name: material.device_law for material in scene.materials}
    for law in laws.values():
        yield transfer.make_measure(law, real), 2.4
        yield diagnostics.make_totals(law, real), 0.65
        yield transfer.make_p2g(law, real, form), 0.6
        yield transfer.make_g2p(law, real, form), 0.5
        if law.project is None:
            yield stretch.make_apart(real), 0.2
        else:
            yield soundness.make_limit_total(real), 0.15
    for boundary in scene.boundaries:
        yield from ((_wall(part, real), 0.4) for part in boundary.parts())
    if scene.boundaries and scene.checks.balance:
        yield external_work.make_wall_copy(real), 0.15
        yield external_work.make_wall_sums(real), 0.2


def _wall(wall: Any, real: Any) -> Any:
    """The kernel of a simple wall."""
    moves = wall.moves or getattr(wall, "end", None) is not None
    met = wall.contact == "sticky" if isinstance(wall, Clamp) else True
    make = make_contact if met else make_collider
    return make(wall.outline(), wall.response(), moves, real)
