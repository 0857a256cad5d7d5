"""Tracks: quantities that change over time, evaluated on the device once per substep.

Every time profile becomes a piecewise linear table, so kernels need not distinguish profiles.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray
from pydantic import Field, model_validator

from phy124.kernels.arguments import types
from phy124.kernels.launches import put, record
from phy124.kernels.profile import DRIFT, JOINS, KICK, LIMITED, MEAN, make_sampler
from phy124.schema.bounds import LONGEST, SHORTEST, Factor, Instant
from phy124.schema.region import Vector
from phy124.schema.section import Section

SEGMENTS = 64
"""Number of straight segments per period of a sine; the error is 0.12 % of the amplitude."""
FOREVER = 1e30
"""A time later than the end of any run [s], but finite in float32."""
Key = tuple[float, Vector]
"""A key of a track: time [s] and value."""
Over = Literal["", "kick", "drift"]
"""Interval over which a track's value is averaged: no interval, the kick, or the drift."""
OVER: dict[Over, int] = {"": 0, "kick": KICK, "drift": DRIFT}


class Table(Section):
    """Base class of time profiles: tables of times [s] and factors, optionally repeated."""

    def table(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return times since the start of the profile [s] and factors at these times; factors are
        linear in between.
        """
        raise NotImplementedError

    @property
    def period(self) -> float:
        """Time after which the table of factors repeats [s]; 0 if it never repeats."""
        return 0.0


class Constant(Table):
    """A profile whose factor is always 1."""

    kind: Literal["constant"] = "constant"

    def table(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the time [s] and the factor of the profile's only key."""
        return np.zeros(1), np.ones(1)


class Ramp(Table):
    """A profile that changes linearly from one factor to another and is then constant."""

    kind: Literal["ramp"] = "ramp"
    duration: float = Field(default=0.5, ge=SHORTEST, le=LONGEST)
    """Duration of the ramp [s]."""
    first: Factor = 0.0
    """Factor at the start of the ramp."""
    last: Factor = 1.0
    """Factor at the end of the ramp and afterwards."""

    def table(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the times [s] and factors at the start and the end of the change."""
        return np.array([0.0, self.duration]), np.array([self.first, self.last])


class Sine(Table):
    """A profile that oscillates: `offset + sin(2 pi (frequency t + phase / 360))`."""

    kind: Literal["sine"] = "sine"
    frequency: float = Field(default=1.0, ge=1e-5, le=1e4)
    """Frequency of the oscillation [Hz]."""
    phase: float = Field(default=0.0, ge=-360, le=360)
    """Phase of the sine at the start [degrees]."""
    offset: Factor = 0.0
    """Mean factor of the profile, around which the sine oscillates."""

    @property
    def period(self) -> float:
        """Duration of one period [s]."""
        return 1 / self.frequency

    def table(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the times [s] and factors of a single period."""
        parts = np.linspace(0, 1, SEGMENTS + 1)
        wave = np.sin(2 * math.pi * (parts + self.phase / 360))
        return parts / self.frequency, self.offset + wave


class Keyframes(Table):
    """A profile that interpolates linearly between factors at given times."""

    kind: Literal["keyframes"] = "keyframes"
    times: tuple[Instant, ...] = (0.0, 1.0)
    """Times at which the factors apply [s]."""
    factors: tuple[Factor, ...] = (1.0, 1.0)
    """Factors of the profile at `times`."""
    repeat: bool = False
    """Whether the profile repeats after the last time."""

    @model_validator(mode="after")
    def _fits(self) -> Keyframes:
        check_times(self.times, len(self.factors), "factors")
        return self

    @property
    def period(self) -> float:
        """Time of the last key [s] if the keys of the profile repeat, otherwise 0."""
        return self.times[-1] if self.repeat else 0.0

    def table(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the profile's times [s] and the factors at these times."""
        return np.array(self.times), np.array(self.factors)


AnyProfile = Annotated[Constant | Ramp | Sine | Keyframes, Field(discriminator="kind")]


def check_times(times: Sequence[float], values: int, name: str) -> None:
    """Check that times increase and are not negative, and that each time has a value.

    Raises:
        ValueError: A condition is not met.
    """
    if len(times) != values or len(times) < 2:
        raise ValueError(
            f"{len(times)} times and {values} {name} do not match; enter "
            "the same number of each, at least two"
        )
    if times[0] < 0 or any(a >= b for a, b in itertools.pairwise(times)):
        raise ValueError(f"times {times} must increase from 0 on; sort them")


@dataclass(frozen=True)
class Track:
    """A quantity over time: linear between keys, constant before the first and after the last."""

    keys: tuple[Key, ...]
    """Times of the keys since the origin [s], and the track's values at these times."""
    start: float = -FOREVER
    """Time from which the track is active [s]."""
    end: float = FOREVER
    """Time until which the track is active [s]."""
    origin: float = 0.0
    """Time from which the times of the keys are counted [s]."""
    period: float = 0.0
    """Time after which the keys of the track repeat [s]; 0 if they never repeat."""
    mean: bool = False
    """Whether the device uses the mean of the track over each velocity update, and zero while the
    track is inactive. If `mean` is false, the flags in the track's slot determine the value.
    """

    @classmethod
    def constant(cls, value: Sequence[float]) -> Track:
        """Return a track with a constant value."""
        x, y, z = value
        return cls(((0.0, (x, y, z)),))

    @classmethod
    def of_profile(
        cls, value: Sequence[float], profile: Table, start: float, end: float, *, mean: bool
    ) -> Track:
        """Return a track with a value multiplied by a profile.

        A track that starts at time 0 is also active before time 0, so that the first kick is
        complete.

        Args:
            value: The value at factor 1.
            profile: Factors over time, measured from `start`.
            start: Time from which the track is active [s].
            end: Time until which the track is active [s].
            mean: Whether the value is averaged over each kick.
        """
        times, factors = profile.table()
        keys = np.multiply.outer(factors, np.asarray(value, float)).tolist()
        return cls(
            tuple((t, (x, y, z)) for t, (x, y, z) in zip(times.tolist(), keys, strict=True)),
            -FOREVER if start <= 0 else start, end, start, profile.period, mean,
        )  # fmt: skip

    @property
    def varies(self) -> bool:
        """Whether the value of the track changes in time."""
        return len(self.keys) > 1 or self.start > -FOREVER or self.end < FOREVER

    def acts(self, start: float, end: float) -> bool:
        """Return whether the track is active at any time from `start` to `end` [s]."""
        return start < self.end and end > self.start

    def changes(self, start: float, end: float) -> bool:
        """Return whether the track's value may change from `start` to `end` [s].

        A change exactly at `end` is excluded. A live run does not know before `end` about a push
        that begins at `end`. A repetition of this run, which knows about the push, must take the
        same substeps.
        """
        begins_or_ends = start <= self.start < end or start <= self.end < end
        return begins_or_ends or (len(self.keys) > 1 and self.acts(start, end))

    def largest(self, start: float, end: float) -> float:
        """Return an upper bound of the value's norm from `start` to `end` [s]; 0 if inactive."""
        if not self.acts(start, end):
            return 0.0
        return max(math.hypot(*value) for _, value in self.keys)

    def fastest(self, start: float, end: float) -> float:
        """Return the largest norm of the value's rate of change from `start` to `end` [s]."""
        fastest, start, end = 0.0, start - self.origin, end - self.origin
        for (t, a), (u, b) in itertools.pairwise(self.keys):
            repeats = self.period > 0 and end > 0
            if u > t and (repeats or (t < end and u > start)):
                fastest = max(fastest, math.dist(a, b) / (u - t))
        return fastest

    def largest_jump(self, end: float) -> float:
        """Return the norm of the largest jump in the value's rate of change before `end` [s]."""
        times = np.array([time for time, _ in self.keys])
        rates = np.zeros((len(times) + 1, 3))
        rates[1:-1] = np.diff([value for _, value in self.keys], axis=0) / np.diff(times)[:, None]
        if self.period > 0 and end > self.origin + self.period:
            rates[0] = rates[-2]
        jumps = np.linalg.norm(np.diff(rates, axis=0), axis=1)
        return float(jumps[times + self.origin < end].max(initial=0.0))

    def values(self, times: NDArray) -> NDArray[np.float64]:
        """Return the track's values at some times [T,3], ignoring whether the track is active."""
        since = np.asarray(times, float) - self.origin
        if self.period > 0:
            since = np.where(since > 0, since % self.period, since)
        at, keys = np.array([key[0] for key in self.keys]), np.array([key[1] for key in self.keys])
        return np.stack([np.interp(since, at, column) for column in keys.T], axis=1)


STILL = Track.constant((0.0, 0.0, 0.0))
"""Track with the displacement of a wall that never moves."""


class Tracks:
    """All tracks of a run on one device; slot 0 is the sum of the uniform accelerations."""

    def __init__(self, *, real: type, device: str) -> None:
        self.tracks: list[Track] = [Track.constant((0, 0, 0))]
        self.flags: list[int] = [0]
        self.real, self.device = real, device

    def add(self, track: Track, *, limited: bool = False, over: Over = "") -> int:
        """Add a track, and return the index of its slot.

        Args:
            track: The track.
            limited: Whether the stage that uses the track has its own limit, which replaces the
                limit from the track's values.
            over: For a track with `mean` false: the interval of the substep over which the value is
                averaged, "kick" or "drift". The interval may include times at which the track is
                not active. If `over` is empty, the current value is used.
        """
        averaged = MEAN if track.mean else OVER[over]
        return self._append(track, averaged | (LIMITED if limited else 0))

    def accelerate(self, track: Track) -> None:
        """Add a uniform acceleration [m/s^2] to slot 0, from which the grid update reads it."""
        self._append(track, MEAN | JOINS)

    def _append(self, track: Track, flag: int) -> int:
        self.tracks.append(track)
        self.flags.append(flag)
        return len(self.tracks) - 1

    @property
    def vary(self) -> bool:
        """Whether any track changes in time; if not, the tracks are sampled only once."""
        return any(track.varies for track in self.tracks)

    @property
    def acceleration_varies(self) -> bool:
        """Whether the sum of the uniform accelerations changes in time."""
        pairs = zip(self.tracks, self.flags, strict=True)
        return any(track.varies for track, flag in pairs if flag & JOINS)

    def upload(self, clock: wp.array) -> None:
        """Copy the tables of all tracks to the device."""
        t, tracks = types(self.real), self.tracks
        keys = [key for track in tracks for key in track.keys]
        counts = [len(track.keys) for track in tracks]
        spans = [(track.start, track.end, track.origin, track.period) for track in tracks]

        def array(values: object, dtype: object) -> wp.array:
            return wp.array(np.array(values), dtype=dtype, device=self.device)

        self.starts = array(np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), int)
        self.times = array([key[0] for key in keys], self.real)
        self.keys = array([key[1] for key in keys], t.vec3)
        self.spans = array(spans, t.vec4)
        self.flag_array = array(np.array(self.flags, np.int32), int)
        self.values = wp.zeros(len(counts), dtype=t.vec4, device=self.device)
        self.rates = wp.zeros(len(counts), dtype=t.vec4, device=self.device)
        self.clock = clock

    def put(self, slot: int, track: Track) -> None:
        """Replace an uploaded track by a track with the same number of keys."""
        first, count = int(self.starts.numpy()[slot]), len(track.keys)
        self.tracks[slot], keys = track, np.arange(first, first + count)
        put(self.times, np.array([key[0] for key in track.keys]), keys)
        put(self.keys, np.array([key[1] for key in track.keys]), keys)
        span = track.start, track.end, track.origin, track.period
        put(self.spans, np.array([span]), np.array([slot]))

    def record(
        self, clock: wp.array | None = None, outputs: Sequence[wp.array] | None = None
    ) -> wp.Launch:
        """Return the kernel launch that samples all tracks at the time of a clock [3], s.

        By default, the clock is that of the run, and the outputs are the arrays `values` and
        `rates`.
        """
        tables = [self.starts, self.times, self.keys, self.spans, self.flag_array]
        inputs = [*tables, self.clock if clock is None else clock]
        results = list(outputs or [self.values, self.rates])
        launch = record(make_sampler(self.real), len(self.tracks), inputs, results, self.device)
        return cast("wp.Launch", launch)


def kernels(real: type) -> list[wp.Kernel]:
    """Return the kernel that samples tracks."""
    return [make_sampler(real)]
