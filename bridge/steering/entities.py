"""Objects of a steered run as entities of simulation_interfaces (1.x and 2.x).

An entity's pose is its centre of mass and the rotation that best fits the motion of its particles.
Requests to spawn or delete objects are refused by result codes.
"""

from __future__ import annotations

import re
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from phy124.errors import InputError

from .. import cdr
from ..options import Options

if TYPE_CHECKING:
    from phy124.live.places import Motion

    from .run import SteeredRun


class Code(IntEnum):
    """Codes of `simulation_interfaces/msg/Result` and of SetSimulationState."""

    FEATURE_UNSUPPORTED = 0
    OK = 1
    NOT_FOUND = 2
    OPERATION_FAILED = 4
    ALREADY_IN_TARGET_STATE = 101


INVALID_POSE = 101
"""Additional result code of SetEntityState."""
DYNAMIC, STATIC = 4, 5
"""Categories of `simulation_interfaces/msg/EntityCategory`: moving objects, held objects."""
EMPTY, BOX, SPHERE = 0, 1, 3
"""Supported types of `simulation_interfaces/msg/Bounds`."""
FARTHEST = 5.0
"""Largest distance of a new position from the middle of the scene [object sizes]."""
FIXED = "The objects of a run are fixed; {} of entities is not supported. Start `live` with --more."


class Entities:
    """Services that list, describe and move the entities (objects and props)."""

    def __init__(self, run: SteeredRun, options: Options) -> None:
        self._run, self._options = run, options

    def list(self, request: Any) -> dict[str, Any]:
        """List the names of the entities that pass the filters (GetEntities)."""
        filters = request.filters
        try:
            pattern = re.compile(filters.filter)
        except (re.error, OverflowError, RecursionError) as error:
            return {"result": result(Code.OPERATION_FAILED, f"filter: {error}")}
        if filters.tags.tags:
            return {"result": result(Code.FEATURE_UNSUPPORTED, "Entities have no tags.")}
        if filters.bounds.type not in (EMPTY, BOX, SPHERE):
            said = "Bounds must be a sphere or a box."
            return {"result": result(Code.FEATURE_UNSUPPORTED, said)}
        wanted = {each.category for each in filters.categories}
        names = [
            name
            for name in self._motions
            if pattern.search(name) and (not wanted or self._category(name) in wanted)
        ]
        try:
            overlapping = self._overlapping(filters.bounds)
        except ValueError:
            return {"result": result(Code.OPERATION_FAILED, "Bounds need two points.")}
        return {
            "result": result(Code.OK),
            "entities": [name for name in names if overlapping is None or name in overlapping],
        }

    def info(self, request: Any) -> dict[str, Any]:
        """Describe an entity (GetEntityInfo)."""
        name = request.entity
        if name not in self._motions:
            return {"result": self._unknown(name)}
        scene, item = self._run.live.scene, self._item(name)
        solid = getattr(item, "scenery", False)
        material = "rigid" if solid else (scene if item is scene.object else item).material.law
        return {
            "result": result(Code.OK),
            "info": {
                "category": {"category": self._category(name)},
                "description": f"{material} object of {item.size:g} m",
            },
        }

    def state(self, request: Any) -> dict[str, Any]:
        """Return the pose and twist of an entity in the run's coordinate frame (GetEntityState)."""
        motion = self._motions.get(request.entity)
        if motion is None:
            return {"result": self._unknown(request.entity)}
        stamp = cdr.stamp(self._run.epoch, self._run.position)
        header = {"stamp": cdr.time(stamp), "frame_id": self._options.frame_id}
        w, x, y, z = motion.quat.tolist()
        pose = {
            "position": _xyz(motion.place),
            "orientation": {"x": x, "y": y, "z": z, "w": w},
        }
        twist = {"linear": _xyz(motion.velocity), "angular": _xyz(motion.spin)}
        return {
            "result": result(Code.OK),
            "state": {"header": header, "pose": pose, "twist": twist},
        }

    def set_state(self, request: Any) -> dict[str, Any]:
        """Move an entity as a rigid body (SetEntityState); requests of version 1.x set pose and
        twist.
        """
        name, state = request.entity, request.state
        before = self._motions.get(name)
        if before is None:
            return {"result": self._unknown(name)}
        if getattr(request, "set_acceleration", False):
            said = "Accelerations follow from forces; use ~/push."
            return {"result": result(Code.FEATURE_UNSUPPORTED, said)}
        sets_pose = getattr(request, "set_pose", True)
        sets_twist = getattr(request, "set_twist", True)
        try:
            motion = self._asked_motion(before, state, pose=sets_pose, twist=sets_twist)
        except InputError as error:
            return {"result": result(INVALID_POSE, str(error))}
        try:
            self._run.live.set_motion(name, motion, twist=sets_twist)
        except InputError as error:
            return {"result": result(Code.OPERATION_FAILED, str(error))}
        return {"result": result(Code.OK)}

    def spawn(self, request: Any) -> dict[str, Any]:
        """Refuse to add an entity (SpawnEntity)."""
        del request
        return {"result": result(Code.FEATURE_UNSUPPORTED, FIXED.format("spawning"))}

    def delete(self, request: Any) -> dict[str, Any]:
        """Refuse to remove an entity (DeleteEntity)."""
        if request.entity not in self._motions:
            return {"result": self._unknown(request.entity)}
        return {"result": result(Code.FEATURE_UNSUPPORTED, FIXED.format("deleting"))}

    @property
    def _motions(self) -> dict[str, Motion]:
        return self._run.live.motions

    def _item(self, name: str) -> Any:
        scene = self._run.live.scene
        return scene.every_object[scene.names.index(name)]

    def _category(self, name: str) -> int:
        item = self._item(name)
        fixed = item.held or (getattr(item, "scenery", False) and not item.free)
        return STATIC if fixed else DYNAMIC

    def _unknown(self, name: str) -> dict[str, Any]:
        return result(Code.NOT_FOUND, f"There is no {name!r}, only {', '.join(self._motions)}.")

    def _overlapping(self, bounds: Any) -> set[str] | None:
        """Return the names of the entities that overlap the bounds; None if these are empty."""
        if bounds.type == EMPTY:
            return None
        first, second = (np.array([p.x, p.y, p.z]) for p in bounds.points[:2])
        overlapping = set()
        for name, x in self._run.live.points.items():
            if bounds.type == SPHERE:
                inside = np.linalg.norm(x - first, axis=1) <= second[0]
            else:
                low, high = np.minimum(first, second), np.maximum(first, second)
                inside = ((x >= low) & (x <= high)).all(1)
            if inside.any():
                overlapping.add(name)
        return overlapping

    def _asked_motion(self, before: Motion, state: Any, *, pose: bool, twist: bool) -> Motion:
        frame = state.header.frame_id
        base = np.eye(4) if not frame else self._run.inputs.pose(frame)
        motion = before
        if pose:
            q, t = state.pose.orientation, state.pose.position
            quat, place = np.array([q.x, q.y, q.z, q.w]), np.array([t.x, t.y, t.z])
            size = self._run.live.limits.size
            if not (np.isfinite(place).all() and 0.5 < np.linalg.norm(quat) < 2):
                limit = "it must be a unit quaternion and three finite numbers."
                raise InputError("state.pose", place.tolist(), limit, "Correct the pose.")
            place = base[:3, :3] @ place + base[:3, 3]
            if np.linalg.norm(place) > FARTHEST * size:
                limit = f"it is more than {FARTHEST:g} times the object's size away."
                raise InputError("state.pose", place.tolist(), limit, "Choose a nearer position.")
            rotation = Rotation.from_matrix(base[:3, :3]) * Rotation.from_quat(quat)
            motion = motion._replace(place=place, quat=rotation.as_quat()[[3, 0, 1, 2]])
        if twist:
            parts = [np.array([v.x, v.y, v.z]) for v in (state.twist.linear, state.twist.angular)]
            if not np.isfinite(parts).all():
                raise InputError("state.twist", str(parts), "it is not finite.", "Correct it.")
            linear, angular = (base[:3, :3] @ part for part in parts)
            motion = motion._replace(velocity=linear, spin=angular)
        return motion


def result(code: int, said: str = "") -> dict[str, Any]:
    """Return a `simulation_interfaces/msg/Result`."""
    return {"result": int(code), "error_message": said}


def _xyz(values: Any) -> dict[str, float]:
    return dict(zip("xyz", map(float, values), strict=True))
