"""A run: advances the particles of a setup from frame to frame."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import cached_property, partial
from typing import Any
from weakref import proxy

import numpy as np
from numpy.typing import NDArray

from phy124.budget import cost
from phy124.budget.limits import duration
from phy124.budget.remedies import SLOW, advise, find_remedies, find_speedups
from phy124.errors import Cancelled, Remedy
from phy124.gaussians import Frame
from phy124.io.clip import Clip, stack_arrays
from phy124.lattice.refusals import refuse_for_lattice
from phy124.monitor.diagnostics import describe_substep
from phy124.monitor.observer import Kind, Observer, Violation, find, restore_all, snapshots
from phy124.monitor.watchdog import Watchdog
from phy124.motion.deform import Deformer, host
from phy124.motion.recorded import Motion, Recorded, make_arrays
from phy124.motion.smoothing import Smoothing
from phy124.mpm import Unstable
from phy124.mpm.workers import HOST, REPAIR, Timings, add_timings, run_timed
from phy124.runtime.compiling import compile_missing
from phy124.runtime.device import lock_gpu
from phy124.scene import Scene
from phy124.scene.lattices import keep_lattice
from phy124.scene.liquids import keep_solver, refuse_unprojectable
from phy124.simulation.report import report_clip, report_run
from phy124.simulation.setup import Setup
from phy124.simulation.solver import kernels, make_solver, wrap
from phy124.simulation.spent import Spent
from phy124.simulation.targets import find_moved

BRIEF = 1e-3
"""Length of the substep that advances velocities to the time of the positions, relative to the last
substep.
"""


class Stopped(RuntimeError):
    """Raised if a run ends early because its results would be wrong."""

    def __init__(self, why: str, remedies: Sequence[Remedy] = ()) -> None:
        self.remedies = tuple(remedies)
        """Changes to the scene; one of these changes is sufficient."""
        super().__init__(f"{why} {advise(remedies)}".strip())


class Interrupted(Cancelled):
    """Raised if a run is cancelled. Computed frames are valid, and `resume` can save the state."""

    def __init__(self, run: Simulation) -> None:
        self.run = run
        super().__init__(f"after frame {run.count} of {run.scene.time.frames}")


class Simulation:
    """One run. An iteration yields the remaining frames, so a run can be paused and continued.

    `phy124.pipeline.resume` saves a paused run and continues it later, bit for bit.
    """

    def __init__(self, setup: Setup) -> None:
        """Compile missing kernels, and build the solver and its observers.

        Raises:
            InputError: An object starts inside a wall, a force acts on no particle, or a wall is
                too thin for the grid.
        """
        self.setup, self.scene, self.device = setup, setup.scene, setup.context.device
        self._asked = setup.scene
        with setup.context.watch.stage("compile"):
            missing = kernels(setup.solid_scene, self.device)
            compile_missing(missing, self.device, setup.context.progress)
            needed = (kind for kind in setup.observers if kind.called_for(setup.subject))
            self.observers = [kind.of(setup) for kind in needed]
            self.solver = make_solver(setup, self.observers)
            for observer in self.observers:
                # A weak reference, because the solver refers to its observers.
                observer.bind(proxy(self.solver), self.observers)
            self.solver.start()
            self.spent = Spent(self.solver.runner.team, self.device)
        self.count = 0
        self.frames: list[Frame] = []
        scene, count = self.scene, len(setup.shown)
        measured = scene.velocities or scene.keeps_contacts
        size = cost.BYTES_PER_GAUSSIAN * count * scene.time.frames
        self.light = setup.keep and setup.shapes and not measured and size > cost.HELD
        """Whether `frames` contain no Gaussians. The Gaussians are then computed later from the
        motion.
        """
        self._recorded: Recorded | None = None
        self.rotations: list[NDArray] = []
        """Rotations of Gaussians in each frame [N,4] wxyz, if colours depend on rotations."""
        self.poses: list[NDArray] = []
        """Centres [m] and orientations (wxyz) of freely moving solids in each frame [F,7]."""
        self.retried: list[int] = []
        """Frames that were repeated with half the substep."""
        self.stopped: str | None = None
        self.remedies: tuple[Remedy, ...] = ()
        self.remarks: list[str] = []
        self.most_substeps = math.inf
        """Largest number of substeps of a frame, for live runs."""

    def __iter__(self) -> Iterator[Frame]:
        """Yield the remaining frames.

        Raises:
            Stopped: A frame is wrong, or the run has used twice its time budget.
            Cancelled: Raised by `progress`.
        """
        while self.count < self.scene.time.frames:
            yield self.step()

    def step(self) -> Frame:
        """Return the next frame, even beyond the last frame of the scene.

        Raises:
            Stopped: The frame is wrong, or the run has used twice its time budget.
            Cancelled: Raised by `progress`.
        """
        frame = self._take_frame()
        if not self.light:
            return frame
        return replace(frame, gaussians=self._frames_so_far().gaussians(frame.index))

    def _take_frame(self) -> Frame:
        """Compute the next frame; if `light` is set, the frame contains no Gaussians."""
        index, timing, context = self.count, self.scene.time, self.setup.context
        time = index / timing.fps
        skipped = next(filter(None, (o.skip_to(index) for o in self.observers)), None)
        if skipped is not None:
            self.solver.clock.time = skipped
        elif index:
            self._advance(index, time)
        frame = self._repeat_frame(index, time) if skipped else self._make_frame(index, time)
        if not self.setup.keep:
            self.frames.clear()
            del self.rotations[:-1]
        self.frames.append(frame)
        self.count += 1
        context.progress("simulate", self.count, timing.frames)
        return frame

    def change(self, scene: Scene) -> None:
        """Continue with the forces and boundaries of another scene, from the next substep on.

        Raises:
            InputError: A force or boundary does not fit the object. The run is then unchanged.
        """
        from phy124.lattice.solver import LatticeSolver  # its import is slow

        solver, moved = self.solver, find_moved(self._asked, scene)
        if moved is not None and isinstance(solver, LatticeSolver) and solver.retarget(moved):
            acting = {"forces": scene.forces, "boundaries": scene.boundaries}
            self.scene, self._asked = self.scene.model_copy(update=acting), scene
            return
        rejected, asked = self.solver.rejection.rejected, scene
        scene = keep_lattice(scene, self.setup.scene)
        solid_scene = keep_solver(scene.with_solids(), self.setup.solid_scene)
        if solid_scene.projects:
            refuse_unprojectable(solid_scene)
        if scene.on_lattice:
            refuse_for_lattice(scene, self.setup.materials)
        self.solver.bind(**wrap(solid_scene, self.observers))
        self.solver.rejection.rejected = rejected
        self.scene, self._asked = scene, asked
        for observer in self.observers:
            observer.change(scene)

    def find(self, kind: type[Kind]) -> Kind | None:
        """Return the observer of a class, or None if the scene does not require it."""
        return find(self.observers, kind)

    def run(
        self,
        each: Callable[[Frame], object] | None = None,
        *,
        record: Callable[[Simulation], object] = lambda run: None,
        shapes: bool = True,
    ) -> Clip:
        """Return all frames as a clip. After an early stop, the clip has the valid frames and the
        reason.

        Args:
            each: Function called with every frame.
            record: Function called with this simulation after every frame, before `each`.
            shapes: As for `clip`.

        Raises:
            Interrupted: The run was cancelled. Its state is the state after the last computed
                frame.
        """
        try:
            while self.count < self.scene.time.frames:
                frame = self._take_frame() if each is None else self.step()
                record(self)
                if each is not None:
                    each(frame)
        except Stopped as stop:
            self.stopped, self.remedies = str(stop), stop.remedies
        except Cancelled as cancelled:
            raise Interrupted(self) from cancelled
        launches = sum(count for name, (_, count) in self.timings.items() if name not in HOST)
        self.setup.context.watch.launches["simulate"] = int(launches)
        return self.clip(shapes=shapes)

    def clip(self, *, shapes: bool = True) -> Clip:
        """Return the frames computed so far as a clip.

        Raises:
            ValueError: The frames were not kept.
        """
        setup = self.setup
        if not setup.keep:
            raise ValueError("this run does not keep its frames")
        clip = Clip.from_frames(
            self.frames, stack_arrays(self.rotations) if self.rotations else None
        )
        computed = make_arrays(self._frames_so_far()) if self.light else {}
        clip = replace(
            clip,
            **computed,
            object_id=setup.shown.object_id,
            opacities=setup.shown.opacities,
            sh=setup.shown.sh,
            scene=setup.cleaned_scene.data(),
            objects=self.scene.names if self.scene.objects else (),
        )
        if self._follows_particles():
            clip = clip.with_motion(self._motion(clip.times))
        for observer in self.observers:
            clip = observer.complete(clip)
        report = self.report() | report_clip(setup, clip)
        return clip.with_report(report | (self.shapes_of(clip) if shapes or not self.light else {}))

    def shapes_of(self, clip: Clip, *, every: bool = True) -> dict[str, Any]:
        """Return the report's entry about the shapes of the Gaussians in the run's clip.

        If `every` is false and `light` is set, frames that have not been read are skipped.
        """
        look, materials = self.setup.appearance, self.setup.materials
        if self._recorded is None:
            measure = look.elongation(materials)
            ratios = [measure({"scales": scales}) for scales in clip.scales]
        else:
            ratios = self._recorded.measurements(every=every)
        return {"shapes": look.shapes(ratios, clip.opacities, materials)}

    def report(self) -> dict[str, Any]:
        """Return the report; phy124.pipeline.report_keys documents its keys."""
        return report_run(self)

    @property
    def timings(self) -> Timings:
        """Seconds and number of kernel launches of each stage of a step, on the main thread."""
        solvers = [self.solver, getattr(self.solver, "liquid", None)]
        return add_timings(solver.timings for solver in solvers if solver is not None)

    def snapshot(self) -> dict[str, Any]:
        """Return arrays and plain data, without frames, from which the run can continue."""
        return {
            "count": self.count,
            "retried": list(self.retried),
            "spent": self.spent.earlier,
            "rejected": self.solver.rejection.rejected,
            "solver": self.solver.snapshot(),
            "deformer": self.deformer.snapshot() if self._deforms else {},
            "observers": snapshots(self.observers),
            **({"poses": np.array(self.poses)} if self.setup.free else {}),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state of a snapshot."""
        self.count, self.retried = snapshot["count"], list(snapshot["retried"])
        self.spent.earlier = snapshot["spent"]
        self.solver.rejection.rejected = snapshot["rejected"]
        self.solver.restore(snapshot["solver"])
        if self._deforms:
            self.deformer.restore(snapshot["deformer"])
        restore_all(self.observers, snapshot["observers"])
        self.poses = list(snapshot.get("poses", []))

    @lock_gpu
    def _make_frame(self, index: int, time: float) -> Frame:
        setup, state = self.setup, self.solver.state
        scenery, stage = setup.scenery, setup.context.watch.stage
        frame = Frame(index, time, scenery.moving)
        with stage("simulate"):
            v = self._velocities() if self.scene.velocities and self._deforms else None
        with stage("deform"):
            x, F = self.carrying() if setup.shapes else (state.x, state.deformation)
            if self._deforms:
                frame = self.deformer(x, F, index=index, time=time, velocities=v)
                if self.deformer.rotations is not None:
                    self.rotations.append(scenery.turns(self.deformer.rotations))
        with stage("observe"):
            for observer in self.observers:
                frame = observer.after_frame(frame)
        with stage("deform"):
            if not setup.keep:
                del self.poses[1:]
            self.poses.append(self.solver.free.poses())
            if self.light:
                frame = replace(frame, gaussians=setup.shown.select(np.zeros(0, int)))
            else:
                frame = scenery.whole(frame, self.poses, self.solver.free.motions())
            if not (setup.keep and setup.shapes):
                return frame
            carried = tuple(host(a)[self.deformer.carriers].astype(np.float32) for a in (x, F))
            return replace(frame, carried=carried)

    def _velocities(self) -> NDArray:
        """Return the particles' velocities [P,3], m/s, at the time of their positions.

        The solver's velocities are half a substep behind. A very short substep, which is undone,
        advances them to the time of the positions.
        """
        clock, v = self.solver.clock, host(self.solver.state.v).copy()
        if clock.last_dt > 0:
            before = self.checkpoint()
            with suppress(Unstable):  # the next frame reports the error
                self.solver.advance(clock.time + BRIEF * clock.last_dt)
                v = host(self.solver.state.v).copy()
            self.roll_back(before)
        return v

    @property
    def _deforms(self) -> bool:
        return self.setup.shapes and not self.light

    @cached_property
    def deformer(self) -> Deformer:
        """Object that computes the Gaussians of each frame."""
        return Deformer(
            self.setup.scenery.moving,
            self.setup.particles,
            **self.setup.appearance.limits(),
            device=self.device,
            threads=len(self.solver.workers),
        )

    @cached_property
    def _smoothing(self) -> Smoothing | None:
        setup = self.setup
        dents = np.array([section.dents for section in setup.materials])[setup.particles.material]
        smooth = dents.any() and self.scene.binding == "lattice"
        return Smoothing(setup.particles, dents, self.scene.dx) if smooth else None

    def carrying(self) -> tuple[Any, Any]:
        """Return the particles' positions and deformation gradients, which move the Gaussians."""
        x, F = self.solver.state.x, self.solver.state.deformation
        return self._smoothing(host(x), host(F)) if self._smoothing else (x, F)

    def _frames_so_far(self) -> Recorded:
        motion = self._motion(np.array([frame.time for frame in self.frames]))
        if self._recorded is None:
            measure = self.setup.appearance.elongation(self.setup.materials)
            threads, frames = self.setup.context.threads, self.scene.time.frames
            self._recorded = Recorded(motion, measure=measure, threads=threads, frames=frames)
        self._recorded.motion = motion
        return self._recorded

    def _follows_particles(self) -> bool:
        every = all(frame.carried is not None for frame in self.frames)
        known = not self.setup.free or len(self.poses) == len(self.frames)
        return every and known

    def _motion(self, times: NDArray[np.float64]) -> Motion:
        """Return the motion at times [T], s."""
        setup, count = self.setup, len(self.frames)
        carried = [frame.carried for frame in self.frames if frame.carried is not None]
        tracks = [track.values(times) for _, track in setup.scenery.tracks]
        return Motion(
            gaussians=setup.shown,
            moves=setup.appearance.moves,
            particles=setup.particles,
            limits=setup.appearance.limits(),
            carriers=self.deformer.carriers,
            x=[x for x, _ in carried],
            F=[F for _, F in carried],
            times=times,
            on_tracks=tuple(index for index, _ in setup.scenery.tracks),
            tracks=np.stack(tracks, axis=1) if tracks else np.zeros((count, 0, 3)),
            free=setup.scenery.free,
            poses=np.array(self.poses) if setup.free else np.zeros((count, 0, 7)),
            binding=self.deformer.binding,
        )

    def _repeat_frame(self, index: int, time: float) -> Frame:
        if self.rotations:
            self.rotations.append(self.rotations[-1])
        return replace(self.frames[-1], index=index, time=time)

    @lock_gpu
    def _advance(self, index: int, until: float) -> None:
        """Take substeps up to the time of a frame. After a failure, try again with half the
        substep.
        """
        with self.setup.context.watch.stage("simulate"), self.spent.counting():
            start = (index - 1) / self.scene.time.fps
            prepare = [partial(observer.before_frame, start) for observer in self.observers]
            run_timed(self.solver.timings, "watchdog", lambda: [each() for each in prepare])
            problem = self._try(index, until)
            if problem is not None:
                with self._half_substep():
                    problem = self._try(index, until, closely=True)
                self.retried.append(index)
            if problem is not None:
                helpful = find_remedies(problem.causes, self.scene, until)
                raise Stopped(f"frame {index} is not valid: {problem.what}.", helpful)

    @contextmanager
    def _half_substep(self) -> Iterator[None]:
        with ExitStack() as halved:
            for clock, failed in self._failed:
                halved.enter_context(clock.halve(failed))
            yield

    def _try(self, index: int, until: float, *, closely: bool = False) -> Violation | None:
        """Attempt a frame; if it is not valid, reset the state and return the error."""
        solver = self.solver
        run_timed(solver.timings, REPAIR, lambda: solver.repair.begin(solver.clock))
        solver.pairs.begin()
        solver.free.begin()
        run_timed(solver.timings, "watchdog", lambda: self.before_attempt(closely=closely))
        before = run_timed(solver.timings, "snapshot", self.checkpoint)
        failed = 0.0
        try:
            solver.advance(until, after=self._follower(index), each=closely)
            problem = run_timed(solver.timings, "watchdog", self.after_attempt)
        except Unstable as error:
            watchdog, failed = self.find(Watchdog), error.dt
            what = str(error)
            problem = watchdog.diagnose(what) if watchdog else Violation(what, ("substep",))
        except Exception:
            self.roll_back(before)
            raise
        if problem is None:
            solver.repair.end()
        else:
            self._failed = solver.clock.list_failed(failed or solver.clock.last_dt)
            self.roll_back(before)
        return problem

    def before_attempt(self, *, closely: bool = False) -> None:
        """Prepare the observers for an attempt to compute a frame."""
        for observer in self.observers:
            observer.before_attempt(closely=closely)

    def after_attempt(self) -> Violation | None:
        """Return the first error of an observer at the end of a frame."""
        return next(filter(None, (o.after_attempt() for o in self.observers)), None)

    def checkpoint(self) -> dict[str, Any]:
        """Return the solver's state and the observers' sums, for `roll_back`."""
        return {"solver": self.solver.snapshot(), "observers": snapshots(self._summing)}

    def roll_back(self, checkpoint: dict[str, Any]) -> None:
        """Return to a checkpoint."""
        self.solver.restore(checkpoint["solver"])
        restore_all(self._summing, checkpoint["observers"])

    @property
    def _summing(self) -> list[Observer]:
        return [o for o in self.observers if o.in_substeps or o.in_gathers]

    def _follower(self, index: int) -> Callable[[], None]:
        budget, frames = self.scene.time.budget, self.scene.time.frames
        progress, solver = self.setup.context.progress, self.solver
        last = solver.clock.substeps + self.most_substeps

        def after() -> None:
            for observer in self.observers:
                observer.after_substep()
            if solver.clock.substeps >= last and solver.clock.time < index / self.scene.time.fps:
                causes = (*SLOW[solver.clock.stable().limiter], "cells")
                why = f"frame {index} needs more than {self.most_substeps:g} substeps"
                raise Stopped(
                    f"{why}, because the motion is too violent.", find_remedies(causes, self.scene)
                )
            spent = self.spent.total()
            if spent > 2 * budget:
                slow = describe_substep(solver.model, solver.state, solver.clock)
                done = solver.clock.time * self.scene.time.fps / max(frames - 1, 1)
                raise Stopped(
                    f"frame {index} was reached in {duration(spent)}, twice time.budget: {slow}.",
                    find_speedups(self.scene, solver.clock.stable().limiter, done),
                )
            progress("simulate", index, frames)

        return after
