"""Computes the frames of a clip from the motion of the carrying particles.

The shapes of the Gaussians in a frame depend on the shapes in the previous frame
(`phy124.motion.deform`). Frames are therefore computed in order, from the first frame or from the
nearest stored state. Every reading of a frame then gives bitwise equal results.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from threading import RLock
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from phy124.gaussians import Array, Gaussians, Particles, join, rotate_sh
from phy124.motion.exposed import Exposed
from phy124.motion.scenery import Scenery
from phy124.runtime.cores import cores
from phy124.runtime.memory import release, trim

if TYPE_CHECKING:
    from phy124.motion.binding import Binding
    from phy124.motion.deform import Deformer

KEPT = 256e6
"""All computed frames of a clip are kept if their total size is at most this [bytes]."""
NEAR = 4
"""Number of frames that are kept if a clip is larger than `KEPT`."""
TRIM = 32
"""Number of frames after which freed memory is returned to the system."""
STATES = 16e6
"""Largest total size of the stored states [bytes]. Later frames are computed from these states."""
BYTES = 40
"""Size of one Gaussian in a computed frame [bytes]."""
STATE = 32
"""Size of one Gaussian in a stored state [bytes]."""
MOVING = ("means", "quats", "scales", "rotations")


class Rows(Protocol):
    """A sequence with one array per frame."""

    def __len__(self) -> int: ...

    def __getitem__(self, index: int, /) -> NDArray: ...


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of the particles that carry the Gaussians of a clip, in T frames."""

    gaussians: Gaussians
    """All N Gaussians at rest."""
    moves: NDArray[np.bool_]
    """Mask of the Gaussians that particles carry [N]."""
    particles: Particles
    """All particles at rest [P]."""
    limits: dict[str, NDArray]
    """Limits on the shapes of Gaussians, as arguments of `Deformer`."""
    carriers: NDArray[np.int32]
    """Indices of the particles that carry Gaussians [C]."""
    x: Rows
    """Positions of the carrying particles in each frame [C,3], m."""
    F: Rows
    """Deformation gradients of the carrying particles in each frame [C,3,3]."""
    times: NDArray[np.float64]
    """Times of the frames [T], s."""
    on_tracks: tuple[int, ...]
    """Indices of the objects that follow a prescribed path."""
    tracks: NDArray[np.float64]
    """Displacements of the objects in `on_tracks` [T,K,3], m."""
    free: tuple[int, ...]
    """Indices of the objects that are rigid solids."""
    poses: NDArray[np.float64]
    """Centres [m] and rotations (wxyz) of the rigid solids [T,R,7]."""
    binding: Binding | None = None
    """Particles that carry the moving Gaussians, if already known."""
    exposed: Exposed | None = None
    """Additional Gaussians that become visible if the object tears."""
    describes: tuple[Any, ...] = ()
    """Arrays of a clip that can be computed from this motion (`phy124.io.clip.DESCRIBED`)."""

    @property
    def shown(self) -> Gaussians:
        """All Gaussians at rest; Gaussians that become visible by a tear come last."""
        return (
            self.gaussians if self.exposed is None else join([self.gaussians, self.exposed.grains])
        )


class Track:
    """Displacement of an object along its prescribed path, in each frame."""

    def __init__(self, times: NDArray, displacements: NDArray) -> None:
        """Store the displacements [T,3] at the times [T]."""
        self._times, self._displacements = times, displacements

    def values(self, times: NDArray) -> NDArray:
        """Return the displacements [T,3], m, of the last frames at or before some times."""
        return self._displacements[np.searchsorted(self._times, times, side="right") - 1]


class Recorded:
    """The frames of a clip, each computed from the motion of the particles when it is read."""

    def __init__(
        self,
        motion: Motion,
        chosen: NDArray | None = None,
        measure: Callable[[dict[str, Array]], Any] | None = None,
        threads: int | None = None,
        frames: int = 0,
    ) -> None:
        """Prepare to compute frames; nothing is computed before the first frame is read.

        Args:
            motion: The motion.
            chosen: Indices of the Gaussians that the frames contain [M]; None: all Gaussians.
            measure: Function that is called once with the arrays of each computed frame.
            threads: Number of CPU threads; None: one per core.
            frames: Final number of frames, if frames are still being added to the motion.
        """
        self.motion, self.chosen = motion, chosen
        self._threads, self._expected = threads, frames
        self._measure, self._measured = measure, dict[int, Any]()
        self.count = len(motion.gaussians) if chosen is None else len(chosen)
        self._deformer: Deformer | None = None
        self._next = 0
        self._frames = OrderedDict[int, dict[str, Array]]()
        self._states = dict[int, dict[str, NDArray]]()
        self._lock = RLock()

    def __len__(self) -> int:
        return len(self.motion.times)

    @property
    def _length(self) -> int:
        """Number of frames, including frames that will be added later."""
        return max(len(self), self._expected)

    @property
    def _keeps_all(self) -> bool:
        return BYTES * self.count * self._length <= KEPT

    @property
    def turns(self) -> bool:
        """Whether frames have rotations of the material."""
        return self.motion.gaussians.sh_degree > 0

    def gaussians(self, index: int) -> Gaussians:
        """Return the Gaussians of a frame, with colours rotated with the material."""
        row = self.row(index)
        sh = self.motion.gaussians.sh
        if "rotations" in row:
            sh = rotate_sh(sh, row["rotations"])
        return replace(self.motion.gaussians, **{name: row[name] for name in MOVING[:3]}, sh=sh)

    def row(self, index: int) -> dict[str, Array]:
        """Return the arrays of a frame by name."""
        with self._lock:
            if index in self._frames:
                self._frames.move_to_end(index)
                return self._frames[index]
            if self._next > index:
                self._return_to(index)
            for _ in range(index - self._next):
                self._advance()
            row = self._advance()
            self._frames[index] = row
            # A larger clip is read frame by frame, so keeping earlier frames would not help.
            while len(self._frames) > NEAR and not self._keeps_all:
                self._frames.popitem(last=False)
            return row

    def measurements(self, *, every: bool = True) -> list[Any]:
        """Return the results of `measure` for all frames; if `every` is false, only for the frames
        computed so far.
        """
        for index in range(len(self) if every else 1):
            if index not in self._measured:
                self.row(index)
        return [self._measured[index] for index in sorted(self._measured)]

    def rows_of(self, chosen: NDArray) -> Iterator[dict[str, Array]]:
        """Yield the arrays of chosen Gaussians, frame by frame.

        The frames of a short clip are kept, because its Gaussians will be read again for drawing.
        """
        if self._keeps_all:
            rows = (self.row(index) for index in range(len(self)))
            return ({name: array[chosen] for name, array in row.items()} for row in rows)
        part = Recorded(self.motion, chosen)
        return (part._advance() for _ in range(len(self)))

    def _return_to(self, index: int) -> None:
        start = max((state for state in self._states if state <= index), default=0)
        self._next = start
        assert self._deformer is not None
        if start in self._states:
            self._deformer.restore(self._states[start])
        else:
            self._deformer.reset()

    def _advance(self) -> dict[str, Array]:
        motion, index = self.motion, self._next
        if self._deformer is None:
            self._prepare()
        deformer = self._deformer
        assert deformer is not None
        every = max(16, int(self.count * STATE * self._length / STATES) + 1)
        if index and index % every == 0 and index not in self._states:
            self._states[index] = deformer.snapshot()
        for array, rows in ((self._x, motion.x), (self._F, motion.F)):
            array[motion.carriers] = row = rows[index]
            release(row)
        time = float(motion.times[index])
        frame = deformer(self._x, self._F, index=index, time=time, colours=False)
        rotations = deformer.rotations
        poses = (motion.poses[0], motion.poses[index]) if motion.free else ()
        frame = self._scenery.whole(frame, poses)
        self._next += 1
        if self._next % TRIM == 0:
            trim()
        gaussians = frame.gaussians
        row = {name: getattr(gaussians, name) for name in MOVING[:3]}
        if rotations is not None:
            row["rotations"] = self._scenery.turns(rotations)
        if self._measure is not None and index not in self._measured:
            self._measured[index] = self._measure(row)
        return row

    def _prepare(self) -> None:
        from phy124.motion.binding import bind  # This import loads Warp.
        from phy124.motion.deform import Deformer

        motion, chosen = self.motion, self.chosen
        gaussians, moves = motion.gaussians, motion.moves
        limits: dict[str, Any] = dict(motion.limits)
        particles, binding = motion.particles, motion.binding
        if chosen is not None:
            places = (np.cumsum(moves)[chosen] - 1)[moves[chosen]]
            if binding is None and (particles.gaussian >= 0).any():
                binding = bind(gaussians.select(moves), particles)
            binding = binding and binding.select(places)
            gaussians, moves = gaussians.select(chosen), moves[chosen]
            limits = {name: array[places] for name, array in limits.items()}
        tracks = tuple(
            (index, Track(motion.times, motion.tracks[:, k]))
            for k, index in enumerate(motion.on_tracks)
        )
        self._scenery = Scenery(gaussians, moves, tracks, motion.free)
        self._deformer = Deformer(
            self._scenery.moving,
            particles,
            **limits,
            binding=binding,
            threads=self._threads or cores(),
        )
        self._x = np.zeros((len(particles.x), 3), np.float32)
        self._F = np.zeros((len(particles.x), 3, 3), np.float32)


class Torn:
    """Frames of a motion. In each frame, the Gaussians that a tear makes visible come last."""

    def __init__(self, recorded: Frames, exposed: Exposed) -> None:
        """Store the frames, which do not contain the exposed Gaussians."""
        self._recorded, self._exposed = recorded, exposed
        self.count, self.turns = recorded.count + len(exposed.above), recorded.turns
        self._last: tuple[int, dict[str, Array]] = -1, {}

    def __len__(self) -> int:
        return len(self._recorded)

    def row(self, index: int) -> dict[str, Array]:
        """Return the arrays of a frame by name."""
        if self._last[0] != index:
            every = np.arange(self.count)
            carried, grains = self._split(every)
            row = {name: array[carried] for name, array in self._recorded.row(index).items()}
            self._last = index, self._exposed.show(row, index, grains)
        return self._last[1]

    def rows_of(self, chosen: NDArray) -> Iterator[dict[str, Array]]:
        """Yield the arrays of chosen Gaussians, frame by frame, without keeping frames."""
        carried, grains = self._split(chosen)
        for index, row in enumerate(self._recorded.rows_of(carried)):
            yield self._exposed.show(row, index, grains)

    def _split(self, chosen: NDArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return the indices of the carried and the exposed Gaussian for each chosen Gaussian.

        The second index is -1 if the Gaussian does not become visible by a tear.
        """
        grains = np.maximum(chosen - self._recorded.count, -1)
        return np.where(grains < 0, chosen, self._exposed.above[grains]), grains


Frames = Recorded | Torn


class Computed(NDArrayOperatorsMixin):
    """One array of all frames [T,N,...], computed frame by frame when it is read."""

    def __init__(self, recorded: Frames, name: str, *, columns: NDArray | None = None) -> None:
        self.recorded, self.name, self.columns = recorded, name, columns
        count = recorded.count if columns is None else len(columns)
        self.shape = (len(recorded), count, 4 if name in ("quats", "rotations") else 3)
        self.dtype, self.ndim = np.dtype(np.float32), 3

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[Array]:
        return (self[index] for index in range(len(self)))

    def __getitem__(self, key: Any) -> Array:
        """Index the whole array as NumPy does."""
        rows, rest = (key[0], key[1:]) if isinstance(key, tuple) else (key, ())
        if isinstance(rows, (int, np.integer)):
            index = range(len(self))[rows]
            row = self.recorded.row(index)[self.name]
            return (row if self.columns is None else row[self.columns])[rest]
        chosen = np.arange(len(self))[rows]
        every = isinstance(rows, slice) and len(chosen) == len(self)
        if every and self.columns is None and rest and isinstance(rest[0], np.ndarray):
            which = rest[0] if rest[0].dtype != bool else np.flatnonzero(rest[0])
            values = np.stack([row[self.name] for row in self.recorded.rows_of(which)])
            return values[(slice(None), slice(None), *rest[1:])]
        return np.stack([self[int(index)][rest] for index in chosen])

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        return np.asarray(self[:], dtype)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        whole = (np.asarray(i) if isinstance(i, Computed) else i for i in inputs)
        return getattr(ufunc, method)(*whole, **options)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(np.asarray(self), name)

    def select(self, columns: slice | NDArray) -> Computed:
        """Return the array of the Gaussians that a slice or an index array selects."""
        every = np.arange(self.recorded.count) if self.columns is None else self.columns
        return Computed(self.recorded, self.name, columns=every[columns])


def frames_of(motion: Motion) -> Frames:
    """Return the frames of a recorded motion; each frame is computed when it is read."""
    frames = Recorded(motion)
    return frames if motion.exposed is None else Torn(frames, motion.exposed)


def make_arrays(recorded: Frames) -> dict[str, Any]:
    """Return the arrays of all frames by name."""
    names = MOVING if recorded.turns else MOVING[:3]
    return {name: Computed(recorded, name) for name in names}
