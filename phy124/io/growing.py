"""A clip file that grows with its run: each frame is written to its place once it is computed.

A run that is killed leaves its frames so, and one that ends has no clip left to write: `finish`
puts the header in front, and the file is a clip. It is not a byte longer than the clip, and the
frames are read from it, so that they take no memory of their own. Its other name, that of the clip,
is made before the first is removed, so that at no time a state to resume from lacks its frames.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Frame, stacked
from phy124.io import locks
from phy124.io.clip import Clip

SPARE = 1 << 14
"""Multiple of which the room for the header is [bytes]."""
CODES = {"F32": "<f4", "F64": "<f8", "I32": "<i4"}
"""Names of types in a safetensors file."""
SHAPES = ("means", "quats", "scales")
"""Arrays of the Gaussians that every frame has of its own."""
MOVING = {"times", *SHAPES, "rotations", "velocities", "contacts", "wrenches"}
"""Arrays of which each frame has a row."""


class Tensor(NamedTuple):
    """One array of the clip."""

    code: str
    shape: tuple[int, ...]
    offset: int
    """Where it begins in the file [bytes]."""

    @property
    def size(self) -> int:
        """Bytes of all of it."""
        return int(np.prod(self.shape)) * np.dtype(CODES[self.code]).itemsize


class Unlike(ValueError):
    """A frame or clip that does not fit the file."""


class Growing:
    """A clip file of which some frames are there."""

    def __init__(self, path: Path, tensors: Mapping[str, Tensor]) -> None:
        """Open the file, which is made if it is not there, and hold its lock.

        Raises:
            InputError: Another process is writing it.
            OSError: It cannot be written.
        """
        self.path, self.tensors = path, dict(tensors)
        self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        self._held = locks.lock(path)
        if self._held is None and locks.AVAILABLE:
            os.close(self._file)
            limit = "another process is computing this very run."
            raise InputError("resume", path.parent, limit, "Wait for its end, or end it.")
        try:
            os.ftruncate(self._file, self._end)
        except OSError:
            if os.fstat(self._file).st_size == 0:
                path.unlink()
            os.close(self._file)
            locks.unlock(self._held)
            raise
        self.arrays = {
            name: np.asarray(np.memmap(path, CODES[one.code], "r", one.offset, one.shape))
            for name, one in self.tensors.items()
            if one.size
        }
        """What is there of each array; what is not is zero."""

    @classmethod
    def like(
        cls, path: Path, frame: Frame, count: int, *, rotation: NDArray | None, header: int
    ) -> Growing:
        """Begin a clip of so many frames like this one.

        Args:
            path: Where to write it.
            frame: Its first frame.
            count: Number of frames.
            rotation: Rotations of the material in that frame, if the clip has them.
            header: Bytes that the header may take.

        Raises:
            Unlike: It has arrays of a type that clips do not have.
            OSError: It cannot be written.
        """
        gaussians, moving = frame.gaussians, _moving(frame, rotation)
        found = {**moving, "opacities": gaussians.opacities, "sh": gaussians.sh}
        if gaussians.object_id is not None:
            found["object_id"] = gaussians.object_id
        offset, tensors = 8 + -(-header // SPARE) * SPARE, {}
        for name, array in sorted(found.items(), key=lambda item: -item[1].dtype.itemsize):
            shape = (count, *array.shape) if name in moving else array.shape
            code = next((k for k, v in CODES.items() if np.dtype(v) == array.dtype), None)
            if code is None:
                raise Unlike(f"{name} is {array.dtype}")
            tensors[name] = Tensor(code, shape, offset)
            offset += tensors[name].size
        return cls(path, tensors)

    def put(self, frame: Frame, rotation: NDArray | None = None) -> tuple[Frame, NDArray | None]:
        """Write a frame; returns it and its rotations with the arrays of the file.

        Raises:
            Unlike: It is not like the first one.
            OSError: It cannot be written.
        """
        index, found = frame.index, _moving(frame, rotation)
        if found.keys() != self.tensors.keys() & MOVING:
            raise Unlike(f"frame {index} has {', '.join(found)}")
        for name, array in found.items():
            one = self.tensors[name]
            if one.shape[1:] != array.shape or CODES[one.code] != array.dtype.str:
                raise Unlike(f"{name} of frame {index} is {array.dtype} {array.shape}")
            self._write(array, one.offset + index * array.nbytes)
        gaussians = replace(frame.gaussians, **{n: self.arrays[n][index] for n in SHAPES})
        optional = {name: self._row(name, index) for name in ("velocities", "contacts")}
        return replace(frame, gaussians=gaussians, **optional), self._row("rotations", index)

    def finish(self, clip: Clip, path: Path) -> bool:
        """Make it a clip, also under another name; False if that clip has not just these frames.

        Raises:
            OSError: There is no room, or the file system knows no second name of a file.
        """
        held = clip.tensors()
        if {name: (array.dtype.str, array.shape) for name, array in held.items()} != {
            name: (CODES[one.code], one.shape) for name, one in self.tensors.items()
        }:
            return False
        if any(held[name].ctypes.data != self.arrays[name].ctypes.data for name in SHAPES):
            return False
        for name in held.keys() - MOVING:
            self._write(held[name], self.tensors[name].offset)
        if not self.state(clip):
            return False
        os.link(self.path, path)
        return True

    def state(self, clip: Clip) -> bool:
        """Write what the file says of itself, as a clip; False if there is no room for it.

        Raises:
            OSError: It cannot be written.
        """
        first = min(one.offset for one in self.tensors.values())
        header = self._header(clip, first)
        if len(header) > first - 8:
            return False
        size = (first - 8).to_bytes(8, "little")
        self._write(np.frombuffer(size + header.ljust(first - 8), np.uint8), 0)
        return True

    def place(self) -> dict[str, Any]:
        """What `there` needs to open it again, as plain data."""
        return {"file": self.path.name, "tensors": self.tensors}

    @classmethod
    def there(cls, folder: Path, place: Mapping[str, Any]) -> Growing:
        """Open the file that `place` told of.

        Raises:
            InputError: It is not there, too short, or another process is writing it.
        """
        path = folder / Path(place["file"]).name
        tensors = {n: Tensor(c, tuple(s), o) for n, (c, s, o) in place["tensors"].items()}
        end = max(one.offset + one.size for one in tensors.values())
        if not path.is_file() or path.stat().st_size != end:
            limit = f"its frames, {path.name}, are missing or cut short."
            raise InputError("paused run", folder, limit, "Run it again, without --resume.")
        return cls(path, tensors)

    def close(self) -> None:
        """Give file and lock back; what was read stays readable."""
        locks.unlock(self._held)
        if self._file >= 0:
            os.close(self._file)
        self._held, self._file = None, -1

    def remove(self) -> None:
        """Remove the file; what was read stays readable."""
        self.close()
        with suppress(OSError):
            self.path.unlink(missing_ok=True)

    @property
    def _end(self) -> int:
        return max(one.offset + one.size for one in self.tensors.values())

    def _row(self, name: str, index: int) -> NDArray | None:
        return self.arrays[name][index] if name in self.arrays else None

    def _header(self, clip: Clip, first: int) -> bytes:
        """What a safetensors file says of itself."""
        told = {
            name: {
                "dtype": one.code,
                "shape": one.shape,
                "data_offsets": [one.offset - first, one.offset - first + one.size],
            }
            for name, one in self.tensors.items()
        }
        metadata = dict(sorted(clip.metadata().items()))
        text = {"__metadata__": metadata, **told}
        return json.dumps(text, ensure_ascii=False, separators=(",", ":")).encode()

    def _write(self, array: NDArray, offset: int) -> None:
        """Write all of an array."""
        left = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
        while len(left):
            done = os.pwrite(self._file, left.data, offset)
            left, offset = left[done:], offset + done


def _moving(frame: Frame, rotation: NDArray | None) -> dict[str, NDArray]:
    """The arrays of one frame, by their names in a clip."""
    return dict(_arrays(frame, rotation))


def _arrays(frame: Frame, rotation: NDArray | None) -> Iterator[tuple[str, NDArray]]:
    yield "times", np.array(frame.time, np.float64)
    for name in SHAPES:
        yield name, getattr(frame.gaussians, name)
    for name, array in (
        ("rotations", rotation), ("velocities", frame.velocities), ("contacts", frame.contacts),
    ):  # fmt: skip
        if array is not None:
            yield name, np.asarray(array)
    if frame.wrenches is not None:
        yield "wrenches", stacked([frame])[0]
