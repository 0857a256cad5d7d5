"""Writes a clip as one small file: the first frame as SOG, and the motion of a coarse lattice.

The lattice covers the first frame; a Gaussian moves with the eight nodes around it, whose
displacements are interpolated trilinearly. The displacements of a frame are those that fit the
Gaussians' best. Gaussians that would be wrong by more than `TOLERANCE` of the object's size are
exceptions, which have a shift of their own in each frame. The file states the remaining error of
each Gaussian. Layout, little endian, with offsets from the start of the file:

    bytes          content
    0 to 7         "PHY4D" 0 1 0
    8 to 11        length of the JSON, uint32
    12 on          JSON: count, times [s], origin [3] and spacing of the lattice [m], shape [3],
                   nodes and exceptions (numbers), size [m], error {max, p99} [m], and sections
                   [offset, length]: still (SOG), indices, frames (one each), errors
    indices        index of each node in the lattice, in C order, then of each exception, uint32;
                   compressed by zlib
    frames[k]      float32 step [m]; then int16 in steps, compressed by zlib: displacements of the
                   nodes, then shifts of the exceptions, all x, all y, all z; each value is stored
                   as its difference from the previous one
    errors         largest error of each Gaussian, uint8 in steps of error.max / 255, rounded up;
                   compressed by zlib

Frames are independent, so a reader can request a range of bytes. docs/guide/p4d.md has
readers in Python and JavaScript. The axes are those of SOG: -y up, -z to the front.
"""

from __future__ import annotations

import json
import os
import tempfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.io.axes import orientation, rotate_gaussians
from phy124.io.clip import Clip
from phy124.io.content import Y_DOWN
from phy124.io.files import replacing
from phy124.io.formats import sog
from phy124.progress import Progress, silent

MAGIC = b"PHY4D\0\1\0"
TOLERANCE = 1e-3
"""Largest error of a Gaussian's centre relative to the object's size."""
NODES = (12, 17, 24, 34)
"""Nodes along the longest side of the lattices that are tried; the smallest file is kept."""
STIFF = 1e-4
"""Weight of the differences between neighbouring nodes, which determines nodes that move little."""
STEP = TOLERANCE / 8
"""Step of the displacements relative to the object's size."""
LARGEST = 2**15 - 1


@dataclass(frozen=True, eq=False)
class Lattice:
    """Nodes that move Gaussians, and the Gaussians' weights."""

    origin: NDArray[np.float64]
    spacing: float
    shape: NDArray[np.int64]
    indices: NDArray[np.int64]
    """Index of each node in the whole lattice [M], increasing."""
    weights: Any
    """Trilinear weights, a sparse matrix [N,M]."""

    @classmethod
    def around(cls, points: NDArray[np.float64], nodes: int) -> Lattice:
        """Build the lattice with a number of nodes along the longest side of points [N,3], m."""
        from scipy import sparse

        low, high = points.min(axis=0), points.max(axis=0)
        spacing = float((high - low).max()) / (nodes - 1)
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

    def solver(self) -> Any:
        """Return the factors of the least-squares fit of node displacements."""
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
) -> None:
    """Write a clip as one file, which appears whole or not at all.

    Raises:
        InputError: The clip is empty, or the file cannot be written.
    """
    if not len(clip):
        raise InputError("clip", "empty", "it has no frames.", "Simulate one frame or more.")
    turn = orientation(*Y_DOWN).T
    mask = clip.object_mask
    first = rotate_gaussians(clip.frame(0).gaussians.select(mask), turn)
    still = sog.encode(first)
    rest = _centres(still)
    size = float(np.ptp(rest, axis=0).max())
    places = [clip.means[index][mask].astype(np.float64) @ turn.T for index in range(len(clip))]
    made = []
    for index, nodes in enumerate(NODES):
        made.append(_Motion.of(Lattice.around(rest, nodes), rest, places))
        progress("export", index + 1, len(NODES))
        if made[-1].size > min(each.size for each in made):
            break
    motion = min(made, key=lambda each: each.size)
    lattice, errors = motion.lattice, motion.errors
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
        "error": {"max": worst, "p99": float(np.percentile(errors, 99))},
    }
    numbers = np.concatenate([lattice.indices, motion.exceptions]).astype("<u4").tobytes()
    parts = [still, zlib.compress(numbers, 9), *motion.frames]
    data = _pack(about, [*parts, zlib.compress(steps.tobytes(), 9)])
    with replacing(path) as temporary:
        temporary.write_bytes(data)


def _centres(still: bytes) -> NDArray[np.float64]:
    """Return the centres that a reader of a SOG file gets [N,3], m."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "still.sog"
        path.write_bytes(still)
        return sog.read(path).gaussians.means.astype(np.float64)


@dataclass(frozen=True, eq=False)
class _Motion:
    """The motion of a clip by a lattice, and by shifts of the Gaussians that it moves wrongly."""

    lattice: Lattice
    exceptions: NDArray[np.int64]
    """Gaussians that have shifts of their own [E]."""
    frames: list[bytes]
    errors: NDArray[np.float64]
    """Largest error of each Gaussian [N], m."""

    @property
    def size(self) -> int:
        """Size of the motion [bytes]."""
        return sum(map(len, self.frames)) + 2 * len(self.lattice.indices)

    @classmethod
    def of(
        cls, lattice: Lattice, rest: NDArray[np.float64], places: list[NDArray[np.float64]]
    ) -> _Motion:
        """Fit a lattice to the positions of Gaussians in each frame [N,3], m."""
        solver, size = lattice.solver(), float(np.ptp(rest, axis=0).max())
        errors, fitted = np.zeros(len(rest)), []
        for place in places:
            moved = solver.solve(lattice.weights.T @ (place - rest))
            step = float(np.float32(max(float(np.abs(moved).max()) / LARGEST, STEP * size)))
            whole = np.rint(moved / step)
            rest_error = place - rest - lattice.weights @ (whole * step)
            errors = np.maximum(errors, np.linalg.norm(rest_error, axis=1))
            fitted.append((step, whole, rest_error))
        exceptions = np.flatnonzero(errors > TOLERANCE * size)
        errors[exceptions], frames = 0.0, []
        for step, whole, rest_error in fitted:
            shifts = np.rint(rest_error[exceptions] / step).clip(-LARGEST, LARGEST)
            left = np.linalg.norm(rest_error[exceptions] - shifts * step, axis=1)
            errors[exceptions] = np.maximum(errors[exceptions], left)
            change = np.diff(
                np.concatenate([whole, shifts]).astype("<i2").T, axis=1, prepend=np.int16(0)
            )
            frames.append(
                np.float32(step).tobytes() + zlib.compress(change.astype("<i2").tobytes(), 9)
            )
        return cls(lattice, exceptions, frames, errors)


def _pack(about: dict[str, Any], parts: list[bytes]) -> bytes:
    """Return the file; the JSON is padded, so that its length does not depend on the offsets."""
    start = 12 + len(json.dumps(about)) + 200 + 32 * len(parts)
    offsets = start + np.cumsum([0, *map(len, parts[:-1])])
    sections = [[int(at), len(part)] for at, part in zip(offsets, parts, strict=True)]
    about |= {"still": sections[0], "indices": sections[1]}
    about |= {"frames": sections[2:-1], "errors": sections[-1]}
    text = json.dumps(about).encode().ljust(start - 12)
    return MAGIC + len(text).to_bytes(4, "little") + text + b"".join(parts)
