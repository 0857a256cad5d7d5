"""Sums the impulses of walls on surface points, and of clamps on nodes.

Impulses are summed only if the forces on Gaussians are stored (phy124/monitor/lattice.py).
"""

from collections.abc import Iterator
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.lattice.impulses import make_add_impulse, make_add_momentum
from phy124.mpm.model import Model
from phy124.mpm.stage import Named, launches
from phy124.mpm.tracks import Tracks


class Impulses:
    """The impulses since the sums were last cleared."""

    def __init__(self, model: Model, points: int, nodes: Any, tracks: Tracks) -> None:
        """Set all sums to zero.

        Args:
            model: The constants of the run.
            points: Number of surface points.
            nodes: Arrays of the nodes.
            tracks: The tracks of the run, with the clock.
        """
        self._model, self._nodes, self._clock = model, nodes, tracks.clock
        count = points + len(nodes.rest)
        self.sums = wp.zeros(count, dtype=wp.vec3d, device=model.device)
        """Impulse on each surface point, followed by the impulse on each node [S+N,3], N s."""
        self.of_nodes = cast("wp.array", self.sums[points:])
        """Impulse on each node [N,3], N s."""

    def press(self, near: wp.array, force: wp.array) -> wp.Launch:
        """Record the launch that adds a wall's impulses on nearby points to the sums.

        `near` contains the points, one per thread, `force` [S,3], N, the mean forces in a substep.
        """
        kernel = make_add_impulse(self._model.real)
        launch = self._model.launch(kernel, len(near), [near, force, self._clock], [self.sums])
        return cast("wp.Launch", launch)

    def hold(self, clamps: list[Named], held: NDArray[np.int64]) -> list[Named]:
        """Return the launches of clamps, with sums of the momenta of the nodes `held`."""
        model, nodes = self._model, self._nodes
        chosen = wp.array(held.astype(np.int32), dtype=int, device=model.device)
        kernel = make_add_momentum(model.real)
        before, after = (
            launches([("clamp", model.launch(kernel, len(held), inputs, [self.of_nodes]))])
            for inputs in ([sign, chosen, nodes.inverse, nodes.v] for sign in (-1.0, 1.0))
        )
        return [*before, *clamps, *after]


def kernels(real: Any) -> Iterator[Any]:
    """Yield the kernels that sum impulses."""
    yield make_add_impulse(real)
    yield make_add_momentum(real)
