"""Adds to each frame the Gaussians that the solver does not move.

The added Gaussians belong to static parts, to objects that follow a track, and to rigid solids.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Array, Frame, Gaussians, rotation_matrices

IDENTITY = np.array([1, 0, 0, 0], np.float32)
INSTANT = 1e-6
"""Time step of the difference quotient for the velocity of an object on a prescribed path [s]."""


class Track(Protocol):
    """Displacement of an object over time."""

    def values(self, times: NDArray) -> NDArray:
        """Return the displacements at some times [T,3], m."""
        ...


@dataclass(frozen=True, eq=False)
class Scenery:
    """Completes frames by adding the Gaussians that the solver does not move."""

    gaussians: Gaussians
    """All N Gaussians at rest."""
    moves: NDArray[np.bool_]
    """Mask of the Gaussians that the solver moves [N]."""
    tracks: tuple[tuple[int, Track], ...] = ()
    """Index of each object that follows a prescribed path, and its displacement over time [m]."""
    free: tuple[int, ...] = ()
    """Indices of the objects that are rigid solids."""

    @property
    def count(self) -> int:
        """Number of Gaussians that the solver does not move."""
        return int((~self.moves).sum())

    @property
    def moving(self) -> Gaussians:
        """The Gaussians that the solver moves, in their rest positions and original order."""
        return self.gaussians.select(self.moves) if self.count else self.gaussians

    def whole(
        self, frame: Frame, poses: Sequence[NDArray] = (), motions: NDArray | None = None
    ) -> Frame:
        """Add all other Gaussians to a frame that contains only the Gaussians moved by the solver.

        Static Gaussians are bitwise unchanged. Gaussians of rigid solids and of objects on tracks
        are at their positions at the frame's time.

        Args:
            frame: Frame of the Gaussians that the solver moves.
            poses: Centre [m] and rotation (wxyz) of each rigid solid [F,7], for each frame so far.
            motions: Velocities [m/s] and angular velocities [rad/s] of the rigid solids at the
                frame's time [F,6].
        """
        if not self.count:
            return frame
        rest, moved = self.gaussians, frame.gaussians
        means, quats, scales = (
            self._insert(getattr(rest, name), getattr(moved, name))
            for name in ("means", "quats", "scales")
        )
        sh = rest.sh if rest.sh_degree == 0 else self._insert(rest.sh, moved.sh)
        velocities, contacts = (
            None if some is None else self._insert(np.zeros_like(rest.means), some)
            for some in (frame.velocities, frame.contacts)
        )
        for index, track in self.tracks:
            chosen = rest.object_id == index
            at, later = track.values(np.array([frame.time, frame.time + INSTANT]))
            means[chosen] += at.astype(np.float32)
            if velocities is not None:
                velocities[chosen] = (later - at) / INSTANT
        for place, index in enumerate(self.free):
            chosen, pose = rest.object_id == index, poses[-1][place]
            turn = _multiply(pose[3:], poses[0][place][3:] * (1, -1, -1, -1))
            arms = (rest.means[chosen] - poses[0][place][:3]) @ rotation_matrices(turn[None])[0].T
            means[chosen], quats[chosen] = pose[:3] + arms, _multiply(turn, rest.quats[chosen])
            if velocities is not None and motions is not None:
                velocities[chosen] = motions[place][:3] + np.cross(motions[place][3:], arms)
        gaussians = replace(rest, means=means, quats=quats, scales=scales, sh=sh)
        return replace(frame, gaussians=gaussians, velocities=velocities, contacts=contacts)

    def turns(self, rotations: Array) -> Array:
        """Return the rotations of all Gaussians [N,4] from those of the moving Gaussians."""
        if not self.count:
            return rotations
        return self._insert(np.tile(IDENTITY, (len(self.moves), 1)), rotations)

    def _insert(self, still: Array, moved: Array) -> Array:
        every = still.copy()
        every[self.moves] = moved
        return every


def _multiply(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    """Multiply quaternions wxyz `a` [4] and `b` [...,4]; the product rotates by `b` first."""
    w, v = b[..., :1], b[..., 1:]
    first = a[0] * w - (v @ a[1:])[..., None]
    return np.concatenate([first, a[0] * v + w * a[1:] + np.cross(a[1:], v)], axis=-1)
