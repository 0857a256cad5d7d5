"""Runs a scene frame by frame while inputs act on it.

A frame fails if the watchdog rejects the frame or if the frame needs too many substeps. The run
then drops the inputs and continues from an earlier valid state. The run ends only if a frame fails
although no input has acted since the start.
"""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.budget.cost import longest_substeps
from phy124.errors import InputError
from phy124.forces import WrenchForce
from phy124.gaussians import Frame, Gaussians, Wrench
from phy124.imaging.painted import WHOLE, Crop
from phy124.io.clip import Clip
from phy124.live import places
from phy124.live.inputs import GrabRecord, Inputs, WallPath, is_movable
from phy124.live.limits import (
    FASTEST,
    PUSHES,
    STANDARD_GRAVITY,
    STRONGEST,
    Limits,
    check_number,
    check_vector,
    shorten,
)
from phy124.monitor.wrenches import Wrenches
from phy124.properties.stiffness import SOFTEST, STIFFEST
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.scene.lattices import keep_lattice
from phy124.scene.liquids import keep_solver
from phy124.schema.region import Vector
from phy124.simulation import Setup, Simulation, Stopped, prepare
from phy124.simulation.appearance import Appearance

FOREVER = 1e8
"""Time budget of a live run [s]; practically unlimited."""
KEPT_EVERY = 12
"""Number of frames between two stored states."""
LOST = 50.0
"""The run restarts if the distance between the object and the middle of the scene exceeds this
value [object sizes].
"""
NOTES = 20
"""Largest number of stored notes."""
SLOWEST = 30
"""Largest number of substeps of a frame, as a multiple of the number that the object needs at rest.
For example, the gravity of a duck is multiplied by ten, and its stiffness is divided by 100. The
duck then needs 23 times as many substeps as at rest.
"""


class Live:
    """A run that accepts inputs during the computation.

    Call the input methods between two frames. Inputs act from the next frame on. The class is not
    thread-safe, so inputs from other threads must be passed through a queue.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        scene: Scene,
        context: RunContext | None = None,
        *,
        shapes: bool = True,
        crop: Crop = WHOLE,
    ) -> None:
        """Prepare the run; the first frame is the object at rest.

        Args:
            gaussians: The object, of any size, upright and facing +x.
            scene: The scene without inputs, with its accuracy (`held_rate` chooses an accuracy that
                this machine can run in real time).
            context: Device, number of threads, progress function and timer.
            shapes: Whether frames contain the shapes of the Gaussians. Frames without shapes take
                less time. Such frames suffice for programs that bind Gaussians to `particles`
                themselves.
            crop: Position of the object in the picture on which the masks of parts were painted.

        Raises:
            InputError: The Gaussians or the scene cannot be used.
        """
        timing = scene.time.model_copy(update={"sleep": False, "budget": FOREVER})
        self._scene = scene.model_copy(update={"time": timing, "wrenches": True})
        self._gaussians, self._shapes, self._crop = gaussians, shapes, crop
        self._context = context or RunContext()
        self.notes: list[str] = []
        """The latest messages for the user about reduced inputs and failed frames."""
        self.notes_made = 0
        """Number of all notes so far, including those that are not stored."""
        self.reset()
        self.limits = Limits.of(self._run.setup.particles, self._scene)

    def reset(self) -> None:
        """Restart the run without inputs."""
        self._inputs = Inputs(self._scene)
        options: dict[str, Any] = {"keep": False, "changes": True, "shapes": self._shapes}
        self._run = Simulation(self._prepare(self._scene, **options))
        self._target: Vector | None = None
        self._offsets: dict[int, Vector] = {}
        self._named: dict[str, int] = {}
        self._changed = False
        self._touched = False
        """Whether an input has acted since the start."""
        self._kept: list[tuple[float, dict[str, Any]]] = []
        self._wrenches: dict[str, Wrench] = {}
        self._limit_substeps()

    @property
    def time(self) -> float:
        """Simulated time of the last frame [s], from which new inputs act."""
        return max(self._run.count - 1, 0) / self._scene.time.fps

    @property
    def count(self) -> int:
        """Number of frames computed so far."""
        return self._run.count

    @property
    def particles(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Positions [P,3], m, and deformation gradients [P,3,3] of all particles."""
        state = self._run.solver.state
        x, F = np.asarray(state.x.numpy()), np.asarray(state.deformation.numpy())
        return x.astype(np.float32), F.astype(np.float32)

    @property
    def centre(self) -> NDArray[np.float64]:
        """Centre of mass of the object [3], m."""
        x = np.asarray(self._run.solver.state.x.numpy(), dtype=np.float64)
        mass = self._run.setup.particles.mass.astype(np.float64)
        return mass @ x / mass.sum()

    @property
    def holds(self) -> bool:
        """Whether a grab holds the object."""
        return self._inputs.holding is not None

    @property
    def scene(self) -> Scene:
        """The scene without inputs."""
        return self._scene

    @property
    def softens(self) -> bool:
        """Whether `soften` can change the stiffness of a material of the scene."""
        varies = any(section.scaled for section in self._run.setup.materials)
        return varies and (self._scene.projects or not self._scene.couples)

    @property
    def rest(self) -> NDArray[np.float64]:
        """Positions of all particles at rest [P,3], m."""
        return self._run.solver.model.rest

    @property
    def bodies(self) -> dict[str, NDArray[np.float64]]:
        """Positions of each body's particles at rest [P,3], m, by name."""
        model = self._run.solver.model
        return {name: model.rest_of(name) for name in model.names} or {"": model.rest}

    @property
    def look(self) -> Appearance:
        """Gaussians of the object at rest, and a mask of the Gaussians that move."""
        return self._run.setup.appearance

    def frames(self, count: int) -> Iterator[Frame]:
        """Yield `count` frames; the input methods may be called between them."""
        for _ in range(count):
            yield self.step()

    def step(self) -> Frame:
        """Compute the next frame; if it is not valid, continue from the last valid state.

        Raises:
            Stopped: A frame failed although no input has acted since the start.
        """
        if self._run.count:
            self._lead()
        self._apply()
        try:
            frame = self._run.step()
        except Stopped as stop:
            frame = self._go_back(str(stop))
        if float(np.linalg.norm(self.centre)) > LOST * self._scene.object.size:
            self._note(
                f"The object is more than {LOST:g} times its size away, so the run starts again."
            )
            self.reset()
            frame = self._run.step()
        self._wrenches = frame.wrenches or {}
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
        """Grab the object, and release any earlier grab.

        Args:
            point: Position on or near the object in its current state [m].
            object: Name of the object, if there are several; None: the nearest object.
            radius: Radius of the pulled material [m]; the force decreases towards the rim.
            stiffness: Stiffness of the spring between hand and object [N/m].
            strength: Largest force [N]; None: three times the weight, or less on soft material.

        Raises:
            InputError: A number cannot be used, or no part of the object is near `point`.
        """
        limits = self.limits
        place = check_vector("grab.point", point)
        radius = limits.check_radius("grab.radius", radius)
        stiffness = limits.stiffness if stiffness is None else stiffness
        stiffness = check_number("grab.stiffness", stiffness, 0, 1e4 * limits.stiffness)
        held = places.find_material(self._run, "grab.point", place, radius, object)
        softened = held.modulus * self._inputs.softness[-1][1]
        strength = limits.strength(softened, radius) if strength is None else strength
        strength = check_number("grab.strength", strength, 0, STRONGEST * limits.weight)
        self.release()
        options = {
            "point": held.rest,
            "object": held.object,
            "radius": radius,
            "stiffness": stiffness,
            "damping": limits.damping,
            "strength": strength,
        }
        self._inputs.grabs.append(GrabRecord(self.time, options, [0.0], [place]))
        self._target, self._changed = place, True

    def move_to(self, target: Sequence[float]) -> None:
        """Set the target position [m] of the grab; the hand reaches the target by the next frame.

        Raises:
            InputError: No object is held, or the position is not three finite numbers.
        """
        if not self.holds:
            raise InputError("move_to", target, "nothing is held.", "Call grab first.")
        self._target = self._note_change(*self.limits.place("move_to", target))

    def release(self) -> None:
        """Release the object."""
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
        """Push the object for a number of seconds.

        Args:
            force: Force [N].
            torque: Torque about `at` [N m].
            at: Position on the moving object [m]; None: the push acts on the whole object.
            object: Name of the object. If None, the push acts on the object at the position `at`.
                If `at` is also None, the push acts on all objects.
            radius: Radius of the pushed material [m]; the force decreases towards the rim.
            seconds: Duration [s].
            name: Name of the push; the new push replaces an earlier push of this name. An unnamed
                push is added to all other pushes.

        Raises:
            InputError: A number cannot be used, no part of the object is near `at`, or the largest
                number of pushes is already acting.
        """
        now, limits = self.time, self.limits
        before = self._named.get(name)
        acting = self._inputs.count_acting(now, before)
        if acting >= PUSHES:
            limit = f"{acting} pushes act at this moment, which is the maximum."
            raise InputError("push", acting + 1, limit, "Wait until a push ends.")
        seconds = check_number("push.seconds", seconds, 1e-3, 3600)
        radius = limits.check_radius("push.radius", radius)
        place = None if at is None else check_vector("push.at", at)
        point, of = None, places.check_object(self._scene, "push.object", object)
        if place is not None:
            point, of, _ = places.find_material(self._run, "push.at", place, radius, object)
        push = WrenchForce(
            force=self._note_change(*limits.force("push.force", force)),
            torque=self._note_change(*limits.torque("push.torque", torque)),
            point=point,
            radius=radius,
            object=of,
            start=now,
            end=now + seconds,
        )
        self._inputs.end_push(before, now)
        number = self._inputs.push(push)
        if name:
            self._named[name] = number
        self._changed = True

    def gravity(self, g: Sequence[float]) -> None:
        """Set gravity [m/s^2]; its magnitude is limited to ten times the earth's gravity.

        Raises:
            InputError: The value is not three finite numbers.
        """
        shortened = shorten("gravity", g, 10 * STANDARD_GRAVITY, "m/s^2")
        self._inputs.weigh(self._note_change(*shortened), self.time)
        self._changed = True

    def soften(self, factor: float) -> None:
        """Set the factor (0.01 to 100) on the scene's Young's modulus, instead of earlier factors.

        Raises:
            InputError: The factor is out of bounds, the scene has a stiffness profile, or the
                stiffness of its materials cannot be changed.
        """
        if not self.softens:
            limit = "the stiffness of the scene's materials cannot be changed during a run."
            raise InputError(
                "soften", factor, limit, "Use an elastic material, such as neo_hookean."
            )
        if self._scene.stiffness_profile is not None:
            limit = "the scene has a stiffness profile."
            raise InputError("soften", factor, limit, "Remove stiffness_profile.")
        factor = check_number("soften", factor, SOFTEST, STIFFEST)
        before = max(self._run.count - 2, 0) / self._scene.time.fps
        self._inputs.soften(factor, self.time, before)
        self._changed = True

    def move(self, wall: int, to: Sequence[float]) -> None:
        """Displace a boundary by `to` [m] from its initial position, no faster than a hand moves.

        Raises:
            InputError: There is no such boundary, the boundary cannot be moved or follows a motion
                of the scene, or the value is not three finite numbers.
        """
        walls = self._scene.boundaries
        if type(wall) is not int or not 0 <= wall < len(walls):
            kinds = ", ".join(f"{i} ({w.kind})" for i, w in enumerate(walls))
            remedy = f"Give the number of a boundary: {kinds}." if walls else "It has no boundary."
            raise InputError("move.wall", wall, "the scene has no such boundary.", remedy)
        if not is_movable(self._scene, wall):
            why = f"the {walls[wall].kind} of this scene cannot be moved by hand."
            raise InputError("move.wall", wall, why, "Choose a boundary that has no motion.")
        self._offsets[wall] = self._note_change(*self.limits.place("move.to", to))

    def contacts(self) -> dict[str, Wrench]:
        """Return the mean wrenches on walls and between bodies since the last frame [N, N m].

        The dictionary is empty before the first frame.
        """
        return dict(self._wrenches)

    @property
    def contact_names(self) -> tuple[str, ...]:
        """Names of all wrenches of `contacts`, known before the first frame."""
        wrenches = self._run.find(Wrenches)
        return () if wrenches is None else wrenches.names

    @property
    def pairs(self) -> dict[str, str]:
        """The object on which each contact force acts, by the name of the force
        (`duck_on_cushion`).
        """
        return places.list_pairs(self._run)

    @property
    def centres(self) -> dict[str, NDArray[np.float64]]:
        """Centre of mass [3], m, of each object by name."""
        return places.compute_centres(self._run)

    @property
    def points(self) -> dict[str, NDArray[np.float64]]:
        """Positions of each object's particles [P,3], m, or the centre of a rigid object."""
        return places.list_points(self._run)

    @property
    def motions(self) -> dict[str, places.Motion]:
        """Pose and velocity of each object by name."""
        return places.list_motions(self._run)

    def set_motion(self, name: str, motion: places.Motion, *, twist: bool = True) -> None:
        """Move an object immediately, as a rigid body; `session` does not repeat this move.

        Args:
            name: Name of the object.
            motion: New position and orientation, and new velocities.
            twist: Whether to set the velocities; if not, the current velocities are rotated with
                the object.

        Raises:
            InputError: There is no such object, it never moves, or it has no particles.
        """
        places.set_motion(self._run, name, motion, twist=twist)
        self._touched = True
        self._note(f"{name} was moved immediately; the session does not repeat this move.")

    def session(self) -> Scene:
        """Return the scene with all inputs, the run's solvers and its number of frames."""
        frames, before = max(self._run.count, 1), self._run.setup
        scene = keep_lattice(self._inputs.scene(), before.scene)
        if scene.projects != before.scene.projects:
            scene = keep_solver(scene, before.scene)
        return scene.model_copy(update={"time": scene.time.model_copy(update={"frames": frames})})

    def clip(self) -> Clip:
        """Simulate the session again and return the clip, which equals the live run bit for bit."""
        return Simulation(self._prepare(self.session())).run()

    def _prepare(self, scene: Scene, **options: Any) -> Setup:
        return prepare(self._gaussians, scene, self._context, crop=self._crop, **options)

    def _lead(self) -> None:
        """Record the hand's target and the wall displacements for the next frame."""
        next_time = self._run.count / self._scene.time.fps
        held = self._inputs.holding
        if held is not None and self._target is not None:
            held.times.append(next_time - held.start)
            held.targets.append(self._target)
            self._changed = True
        most = FASTEST * self.limits.size / self._scene.time.fps
        for wall, offset in list(self._offsets.items()):
            moved = self._inputs.moved.setdefault(wall, WallPath())
            if moved.approach(offset, self.time, next_time, most):
                del self._offsets[wall]
            self._changed = True

    def _apply(self) -> None:
        if self._changed:
            # The first kick of a frame also covers the half substep before the frame starts.
            self._run.change(self._inputs.scene(self.time - 1 / self._scene.time.fps))
            self._limit_substeps()
            self._changed, self._touched = False, True

    def _limit_substeps(self) -> None:
        """Limit the number of substeps of a frame, so that a frame does not take many seconds."""
        timing = self._scene.time.model_copy(update={"frames": max(self._scene.time.frames, 2)})
        resting = longest_substeps(self._scene.model_copy(update={"time": timing})).min()
        stiffer = math.sqrt(max(self._inputs.softness[-1][1], 1.0))
        usual = max(1.0, stiffer / (timing.fps * float(resting)))
        self._run.most_substeps = math.ceil(SLOWEST * usual)

    def _go_back(self, why: str) -> Frame:
        """Drop the inputs, and continue from the last valid state from which the run succeeds.

        Raises:
            Stopped: No input has acted since the start.
        """
        if not self._touched:
            raise Stopped(f"{why} The frame fails even without inputs, so the live run ends.")
        self._note(f"{why} The inputs are dropped.")
        for time, snapshot in [(self.time, None), *reversed(self._kept)]:
            if snapshot is not None:
                # If the run fails again, it continues from an even earlier state.
                self._kept.pop()
                self._run.restore(snapshot)
            self._drop(time)
            try:
                return self._run.step()
            except Stopped:
                continue
        self._note("The run also failed from each earlier state, so it starts again.")
        self.reset()
        return self._run.step()

    def _drop(self, time: float) -> None:
        self._inputs.forget(time)
        self._target, self._offsets = None, {}
        self._run.change(self._inputs.scene())

    def _note_change(self, value: Vector, sentence: str) -> Vector:
        """Return the value; add the sentence to the notes unless the sentence is empty."""
        if sentence:
            self._note(sentence)
        return value

    def _note(self, sentence: str) -> None:
        if self.notes[-1:] != [sentence]:
            self.notes = [*self.notes, sentence][-NOTES:]
            self.notes_made += 1
