"""Packs a motion into bytes: static arrays without loss, moving arrays with rounding.

Every array is stored as differences. Bytes of equal significance are grouped, and then compressed
by Zstandard. Positions and F of particles are rounded to `STEP_X` and `STEP_F`. Their differences
are taken in time, and along a Hilbert curve through the particles at rest.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Gaussians, Particles
from phy124.motion.exposed import Exposed
from phy124.motion.recorded import Motion, Rows
from phy124.runtime.memory import release, trim

STEP_X = 2e-5
"""Positions of particles are rounded to multiples of at most this length, relative to the object's
size, unless they move farther than 10,000 times this size.
"""
STEP_F = 2.0**-10
"""Deformation gradients are rounded to multiples of this value."""
LIMIT = 2.0**30
"""Multiples of a step must be smaller, because their differences are stored in 32 bits."""
FRAMES = 32
"""Number of frames that are packed together."""
FAST = 1 << 20
"""Arrays with more values than this are compressed at the second level of `LEVELS`."""
LEVELS = 9, 1
"""Levels of compression for small and for large arrays."""
BITS = 10
"""Binary logarithm of the number of cells of the Hilbert curve along each axis."""
Tensors = dict[str, NDArray]
Packed = tuple[Tensors, dict[str, Any]]
"""Packed arrays [bytes] by name, and the data for `unpack`."""
STATIC = ("means", "quats", "scales", "opacities", "sh", "object_id")
EXPOSED = ("above", "grain", "frame", "x")
"""Names of the arrays of `Exposed` other than its Gaussians; files add the prefix `exposed.`."""


def pack(motion: Motion) -> Packed:
    """Pack the arrays of a motion."""
    still, particles = motion.gaussians, motion.particles
    exact = {name: getattr(still, name) for name in STATIC}
    volumes = _mean_volumes(particles)
    exact |= {"moves": motion.moves, "rest": particles.x, "volume": volumes}
    exact |= {"gaussian": particles.gaussian, "body": particles.body, "carriers": motion.carriers}
    exact |= {"piece": particles.piece, "tracks": motion.tracks, "poses": motion.poses}
    exact |= motion.limits
    if (torn := motion.exposed) is not None:
        exact |= {f"exposed.{name}": getattr(torn.grains, name) for name in STATIC}
        exact |= {f"exposed.{name}": getattr(torn, name) for name in EXPOSED}
    tensors, arrays = {}, {}
    for name, array in exact.items():
        if array is not None:
            tensors[f"motion.{name}"], arrays[name] = _pack_exact(name, np.asarray(array))
    rest = particles.x[motion.carriers].astype(np.float64)
    size = float(np.ptp(rest, axis=0).max()) if len(rest) else 1.0
    steps = {"x": 2.0 ** math.floor(math.log2(STEP_X * max(size, 1e-12))), "F": STEP_F}
    order = hilbert_order(rest)
    for name, rows in (("x", motion.x), ("F", motion.F)):
        chunks, steps[name] = _pack_rows(rows, _base(name, rest), steps[name], order)
        tensors[f"motion.{name}"], lengths = _join(chunks)
        arrays[name] = {"chunks": lengths}
    facts = {"arrays": arrays, "steps": steps, "frames": len(motion.x)}
    return tensors, {**facts, "on_tracks": list(motion.on_tracks), "free": list(motion.free)}


def _pack_rows(
    rows: Rows, base: NDArray[np.float64], step: float, order: NDArray[np.intp]
) -> tuple[list[bytes], float]:
    """Pack the values of particles in all frames, as differences from `base` [P,K].

    Returns:
        The chunks of bytes, and the step to whose multiples the values are rounded: `step`, or a
        larger one if the multiples were too large for 32 bits.

    Raises:
        OverflowError: If a value is not finite.
    """
    chunks = []
    for start in range(0, len(rows), FRAMES):
        part = [rows[i] for i in range(start, min(start + FRAMES, len(rows)))]
        values = np.stack(part).reshape(len(part), *base.shape)
        release(part[0])
        whole = np.empty((base.shape[1], *values.shape[:2]), np.int32)
        for k in range(len(whole)):
            exact = np.rint((values[..., k] - base[:, k]) / step)
            largest = float(np.abs(exact).max(initial=0))
            if not math.isfinite(largest):
                raise OverflowError("a position or F is not finite, so no clip can store it")
            if largest >= LIMIT:
                return _pack_rows(
                    rows, base, math.ldexp(step, math.frexp(largest / LIMIT)[1]), order
                )
            whole[k] = exact[:, order]
        chunks.append(_pack_steps(whole))
        trim()  # Otherwise, the gaps between the chunks could not be reused.
    return chunks, step


def unpack(tensors: Mapping[str, NDArray], facts: Mapping[str, Any], times: NDArray) -> Motion:
    """Return a packed motion; positions and F are unpacked only when they are read.

    Raises:
        KeyError, ValueError, zstandard.ZstdError: The arrays are damaged.
    """
    arrays = facts["arrays"]
    exact = {
        name: _unpack_exact(tensors[f"motion.{name}"], arrays[name])
        for name in arrays
        if name not in ("x", "F")
    }
    still, exposed = _take_gaussians(exact), None
    if "exposed.means" in exact:
        grains = _take_gaussians(exact, "exposed.")
        exposed = Exposed(grains, *(exact.pop(f"exposed.{name}") for name in EXPOSED))
    x = exact.pop("rest")
    particles = Particles(
        x=x,
        volume=exact.pop("volume"),
        density=np.ones(len(x)),
        material=np.zeros(len(x), np.int32),
        gaussian=exact.pop("gaussian"),
        body=exact.pop("body", None),
        piece=exact.pop("piece", None),
    )
    moves, carriers = exact.pop("moves"), exact.pop("carriers")
    tracks, poses = exact.pop("tracks"), exact.pop("poses")
    rest = x[carriers].astype(np.float64)
    order = hilbert_order(rest)
    rows: dict[str, Any] = {
        name: Steps(
            tensors[f"motion.{name}"],
            arrays[name]["chunks"],
            facts["steps"][name],
            _base(name, rest),
            order,
            facts["frames"],
            (len(rest), 3) if name == "x" else (len(rest), 3, 3),
        )
        for name in ("x", "F")
    }
    return Motion(
        gaussians=still,
        moves=moves,
        particles=particles,
        limits=exact,
        carriers=carriers,
        times=times,
        on_tracks=tuple(facts["on_tracks"]),
        tracks=tracks,
        free=tuple(facts["free"]),
        poses=poses,
        exposed=exposed,
        **rows,
    )


def _take_gaussians(arrays: Tensors, prefix: str = "") -> Gaussians:
    means, quats, scales, opacities, sh = (arrays.pop(prefix + name) for name in STATIC[:5])
    return Gaussians(means, quats, scales, opacities, sh, arrays.pop(f"{prefix}object_id", None))


class Steps:
    """Packed positions or F of all frames; the frames that were read last stay unpacked."""

    def __init__(
        self,
        data: NDArray,
        lengths: Sequence[int],
        step: float,
        base: NDArray,
        order: NDArray,
        count: int,
        shape: tuple[int, ...],
    ) -> None:
        self._data, self._step = data, step
        self._place = np.argsort(order)
        self._base = np.ascontiguousarray(base[order].T)
        self._ends = np.cumsum([0, *lengths])
        self._count, self._shape, self._chunk = count, shape, (-1, np.zeros(0))

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, index: Any) -> NDArray[np.float32]:
        """Return the values of the particles in a frame.

        Raises:
            InputError: The packed bytes are damaged.
        """
        which, place = divmod(index, FRAMES)
        if self._chunk[0] != which:
            start, end = self._ends[which : which + 2]
            frames = min(FRAMES, self._count - which * FRAMES)
            width, points = self._base.shape
            try:
                steps = _unpack_steps(self._data[start:end].tobytes(), (width, frames, points))
            except (zstandard.ZstdError, ValueError) as error:
                limit = f"its motion is damaged ({error})."
                raise InputError("clip", f"frame {index}", limit, "Simulate it again.") from error
            self._chunk = which, steps
        values = (self._base + self._chunk[1][:, place] * self._step).T
        row = np.ascontiguousarray(values, np.float32).take(self._place, axis=0)
        return row.reshape(self._shape)


def hilbert_order(points: NDArray[np.float64]) -> NDArray[np.intp]:
    """Return the order of points [P,3] along a Hilbert curve (Skilling 2004, 10.1063/1.1751381)."""
    if not len(points):
        return np.zeros(0, np.intp)
    low, size = points.min(axis=0), max(float(np.ptp(points, axis=0).max()), 1e-12)
    x = ((points - low) / size * (2**BITS - 1)).astype(np.int64).T.copy()
    bit = 1 << (BITS - 1)
    while bit > 1:
        for i in range(3):
            high = (x[i] & bit) > 0
            x[0] = np.where(high, x[0] ^ (bit - 1), x[0])
            swap = np.where(high, 0, (x[0] ^ x[i]) & (bit - 1))
            x[0] ^= swap
            x[i] ^= swap
        bit >>= 1
    x[1] ^= x[0]
    x[2] ^= x[1]
    turn = np.zeros_like(x[0])
    for power in range(BITS - 1, 0, -1):
        turn = np.where(x[2] & (1 << power), turn ^ ((1 << power) - 1), turn)
    x ^= turn
    code = np.zeros_like(x[0])
    for power in range(BITS - 1, -1, -1):
        for i in range(3):
            code = (code << 1) | ((x[i] >> power) & 1)
    return np.argsort(code, kind="stable")


def _base(name: str, rest: NDArray) -> NDArray[np.float64]:
    return rest if name == "x" else np.broadcast_to(np.eye(3).ravel(), (len(rest), 9))


def _mean_volumes(particles: Particles) -> NDArray[np.float64]:
    """Return the mean volume per body for each particle [P]; the binding needs no other volumes."""
    body = np.zeros(len(particles.x)) if particles.body is None else particles.body
    volume = particles.volume.astype(np.float64)
    for number in np.unique(body):
        inside = body == number
        # The mean of equal numbers can differ from them by rounding; a clip that is read and saved
        # again would change.
        if np.ptp(volume[inside]) > 0:
            volume[inside] = volume[inside].mean()
    return volume


def _pack_steps(steps: NDArray[np.int32]) -> bytes:
    """Pack integers [K,T,P] as differences in time, and then along a Hilbert curve."""
    steps = np.diff(steps, axis=1, prepend=np.int32(0))
    return _compress(_zigzag(np.diff(steps, axis=2, prepend=np.int32(0)), 4))


def _unpack_steps(data: bytes, shape: tuple[int, int, int]) -> NDArray[np.int32]:
    steps = _unzigzag(_decompress(data, 4)).reshape(shape)
    np.cumsum(steps, axis=2, dtype=np.int32, out=steps)
    for before, after in pairwise(range(shape[1])):
        steps[:, after] += steps[:, before]
    return steps


def _pack_exact(name: str, array: NDArray) -> tuple[NDArray[np.uint8], dict[str, Any]]:
    """Pack an array without loss; a column that equals the previous column takes no bytes."""
    columns = _columns(array)
    last, chunks = None, []
    for index in _column_order(name, len(columns)):
        column = columns[index]
        if name.endswith("quats") and index == 0:
            column = column - _bits(_real_part(columns))
        same = last is not None and np.array_equal(column, last)
        size = column.dtype.itemsize
        chunks.append(b"" if same else _compress(_zigzag(np.diff(column, prepend=0), size)))
        last = column
    data, lengths = _join(chunks)
    return data, {"dtype": array.dtype.str, "shape": list(array.shape), "chunks": lengths}


def _unpack_exact(data: NDArray, facts: Mapping[str, Any]) -> NDArray:
    dtype, shape = np.dtype(facts["dtype"]), tuple(facts["shape"])
    ends = np.cumsum([0, *facts["chunks"]])
    width = len(facts["chunks"])
    columns = np.empty((width, shape[0]), _whole(dtype))
    quats = width == 4 and shape[1:] == (4,)
    last = None
    for place, index in enumerate(_column_order("quats" if quats else "", width)):
        chunk = data[ends[place] : ends[place + 1]].tobytes()
        if chunk or last is None:
            last = np.cumsum(_unzigzag(_decompress(chunk, dtype.itemsize)), dtype=columns.dtype)
        columns[index] = last
        if quats and index == 0:
            columns[0] += _bits(_real_part(columns))
    return np.ascontiguousarray(columns.T).view(dtype).reshape(shape)


def _column_order(name: str, count: int) -> Sequence[int]:
    """Return the order of columns; the real part of quaternions is computed last."""
    return (1, 2, 3, 0) if name.endswith("quats") and count == 4 else range(count)


def _real_part(columns: NDArray) -> NDArray[np.float32]:
    """Return the positive real part of unit quaternions from the bits of the other parts."""
    x, y, z = (columns[k].view(np.float32).astype(np.float64) for k in (1, 2, 3))
    return np.sqrt(np.maximum(1 - x * x - y * y - z * z, 0)).astype(np.float32)


def _whole(dtype: np.dtype) -> np.dtype:
    return np.dtype(f"<i{dtype.itemsize}")


def _bits(array: NDArray) -> NDArray:
    return np.ascontiguousarray(array).view(_whole(array.dtype))


def _columns(array: NDArray) -> NDArray:
    """Return the bits of an array as integers, transposed."""
    return np.ascontiguousarray(_bits(array).reshape(len(array), math.prod(array.shape[1:])).T)


def _zigzag(values: NDArray, size: int) -> NDArray:
    """Map integers to non-negative integers, so that integers close to 0 become small."""
    whole = values.astype(f"<i{size}", copy=False)
    return ((whole << 1) ^ (whole >> (8 * size - 1))).view(f"<u{size}")


def _unzigzag(values: NDArray) -> NDArray:
    """Invert `_zigzag`; `values` are overwritten."""
    signed = values.view(f"<i{values.dtype.itemsize}")
    odd = signed & 1
    values >>= 1
    signed ^= np.negative(odd, out=odd)
    return signed


def _compress(values: NDArray) -> bytes:
    """Compress numbers after placing bytes of equal significance next to each other."""
    planes = np.ascontiguousarray(values).reshape(-1).view(np.uint8)
    planes = np.ascontiguousarray(planes.reshape(-1, values.dtype.itemsize).T)
    level = LEVELS[values.size > FAST]
    return zstandard.ZstdCompressor(level=level).compress(planes.tobytes())


def _decompress(data: bytes, size: int) -> NDArray:
    planes = np.frombuffer(zstandard.ZstdDecompressor().decompress(data), np.uint8)
    planes = planes.reshape(size, -1)
    values = np.zeros((planes.shape[1], size), np.uint8)
    for place, plane in enumerate(planes):
        if plane.any():  # The upper bytes of small numbers are zero.
            values[:, place] = plane
    return values.view(f"<u{size}").reshape(-1)


def _join(chunks: Sequence[bytes]) -> tuple[NDArray[np.uint8], list[int]]:
    return np.frombuffer(b"".join(chunks), np.uint8), [len(chunk) for chunk in chunks]
