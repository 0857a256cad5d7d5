"""Writes the file of a clip during the run: each frame is written as soon as it is computed.

If a run is killed, the file contains the finished frames. `put` returns memory-mapped views of the
file, which take no further memory. The finished clip is a hard link to the file, so the frames of a
paused run are always on disk and are never copied.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Frame, stack_wrenches
from phy124.io import files
from phy124.io.clip import Clip
from phy124.io.files import replacing
from phy124.progress import Progress, silent

SPARE = 1 << 14
"""The space reserved for the header of a clip's file is a multiple of this size [bytes]."""
CODES = {"F32": "<f4", "F64": "<f8", "I32": "<i4"}
SHAPES = ("means", "quats", "scales")
"""Arrays of the Gaussians' positions and shapes, which change over time."""
MOVING = {
    "times",
    *SHAPES,
    "rotations",
    "velocities",
    "contacts",
    "wrenches",
    "carried_x",
    "carried_F",
}
"""Arrays of a clip that have one row per frame."""


class Tensor(NamedTuple):
    """Type, shape and position of an array in the clip's file."""

    code: str
    shape: tuple[int, ...]
    offset: int
    """Offset of the array's first byte from the start of the file [bytes]."""

    @property
    def size(self) -> int:
        """Size of the whole array [bytes]."""
        return int(np.prod(self.shape)) * np.dtype(CODES[self.code]).itemsize


class Unlike(ValueError):
    """Raised if an array of a frame or clip differs in type or shape from the file's array."""


class Growing:
    """A clip file to which frames are written one by one."""

    def __init__(self, path: Path, tensors: Mapping[str, Tensor]) -> None:
        """Open or create the clip's file, and lock it.

        Raises:
            InputError: If another process is writing the file.
            OSError: If the file cannot be written.
        """
        self.path, self.tensors = path, dict(tensors)
        self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        self._held = files.lock(path)
        if self._held is None and files.LOCKS_AVAILABLE:
            os.close(self._file)
            limit = "another process is still computing this run."
            raise InputError(
                "resume", path.parent, limit, "Wait until that process ends, or stop it."
            )
        created = os.fstat(self._file).st_size == 0
        try:
            os.ftruncate(self._file, self._end)
            self.arrays = {
                name: np.memmap(path, CODES[array.code], "r", array.offset, array.shape)
                for name, array in self.tensors.items()
                if array.size
            }
        except OSError:
            self.remove() if created else self.close()
            raise
        """Memory-mapped arrays by name; rows of frames that are not yet written are zero."""

    @classmethod
    def like(
        cls, path: Path, frame: Frame, count: int, *, rotation: NDArray | None, header: int
    ) -> Growing:
        """Create a clip file for frames whose arrays have the same shapes as in the first frame.

        Args:
            path: The file.
            frame: The first frame.
            count: Number of frames that the clip will have.
            rotation: Rotations of the material in the first frame, None if the clip has none.
            header: Upper bound on the header's size [bytes].

        Raises:
            Unlike: If the frame has an array of a type that clips do not support.
            OSError: If the file cannot be written.
        """
        gaussians, moving = frame.gaussians, _arrays_of(frame, rotation)
        arrays = {**moving, "opacities": gaussians.opacities, "sh": gaussians.sh}
        if gaussians.object_id is not None:
            arrays["object_id"] = gaussians.object_id
        offset, tensors = 8 + -(-header // SPARE) * SPARE, {}
        for name, array in sorted(arrays.items(), key=lambda item: -item[1].dtype.itemsize):
            shape = (count, *array.shape) if name in moving else array.shape
            code = next((k for k, v in CODES.items() if np.dtype(v) == array.dtype), None)
            if code is None:
                raise Unlike(f"{name} is {array.dtype}")
            tensors[name] = Tensor(code, shape, offset)
            offset += tensors[name].size
        return cls(path, tensors)

    def put(self, frame: Frame, rotation: NDArray | None = None) -> tuple[Frame, NDArray | None]:
        """Write a frame; return the frame and its rotations as memory-mapped views of the file.

        Raises:
            Unlike: If the arrays of the frame differ from the arrays of the first frame.
            OSError: If the file cannot be written.
        """
        index, arrays = frame.index, _arrays_of(frame, rotation)
        if arrays.keys() != self.tensors.keys() & MOVING:
            raise Unlike(f"frame {index} has {', '.join(arrays)}")
        for name, array in arrays.items():
            tensor = self.tensors[name]
            if tensor.shape[1:] != array.shape or CODES[tensor.code] != array.dtype.str:
                raise Unlike(f"{name} of frame {index} is {array.dtype} {array.shape}")
            self._write(array, tensor.offset + index * array.nbytes)
        gaussians = replace(
            frame.gaussians, **{n: self._row(n, index) for n in SHAPES if n in self.arrays}
        )
        optional = {name: self._row(name, index) for name in ("velocities", "contacts")}
        carried = None
        if "carried_x" in self.arrays:
            carried = self.arrays["carried_x"][index], self.arrays["carried_F"][index]
        kept = replace(frame, gaussians=gaussians, carried=carried, **optional)
        return kept, self._row("rotations", index)

    def finish(self, clip: Clip, path: Path) -> bool:
        """Complete the file and link it as `path`; return False if it does not match the clip.

        Raises:
            OSError: If the disk is full or the file system has no hard links.
        """
        held = clip.tensors()
        if {name: (array.dtype.str, array.shape) for name, array in held.items()} != {
            name: (CODES[tensor.code], tensor.shape) for name, tensor in self.tensors.items()
        }:
            return False
        if any(held[name].ctypes.data != self.arrays[name].ctypes.data for name in SHAPES):
            return False
        if not self.complete(clip):
            return False
        os.link(self.path, path)
        return True

    def complete(self, clip: Clip) -> bool:
        """Write the static arrays and the header; return False if the header is too large.

        Raises:
            OSError: If the file cannot be written.
        """
        for name in self.tensors.keys() - MOVING:
            self._write(getattr(clip, name), self.tensors[name].offset)
        return self.state(clip)

    def state(self, clip: Clip) -> bool:
        """Write the header of the clip; return False if the header is too large.

        Raises:
            OSError: If the file cannot be written.
        """
        first = min(tensor.offset for tensor in self.tensors.values())
        header = self._header(clip, first)
        if len(header) > first - 8:
            return False
        size = (first - 8).to_bytes(8, "little")
        self._write(np.frombuffer(size + header.ljust(first - 8), np.uint8), 0)
        return True

    def place(self) -> dict[str, Any]:
        """Return the file's name and arrays as plain data, from which `there` reopens the file."""
        return {"file": self.path.name, "tensors": self.tensors}

    @classmethod
    def there(cls, folder: Path, place: Mapping[str, Any]) -> Growing:
        """Reopen the file that `place` describes.

        Raises:
            InputError: If the file is missing or too short, or another process is writing it.
        """
        path = folder / Path(place["file"]).name
        tensors = {n: Tensor(c, tuple(s), o) for n, (c, s, o) in place["tensors"].items()}
        end = max(tensor.offset + tensor.size for tensor in tensors.values())
        if not path.is_file() or path.stat().st_size != end:
            limit = f"the file with its frames, {path.name}, is missing or cut short."
            raise InputError("paused run", folder, limit, "Start the run again, without --resume.")
        return cls(path, tensors)

    def close(self) -> None:
        """Close the file and release its lock; its memory-mapped arrays can still be read."""
        files.unlock(self._held)
        if self._file >= 0:
            os.close(self._file)
        self._held, self._file = None, -1

    def remove(self) -> None:
        """Remove the file; its memory-mapped arrays can still be read."""
        self.close()
        with suppress(OSError):
            self.path.unlink(missing_ok=True)

    @property
    def _end(self) -> int:
        return max(tensor.offset + tensor.size for tensor in self.tensors.values())

    def _row(self, name: str, index: int) -> NDArray | None:
        return np.asarray(self.arrays[name][index]) if name in self.arrays else None

    def _header(self, clip: Clip, first: int) -> bytes:
        entries = {
            name: {
                "dtype": tensor.code,
                "shape": tensor.shape,
                "data_offsets": [tensor.offset - first, tensor.offset - first + tensor.size],
            }
            for name, tensor in self.tensors.items()
        }
        metadata = dict(sorted(clip.metadata().items()))
        text = {"__metadata__": metadata, **entries}
        return json.dumps(text, ensure_ascii=False, separators=(",", ":")).encode()

    def _write(self, array: NDArray, offset: int) -> None:
        left = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
        while len(left):
            done = os.pwrite(self._file, left.data, offset)
            left, offset = left[done:], offset + done


def write_frames_clip(path: Path, clip: Clip, progress: Progress = silent) -> None:
    """Write a clip with the values of every frame, one frame at a time.

    Raises:
        InputError: If the file cannot be created.
        OSError: If the disk is full.
    """
    header = SPARE + 2 * len(json.dumps(clip.metadata()))
    with replacing(path) as temporary:
        file = None
        try:
            for frame in clip.frames():
                turns = None if clip.rotations is None else clip.rotations[frame.index]
                if file is None:
                    values = temporary.with_name(f"{temporary.name}.values")
                    file = Growing.like(values, frame, len(clip), rotation=turns, header=header)
                file.put(frame, turns)
                progress("export", frame.index + 1, len(clip))
            if file is not None:
                file.complete(clip)
                os.replace(file.path, temporary)
        finally:
            if file is not None:
                file.remove()


def _arrays_of(frame: Frame, rotation: NDArray | None) -> dict[str, NDArray]:
    wrenches = None if frame.wrenches is None else stack_wrenches([frame])[0]
    arrays = {
        "times": np.array(frame.time, np.float64),
        **{name: getattr(frame.gaussians, name) for name in SHAPES},
        "rotations": rotation,
        "velocities": frame.velocities,
        "contacts": frame.contacts,
        "wrenches": wrenches,
        "carried_x": frame.carried and frame.carried[0],
        "carried_F": frame.carried and frame.carried[1],
    }
    return {name: np.asarray(array) for name, array in arrays.items() if array is not None}
