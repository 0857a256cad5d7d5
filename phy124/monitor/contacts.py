"""Contacts: the force of the walls on each particle, if it is asked for.

The impulse that walls give to the nodes around a particle is summed in every substep, in the
fraction of the nodes' mass that is the particle's. The sum over all particles is the impulse that
`phy124.monitor.external_work` counts for the walls.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.gaussians import Array, Gaussians
from phy124.kernels import contacts as kernels
from phy124.monitor.external_work import Measured
from phy124.monitor.near import NodesNear
from phy124.mpm import Attachable, Grid, Model, Stage, State
from phy124.mpm.tracks import Tracks
from phy124.particles import Particles
from phy124.particles.scenery import Scenery

STAGE = "contacts"
"""Name of the stages that sum them."""


class Contacts:
    """The impulses of one frame; give the solver the result of `boundaries` and this object."""

    def __init__(self, *, asked: bool = True) -> None:
        self.asked = asked
        """Whether anything is summed."""
        self._impulses: dict[int, wp.array] = {}
        """Those that each worker adds up."""
        self._bearers: NDArray[np.int64] | None = None

    def boundaries(
        self, walls: Sequence[Boundary], inner: Sequence[Attachable] | None = None
    ) -> list[Attachable]:
        """The walls, or what each is wrapped in, measured before and after they act."""
        each = zip(walls, walls if inner is None else inner, strict=True)
        return [Measured([one], partial(self._attach, wall)) for wall, one in each]

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Nothing more: the walls have the stages."""
        del model, state, tracks
        return []

    def begin(self) -> None:
        """Start a frame."""
        for impulses in self._impulses.values():
            impulses.zero_()

    def impulses(self, count: int) -> NDArray[np.float64]:
        """What each of so many particles was given since the frame began [P,3], N s."""
        total = np.zeros((count, 3))
        for impulses in self._impulses.values():
            total += impulses.numpy()
        return total

    def forces(self, scenery: Scenery, particles: Particles, fps: float) -> Array | None:
        """Mean force on each Gaussian that moves since the frame began [N,3], N; None if not asked.

        Args:
            scenery: The Gaussians.
            particles: The particles at rest; the force on those inside is the nearest Gaussian's.
            fps: Frames per second.
        """
        if not self.asked:
            return None
        moving = scenery.moving
        if self._bearers is None:
            self._bearers = bearers(moving, particles)
        columns = fps * self.impulses(len(particles)).T
        sums = [np.bincount(self._bearers, column, len(moving)) for column in columns]
        return np.stack(sums, axis=1).astype(np.float32)

    def snapshot(self) -> dict[str, Any]:
        """The sums as they are now."""
        return {str(worker): wp.clone(sums) for worker, sums in self._impulses.items()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Set the sums back to a snapshot."""
        for worker, sums in self._impulses.items():
            kept = snapshot.get(str(worker))
            sums.zero_() if kept is None else wp.copy(sums, kept)

    def _attach(
        self, wall: Boundary, stages: Sequence[Stage], model: Model, state: State
    ) -> tuple[Stage, Stage, Stage]:
        """The stages before and after the `stages` of a wall."""
        del stages
        near = NodesNear([wall], model)
        copy, changed, share = contact_kernels(model.real)
        corners: list[wp.array] = []

        def before(grid: Grid) -> wp.Launch | None:
            nonlocal corners
            near.fit(grid)
            # Each worker has its own, since it is recorded with its own layers of nodes.
            corners = [wp.zeros(3, dtype=int, device=model.device) for _ in range(2)]
            return model.launch(copy, near.threads, near.read, [near.kept, *corners])

        def between(grid: Grid) -> wp.Launch | None:
            del grid
            return model.launch(changed, near.threads, near.read, [near.kept, *corners])

        def after(grid: Grid) -> wp.Launch | None:
            own, (_, box, window, _) = self._own(grid, model), near.read
            if not np.prod(near.threads):
                return None
            mass, x, given = (array[grid.particles] for array in (model.mass, state.x, own))
            inputs = [mass, grid.lattice, box, window, x, near.kept, *corners]
            return model.launch(share, len(mass), inputs, [given])

        return Stage(STAGE, before), Stage(STAGE, between), Stage(STAGE, after)

    def _own(self, grid: Grid, model: Model) -> wp.array:
        """The sums of a worker: all look at all particles, each at its own layers of nodes."""
        if grid.worker not in self._impulses:
            zeros = wp.zeros(len(model), dtype=wp.vec3d, device=model.device)
            self._impulses[grid.worker] = zeros
        return self._impulses[grid.worker]


def bearers(gaussians: Gaussians, particles: Particles) -> NDArray[np.int64]:
    """The Gaussian that stands for each particle [P]: its own, or the nearest one at rest."""
    from scipy.spatial import KDTree

    nearest = KDTree(gaussians.means).query(particles.x)[1]
    return np.where(particles.gaussian >= 0, particles.gaussian, nearest)


def contact_kernels(real: Any) -> tuple[Any, Any, Any]:
    """What measures contacts: before a wall acts, and twice after it."""
    return (
        kernels.make_contact_copy(real),
        kernels.make_contact_reach(real),
        kernels.make_contacts(real),
    )
