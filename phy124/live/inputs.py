"""Inputs: what hands did to a live run, as forces and motions of a scene that grow with time.

All times are those of frames, so that a run of the finished scene takes the same substeps.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field
from typing import Any

from phy124.boundaries.base import Movable
from phy124.boundaries.motion import Path
from phy124.forces import AnyForce, Grab, Gravity, WrenchForce
from phy124.mpm.tracks import Keyframes
from phy124.scene import Scene
from phy124.schema.region import Vector


@dataclass
class Held:
    """A grab, of which each frame adds a target."""

    start: float
    """When it began [s]."""
    options: dict[str, Any]
    """Fields of `Grab` that stay."""
    times: list[float]
    """Since the start [s]."""
    targets: list[Vector]
    end: float | None = None
    """When it let go [s]; None: it still holds."""

    def force(self, since: float) -> Grab:
        """As a force of a scene, without the way of its target before a time [s]."""
        before = bisect_right(self.times, since - self.start) - 1
        first = max(min(before, len(self.times) - 2), 0)
        found = {"start": self.start, "end": self.end, **self.options}
        return Grab(times=tuple(self.times[first:]), targets=tuple(self.targets[first:]), **found)


@dataclass
class Moved:
    """A boundary's displacement, to which each frame in which it moves adds a point."""

    times: list[float] = field(default_factory=lambda: [0.0])
    points: list[Vector] = field(default_factory=lambda: [(0.0, 0.0, 0.0)])


class Inputs:
    """What was done so far, on top of a scene."""

    def __init__(self, scene: Scene) -> None:
        self.base = scene
        self.grabs: list[Held] = []
        self.wrenches: list[WrenchForce] = []
        self.gravity: list[Gravity] = []
        self.moved: dict[int, Moved] = {}
        self.softness: list[tuple[float, float]] = [(0.0, 1.0)]
        """Times [s] and the factors on Young's modulus at them."""

    def soften(self, factor: float, now: float, before: float) -> None:
        """Another factor on Young's modulus from now on; the frame before had the old one."""
        kept = [key for key in self.softness if key[0] < now]
        if kept and kept[-1][0] < before:
            kept.append((before, kept[-1][1]))
        self.softness = [*kept, (now, factor)]

    @property
    def holding(self) -> Held | None:
        """The grab that holds, if any."""
        return next((held for held in self.grabs if held.end is None), None)

    def weigh(self, g: Vector, now: float) -> None:
        """Another gravity from now on [m/s^2]."""
        if self.gravity and self.gravity[-1].start == now:
            self.gravity.pop()
        self.gravity.append(Gravity(g=g, start=now))

    def end_push(self, before: WrenchForce | None, now: float) -> None:
        """Let a push act no longer from now on [s]; if it has not begun, it never was."""
        if before in self.wrenches:
            index = self.wrenches.index(before)
            self.wrenches[index : index + 1] = _ended(before, now)

    def scene(self, since: float = 0.0) -> Scene:
        """The scene with everything that was done to it, without what was over by then [s]."""
        boundaries = list(self.base.boundaries)
        for index, moved in self.moved.items():
            path = Path(times=tuple(moved.times), points=tuple(moved.points), smooth=False)
            boundaries[index] = boundaries[index].model_copy(update={"motion": path})
        grabs = [held.force(since) for held in self.grabs if _lasts(held, since)]
        pushes = [push for push in self.wrenches if _lasts(push, since)]
        forces = (*self._weights(since), *pushes, *grabs)
        done = {"forces": forces, "boundaries": tuple(boundaries), **self._softened(since)}
        return self.base.model_copy(update=done)

    def _softened(self, since: float) -> dict[str, Keyframes]:
        """The factors on Young's modulus, if any has changed."""
        if self.softness == [(0.0, 1.0)]:
            return {}
        first = max(sum(time <= since for time, _ in self.softness) - 1, 0)
        kept = self.softness[first:]
        # A profile has two keys or more; after the last it stays.
        times, factors = zip(*kept, (kept[-1][0] + 1, kept[-1][1]), strict=True)
        return {"stiffness_profile": Keyframes(times=times, factors=factors)}

    def forget(self, since: float) -> None:
        """Take back all that was done from a time on [s]; what acts then ends there."""
        self.grabs = [held for held in self.grabs if held.start < since]
        for held in self.grabs:
            kept = sum(held.start + time <= since + 1e-9 for time in held.times)
            del held.times[max(kept, 2) :], held.targets[max(kept, 2) :]
            held.end = since if held.end is None else min(held.end, since)
        self.wrenches = [
            wrench.model_copy(update={"end": min(wrench.end or since, since)})
            for wrench in self.wrenches
            if wrench.start < since
        ]
        self.gravity = [one for one in self.gravity if one.start < since or one.start == 0.0]
        self.softness = [key for key in self.softness if key[0] < since] or [(0.0, 1.0)]
        for moved in self.moved.values():
            kept = sum(time <= since + 1e-9 for time in moved.times)
            del moved.times[max(kept, 1) :], moved.points[max(kept, 1) :]
        self.moved = {i: moved for i, moved in self.moved.items() if len(moved.times) > 1}

    def _weights(self, since: float) -> list[AnyForce]:
        """The forces of the scene; its gravity ends where another one begins."""
        if not self.gravity:
            return list(self.base.forces)
        first, found = self.gravity[0].start, []
        for force in self.base.forces:
            if not isinstance(force, Gravity) or force.region is not None:
                found.append(force)
            elif force.start < first:
                end = first if force.end is None else min(force.end, first)
                found.append(force.model_copy(update={"end": end}))
        ends = [*(one.start for one in self.gravity[1:]), None]
        weights = zip(self.gravity, ends, strict=True)
        changed = [one.model_copy(update={"end": end}) for one, end in weights]
        return found + [one for one in changed if _lasts(one, since)]


def _lasts(one: Held | WrenchForce | Gravity, since: float) -> bool:
    """Whether something acts after a time [s]."""
    return one.end is None or one.end > since


def _ended(push: WrenchForce, now: float) -> list[WrenchForce]:
    """The part of a push before a time [s], if any."""
    if push.start >= now:
        return []
    end = now if push.end is None else min(push.end, now)
    return [push.model_copy(update={"end": end})]


def movable(scene: Scene, index: int) -> bool:
    """Whether a boundary of the scene can be moved by hand."""
    wall = scene.boundaries[index]
    return isinstance(wall, Movable) and wall.motion is None
