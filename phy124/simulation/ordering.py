"""The order of the particles: that of the slabs into which several threads cut them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np
from numpy.typing import NDArray

from phy124.materials import AnyMaterial
from phy124.mpm.slabs import layers
from phy124.particles import Particles


def axis_of(particles: Particles, threads: int) -> int:
    """The axis along which particles are to be ordered: x, or for several threads the longest."""
    return int(np.argmax(np.ptp(particles.x, axis=0))) if threads > 1 else 0


def ordered(
    particles: Particles,
    materials: Sequence[AnyMaterial],
    stiffness: NDArray | None,
    dx: float,
    axis: int,
) -> tuple[Particles, NDArray | None]:
    """Particles sorted by layers of cells, so that a slab is a run of them in memory.

    Args:
        particles: They are sorted by law, and along x within each; the laws stay as they are.
        materials: What they are made of.
        stiffness: Values for each [P], or None.
        dx: Thickness of a layer [m].
        axis: The axis across the layers; 0: they stay in their order.
    """
    if axis == 0:
        return particles, stiffness
    laws = [section.device_law.name for section in materials]
    law = np.array([laws.index(name) for name in laws])[particles.material]
    body = np.zeros_like(law) if particles.body is None else particles.body
    changes = (np.diff(law, prepend=law[0]) != 0) | (np.diff(body, prepend=body[0]) != 0)
    run = np.cumsum(changes)
    order = np.lexsort((layers(particles.x, axis, dx), run))
    arrays = {one.name: getattr(particles, one.name) for one in fields(particles)}
    moved = {name: array[order] for name, array in arrays.items() if array is not None}
    return replace(particles, **moved), None if stiffness is None else stiffness[order]
