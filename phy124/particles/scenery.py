"""Scenery: the Gaussians of static parts, which are in every frame and never in the solver.

Objects with a motion of their own are scenery, too: their Gaussians are shifted by their tracks.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Array, Frame, Gaussians
from phy124.tracks import Track

IDENTITY = np.array([1, 0, 0, 0], np.float32)
"""The identity rotation, wxyz."""
INSTANT = 1e-6
"""Time over which the velocity of a shifted object is taken [s]."""


@dataclass(frozen=True, eq=False)
class Scenery:
    """An object of which only some Gaussians move; completes frames of those to frames of all."""

    gaussians: Gaussians
    """All of them at rest, N."""
    moves: NDArray[np.bool_]
    """Which of them move in the solver [N]."""
    tracks: tuple[tuple[int, Track], ...] = ()
    """Numbers of the objects that are shifted, and their displacements over time [m]."""

    @property
    def count(self) -> int:
        """How many are static."""
        return int((~self.moves).sum())

    @property
    def moving(self) -> Gaussians:
        """Those that move, at rest, in order."""
        return self.gaussians.select(self.moves) if self.count else self.gaussians

    def whole(self, frame: Frame) -> Frame:
        """A frame of the moving Gaussians with the static ones added, unchanged bit for bit, and
        the shifted ones where they are then.
        """
        if not self.count:
            return frame
        rest, moved = self.gaussians, frame.gaussians
        means, quats, scales = (
            self._filled(getattr(rest, name), getattr(moved, name))
            for name in ("means", "quats", "scales")
        )
        sh = rest.sh if rest.sh_degree == 0 else self._filled(rest.sh, moved.sh)
        velocities, contacts = (
            None if some is None else self._filled(np.zeros_like(rest.means), some)
            for some in (frame.velocities, frame.contacts)
        )
        for index, track in self.tracks:
            own = rest.object_id == index
            at, later = track.values(np.array([frame.time, frame.time + INSTANT]))
            means[own] += at.astype(np.float32)
            if velocities is not None:
                velocities[own] = (later - at) / INSTANT
        gaussians = replace(rest, means=means, quats=quats, scales=scales, sh=sh)
        return replace(frame, gaussians=gaussians, velocities=velocities, contacts=contacts)

    def turns(self, rotations: Array) -> Array:
        """Rotations of all [N,4] from those of the Gaussians that move."""
        if not self.count:
            return rotations
        return self._filled(np.tile(IDENTITY, (len(self.moves), 1)), rotations)

    def _filled(self, still: Array, moved: Array) -> Array:
        filled = still.copy()
        filled[self.moves] = moved
        return filled
