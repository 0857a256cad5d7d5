"""Writes a clip as one small file: the first frame as SOG, and the motion of a coarse lattice.

The displacement of a Gaussian is interpolated trilinearly from the eight nodes around it. The
displacements of the nodes are fitted to the displacements of the Gaussians by least squares. A
Gaussian whose error would exceed `TOLERANCE` times the object's size gets an extra shift in each
frame. The file states the remaining error of each Gaussian. Layout, little endian, with offsets
from the start of the file:

    bytes          content
    0 to 7         "PHY4D" 0 1 0
    8 to 11        length of the JSON, uint32
    12 on          JSON: count, times [s], origin [3] and spacing of the lattice [m], shape [3],
                   nodes and exceptions (numbers), size [m], error {max, p99} [m] and {shape},
                   player (settings of the player, in the axes of phy124), and sections
                   [offset, length]: still (SOG), indices, frames (one each), errors
    indices        index of each node in the lattice, in C order, then of each exception, uint32;
                   compressed by zlib
    frames[k]      float32 step [m]; then int16 in steps, compressed by zlib: displacements of the
                   nodes, then shifts of the exceptions, all x, all y, all z; each value is stored
                   as its difference from the previous one
    errors         largest error of each Gaussian, uint8 in steps of error.max / 255, rounded up;
                   compressed by zlib

Each frame can be decoded alone, so a reader can request only a range of bytes. docs/guide/p4d.md
describes readers in Python and JavaScript. The axes are as in SOG: -y up, -z to the front.
"""

from __future__ import annotations

import json
import os
import tempfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import rotation_matrices
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.clip import Clip
from phy124.io.content import Y_DOWN
from phy124.io.files import replacing
from phy124.io.formats import sog
from phy124.progress import Progress, silent
from phy124.runtime.memory import release

MAGIC = b"PHY4D\0\1\0"
TOLERANCE = 1e-3
"""Largest error of a Gaussian's centre, relative to the object's size."""
NODES = (12, 17, 24, 34)
"""These numbers of nodes along the object's longest side are tried; the smallest file is kept."""
STIFF = 1e-4
"""Weight of the term that makes neighbouring nodes move alike. Without this term, the motion of
nodes with few Gaussians nearby would be undetermined.
"""
STEP = TOLERANCE / 8
"""Quantisation step of the displacements of lattice nodes, relative to the object's size."""
LOOSE = 0.5
"""Largest error of the shapes for which a file shows the clip well; see `encode`."""
LARGEST = 2**15 - 1
TALLEST = 4.0
"""Largest magnitude of the logarithm of a Gaussian's scale divided by its scale at rest; exp(4) =
55.
"""
STRETCHES = 1 << 22
"""Largest number of samples from which the range of the material's stretch is determined."""
PERCENTILES = (1, 99)
"""Percentiles of the material's stretch at the ends of the colour ramp; outliers are ignored."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """The nodes of a lattice, and the trilinear weights with which they move each Gaussian."""

    origin: NDArray[np.float64]
    spacing: float
    shape: NDArray[np.int64]
    indices: NDArray[np.int64]
    """Indices of the nodes in the complete lattice [M], in increasing order."""
    weights: Any
    """Trilinear weights of M nodes for N Gaussians, a sparse matrix [N,M]."""

    @classmethod
    def around(cls, points: NDArray[np.float64], nodes: int) -> Lattice:
        """Build the lattice with `nodes` nodes along the longest side of points [N,3], m."""
        from scipy import sparse

        low = points.min(axis=0)
        spacing = measure_size(points) / (nodes - 1)
        origin = low - 1e-4 * spacing
        at = (points - origin) / spacing
        cell = np.floor(at).astype(np.int64)
        shape = cell.max(axis=0) + 2
        corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), -1).reshape(-1, 3)
        fraction = (at - cell)[:, None]
        weights = np.where(corners, fraction, 1 - fraction).prod(axis=-1)
        whole = (cell[:, None] + corners) @ [shape[1] * shape[2], shape[2], 1]
        indices, columns = np.unique(whole, return_inverse=True)
        rows = np.repeat(np.arange(len(points)), 8)
        entries = (weights.ravel(), (rows, columns.ravel()))
        matrix = sparse.csr_matrix(entries, (len(points), len(indices)))
        return cls(origin, spacing, shape, indices, matrix)

    def slopes(self, points: NDArray[np.float64]) -> list[Any]:
        """Return the derivatives of the weights along each axis at points [N,3], one sparse matrix
        [N,M] per axis, 1/m.
        """
        at = (points - self.origin) / self.spacing
        fraction, slopes = (at - np.floor(at))[:, None], []
        far = np.arange(8)[:, None] >> [2, 1, 0] & 1
        factors = np.where(far, fraction, 1 - fraction)
        for axis in range(3):
            others = factors[..., [(axis + 1) % 3, (axis + 2) % 3]].prod(axis=-1)
            slope = self.weights.copy()
            slope.data = ((2 * far[:, axis] - 1) * others / self.spacing).ravel()
            slopes.append(slope)
        return slopes

    def solver(self) -> Any:
        """Factorise the least-squares problem for the displacements of the nodes."""
        from scipy import sparse
        from scipy.sparse.linalg import splu

        at = np.stack(np.unravel_index(self.indices, self.shape), axis=-1)
        number = np.full(self.shape, -1)
        number[tuple(at.T)] = np.arange(len(at))
        pairs = []
        for axis in range(3):
            next_to = at + np.eye(3, dtype=np.int64)[axis]
            inside = next_to[:, axis] < self.shape[axis]
            other = np.where(inside, number[tuple(np.minimum(next_to, self.shape - 1).T)], -1)
            pairs.append(np.stack([np.flatnonzero(other >= 0), other[other >= 0]], axis=-1))
        first, second = np.concatenate(pairs).T
        rows = np.arange(len(first))
        ones = np.ones(len(first))
        size = (len(first), len(self.indices))
        edges = sparse.csr_matrix((ones, (rows, first)), size)
        edges -= sparse.csr_matrix((ones, (rows, second)), size)
        normal = self.weights.T @ self.weights + STIFF * (edges.T @ edges)
        return splu((normal + 1e-9 * sparse.identity(len(self.indices))).tocsc())


def write_lattice4d(
    path: str | os.PathLike[str], clip: Clip, *, progress: Progress = silent
) -> list[str]:
    """Write the object of a clip as one file, atomically; return notes about its accuracy.

    Raises:
        InputError: The clip is empty, or the file cannot be written.
    """
    parts, errors = encode(clip, clip.object_mask, progress=progress)
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.writelines(parts)
    changes = []
    if errors.centre > TOLERANCE:
        changes.append(
            f"displaces the centres of the Gaussians by up to {100 * errors.centre:.2g} % of the "
            "object's size, since the object moves too far for displacements in 16 bits"
        )
    if errors.shape > LOOSE:
        changes.append(
            f"changes the covariances of the Gaussians by up to {100 * errors.shape:.0f} % (99th "
            "percentile), since a lattice cannot describe this motion"
        )
    return [f"P4D {change}. Use the format usd or 4dgs." for change in changes]


class Errors(NamedTuple):
    """Errors of the Gaussians in a file."""

    centre: float
    """Largest error of a centre, relative to the object's size."""
    shape: float
    """Largest relative error of a covariance: the 99th percentile over all Gaussians."""


def encode(
    clip: Clip,
    mask: NDArray[np.bool_],
    *,
    player: dict[str, Any] | None = None,
    shades: bytes = b"",
    progress: Progress = silent,
) -> tuple[list[bytes], Errors]:
    """Return the bytes of a file as a list of sections, and the errors of the Gaussians.

    The covariances of the Gaussians are computed from the deformation gradient of the lattice.

    Args:
        clip: The clip.
        mask: The Gaussians to write [N].
        player: Further entries of the JSON for the player.
        shades: The player's shadow maps.
        progress: Function that is called as progress("export", lattices tried, lattices in total).

    Raises:
        InputError: The clip is empty.
    """
    clip.refuse_empty()
    turn = orientation(*Y_DOWN).T
    first = rotate_gaussians(clip.frame(0).gaussians.select(mask), turn)
    still = sog.encode(first)
    rest = _centres(still)
    size = measure_size(rest)
    with tempfile.TemporaryFile() as file:
        places = np.memmap(file, np.float32, shape=(len(clip), len(rest), 3))
        for index in range(len(clip)):
            places[index] = clip.means[index][mask] @ turn.T
            release(places)
        motion = _Motion.of(Lattice.around(rest, NODES[0]), rest, places)
        for index, nodes in enumerate(NODES[1:], 1):
            progress("export", index, len(NODES))
            finer = _Motion.of(Lattice.around(rest, nodes), rest, places)
            if finer.size > motion.size:
                break
            motion = finer
        progress("export", len(NODES), len(NODES))
        del places
    lattice, errors = motion.lattice, motion.errors
    shape = float(np.percentile(_shape_errors(clip, mask, motion, rest, turn), 99))
    worst = float(errors.max()) or 1e-12
    steps = np.ceil(errors / worst * 255).astype(np.uint8)
    about = {
        "count": len(rest),
        "times": (clip.times - clip.times[0]).tolist(),
        "origin": lattice.origin.tolist(),
        "spacing": lattice.spacing,
        "shape": lattice.shape.tolist(),
        "nodes": len(lattice.indices),
        "exceptions": len(motion.exceptions),
        "size": size,
        "error": {"max": worst, "p99": float(np.percentile(errors, 99)), "shape": shape},
        "player": {**measure(clip), **(player or {})},
    }
    numbers = np.concatenate([lattice.indices, motion.exceptions]).astype("<u4").tobytes()
    parts = [still, zlib.compress(numbers, 9), *motion.frames]
    sections = _pack(about, [*parts, zlib.compress(steps.tobytes(), 9), shades])
    return sections, Errors(worst / size, shape)


def measure_size(points: NDArray[np.float64]) -> float:
    """Return the longest side of the box of points [N,3], m; 1 if all points coincide."""
    return float(np.ptp(points, axis=0).max()) or 1.0


def measure(clip: Clip) -> dict[str, Any]:
    """Measure, over all frames, the ranges of values that the player needs when it starts.

    The stretch is the longest axis of a Gaussian divided by the longest axis at rest. The colour
    ramp for the stretch is symmetric about 1.
    """
    rest = np.maximum(clip.scales[0], 1e-9)
    some = slice(None, None, 1 + len(clip) * len(rest) // STRETCHES)
    stretch, ends = np.empty((len(clip), len(rest[some])), np.float32), []
    # Frames are read one by one, because a clip may be larger than the memory.
    for index in range(len(clip)):
        means, scales = clip.means[index], clip.scales[index]
        ratios = np.log(np.maximum(scales, 1e-9) / rest)
        ends.append((means.min(axis=0), means.max(axis=0), ratios.min(), ratios.max()))
        stretch[index] = scales[some].max(axis=1) / rest[some].max(axis=1)
    lowest, highest, shrunk, grown = zip(*ends, strict=True)
    low, high = np.percentile(stretch, PERCENTILES, overwrite_input=True).tolist()
    half = max(1 - low, high - 1, 0.01)
    return {
        "low": np.min(lowest, axis=0).tolist(),
        "high": np.max(highest, axis=0).tolist(),
        "ratio": [max(float(min(shrunk)), -TALLEST), min(float(max(grown)), TALLEST)],
        "speed": max(float(speeds.max()) for speeds in measure_speeds(clip)),
        "stretch": [1 - half, 1 + half],
    }


def measure_speeds(clip: Clip) -> Iterator[NDArray]:
    """Yield the speeds of the N Gaussians in each frame [N], m/s.

    If the clip has no velocities, the speeds are computed from the positions in adjacent frames.
    """
    if clip.velocities is not None or len(clip) < 2:
        for index in range(len(clip)):
            still = np.zeros_like(clip.means[index])
            yield np.linalg.norm(
                still if clip.velocities is None else clip.velocities[index], axis=1
            )
        return
    before, now = None, clip.means[0]
    for index in range(len(clip)):
        after = clip.means[index + 1] if index + 1 < len(clip) else None
        near = np.stack([means for means in (before, now, after) if means is not None])
        times = clip.times[max(index - 1, 0) : index + 2]
        slopes = np.gradient(near, times, axis=0)
        yield np.linalg.norm(slopes[min(index, 1)], axis=1)
        before, now = now, after


def _shape_errors(
    clip: Clip, mask: NDArray[np.bool_], motion: _Motion, rest: NDArray, turn: NDArray
) -> NDArray[np.float64]:
    """Return the largest relative error of each Gaussian's covariance [N] in a few frames."""
    first = _covariances(clip, 0, mask, turn)
    slopes = motion.lattice.slopes(rest)
    errors = np.zeros(len(first))
    for index in _compared(len(clip)):
        gradient = np.eye(3) + np.stack([slope @ motion.moved[index] for slope in slopes], axis=-1)
        made = np.einsum("nij,njk,nlk->nil", gradient, first, gradient)
        true = _covariances(clip, index, mask, turn)
        error = np.linalg.norm(made - true, axis=(1, 2)) / np.linalg.norm(true, axis=(1, 2))
        errors = np.maximum(errors, error)
    return errors


def _covariances(clip: Clip, index: int, mask: NDArray[np.bool_], turn: NDArray) -> NDArray:
    """Return the covariances of Gaussians in a frame [N,3,3], m^2, in the axes of the file."""
    turns = turn @ rotation_matrices(clip.quats[index][mask])
    return np.einsum("nij,nj,nkj->nik", turns, clip.scales[index][mask].astype(float) ** 2, turns)


def _centres(still: bytes) -> NDArray[np.float64]:
    """Return the quantised centres [N,3], m, that a SOG file stores."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "still.sog"
        path.write_bytes(still)
        content = sog.read(path)
        return content.gaussians.means.astype(np.float64) + content.origin


@dataclass(frozen=True, eq=False)
class _Motion:
    """Displacements of a lattice, and extra shifts of Gaussians whose error would be too large."""

    lattice: Lattice
    exceptions: NDArray[np.int64]
    """Indices [E] of the Gaussians with an extra shift."""
    frames: list[bytes]
    errors: NDArray[np.float64]
    """Largest error of each Gaussian's position over all frames [N], m."""
    moved: dict[int, NDArray[np.float64]]
    """Displacements of the lattice nodes [M,3], m, for each frame in which shapes are compared."""

    @property
    def size(self) -> int:
        return sum(map(len, self.frames)) + 2 * len(self.lattice.indices)

    @classmethod
    def of(
        cls, lattice: Lattice, rest: NDArray[np.float64], places: NDArray[np.float32]
    ) -> _Motion:
        """Fit a lattice to the positions of Gaussians in all frames (shape [T,N,3], metres)."""
        solver, size = lattice.solver(), measure_size(rest)
        errors, fitted = np.zeros(len(rest)), []
        for place in places:
            moved = solver.solve(lattice.weights.T @ (place - rest))
            step = float(np.float32(max(float(np.abs(moved).max()) / LARGEST, STEP * size)))
            whole = np.rint(moved / step).astype("<i2")
            fitted.append((step, whole))
            rest_error = place - rest - lattice.weights @ (whole * step)
            errors = np.maximum(errors, np.linalg.norm(rest_error, axis=1))
            release(places)
        exceptions = np.flatnonzero(errors > TOLERANCE * size)
        weights = lattice.weights[exceptions]
        errors[exceptions], frames = 0.0, []
        for place, (step, whole) in zip(places, fitted, strict=True):
            rest_error = place[exceptions] - rest[exceptions] - weights @ (whole * step)
            release(places)
            shifts = np.rint(rest_error / step).clip(-LARGEST, LARGEST).astype("<i2")
            left = np.linalg.norm(rest_error - shifts * step, axis=1)
            errors[exceptions] = np.maximum(errors[exceptions], left)
            change = np.diff(np.concatenate([whole, shifts]).T, axis=1, prepend=np.int16(0))
            frames.append(np.float32(step).tobytes() + zlib.compress(change.tobytes(), 9))
        compared = ((index, *fitted[index]) for index in _compared(len(places)))
        moved = {index: whole * step for index, step, whole in compared}
        return cls(lattice, exceptions, frames, errors, moved)


def _compared(count: int) -> set[int]:
    return {count // 2, count - 1}


def _pack(about: dict[str, Any], parts: list[bytes]) -> list[bytes]:
    """The JSON is padded with spaces, so that its length is known in advance."""
    start = 12 + len(json.dumps(about)) + 200 + 32 * len(parts)
    offsets = start + np.cumsum([0, *map(len, parts[:-1])])
    sections = [[int(at), len(part)] for at, part in zip(offsets, parts, strict=True)]
    about |= {"still": sections[0], "indices": sections[1]}
    about |= {"frames": sections[2:-2], "errors": sections[-2]}
    about["player"] |= {"shades": sections[-1]} if parts[-1] else {}
    text = json.dumps(about).encode().ljust(start - 12)
    return [MAGIC + len(text).to_bytes(4, "little") + text, *parts]
