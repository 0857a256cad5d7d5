"""Live: one run that answers to inputs, frame by frame.

A run that stops because a frame is not sound says so, drops what was done to it, and goes on from
the last sound frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.forces import WrenchForce
from phy124.gaussians import Frame, Gaussians, Wrench
from phy124.io.clip import Clip
from phy124.live import places
from phy124.live.inputs import Held, Inputs, Moved, movable
from phy124.live.limits import (
    FASTEST,
    LIFTS,
    PUSHES,
    STANDARD_GRAVITY,
    STRONGEST,
    Limits,
    bounded,
    number,
    vector,
)
from phy124.properties.stiffness import SOFTEST, STIFFEST
from phy124.scene import Scene
from phy124.schema.region import Vector
from phy124.simulation import Simulation, Stopped
from phy124.simulation.appearance import Appearance

FOREVER = 1e8
"""A live run has no budget of time of its own [s]; what shows it has."""
KEPT_EVERY = 12
"""Frames between two states that are kept to go back to."""
LOST = 50.0
"""Distance from the middle of the scene [sizes] at which nobody holds it any more."""
NOTES = 20
"""Sentences that are kept."""


class Live:
    """A run that is pushed while it runs.

    Give inputs between two frames; they act from the next frame on. It is not safe to use from
    several threads: who gets inputs from elsewhere queues them.
    """

    def __init__(
        self, gaussians: Gaussians, scene: Scene, *, shapes: bool = True, **options: Any
    ) -> None:
        """Build the run; the first frame is the object at rest.

        Args:
            gaussians: The object at any size, standing upright, facing +x.
            scene: What happens to it without inputs; its accuracy is kept (`held_rate` chooses
                one that this machine runs in real time).
            shapes: Whether frames show where the Gaussians are; False saves their time for who
                binds them to `particles` elsewhere.
            **options: Those of `Simulation`, such as device and threads.

        Raises:
            InputError: The Gaussians or the scene cannot be used.
        """
        timing = scene.time.model_copy(update={"sleep": False, "budget": FOREVER})
        self._scene = scene.model_copy(update={"time": timing, "wrenches": True})
        self._gaussians, self._shapes, self._options = gaussians, shapes, options
        self.notes: list[str] = []
        """Sentences about inputs that were made smaller and about frames that failed."""
        self.reset()
        self.limits = Limits.of(self._run.particles, self._scene)

    def reset(self) -> None:
        """Begin anew, with nothing done to the object."""
        self._inputs = Inputs(self._scene)
        self._run = Simulation(
            self._gaussians, self._scene, keep=False, changes=True, shapes=self._shapes,
            **self._options,
        )  # fmt: skip
        self._target: Vector | None = None
        self._offsets: dict[int, Vector] = {}
        self._named: dict[str, WrenchForce] = {}
        self._changed = False
        self._kept: list[tuple[float, dict[str, Any]]] = []

    @property
    def time(self) -> float:
        """The simulated time that inputs act from [s]: that of the last frame."""
        return max(self._run.count - 1, 0) / self._scene.time.fps

    @property
    def count(self) -> int:
        """Number of frames of the session so far."""
        return self._run.count

    @property
    def particles(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions [P,3], m, and deformation gradients [P,3,3] of all particles now."""
        state = self._run.solver.state
        x, F = np.asarray(state.x.numpy()), np.asarray(state.deformation.numpy())
        return x.astype(np.float32), F.astype(np.float32)

    @property
    def centre(self) -> NDArray[np.float64]:
        """The object's centre of mass now [3], m."""
        x = np.asarray(self._run.solver.state.x.numpy(), dtype=np.float64)
        mass = self._run.particles.mass.astype(np.float64)
        return mass @ x / mass.sum()

    @property
    def holds(self) -> bool:
        """Whether something is held."""
        return self._inputs.holding is not None

    @property
    def scene(self) -> Scene:
        """What happens without inputs."""
        return self._scene

    @property
    def rest(self) -> NDArray[np.float64]:
        """Positions of all particles at rest [P,3], m."""
        return self._run.solver.model.rest

    @property
    def look(self) -> Appearance:
        """How the object is shown: its Gaussians at rest, and which of them move."""
        return self._run.look

    def frames(self, count: int) -> Iterator[Frame]:
        """So many frames, one after the other; inputs may be given between them."""
        for _ in range(count):
            yield self.step()

    def step(self) -> Frame:
        """The next frame; after one that is not sound, the last one that can be made again."""
        if self._run.count:
            self._lead()
        self._apply()
        try:
            frame = self._run.step()
        except Stopped as stop:
            frame = self._go_back(str(stop))
        if float(np.linalg.norm(self.centre)) > LOST * self._scene.object.size:
            self._note(f"It is more than {LOST:g} of its sizes away and begins anew.")
            self.reset()
            frame = self._run.step()
        self._frame = frame
        if self._run.count % KEPT_EVERY == 0:
            self._kept = [*self._kept[-1:], (self.time, self._run.snapshot())]
        return frame

    def grab(
        self,
        point: Sequence[float],
        *,
        object: str | None = None,
        radius: float | None = None,
        stiffness: float | None = None,
        strength: float | None = None,
    ) -> None:
        """Take hold of the object; what was held before is let go.

        Args:
            point: A place on or near the object as it is now [m].
            object: Name of the object that is held, of several; None: the one that is nearest.
            radius: Material so close to it is held [m], less firmly towards the rim.
            stiffness: Of the spring between hand and object [N/m].
            strength: Largest force [N].

        Raises:
            InputError: A number cannot be used, or no part of the object is there.
        """
        limits = self.limits
        place = vector("grab.point", point)
        radius = limits.radius if radius is None else radius
        radius = number("grab.radius", radius, 0.01 * limits.size, 2 * limits.size)
        stiffness = limits.stiffness if stiffness is None else stiffness
        stiffness = number("grab.stiffness", stiffness, 0, 1e4 * limits.stiffness)
        strength = LIFTS * limits.weight if strength is None else strength
        strength = number("grab.strength", strength, 0, STRONGEST * limits.weight)
        held = places.found(self._run, "grab.point", place, radius, object)
        self.release()
        options = {
            "point": held.rest, "object": held.object, "radius": radius,
            "stiffness": stiffness, "damping": limits.damping, "strength": strength,
        }  # fmt: skip
        self._inputs.grabs.append(Held(self.time, options, [0.0], [place]))
        self._target, self._changed = place, True

    def to(self, target: Sequence[float]) -> None:
        """Draw what is held to a place [m]; it gets there by the next frame, if it is free to.

        Raises:
            InputError: Nothing is held, or these are not three finite numbers.
        """
        if not self.holds:
            raise InputError("to", target, "nothing is held.", "Call grab first.")
        self._target = self._said(*self.limits.place("to", target))

    def release(self) -> None:
        """Let go of what is held."""
        held = self._inputs.holding
        if held is not None:
            self._inputs.grabs.remove(held)
            if held.start < self.time:
                held.end = self.time
                self._inputs.grabs.append(held)
            self._changed = True
        self._target = None

    def push(
        self,
        force: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        torque: Sequence[float] = (0.0, 0.0, 0.0),
        at: Sequence[float] | None = None,
        object: str | None = None,
        radius: float | None = None,
        seconds: float = 0.1,
        name: str = "",
    ) -> None:
        """Push the object for a while, and then no more.

        Args:
            force: [N]
            torque: About where it acts [N m].
            at: A place on the object as it is now [m]; None: on the whole of it.
            object: Name of the object, of several; None: that at this place, or all of them.
            radius: Material so close to it is pushed [m], less towards the rim.
            seconds: How long [s].
            name: It takes the place of the push of this name before it, which ends; empty: it
                acts beside all others.

        Raises:
            InputError: A number cannot be used, no part of the object is there, or too many pushes
                act already.
        """
        now, limits = self.time, self.limits
        before = self._named.get(name or "")
        acting = sum(one.end > now for one in self._inputs.wrenches if one.end and one != before)
        if acting >= PUSHES:
            limit = f"{acting} pushes act at this moment, the most there may be."
            raise InputError("push", len(self._inputs.wrenches), limit, "Wait for one to end.")
        seconds = number("push.seconds", seconds, 1e-3, 3600)
        radius = number(
            "push.radius", limits.radius if radius is None else radius,
            0.01 * limits.size, 2 * limits.size,
        )  # fmt: skip
        place = None if at is None else vector("push.at", at)
        point, of = None, places.checked(self._scene, "push.object", object)
        if place is not None:
            point, of = places.found(self._run, "push.at", place, radius, object)
        given = self._said(*limits.force("push.force", force))
        turn = self._said(*limits.torque("push.torque", torque))
        acts: dict[str, Any] = {"object": of, "start": now, "end": now + seconds}
        push = WrenchForce(force=given, torque=turn, point=point, radius=radius, **acts)
        self._inputs.end_push(before, now)
        self._inputs.wrenches.append(push)
        if name:
            self._named[name] = push
        self._changed = True

    def gravity(self, g: Sequence[float]) -> None:
        """Another gravity from now on [m/s^2], at most ten times that of the earth.

        Raises:
            InputError: These are not three finite numbers.
        """
        given = bounded("gravity", g, 10 * STANDARD_GRAVITY, "m/s^2")
        self._inputs.weigh(self._said(*given), self.time)
        self._changed = True

    def soften(self, factor: float) -> None:
        """Multiply the Young's modulus of the scene by a factor from now on, 0.01 to 100.

        Raises:
            InputError: It is no such number, or the scene has a stiffness that changes by itself.
        """
        if self._scene.stiffness_profile is not None:
            limit = "the scene's stiffness changes by itself."
            raise InputError("soften", factor, limit, "Leave stiffness_profile out.")
        given = number("soften", factor, SOFTEST, STIFFEST)
        before = max(self._run.count - 2, 0) / self._scene.time.fps
        self._inputs.soften(given, self.time, before)
        self._changed = True

    def move(self, wall: int, to: Sequence[float]) -> None:
        """Move a boundary of the scene to a displacement from where it began [m], at hand speed.

        Raises:
            InputError: There is no such boundary, it cannot move or moves by itself, or these are
                not three finite numbers.
        """
        walls = self._scene.boundaries
        if not (isinstance(wall, int) and 0 <= wall < len(walls)):
            kinds = ", ".join(f"{i}: {w.kind}" for i, w in enumerate(walls)) or "it has none"
            raise InputError("move.wall", wall, "the scene has no such boundary.", f"({kinds})")
        if not movable(self._scene, wall):
            why = f"the {walls[wall].kind} of this scene cannot be moved by hand."
            raise InputError("move.wall", wall, why, "Choose a boundary that has no motion yet.")
        self._offsets[wall] = self._said(*self.limits.place("move.to", to))

    def contacts(self) -> dict[str, Wrench]:
        """Mean force [N] and torque [N m] over the last frame on each wall and in each pair."""
        return dict(self._frame.wrenches or {})

    @property
    def pairs(self) -> dict[str, str]:
        """Names of wrenches between objects (`duck_on_cushion`), each with what it acts on."""
        return places.pairs(self._run)

    @property
    def centres(self) -> dict[str, NDArray[np.float64]]:
        """The centre of mass of each object now [3], m, by its name."""
        return places.centres(self._run)

    def session(self) -> Scene:
        """The scene that does what was done, for as long as it has lasted."""
        frames = max(self._run.count, 1)
        scene = self._inputs.scene()
        return scene.model_copy(update={"time": scene.time.model_copy(update={"frames": frames})})

    def clip(self) -> Clip:
        """The session as a clip, simulated again: the frames are the same, bit for bit."""
        return Simulation(self._gaussians, self.session(), **self._options).run()

    def _lead(self) -> None:
        """Targets and displacements for the frame to come."""
        next_time = self._run.count / self._scene.time.fps
        held = self._inputs.holding
        if held is not None and self._target is not None:
            held.times.append(next_time - held.start)
            held.targets.append(self._target)
            self._changed = True
        for wall, offset in list(self._offsets.items()):
            self._move_on(wall, offset, next_time)

    def _move_on(self, wall: int, offset: Vector, next_time: float) -> None:
        """A boundary's way in the frame to come: towards its offset, at most at hand speed."""
        moved = self._inputs.moved.setdefault(wall, Moved())
        here, there = np.array(moved.points[-1]), np.array(offset)
        step, most = there - here, FASTEST * self.limits.size / self._scene.time.fps
        far = float(np.linalg.norm(step))
        if far > most:
            there = here + step * (most / far)
        else:
            del self._offsets[wall]
        if moved.times[-1] < self.time:
            moved.times.append(self.time)
            moved.points.append(moved.points[-1])
        moved.times.append(next_time)
        x, y, z = there.tolist()
        moved.points.append((x, y, z))
        self._changed = True

    def _apply(self) -> None:
        """Let the run go on under what has been done since."""
        if self._changed:
            # The first kick of a frame also looks back, half a substep.
            self._run.change(self._inputs.scene(self.time - 1 / self._scene.time.fps))
            self._changed = False

    def _go_back(self, why: str) -> Frame:
        """Drop the inputs and try again from where it was, then from earlier, then anew."""
        self._note(f"{why} What was done to the object is dropped.")
        for time, snapshot in [(self.time, None), *reversed(self._kept)]:
            if snapshot is not None:
                self._run.restore(snapshot)
            self._drop(time)
            try:
                return self._run.step()
            except Stopped:
                continue
        self._note("No earlier state could be continued either: it begins anew.")
        self.reset()
        return self._run.step()

    def _drop(self, time: float) -> None:
        """Take back the inputs from a time on."""
        self._inputs.forget(time)
        self._target, self._offsets = None, {}
        self._run.change(self._inputs.scene())

    def _said(self, value: Vector, said: str) -> Vector:
        """The value; the sentence is kept."""
        if said:
            self._note(said)
        return value

    def _note(self, sentence: str) -> None:
        if self.notes[-1:] != [sentence]:
            self.notes = [*self.notes, sentence][-NOTES:]
