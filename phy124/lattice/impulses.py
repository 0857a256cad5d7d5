"""Sums impulses and work of contact on surface points, and impulses of clamps on nodes.

Impulses are summed only if the forces on Gaussians are stored (phy124/monitor/lattice.py).
"""

from collections.abc import Iterator
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.lattice.impulses import make_add_impulse, make_add_momentum
from phy124.kernels.lattice.work import make_contact_work
from phy124.mpm.model import Model
from phy124.mpm.stage import Named, launches
from phy124.mpm.tracks import Tracks


class Impulses:
    """The sums of contact impulses on surface points and nodes since they were last cleared."""

    def __init__(self, model: Model, points: int, nodes: Any, tracks: Tracks) -> None:
        self._model, self._nodes, self._clock = model, nodes, tracks.clock
        count = points + len(nodes.rest)
        self.sums = wp.zeros(count, dtype=wp.vec3d, device=model.device)
        """Impulse on each surface point, followed by the impulse on each node [S+N,3], N s."""
        self.of_nodes = cast("wp.array", self.sums[points:])
        """Impulse on each node [N,3], N s."""

    def press(self, near: wp.array, force: wp.array) -> wp.Launch:
        """Record the kernel launch that adds a wall's impulses to the sums.

        `near` contains the indices of the points, one per thread. `force` [S,3], N, contains the
        mean forces in a substep.
        """
        kernel = make_add_impulse(self._model.real)
        launch = self._model.launch(kernel, len(near), [near, force, self._clock], [self.sums])
        return cast("wp.Launch", launch)

    def hold(self, clamps: list[Named], held: NDArray[np.int64]) -> list[Named]:
        """Return the clamps' kernel launches, and launches that sum the clamps' impulses.

        An impulse is the change of the momenta of the nodes `held`.
        """
        model, nodes = self._model, self._nodes
        chosen = wp.array(held.astype(np.int32), dtype=int, device=model.device)
        kernel = make_add_momentum(model.real)
        before, after = (
            launches([("clamp", model.launch(kernel, len(held), inputs, [self.of_nodes]))])
            for inputs in ([sign, chosen, nodes.inverse, nodes.v] for sign in (-1.0, 1.0))
        )
        return [*before, *clamps, *after]


def kernels(real: Any) -> Iterator[Any]:
    """Yield the kernels that sum contact impulses on points and nodes."""
    yield make_add_impulse(real)
    yield make_add_momentum(real)


class ContactWork:
    """The sums of the work of contact in a run."""

    def __init__(self, model: Model, nodes: Any, tracks: Tracks, sums: wp.array) -> None:
        self._model, self._nodes, self._tracks, self._sums = model, nodes, tracks, sums

    def of(
        self,
        at: int,
        near: wp.array,
        points: tuple[wp.array, wp.array],
        gap: wp.array,
        force: wp.array,
        slot: int = 0,
        *,
        clamped: bool = False,
    ) -> wp.Launch:
        """Record the kernel launch that sums the work of contact on the listed points.

        Parameter 1 of the launch is the number of listed points.

        Args:
            at: Index of the first of three sums of work.
            near: Indices of the points.
            points: Nodes and weights of each point.
            gap: Normal and distance of each point.
            force: Mean force on each point in a substep [S,3], N.
            slot: Track of the wall; the first track has no rate.
            clamped: Whether to include the work on nodes in clamps.
        """
        nodes, tracks = self._nodes, self._tracks
        moving = nodes.inverse if clamped else nodes.movable
        inputs = [near, 0, at, slot, *points, moving, gap, force, tracks.clock]
        inputs += [tracks.rates, nodes.before, nodes.v]
        kernel = make_contact_work(self._model.real)
        return cast("wp.Launch", self._model.launch(kernel, 1, inputs, [self._sums]))
