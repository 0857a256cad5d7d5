"""Stores the transforms from /tf and /tf_static, and computes poses of coordinate frames.

Only the latest transform of each frame is stored. Transforms are not interpolated in time.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError

MOST = 1000
DEEPEST = 64
"""Largest number of transforms between a frame and the root of its tree."""
Pose = NDArray[np.float64]
"""Rotation and translation [m] as a matrix [4,4]."""


class Transforms:
    """A tree of coordinate frames; poses are relative to the object's world."""

    def __init__(self, world: str) -> None:
        self.world = world
        self._links: dict[str, tuple[str, Pose]] = {}

    def hear(self, message: Any) -> None:
        """Store the transforms of a TFMessage.

        Raises:
            InputError: A rotation is not a unit quaternion, a number is not finite, or there are
                too many frames.
        """
        for link in message.transforms:
            child = link.child_frame_id
            if child not in self._links and len(self._links) >= MOST:
                limit = f"{MOST} frames are known already."
                raise InputError("tf", child, limit, "Publish fewer frames.")
            self._links[child] = link.header.frame_id, _pose(child, link.transform)

    def place(self, frame: str, pose: Pose) -> None:
        """Store the pose in the world of a frame that the bridge itself publishes."""
        self._links[frame] = self.world, pose

    def pose(self, frame: str) -> Pose:
        """Return the pose of a frame in the world.

        Raises:
            InputError: No chain of transforms connects the frame with the world.
        """
        root, there = self._up(frame)
        base, here = self._up(self.world)
        if root != base:
            limit = f"no transform leads from it to {self.world}."
            remedy = f"Publish it on /tf, or give the frame {self.world}."
            raise InputError("frame_id", frame, limit, remedy)
        return np.linalg.inv(here) @ there

    def _up(self, frame: str) -> tuple[str, Pose]:
        pose = np.eye(4)
        for _ in range(DEEPEST):
            if frame not in self._links:
                return frame, pose
            frame, link = self._links[frame]
            pose = link @ pose
        limit = f"it has more than {DEEPEST} parent frames, or is its own parent."
        raise InputError("frame_id", frame, limit, "Correct the tree of coordinate frames (TF).")


def translation(place: NDArray[np.float64]) -> Pose:
    """Return the pose of a frame that has its origin at `place` [3], m, and the world's axes."""
    pose = np.eye(4)
    pose[:3, 3] = place
    return pose


def _pose(name: str, transform: Any) -> Pose:
    q, t = transform.rotation, transform.translation
    quaternion, place = np.array([q.x, q.y, q.z, q.w]), np.array([t.x, t.y, t.z])
    length = float(np.linalg.norm(quaternion))
    if not (np.isfinite(place).all() and 0.5 < length < 2):
        limit = "its transform must be a rotation and three finite numbers."
        raise InputError(
            "tf", name, limit, "Publish a unit quaternion (x y z w) and a translation in metres."
        )
    x, y, z, w = quaternion / length
    pose = translation(place)
    pose[:3, :3] = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return pose
