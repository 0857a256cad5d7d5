"""Tracks: quantities that follow time, evaluated on the device once per substep.

Every time profile becomes a piecewise linear table, so kernels never ask what kind it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from phy124.kernels.grid import make_track_sampler
from phy124.kernels.transfer import types

Key = tuple[float, tuple[float, float, float], bool]
"""Time [s], value, whether it acts from here on."""


@dataclass(frozen=True)
class Track:
    """Keys in order of time; linear between them, constant outside; two at one time jump."""

    keys: tuple[Key, ...]

    @classmethod
    def constant(cls, value: Sequence[float]) -> Track:
        """The same value always."""
        x, y, z = value
        return cls(((0.0, (x, y, z), True),))

    @classmethod
    def window(cls, value: Sequence[float], start: float, end: float) -> Track:
        """A value between two times [s] and nothing outside."""
        x, y, z = value
        nothing = (0.0, 0.0, 0.0)
        keys: list[Key] = [] if start <= 0 else [(0.0, nothing, False), (start, nothing, False)]
        keys.append((max(start, 0.0), (x, y, z), True))
        if np.isfinite(end):
            keys += [(end, (x, y, z), True), (end, nothing, False)]
        return cls(tuple(keys))


class Tracks:
    """All tracks of a run on one device; slot 0 is the sum of the uniform accelerations."""

    def __init__(self, *, real: type, device: str) -> None:
        self.tracks: list[Track] = [Track.constant((0, 0, 0))]
        self.uniform: list[Track] = []
        self.real, self.device = real, device

    def add(self, track: Track) -> int:
        """The slot of a new track."""
        self.tracks.append(track)
        return len(self.tracks) - 1

    def accelerate(self, track: Track) -> None:
        """Add a uniform acceleration [m/s^2] to slot 0, where the grid update finds it."""
        self.uniform.append(track)

    @property
    def vary(self) -> bool:
        """Whether anything changes in time; if not, the tracks are sampled once."""
        return any(len(track.keys) > 1 for track in self.tracks)

    def upload(self, clock: wp.array) -> None:
        """Copy the tables to the device."""
        t = types(self.real)
        self.tracks[0] = add_tracks(self.uniform)
        keys = [key for track in self.tracks for key in track.keys]
        counts = [len(track.keys) for track in self.tracks]

        def array(values: object, dtype: object) -> wp.array:
            return wp.array(np.array(values), dtype=dtype, device=self.device)

        self.starts = array(np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), int)
        self.times = array([key[0] for key in keys], self.real)
        self.keys = array([(*key[1], float(key[2])) for key in keys], t.vec4)
        self.values = wp.zeros(len(counts), dtype=t.vec4, device=self.device)
        self.rates = wp.zeros(len(counts), dtype=t.vec4, device=self.device)
        self.clock = clock

    def record(self) -> wp.Launch:
        """The launch that samples every track at the present time."""
        return wp.launch(
            make_track_sampler(self.real),
            len(self.tracks),
            inputs=[self.starts, self.times, self.keys, self.clock],
            outputs=[self.values, self.rates],
            device=self.device,
            record_cmd=True,
        )


def add_tracks(tracks: Sequence[Track]) -> Track:
    """The sum of piecewise linear tracks, again piecewise linear."""
    if not tracks:
        return Track.constant((0, 0, 0))
    times = sorted({key[0] for track in tracks for key in track.keys})
    keys: list[Key] = []
    for time in times:
        for before in (True, False):
            total = np.sum([_value(track, time, before=before) for track in tracks], axis=0)
            key: Key = (time, (float(total[0]), float(total[1]), float(total[2])), True)
            if not keys or keys[-1] != key:
                keys.append(key)
    return Track(tuple(keys))


def _value(track: Track, time: float, *, before: bool) -> np.ndarray:
    """Value at a time, just before or just after a jump there."""
    times = np.array([key[0] for key in track.keys])
    values = np.array([key[1] for key in track.keys])
    side = "left" if before else "right"
    at = int(np.searchsorted(times, time, side=side)) - 1
    if at < 0:
        return values[0]
    if at >= len(times) - 1 or times[at + 1] == times[at]:
        return values[min(at, len(times) - 1)]
    part = (time - times[at]) / (times[at + 1] - times[at])
    return values[at] + part * (values[at + 1] - values[at])
