"""Records the inputs of a live run as forces and wall motions of a scene.

Every input starts at the time of a frame. A run of the recorded scene therefore takes the same
substeps.
"""

import itertools
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from phy124.boundaries.base import Movable
from phy124.boundaries.motion import Path
from phy124.forces import AnyForce, Grab, Gravity, WrenchForce
from phy124.mpm.tracks import Keyframes
from phy124.scene import Scene
from phy124.schema.region import Vector

ROUNDING = 1e-9
"""Times of frames may differ by rounding errors of at most this size [s]."""


@dataclass
class GrabRecord:
    """A grab with targets over time; each frame adds a target."""

    start: float
    """Start time [s]."""
    options: dict[str, Any]
    """Constant fields of `Grab`."""
    times: list[float]
    """Time of each target of the grab, counted from `start` [s]."""
    targets: list[Vector]
    end: float | None = None
    """Time of release [s]; None before the release."""

    def force(self, since: float) -> Grab:
        """Return the user's grab as a force; targets that no longer matter at `since` [s] are
        omitted.
        """
        first = _first(self.times, since - self.start)
        return Grab(
            start=self.start,
            end=self.end,
            times=tuple(self.times[first:]),
            targets=tuple(self.targets[first:]),
            **self.options,
        )


@dataclass
class WallPath:
    """Displacement of a wall; each frame in which the wall moves adds a point."""

    times: list[float] = field(default_factory=lambda: [0.0])
    points: list[Vector] = field(default_factory=lambda: [(0.0, 0.0, 0.0)])

    def approach(self, target: Vector, now: float, then: float, most: float) -> bool:
        """Move towards a displacement; return whether it will be reached.

        Args:
            target: The displacement [m].
            now: Start of the motion [s].
            then: End of the motion [s].
            most: Largest distance by which the wall moves [m].
        """
        here, there = np.array(self.points[-1]), np.array(target)
        step = there - here
        far = float(np.linalg.norm(step))
        if far > most:
            there = here + step * (most / far)
        if self.times[-1] < now:
            self.times.append(now)
            self.points.append(self.points[-1])
        self.times.append(then)
        x, y, z = there.tolist()
        self.points.append((x, y, z))
        return far <= most

    def path(self, since: float) -> Path:
        """Return the motion as a path; points that no longer matter at `since` [s] are omitted."""
        first = _first(self.times, since)
        times, points = tuple(self.times[first:]), tuple(self.points[first:])
        return Path(times=times, points=points, smooth=False)


class Inputs:
    """All inputs of a session, and the scene to which they are added."""

    def __init__(self, scene: Scene) -> None:
        self.base = scene
        self.grabs: list[GrabRecord] = []
        self.pushes: dict[int, WrenchForce] = {}
        """All pushes of the session, by number in the order in which they start."""
        self._acting: list[int] = []
        """Numbers of the pushes that may still act. A session may have many more pushes."""
        self._numbers = itertools.count()
        self.gravity: list[Gravity] = []
        self.moved: dict[int, WallPath] = {}
        self.softness: list[tuple[float, float]] = [(0.0, 1.0)]
        """Factors on Young's modulus, with the times [s] from which they act."""

    def soften(self, factor: float, now: float, before: float) -> None:
        """Set the factor on E from `now` on; the old factor acts until `before`."""
        kept = [key for key in self.softness if key[0] < now]
        if kept and kept[-1][0] < before:
            kept.append((before, kept[-1][1]))
        self.softness = [*kept, (now, factor)]

    @property
    def holding(self) -> GrabRecord | None:
        """The current grab, or None."""
        return next((held for held in self.grabs if held.end is None), None)

    def weigh(self, g: Vector, now: float) -> None:
        """Set the gravity [m/s^2] from `now` on."""
        if self.gravity and self.gravity[-1].start == now:
            self.gravity.pop()
        self.gravity.append(Gravity(g=g, start=now))

    def push(self, push: WrenchForce) -> int:
        """Add a push; return its number."""
        number = next(self._numbers)
        self.pushes[number] = push
        self._acting.append(number)
        return number

    def end_push(self, number: int | None, now: float) -> None:
        """End a push at `now` [s]; if the push has not begun, remove it."""
        if number is None or number not in self.pushes:
            return
        push = self.pushes[number]
        if push.start < now:
            self.pushes[number] = _end_by(push, now)
        else:
            del self.pushes[number]

    def count_acting(self, now: float, besides: int | None) -> int:
        """Return the number of pushes that act after `now` [s], except the push `besides`."""
        numbers = [number for number in self._acting if number in self.pushes]
        return sum(_acts_after(self.pushes[n], now) for n in numbers if n != besides)

    def _list_pushes(self, since: float) -> list[WrenchForce]:
        """Return the pushes that act after `since` [s]; a later call must not have an earlier time,
        except 0.
        """
        if since <= 0:
            return [*self.pushes.values()]
        numbers = [number for number in self._acting if number in self.pushes]
        self._acting = [n for n in numbers if _acts_after(self.pushes[n], since)]
        return [self.pushes[number] for number in self._acting]

    def scene(self, since: float = 0.0) -> Scene:
        """Return the scene with all inputs except inputs that ended before `since` [s]."""
        boundaries = list(self.base.boundaries)
        for index, moved in self.moved.items():
            wall, path = boundaries[index], moved.path(since)
            boundaries[index] = wall.model_copy(update={"motion": path})
        # A grab acts from its second target on. The next frame adds this target.
        grabs = [held for held in self.grabs if len(held.times) > 1 and _acts_after(held, since)]
        held_by = (held.force(since) for held in grabs)
        forces = (*self._weights(since), *self._list_pushes(since), *held_by)
        done = {"forces": forces, "boundaries": tuple(boundaries), **self._stiffness_profile(since)}
        return self.base.model_copy(update=done)

    def _stiffness_profile(self, since: float) -> dict[str, Keyframes]:
        if self.softness == [(0.0, 1.0)]:
            return {}
        first = max(sum(time <= since for time, _ in self.softness) - 1, 0)
        kept = self.softness[first:]
        # A profile needs at least two keys, so the last factor is repeated one second later.
        times, factors = zip(*kept, (kept[-1][0] + 1, kept[-1][1]), strict=True)
        return {"stiffness_profile": Keyframes(times=times, factors=factors)}

    def forget(self, since: float) -> None:
        """Remove inputs that start at `since` [s] or later; end inputs that act at `since`."""
        self.grabs = [held for held in self.grabs if held.start < since]
        for held in self.grabs:
            kept = sum(held.start + time <= since + ROUNDING for time in held.times)
            del held.times[max(kept, 2) :], held.targets[max(kept, 2) :]
            held.end = since if held.end is None else min(held.end, since)
        self.pushes = {
            number: _end_by(push, since)
            for number, push in self.pushes.items()
            if push.start < since
        }
        self._acting = [*self.pushes]
        self.gravity = [g for g in self.gravity if g.start < since or g.start == 0.0]
        self.softness = [key for key in self.softness if key[0] < since] or [(0.0, 1.0)]
        for moved in self.moved.values():
            kept = sum(time <= since + ROUNDING for time in moved.times)
            del moved.times[max(kept, 1) :], moved.points[max(kept, 1) :]
        self.moved = {i: moved for i, moved in self.moved.items() if len(moved.times) > 1}

    def _weights(self, since: float) -> list[AnyForce]:
        """Return the scene's forces and the gravity inputs.

        Each gravity input ends when the next gravity input begins.
        """
        if not self.gravity:
            return list(self.base.forces)
        first, forces = self.gravity[0].start, []
        for force in self.base.forces:
            if not isinstance(force, Gravity) or force.region is not None:
                forces.append(force)
            elif force.start < first:
                end = first if force.end is None else min(force.end, first)
                forces.append(force.model_copy(update={"end": end}))
        ends = [*(g.start for g in self.gravity[1:]), None]
        weights = zip(self.gravity, ends, strict=True)
        changed = [g.model_copy(update={"end": end}) for g, end in weights]
        return forces + [g for g in changed if _acts_after(g, since)]


def _first(times: list[float], since: float) -> int:
    """Return the index of the last time up to `since` [s], but leave at least two times."""
    return max(min(bisect_right(times, since + ROUNDING) - 1, len(times) - 2), 0)


def _end_by(push: WrenchForce, time: float) -> WrenchForce:
    return push.model_copy(update={"end": time if push.end is None else min(push.end, time)})


def _acts_after(item: GrabRecord | WrenchForce | Gravity, since: float) -> bool:
    return item.end is None or item.end > since


def is_movable(scene: Scene, index: int) -> bool:
    """Return whether the user can move a boundary of the scene during the run."""
    wall = scene.boundaries[index]
    return isinstance(wall, Movable) and wall.motion is None
