"""Contacts: measures the force of the walls on each Gaussian.

The impulse of walls on the nodes around a particle is summed in every substep, weighted by the
particle's fraction of the nodes' mass.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.gaussians import Frame
from phy124.kernels import contacts as kernels
from phy124.monitor.measured import Measured, NodesNear
from phy124.monitor.observer import Cost, Effect, Observed, Observer, Subject
from phy124.mpm import Attachable, Grid, Model, Stage, State

if TYPE_CHECKING:
    from typing_extensions import Self

STAGE = "contacts"
PARTICLE_COST = 20
"""Cost of distributing a wall's impulse [ns per particle]."""


class Contacts(Observer):
    """Sums the impulse of the walls on each particle during a frame."""

    in_substeps = True

    def __init__(self) -> None:
        self._impulses: dict[int, wp.array] = {}
        """Impulse on each particle [P,3], N s, for each worker."""
        self._setup: Observed | None = None
        self._nearest_gaussian: NDArray[np.int64] | None = None

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether the scene requests contact forces."""
        return subject.scene.keeps_contacts

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that measure a wall."""
        if subject.scene.boundaries:
            yield from contact_kernels(real)

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects."""
        walls = len(subject.scene.boundaries)
        asked, why = (
            subject.scene.keeps_contacts and walls > 0,
            "not requested, or there is no boundary",
        )
        return Effect("contact forces", asked, why, Cost(particle=PARTICLE_COST * walls))

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Return the observer of a run."""
        contacts = cls()
        contacts._setup = setup
        return contacts

    def wrap_walls(
        self, walls: Sequence[Boundary], inner: Sequence[Attachable]
    ) -> list[Attachable]:
        """Return the walls, with stages that measure each wall's impulse."""
        pairs = zip(walls, inner, strict=True)
        return [Measured([wrapped], partial(self._measure, wall)) for wall, wrapped in pairs]

    def before_attempt(self, *, closely: bool = False) -> None:
        """Set the sums of impulses to zero."""
        for impulses in self._impulses.values():
            impulses.zero_()

    def after_frame(self, frame: Frame) -> Frame:
        """Return the frame with the mean force on each moving Gaussian [N,3], N.

        The force on an inner particle acts on the nearest Gaussian.
        """
        assert self._setup is not None
        moving = self._setup.scenery.moving
        if self._nearest_gaussian is None:
            self._nearest_gaussian = self.find_nearest(self._setup)
        columns = self._setup.scene.time.fps * self.read_impulses(self._setup).T
        sums = [np.bincount(self._nearest_gaussian, column, len(moving)) for column in columns]
        return replace(frame, contacts=np.stack(sums, axis=1).astype(np.float32))

    def find_nearest(self, setup: Observed) -> NDArray[np.int64]:
        """Return the moving Gaussian that receives each particle's impulse [P]."""
        moving, particles = setup.scenery.moving, setup.particles
        nearest = scipy.spatial.KDTree(moving.means).query(particles.x)[1]
        return np.where(particles.gaussian >= 0, particles.gaussian, nearest)

    def read_impulses(self, setup: Observed) -> NDArray[np.float64]:
        """Return the impulse on each particle in the frame so far [P,3], N s."""
        return self.impulses(len(setup.particles))

    def impulses(self, count: int) -> NDArray[np.float64]:
        """Return the impulse on each of `count` particles in the frame so far [P,3], N s."""
        total = np.zeros((count, 3))
        for impulses in self._impulses.values():
            total += impulses.numpy()
        return total

    def snapshot(self) -> dict[str, Any]:
        """Return the sums of impulses."""
        return {str(worker): wp.clone(sums) for worker, sums in self._impulses.items()}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the sums of impulses."""
        for worker, sums in self._impulses.items():
            copy = snapshot.get(str(worker))
            sums.zero_() if copy is None else sums.assign(copy)

    def _measure(
        self, wall: Boundary, stages: Sequence[Stage], model: Model, state: State
    ) -> tuple[Stage, Stage, Stage]:
        near = NodesNear([wall], model)
        copy, changed, share = contact_kernels(model.real)
        corners: list[wp.array] = []

        def before(grid: Grid) -> wp.Launch | None:
            nonlocal corners
            near.fit(grid)
            # Each worker has a pair of corners, since workers have separate layers of nodes.
            corners = [wp.zeros(3, dtype=int, device=model.device) for _ in range(2)]
            return model.launch(copy, near.threads, near.read, [near.copy, *corners])

        def between(grid: Grid) -> wp.Launch | None:
            return model.launch(changed, near.threads, near.read, [near.copy, *corners])

        def after(grid: Grid) -> wp.Launch | None:
            sums, (_, box, window, _) = self._sums(grid, model), near.read
            if not np.prod(near.threads):
                return None
            mass, x, impulses = (array[grid.particles] for array in (model.mass, state.x, sums))
            inputs = [mass, grid.lattice, box, window, x, near.copy, *corners]
            return model.launch(share, len(mass), inputs, [impulses])

        return Stage(STAGE, before), Stage(STAGE, between), Stage(STAGE, after)

    def _sums(self, grid: Grid, model: Model) -> wp.array:
        """Return a worker's sums [P,3]; nodes of several workers may act on one particle."""
        if grid.worker not in self._impulses:
            zeros = wp.zeros(len(model), dtype=wp.vec3d, device=model.device)
            self._impulses[grid.worker] = zeros
        return self._impulses[grid.worker]


def contact_kernels(real: Any) -> tuple[Any, Any, Any]:
    """Return the kernels that measure a wall: one before the wall acts, two afterwards."""
    return (
        kernels.make_contact_copy(real),
        kernels.make_contact_reach(real),
        kernels.make_contacts(real),
    )
