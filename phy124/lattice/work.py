"""Records the launches that sum the work of contact impulses on surface points."""

from typing import Any, cast

import warp as wp

from phy124.kernels.lattice.work import make_contact_work
from phy124.mpm.model import Model
from phy124.mpm.tracks import Tracks


class ContactWork:
    """The sums of contact work in a run, and the arrays that all launches read."""

    def __init__(self, model: Model, nodes: Any, tracks: Tracks, sums: wp.array) -> None:
        """Store the nodes of a run.

        Args:
            model: The constants of the run.
            nodes: Arrays of the nodes.
            tracks: The tracks of the run, with the clock and the velocities of walls.
            sums: The sums to which work is added (phy124/kernels/lattice/work.py).
        """
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
        """Record the launch that sums the work on listed points; parameter 1 is their number.

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
