"""Sleep: substeps are left out while everything rests and nothing that acts changes.

An instant without speed is not rest: a thrown body has one at the top of its path. Rest is that in
Q frames of T seconds no particle got further than D from where it was. Evenly accelerated it then
goes at most 7 D m (1 + m) in the M = m Q frames to be left out (the worst: there, back and on); and
a vibration in step with the frames, whose largest speed is v, hides v T / 2 pi. The object
sleeps where the sum is invisible and its speed does not grow, until a force or a boundary changes,
anywhere in the scene, or the clip ends. Under gravity it must also have stayed where a free body
would have left, or a film of many frames per second would catch it resting in the air.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.mpm import Clock, Model, State
from phy124.tracks import FOREVER, Track, Tracks

STILL = 3e-4
"""How far sleeping could lead anything astray at worst, in object sizes: 0.1 of 300 pixels."""
CALM = 1 / 6
"""Fraction of it that particles may move while they are said to rest."""
HELD = 0.1
"""Fraction of a free body's way that a body may move which something holds."""


class Sleep:
    """Decides for one run which frames need no substeps."""

    def __init__(
        self,
        model: Model,
        state: State,
        clock: Clock,
        tracks: Tracks,
        *,
        size: float,
        frames: int,
        fps: float,
    ) -> None:
        """Bind to a run.

        Args:
            model: Whose grid spacing tells how fast a turning particle is.
            state: Whose particles move or rest.
            clock: Knows how fast they are.
            tracks: Tell when forces and boundaries change.
            size: Of the object [m].
            frames: Of the clip.
            fps: Frames per second of motion.
        """
        self._dx, self._state, self._clock, self._tracks = model.dx, state, clock, tracks
        self._frames, self._fps = frames, fps
        self._far = STILL * size
        self.anchor: NDArray[np.float64] | None = None
        """Where the particles were when they were last seen to move [P,3], m."""
        self.drift = 0.0
        """How far one has got from there [m]."""
        self.speeds: list[float] = []
        """Largest speed in each frame since then [m/s]."""
        self._fastest, self._last = 0.0, 0
        self.since: int | None = None
        """The first frame that was left out."""
        self.skipped = self.saved = 0
        """Frames and substeps left out, as many in each as in the last frame computed."""

    def look(self) -> None:
        """After a substep: note how fast the fastest particle is, turning included."""
        extremes = self._clock.extremes
        self._fastest = max(self._fastest, extremes.speed, extremes.gradient * self._dx)

    def computed(self, index: int, substeps: int) -> None:
        """After a frame that took so many substeps."""
        self.look()
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

    def skip_to(self, index: int) -> float | None:
        """The time of a frame that needs no substeps [s], and count it; None if it needs some."""
        if not self._rests(index):
            return None
        self.since = index if self.since is None else self.since
        self.skipped += 1
        self.saved += self._last
        return index / self._fps

    def snapshot(self) -> dict[str, Any]:
        """What goes on from here: arrays and plain data."""
        return {
            "anchor": self.anchor,
            "drift": self.drift,
            "speeds": list(self.speeds),
            "since": self.since,
            "skipped": self.skipped,
            "saved": self.saved,
            "last": self._last,
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Go back to a snapshot."""
        self.anchor, self.drift = snapshot["anchor"], snapshot["drift"]
        self.speeds, self.since = list(snapshot["speeds"]), snapshot["since"]
        self.skipped, self.saved = snapshot["skipped"], snapshot["saved"]
        self._last = snapshot["last"]

    def report(self) -> dict[str, int] | None:
        """From which frame on it slept first, how many frames, and what that saved."""
        if self.since is None:
            return None
        return {"since": self.since, "frames": self.skipped, "substeps": self.saved}

    def sentence(self) -> str | None:
        """The same in words."""
        if self.since is None:
            return None
        return f"asleep from frame {self.since}, {self.skipped} frames, saved {self.saved} substeps"

    def _rests(self, index: int) -> bool:
        """Whether nothing visible would happen from a frame until something changes."""
        if not self.speeds:
            return False
        until = self._quiet_until((index - 1) / self._fps)
        last = self._frames - 1
        if until < last / self._fps:
            last = math.floor(until * self._fps)
        fraction = (last - index + 1) / len(self.speeds)
        if fraction <= 0 or self._grows() or not self._held():
            return False
        reach = 7 * self.drift * fraction * (1 + fraction)
        return reach + self._hidden(max(self.speeds)) <= self._far

    def _hidden(self, speed: float) -> float:
        """Amplitude of a vibration that frames do not show [m]."""
        return speed / self._fps / (2 * math.pi)

    def _held(self) -> bool:
        """Whether it stayed where it is though it is pulled: free, it would have gone a t^2 / 8."""
        pull: NDArray[Any] = self._tracks.values.numpy()
        way = float(np.linalg.norm(pull[0, :3])) * (len(self.speeds) / self._fps) ** 2 / 8
        return way == 0 or self.drift <= HELD * way

    def _grows(self) -> bool:
        """Whether the last frame was the fastest, as when something begins to topple."""
        *before, latest = self.speeds
        return latest > max(before, default=0.0)

    def _quiet_until(self, time: float) -> float:
        """All forces and boundaries stay as they are from this time on until the result [s]."""
        return min(next_change(track, time) for track in self._tracks.tracks)


def next_change(track: Track, time: float) -> float:
    """When a track next changes, `time` itself if it is changing then; infinity: never [s]."""
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
