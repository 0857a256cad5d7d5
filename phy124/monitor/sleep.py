"""Sleep: skips substeps while all objects are at rest and no force or boundary changes.

A body with zero speed need not be at rest: a thrown body has zero speed at the top of its path. An
object counts as at rest if, for Q frames of T seconds, no particle has moved further than D from
its starting point. Under a constant acceleration, a particle can then move by at most `7 D m (1 +
m)` in the next `M = m Q` frames. In the worst case, a particle first moved by D to one side and
turned, and is now at the distance D on the other side, moving away. In addition, a vibration in
phase with the frames can hide a displacement of `v T / (2 pi)`, where v is the largest speed of the
vibration.

The object sleeps if the sum of both displacements is invisible and the speed does not grow. Under
gravity, the object must also have moved much less than a free body would. Otherwise, in a clip with
many frames per second, an object at the top of its path would count as at rest.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Frame
from phy124.monitor.observer import Effect, Observed, Observer, Subject
from phy124.mpm.tracks import FOREVER, Track
from phy124.scene import Scene

if TYPE_CHECKING:
    from typing_extensions import Self

    from phy124.liquid import AnySolver

STILL = 3e-4
"""Largest error due to sleep, relative to the object's size: 0.1 pixels in an object of 300
pixels.
"""
CALM = 1 / 6
"""Largest motion of particles at rest, as a fraction of `STILL`."""
HELD = 0.1
"""Largest motion of a supported body, as a fraction of a free fall."""


class Sleep(Observer):
    """Decides which frames of a run need no substeps."""

    absent: ClassVar[dict[str, Any]] = {"sleep": None}
    kept = ("anchor", "drift", "speeds", "since", "skipped", "saved", "_last")

    def __init__(self, *, size: float, frames: int, fps: float) -> None:
        self._frames, self._fps = frames, fps
        self._stiffness_changes = False
        self._far = STILL * size
        self.anchor: NDArray[np.float64] | None = None
        """Positions [P,3], m, from which the drift is measured."""
        self.drift = 0.0
        """Largest distance of a particle from `anchor` [m]."""
        self.speeds: list[float] = []
        """Largest speed in each frame since `anchor` was set [m/s]."""
        self._fastest, self._last, self._before = 0.0, 0, 0
        self.since: int | None = None
        self.skipped = self.saved = 0
        """Number of skipped frames, and estimated number of saved substeps."""

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether frames may be skipped."""
        return subject.scene.time.sleep

    @classmethod
    def effect(cls, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects."""
        sleeps = subject.scene.time.sleep
        why = "the object was never at rest long enough" if sleeps else "time.sleep is off"
        return Effect("sleep while all objects rest", sleeps, why)

    @classmethod
    def of(cls, setup: Observed) -> Self:
        """Return the observer of a run."""
        timing, size = setup.scene.time, min(body.size for body in setup.scene.every_object)
        sleep = cls(size=size, frames=timing.frames, fps=timing.fps)
        sleep.change(setup.scene)
        return sleep

    def bind(self, solver: AnySolver, observers: Sequence[Observer] = ()) -> None:
        """Connect the observer to the solver."""
        self._solver, self._state, self._clock = solver, solver.state, solver.clock
        self._tracks = tuple(solver.tracks.tracks)

    def change(self, scene: Scene) -> None:
        """Observe the rest again; disable sleep if the stiffness changes in time."""
        self._stiffness_changes = scene.stiffness_profile is not None
        self.anchor, self.drift, self.speeds = None, 0.0, []

    def skip_to(self, index: int) -> float | None:
        """Return the time [s] of a frame that needs no substeps, and count the frame; otherwise
        None.
        """
        tracks = tuple(self._solver.tracks.tracks)
        if tracks != self._tracks:  # the target of a grab or the path of a wall was replaced
            self._tracks, self.anchor, self.drift, self.speeds = tracks, None, 0.0, []
        flying = self._solver.outliers.count or self._solver.free.all
        if index == 0 or self._stiffness_changes or flying or not self._rests(index):
            return None
        self.since = index if self.since is None else self.since
        self.skipped += 1
        self.saved += self._last
        return index / self._fps

    def before_frame(self, time: float) -> None:
        """Store the current number of substeps."""
        self._before = self._clock.substeps

    def after_substep(self) -> None:
        """Update the largest speed, including rotation."""
        extremes, dx = self._clock.recent, self._solver.model.dx
        self._fastest = max(self._fastest, extremes.speed, extremes.gradient * dx)

    def after_frame(self, frame: Frame) -> Frame:
        """Measure displacements; return the frame unchanged."""
        if frame.index > 0:
            self.observe(frame.index, self._clock.substeps - self._before)
        return frame

    def observe(self, index: int, substeps: int) -> None:
        """Measure displacements after a frame of `substeps` substeps."""
        self.after_substep()
        speed, self._fastest, self._last = self._fastest, 0.0, substeps
        changed = self._quiet_until((index - 1) / self._fps) < index / self._fps
        if changed or self._hidden(speed) > CALM * self._far:
            self.anchor, self.drift, self.speeds = None, 0.0, []
            return
        x = self._state.x.numpy().astype(np.float64)
        if self.anchor is not None:
            self.drift = max(self.drift, float(np.abs(x - self.anchor).max()) * math.sqrt(3))
            self.speeds.append(speed)
        if self.anchor is None or self.drift > CALM * self._far:
            self.anchor, self.drift, self.speeds = x, 0.0, []

    def report(self, frames: Sequence[Frame] = ()) -> dict[str, Any]:
        """Return the first skipped frame, and the numbers of skipped frames and saved substeps."""
        if self.since is None:
            return {"sleep": None}
        sleep = {"since": self.since, "frames": self.skipped, "substeps": self.saved}
        return {"sleep": sleep}

    def finished_effect(self, subject: Subject) -> Effect:
        """Return the entry in the report's list of effects, with start and duration of sleep."""
        row = self.effect(subject)
        if self.since is None:
            return row._replace(called_for=False)
        saved = f"{self.skipped} frames, saved {self.saved} substeps"
        return row._replace(name=f"{row.name}: asleep from frame {self.since}, {saved}")

    def _rests(self, index: int) -> bool:
        if not self.speeds:
            return False
        until = self._quiet_until((index - 1) / self._fps)
        last = self._frames - 1
        if until < last / self._fps:
            last = math.floor(until * self._fps)
        fraction = (last - index + 1) / len(self.speeds)
        if fraction <= 0 or self._grows() or not self._pins_material():
            return False
        reach = 7 * self.drift * fraction * (1 + fraction)
        return reach + self._hidden(max(self.speeds)) <= self._far

    def _hidden(self, speed: float) -> float:
        """Return the amplitude [m] of a vibration with a speed [m/s] and one period per frame."""
        return speed / self._fps / (2 * math.pi)

    def _pins_material(self) -> bool:
        """Return whether something holds the material against the acceleration `a`. Free material
        would move by at least `a t^2 / 8` from its mean position during the time t.
        """
        pull: NDArray[Any] = self._solver.tracks.values.numpy()
        way = float(np.linalg.norm(pull[0, :3])) * (len(self.speeds) / self._fps) ** 2 / 8
        return way == 0 or self.drift <= HELD * way

    def _grows(self) -> bool:
        """Return whether the last frame was the fastest, as when an object begins to topple."""
        *before, latest = self.speeds
        return latest > max(before, default=0.0)

    def _quiet_until(self, time: float) -> float:
        """Return the time [s] until which all forces and boundaries stay constant."""
        return min(next_change(track, time) for track in self._solver.tracks.tracks)


def next_change(track: Track, time: float) -> float:
    """Return the next time [s] at which a track changes: `time` during a change, infinity if there
    is no further change.
    """
    edges = [edge for edge in (track.start, track.end) if time <= edge < FOREVER]
    keys = [(track.origin + at, value) for at, value in track.keys]
    changes = [(a, b) for (a, u), (b, w) in itertools.pairwise(keys) if u != w]
    if track.period and (changes or keys[0][1] != keys[-1][1]):
        changes = [(track.origin, math.inf)]
    for begin, end in changes:
        at = max(begin, time, track.start)
        if at < min(end, track.end):
            edges.append(at)
    return min(edges, default=math.inf)
