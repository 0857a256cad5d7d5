"""A run: particles and a solver made of Gaussians and a scene, advanced from frame to frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.budget.limits import check_limits
from phy124.budget.remedies import find_remedies, find_speedups
from phy124.errors import Cancelled, Remedy
from phy124.gaussians import Frame, Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.io.clip import Clip, joined
from phy124.monitor import OBSERVERS
from phy124.monitor.diagnostics import describe_substep
from phy124.monitor.observer import (
    Kind,
    Observer,
    Subject,
    Violation,
    find,
    restore_all,
    snapshots,
)
from phy124.monitor.watchdog import Watchdog
from phy124.mpm import MEASURE_EVERY, Unstable
from phy124.mpm.workers import HOST, REPAIR, timed, usable_workers
from phy124.particles.thickness import relative_thickness
from phy124.progress import Progress, silent
from phy124.runtime.compiling import compile_missing
from phy124.runtime.cores import refuse_threads
from phy124.runtime.device import one_at_a_time
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.simulation import props
from phy124.simulation.bodies import bodies
from phy124.simulation.deform import Deformer
from phy124.simulation.kernels import kernels
from phy124.simulation.ordering import axis_of, ordered
from phy124.simulation.placing import belongs
from phy124.simulation.report import counted, report_of
from phy124.simulation.solver import acting, judged_as, solver_of
from phy124.simulation.spent import Spent
from phy124.simulation.stopped import Stopped


class Interrupted(Cancelled):
    """A run was cancelled; its frames are good, and `phy124.pipeline.resume` can save its state."""

    def __init__(self, run: Simulation) -> None:
        self.run = run
        super().__init__(f"after frame {run.count} of {run.scene.time.frames}")


class Simulation:
    """One run; iterate over it to get its frames. Leave the loop to pause, iterate again to go on.

    `phy124.pipeline.resume` saves a paused run and continues it later, bit for bit.
    """

    def __init__(
        self,
        gaussians: Gaussians,
        scene: Scene,
        *,
        device: str = "cpu",
        progress: Progress = silent,
        watch: Stopwatch | None = None,
        crop: Crop = WHOLE,
        threads: int | None = None,
        along: int | None = None,
        keep: bool = True,
        changes: bool = False,
        shapes: bool = True,
        observers: Sequence[type[Observer]] = OBSERVERS,
    ) -> None:
        """Place the object, make its particles and build the solver.

        Args:
            gaussians: The object at any size, standing upright, facing +x; or several, told apart
                by `object_id`. Further objects that are missing are shapes or copies of the first.
            scene: What happens to it.
            device: Warp device, "cpu" or "cuda:0".
            progress: Called with ("simulate" or "compile", done, all); may raise Cancelled.
            watch: Where the durations of the stages are recorded.
            crop: Where the object is in the picture that the masks of parts were painted on.
            threads: CPU threads; None: as many as have a free core and enough particles.
            along: Axis along which particles are ordered; None: as suits the number of threads.
            keep: Keep all frames for `clip`; otherwise the frames may exceed the memory.
            changes: Whether `change` may be called.
            shapes: Whether frames show where the Gaussians are; else they show them at rest.
            observers: Classes of observers; those that the scene calls for observe the run.

        Raises:
            InputError: The Gaussians or the scene cannot be used.
        """
        refuse_threads(threads)
        self.scene, self.device, self.progress = scene, device, progress
        self.given, self.crop = gaussians, crop
        self.watch = watch or Stopwatch()
        with self.watch.stage("particles"):
            made = bodies(gaussians, scene, crop)
            scene = scene.with_solids()
            self.numbered, self.cleaning, self.gaussians = made[:3]
            self.look, self.materials, stiffness = made[3:]
            look, self.shown, self.particles = self.look, self.look.gaussians, self.look.particles
            threads = usable_workers(len(self.particles), device, threads)
            self.along = axis_of(self.particles, threads) if along is None else along
            self.particles, stiffness = ordered(
                self.particles, self.materials, stiffness, scene.dx, self.along
            )
            free = list(props.free_bodies(scene, self.shown))
            props.refuse_overlap(free, self.particles.x, scene)
            self.scenery = props.scenery(scene, self.shown, look.moves)
            judged = judged_as(scene, self.materials)
            self.demand = check_limits(self.shown, self.particles, judged, device, keep=keep)
        with self.watch.stage("compile"):
            compile_missing(kernels(scene, device), device, progress)
            self.keep, self.shapes, self.count = keep, shapes, 0
            """Whether all frames are kept, whether they are shaped, and their number so far."""
            self.subject = Subject(scene, self.materials, changes)
            self.observers = [kind.of(self) for kind in observers if kind.called_for(self.subject)]
            self.solver = solver_of(
                self.particles, self.materials, stiffness, scene, device, threads, self.observers,
                free,
            )  # fmt: skip
            for observer in self.observers:
                observer.bind(self.solver, self.observers)
            self.spent = Spent(self.solver.team, device)
            self.deformer = Deformer(
                self.scenery.moving,
                self.particles,
                max_stretch=look.max_stretch,
                rounds=look.rounds,
                flows=look.flows,
                holds=look.holds,
                device=device,
                threads=len(self.solver.workers),
            )
        self.frames: list[Frame] = []
        self.rotations: list[NDArray] = []
        self.poses: list[NDArray] = []
        """Centre [m] and turn (wxyz) of each free solid in every frame [F,7]."""
        self.retried: list[int] = []
        self.stopped: str | None = None
        self.remarks: list[str] = []
        """What the report notes besides what the run itself finds."""
        self.remedies: tuple[Remedy, ...] = ()
        """What would help, if it has stopped."""

    def __iter__(self) -> Iterator[Frame]:
        """The frames in order, starting where an earlier loop left off.

        Raises:
            Stopped: A frame is wrong, or the run has taken twice its time budget.
            Cancelled: `progress` raised it.
        """
        while self.count < self.scene.time.frames:
            yield self.step()

    def step(self) -> Frame:
        """The next frame, also after the last one of the scene.

        Raises:
            Stopped: The frame is wrong, or the run has taken twice its time budget.
            Cancelled: `progress` raised it.
        """
        index, timing = self.count, self.scene.time
        at = index / timing.fps
        skipped = next(filter(None, (one.skip_to(index) for one in self.observers)), None)
        if skipped is not None:
            self.solver.clock.time = skipped
        elif index:
            self._advance(index, at)
        with self.watch.stage("deform"):
            frame = self._again(index, at) if skipped else self._frame(index, at)
        if not self.keep:
            self.frames.clear()
            del self.rotations[:-1]
        self.frames.append(frame)
        self.count += 1
        self.progress("simulate", index + 1, timing.frames)
        return frame

    def change(self, scene: Scene) -> None:
        """Go on under the forces and boundaries of another scene, from the next substep on.

        Raises:
            InputError: One of them does not fit the object or the grid; nothing has changed.
        """
        rejected = self.solver.rejection.rejected
        whole = scene.with_solids()
        self.solver.bind(*acting(whole, self.observers))
        self.solver.rejection.rejected = rejected
        self.scene = scene
        for observer in self.observers:
            observer.change(scene)

    def find(self, kind: type[Kind]) -> Kind | None:
        """Return the observer of a class, or None if the scene does not call for it."""
        return find(self.observers, kind)

    def run(self, each: Callable[[Frame], object] = lambda frame: None) -> Clip:
        """All frames as a clip; if the run stops early, the clip holds the good ones and says so.

        Args:
            each: Called with every frame as soon as it is computed.

        Raises:
            Interrupted: The run was cancelled; its state is that after its last frame.
        """
        try:
            for frame in self:
                each(frame)
        except Stopped as stop:
            self.stopped, self.remedies = str(stop), stop.remedies
        except Cancelled as wish:
            raise Interrupted(self) from wish
        launches = sum(
            count for name, (_, count) in self.solver.timings.items() if name not in HOST
        )
        self.watch.launches["simulate"] = int(launches)
        return self.clip()

    def clip(self) -> Clip:
        """The frames so far.

        Raises:
            ValueError: They were not kept.
        """
        if not self.keep:
            raise ValueError("this run does not keep its frames")
        rotations = joined(self.rotations) if self.rotations else None
        made = Clip.from_frames(self.frames, rotations)
        shown = {"opacities": self.shown.opacities, "sh": self.shown.sh}
        names = self.scene.names if self.scene.objects else ()
        made = replace(made, **shown, scene=self.numbered.data(), objects=names)
        for observer in self.observers:
            made = observer.complete(made)
        return made.with_report(self.report() | counted(self, made))

    @cached_property
    def thickness(self) -> float | None:
        """Local thickness of the object relative to its size; None in scenes of several objects."""
        if self.scene.objects:
            return None
        moving = self.gaussians.select(belongs(self.numbered, len(self.gaussians)))
        return relative_thickness(moving, self.scene.object.size)

    def report(self) -> dict[str, Any]:
        """What the run did; the keys are documented in docs/reference/report.md."""
        return report_of(self)

    def snapshot(self) -> dict[str, Any]:
        """The state from which the run can go on, without the frames: arrays and plain data."""
        return {
            "count": self.count,
            "retried": list(self.retried),
            "spent": self.spent.before,
            "rejected": self.solver.rejection.rejected,
            "solver": self.solver.snapshot(),
            "deformer": self.deformer.snapshot(),
            "observers": snapshots(self.observers),
            **({"poses": np.array(self.poses)} if self.scenery.free else {}),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to the state at which a snapshot was taken."""
        self.count, self.retried = snapshot["count"], list(snapshot["retried"])
        self.spent.before = snapshot["spent"]
        self.solver.rejection.rejected = snapshot["rejected"]
        self.solver.restore(snapshot["solver"])
        self.deformer.restore(snapshot["deformer"])
        restore_all(self.observers, snapshot["observers"])
        self.poses = list(snapshot.get("poses", []))

    @one_at_a_time
    def _frame(self, index: int, time: float) -> Frame:
        state = self.solver.state
        velocities = state.v if self.scene.velocities else None
        frame = Frame(index, time, self.scenery.moving)
        if self.shapes:
            frame = self.deformer(
                state.x, state.deformation, index=index, time=time, velocities=velocities
            )
        if self.deformer.rotations is not None:
            self.rotations.append(self.scenery.turns(self.deformer.rotations))
        for observer in self.observers:
            frame = observer.after_frame(frame)
        self.poses.append(self.solver.free.poses())
        return self.scenery.whole(frame, self.poses, self.solver.free.motions())

    def _again(self, index: int, time: float) -> Frame:
        """The last frame once more: nothing has moved since."""
        if self.rotations:
            self.rotations.append(self.rotations[-1])
        return replace(self.frames[-1], index=index, time=time)

    @one_at_a_time
    def _advance(self, index: int, until: float) -> None:
        """Take substeps up to a frame's time; after a failure, once more with half the substep."""
        with self.watch.stage("simulate"), self.spent.counting():
            start = (index - 1) / self.scene.time.fps
            timed(self.solver.timings, "watchdog", lambda: self.before_frame(start))
            problem = self._try(index, until)
            if problem is not None:
                self.retried.append(index)
                with self._half_substep():
                    problem = self._try(index, until, closely=True)
            if problem is not None:
                found = find_remedies(problem.causes, self.scene)
                raise Stopped(f"frame {index} is not sound: {problem.what}.", found)

    @contextmanager
    def _half_substep(self) -> Iterator[None]:
        """Within this context, substeps are half as long and limits are measured often."""
        clock = self.solver.clock
        usual = clock.cfl, clock.ceiling, clock.measure_every
        clock.cfl, clock.ceiling = usual[0] / 2, min(usual[1], self._failed_dt) / 2
        clock.measure_every = min(usual[2], MEASURE_EVERY)
        try:
            yield
        finally:
            clock.cfl, clock.ceiling, clock.measure_every = usual

    def _try(self, index: int, until: float, *, closely: bool = False) -> Violation | None:
        """Try a frame; returns what is wrong with it, or None. A failure resets the state."""
        solver = self.solver
        timed(solver.timings, REPAIR, lambda: solver.repair.begin(solver.clock))
        solver.pairs.begin()
        solver.free.begin()
        timed(solver.timings, "watchdog", lambda: self.before_attempt(closely=closely))
        before = timed(solver.timings, "snapshot", self.checkpoint)
        try:
            solver.advance(until, after=self._follower(index), each=closely)
            problem = timed(solver.timings, "watchdog", self.after_attempt)
        except Unstable as error:
            watchdog = self.find(Watchdog)
            what = str(error)
            problem = watchdog.diagnose(what) if watchdog else Violation(what, ("substep",))
        except Exception:
            self.roll_back(before)
            raise
        if problem is None:
            solver.repair.end()
        else:
            self._failed_dt = solver.clock.last_dt or math.inf
            self.roll_back(before)
        return problem

    def before_frame(self, time: float) -> None:
        """Prepare the observers for a frame that starts at this time [s]."""
        for observer in self.observers:
            observer.before_frame(time)

    def before_attempt(self, *, closely: bool = False) -> None:
        """Prepare the observers for an attempt at a frame."""
        for observer in self.observers:
            observer.before_attempt(closely=closely)

    def after_substep(self) -> None:
        """Let the observers read the state after a substep."""
        for observer in self.observers:
            observer.after_substep()

    def after_attempt(self) -> Violation | None:
        """Return the first violation that an observer finds at the end of a frame."""
        return next(filter(None, (one.after_attempt() for one in self.observers)), None)

    def checkpoint(self) -> dict[str, Any]:
        """Return what `roll_back` needs to undo substeps."""
        return {"solver": self.solver.snapshot(), "observers": snapshots(self._summing)}

    def roll_back(self, checkpoint: dict[str, Any]) -> None:
        """Return to a checkpoint: the solver, and the sums that grow within substeps."""
        self.solver.restore(checkpoint["solver"])
        restore_all(self._summing, checkpoint["observers"])

    @property
    def _summing(self) -> list[Observer]:
        return [one for one in self.observers if one.in_substeps or one.in_gathers]

    def _follower(self, index: int) -> Callable[[], None]:
        """Return a function for after each substep: it reports, checks, and limits the time."""
        budget, frames = self.scene.time.budget, self.scene.time.frames

        def after() -> None:
            self.after_substep()
            spent = self.spent.total()
            if spent > 2 * budget:
                raise Stopped(
                    f"frame {index} was reached in {spent:.0f} s, twice time.budget: "
                    f"{self._slowest()}.",
                    find_speedups(
                        self.scene, self.solver.clock.stable().limiter, self._fraction_done()
                    ),
                )
            self.progress("simulate", index, frames)

        return after

    def _slowest(self) -> str:
        """A phrase that says why substeps are so short."""
        solver = self.solver
        return describe_substep(solver.model, solver.state, solver.clock)

    def _fraction_done(self) -> float:
        """Fraction of the scene's duration that has been simulated."""
        timing = self.scene.time
        return self.solver.clock.time * timing.fps / max(timing.frames - 1, 1)
