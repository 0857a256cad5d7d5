"""Defines a clip (the Gaussians of every frame) and stores it as one safetensors file."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file
from zstandard import ZstdError

from phy124.errors import InputError
from phy124.gaussians import (
    Array,
    Frame,
    Gaussians,
    finite_rows,
    of_walls,
    rotate_sh,
    stack_wrenches,
    walls_of,
)
from phy124.io.files import replacing
from phy124.io.opening import obstacle
from phy124.motion.packing import Packed, pack, unpack
from phy124.motion.recorded import Computed, Motion, frames_of, make_arrays

FORMAT = "phy124-clip"
VERSION = "1"
"""Version of a clip's file that stores the Gaussians of every frame."""
MOTION = "2"
"""Version of a clip's file that stores a motion, which determines the Gaussians of each frame."""
SPARE = " " * 8192
"""Spaces in the header of a clip's file, which leave room for a longer report."""
SMALL = 64e6
"""Files up to this size [bytes] are read into memory; larger files are memory-mapped."""
REQUIRED = ("means", "quats", "scales", "opacities", "sh", "times")
OPTIONAL = ("rotations", "velocities", "contacts")
MOVING = ("means", "quats", "scales", *OPTIONAL)
"""Arrays with one row [N,...] per frame."""
DESCRIBED = ("means", "quats", "scales", "rotations", "opacities", "sh", "object_id")
"""Arrays that are computed from the motion if a clip's file stores a motion."""
WALLS = "wrenches"
OBJECT = "object_id"
MADE = "Give a clip.safetensors made by `phy124 generate`."


@dataclass(frozen=True, eq=False)
class Clip:
    """The frames of an animation: N Gaussians at T times.

    Opacities and the colours before rotation are constant in time.
    """

    means: Array
    """Centres [T,N,3], m."""
    quats: Array
    """Orientations [T,N,4], unit quaternions wxyz, whose signs are continuous over time."""
    scales: Array
    """Standard deviations [T,N,3], m."""
    opacities: Array
    """Opacities [N], 0..1."""
    sh: Array
    """Colours at rest as spherical-harmonic coefficients [N,K,3]."""
    times: NDArray[np.float64]
    """Times of the frames [T], s."""
    rotations: Array | None = None
    """Rotations of the material relative to its rest state [T,N,4], wxyz.

    None if colours do not depend on the view. The rotations are computed by the polar decomposition
    of F.
    """
    velocities: Array | None = None
    """Velocities of the centres [T,N,3], m/s; None if the scene did not request velocities."""
    scene: dict[str, Any] = field(default_factory=dict)
    """The scene with all its values, as plain data."""
    report: dict[str, Any] = field(default_factory=dict)
    """The report of the run; its entry `complete` is False if the run stopped early."""
    contacts: Array | None = None
    """Mean force [newton] of the walls on each Gaussian since the previous frame [T,N,3].

    None if the scene does not ask for contact forces.
    """
    wrenches: NDArray[np.float64] | None = None
    """Mean wrench that the object exerts on each of W walls since the previous frame [T,W,2,3]: the
    force [N], and the torque about the object's centre of mass [N m]. None if the scene asks for no
    wrenches.
    """
    walls: tuple[str, ...] = ()
    object_id: NDArray[np.int32] | None = None
    """Object index of each Gaussian [N]; None if there is only one object."""
    objects: tuple[str, ...] = ()
    """Names of the objects, if there is more than one."""
    motion: Motion | None = None
    """The motion that the clip's file stores, and from which the Gaussians are computed.

    None if the file stores the Gaussians of every frame, or if an array of the motion was replaced.
    """

    def __post_init__(self) -> None:
        if self.motion is not None:
            pairs = zip(self._arrays_of_motion(), self.motion.describes, strict=True)
            if not all(array is described for array, described in pairs):
                object.__setattr__(self, "motion", None)
        t, n = self.means.shape[:2]
        shapes = {
            "means": (t, n, 3),
            "quats": (t, n, 4),
            "scales": (t, n, 3),
            "opacities": (n,),
            "times": (t,),
            "rotations": (t, n, 4),
            "velocities": (t, n, 3),
            "contacts": (t, n, 3),
            "wrenches": (t, len(self.walls), 2, 3),
            "object_id": (n,),
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and value.shape != shape:
                raise ValueError(f"{name} has shape {value.shape}, but must have shape {shape}")
        if self.sh.ndim != 3 or self.sh.shape[::2] != (n, 3):
            raise ValueError(f"sh has shape {self.sh.shape}, but must have shape ({n}, K, 3)")

    def __len__(self) -> int:
        return len(self.times)

    @classmethod
    def from_frames(cls, frames: list[Frame], rotations: Array | None = None) -> Clip:
        """Combine frames of the same Gaussians into a clip.

        Raises:
            ValueError: If the list of frames is empty.
        """
        if not frames:
            raise ValueError("a clip needs at least one frame")
        first = frames[0].gaussians

        def stack(name: str) -> Array:
            return stack_arrays([getattr(f.gaussians, name) for f in frames])

        def stack_if_all(name: str) -> Array | None:
            arrays = [getattr(f, name) for f in frames]
            return None if any(array is None for array in arrays) else stack_arrays(arrays)

        return cls(
            means=stack("means"),
            quats=stack("quats"),
            scales=stack("scales"),
            opacities=first.opacities,
            sh=first.sh,
            times=np.array([f.time for f in frames], dtype=np.float64),
            rotations=rotations,
            velocities=stack_if_all("velocities"),
            contacts=stack_if_all("contacts"),
            wrenches=stack_wrenches(frames)
            if all(f.wrenches is not None for f in frames)
            else None,
            walls=walls_of(frames),
            object_id=first.object_id,
        )

    def refuse_empty(self) -> None:
        """Check that the clip has frames and Gaussians.

        Raises:
            InputError: The clip has no frames, or no Gaussians.
        """
        if not len(self) or not self.opacities.size:
            raise InputError("clip", "empty", "it has no frames.", "Simulate one frame or more.")

    @property
    def fps(self) -> float:
        """Number of frames per second at which the clip plays in real time."""
        count = len(self)
        return float((count - 1) / (self.times[-1] - self.times[0])) if count > 1 else 24.0

    @property
    def object_mask(self) -> NDArray[np.bool_]:
        """Mask [N]: True for Gaussians of the object, False for surroundings such as a floor."""
        mask = np.ones(len(self.opacities), bool)
        for part in self.scene.get("parts", []):
            if part.get("surroundings"):
                mask[slice(*part["gaussians"])] = False
        return mask if mask.any() else ~mask

    @property
    def object_means(self) -> NDArray[np.float32]:
        """Centres [T,M,3], m, of the M Gaussians of the object, without grains and surroundings."""
        surface = self.surface
        return np.asarray(surface.means)[:, surface.object_mask]

    @property
    def surface(self) -> Clip:
        """A copy of the clip without grains. The number of grains depends on the accuracy."""
        grains = self.report.get("grains", 0)
        if not grains:
            return self
        kept = slice(None, -grains)
        each = select_moving(self, kept) | {"opacities": self.opacities[kept], "sh": self.sh[kept]}
        each["object_id"] = None if self.object_id is None else self.object_id[kept]
        return replace(self, **each, report={**self.report, "grains": 0})

    def frame(self, index: int, *, velocities: bool = False) -> Frame:
        """Return one frame of the clip, in which the colours are rotated with the material.

        If `velocities` is set and the clip has no velocities, `velocity` computes them.
        """
        sh = self.sh
        if self.rotations is not None and sh.shape[1] > 1:
            sh = rotate_sh(sh, self.rotations[index])
        means, quats, scales = self.means[index], self.quats[index], self.scales[index]
        gaussians = Gaussians(means, quats, scales, self.opacities, sh, self.object_id)
        v = None if self.velocities is None else self.velocities[index]
        if v is None and velocities:
            v = self.velocity(index)
        forces = None if self.contacts is None else self.contacts[index]
        walls = None if self.wrenches is None else of_walls(self.walls, self.wrenches[index])
        return Frame(index, float(self.times[index]), gaussians, v, forces, walls)

    def frames(self, *, velocities: bool = False) -> Iterator[Frame]:
        """Yield all frames in order; if the clip is memory-mapped, one frame is read at a time."""
        return (self.frame(index, velocities=velocities) for index in range(len(self)))

    def rows_of(self, chosen: NDArray) -> Iterator[tuple[Array, Array, Array]]:
        """Yield the means, quats and scales of some Gaussians, whose indices are `chosen`."""
        arrays: Any = self.means, self.quats, self.scales
        if all(isinstance(a, Computed) and a.columns is None for a in arrays):
            for row in arrays[0].recorded.rows_of(chosen):
                yield row["means"], row["quats"], row["scales"]
            return
        for index in range(len(self)):
            means, quats, scales = (array[index][chosen] for array in arrays)
            yield means, quats, scales

    def velocity(self, index: int) -> Array | None:
        """Return the velocities of the centres at a frame [N,3], m/s; None for a single frame.

        If the clip has simulated velocities, these are returned. Otherwise, the velocities are
        difference quotients of the adjacent frames, one-sided at the first and the last frame.
        """
        if self.velocities is not None:
            return self.velocities[index]
        before, after = max(index - 1, 0), min(index + 1, len(self) - 1)
        if before == after:
            return None
        seconds = np.float32(self.times[after] - self.times[before])
        return (self.means[after] - self.means[before]) / seconds

    def finite(self, index: int) -> NDArray[np.bool_]:
        """Return a mask [N] of the Gaussians that have only finite values in a frame."""
        arrays = (self.means[index], self.quats[index], self.scales[index], self.sh)
        return finite_rows(self.opacities) & np.all([finite_rows(a) for a in arrays], axis=0)

    def with_motion(self, motion: Motion) -> Clip:
        """Return a copy whose file stores a motion instead of the arrays `DESCRIBED`."""
        return replace(self, motion=replace(motion, describes=self._arrays_of_motion()))

    def _arrays_of_motion(self) -> tuple[Any, ...]:
        return tuple(getattr(self, name) for name in DESCRIBED)

    def with_report(self, report: dict[str, Any]) -> Clip:
        """Return a copy of the clip with another report."""
        return replace(self, report=report)

    def tensors(self, left_out: Collection[str] = ()) -> dict[str, NDArray]:
        """Return the arrays that are saved in the clip's file, by name."""
        more = (*OPTIONAL, WALLS, OBJECT)
        names = REQUIRED + tuple(n for n in more if getattr(self, n) is not None)
        kept = (name for name in names if name not in left_out)
        return {name: np.ascontiguousarray(getattr(self, name)) for name in kept}

    def metadata(self) -> dict[str, str]:
        """Return the metadata of a clip's file as texts: scene, report, names of walls, objects."""
        texts = {
            "format": FORMAT,
            "version": VERSION,
            "scene": json.dumps(self.scene),
            "report": json.dumps(self.report),
            "walls": json.dumps(self.walls),
        }
        return {**texts, "objects": json.dumps(self.objects)} if self.objects else texts

    def pack(self) -> Packed | None:
        """Return the packed motion, or None if the clip has no motion."""
        return None if self.motion is None else pack(self.motion)

    def save(self, path: str | os.PathLike[str], packed: Packed | None = None) -> None:
        """Write the clip to one safetensors file; the file appears only when it is complete.

        Raises:
            InputError: If the folder is missing or the file cannot be created.
            OSError: If the disk is full.
        """
        metadata = self.metadata()
        packed = packed or self.pack()
        if packed is None:
            tensors = self.tensors()
        else:
            arrays, facts = packed
            metadata |= {"version": MOTION, "motion": json.dumps(facts)}
            tensors = self.tensors({*REQUIRED, "rotations", OBJECT} - {"times"}) | arrays
        spare = {"spare": SPARE} if self.motion is not None else {}
        with replacing(path) as temporary:
            save_tensors(tensors, temporary, {**metadata, **spare})
            _write_metadata(temporary, metadata)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Clip:
        """Open a saved clip; the arrays stay on disk until they are read.

        Raises:
            InputError: If the file is missing or cut short, or is not a clip of a known version.
        """
        metadata = _read_metadata(Path(path))
        arrays, motion = _open_tensors(Path(path)), None
        if "motion" in metadata:
            try:
                motion = unpack(arrays, json.loads(metadata["motion"]), np.array(arrays["times"]))
                arrays |= make_arrays(frames_of(motion))
            except (ValueError, KeyError, IndexError, TypeError, ZstdError) as error:
                raise _refusal(path, f"the motion in the file is damaged ({error!r}).") from error
            still = motion.shown
            static = {"opacities": still.opacities, "sh": still.sh, OBJECT: still.object_id}
            arrays |= {name: array for name, array in static.items() if array is not None}
        missing = [name for name in REQUIRED if name not in arrays]
        if missing:
            raise _refusal(path, f"the tensors {', '.join(missing)} are missing.")
        names = (*REQUIRED, *OPTIONAL, WALLS, OBJECT)
        known = {name: arrays[name] for name in names if name in arrays}
        try:
            scene, report = json.loads(metadata["scene"]), json.loads(metadata["report"])
            walls = tuple(json.loads(metadata.get("walls", "[]")))
            objects = tuple(json.loads(metadata.get("objects", "[]")))
        except (ValueError, TypeError) as error:
            raise _refusal(
                path, f"the scene or the report in the file is damaged ({error})."
            ) from error
        try:
            texts = {"scene": scene, "report": report, "walls": walls, "objects": objects}
            clip = cls(**known, **texts)
            return clip if motion is None else clip.with_motion(motion)
        except (ValueError, IndexError) as error:
            raise _refusal(
                path, f"the shapes of its tensors are inconsistent ({error})."
            ) from error


def select_moving(clip: Clip, index: slice | NDArray[np.intp]) -> dict[str, Any]:
    """Return the arrays that change over time (`MOVING`), for some of the Gaussians."""
    return {
        name: array.select(index) if isinstance(array, Computed) else array[:, index]
        for name in MOVING
        if (array := getattr(clip, name)) is not None
    }


def stack_arrays(rows: Sequence[NDArray]) -> NDArray:
    """Stack arrays of the same shape; if the arrays are adjacent in memory, nothing is copied."""
    first = rows[0]
    owner, start, step = _owner(first), first.ctypes.data, first.nbytes
    follow = (
        _owner(row) is owner and row.ctypes.data == start + i * step for i, row in enumerate(rows)
    )
    if owner is first or not first.flags.c_contiguous or not all(follow):
        return np.stack(rows)
    shape, strides = (len(rows), *first.shape), (step, *first.strides)
    return np.lib.stride_tricks.as_strided(first, shape, strides, writeable=False)


def _owner(array: NDArray) -> Any:
    owner: Any = array
    while isinstance(owner, np.ndarray) and owner.base is not None:
        owner = owner.base
    return owner


def read_shape(path: str | os.PathLike[str]) -> tuple[int, int]:
    """Read the numbers of frames and Gaussians from the header of a saved clip.

    Raises:
        InputError: If the file is missing or cut short, or is not a clip of a known version.
    """
    _read_metadata(Path(path))
    with safe_open(path, framework="np") as file:
        if "motion" in (metadata := file.metadata()):
            facts = json.loads(metadata["motion"])
            counts = (facts["arrays"].get(name) for name in ("means", "exposed.means"))
            return facts["frames"], sum(each["shape"][0] for each in counts if each)
        if "means" not in file.keys():  # noqa: SIM118
            raise _refusal(path, "the tensor means is missing.")
        frames, gaussians, _ = file.get_slice("means").get_shape()
    return frames, gaussians


def read_scene(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read the scene of a saved clip from the file's header; return plain data.

    Raises:
        InputError: If the file is missing or cut short, or is not a clip of a known version.
    """
    return json.loads(_read_metadata(Path(path))["scene"])


def _refusal(path: object, limit: str, remedy: str = MADE) -> InputError:
    return InputError("clip", path, limit, remedy)


def _read_metadata(path: Path) -> dict[str, str]:
    if hindrance := obstacle(path):
        raise _refusal(path, *hindrance)
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
    except (SafetensorError, OSError) as error:
        raise _refusal(
            path, f"it cannot be read; it is cut short or of another kind ({error})."
        ) from error
    if metadata.get("format") != FORMAT or not {"scene", "report"} <= metadata.keys():
        raise _refusal(path, "it is a safetensors file, but not a phy124 clip.")
    if metadata.get("version") not in (VERSION, MOTION):
        version = metadata.get("version")
        raise _refusal(
            path, f"its format version is {version}, but this program reads {VERSION} and {MOTION}."
        )
    return metadata


def restate(path: Path, clip: Clip) -> bool:
    """Replace the report in a clip's file; return False if the report is too long for the header.

    Raises:
        OSError: If the file cannot be written.
    """
    with safe_open(path, framework="np") as file:
        old = file.metadata() or {}
    kept = {name: old[name] for name in ("version", "motion") if name in old}
    return _write_metadata(path, clip.metadata() | kept)


def _write_metadata(path: Path, metadata: Mapping[str, str]) -> bool:
    """Write a safetensors file's metadata in a fixed order; equal clips thus have equal files."""
    with open(path, "r+b") as file:
        length = int.from_bytes(file.read(8), "little")
        header = json.loads(file.read(length))
        header["__metadata__"] = dict(sorted(metadata.items()))
        text = json.dumps(header, ensure_ascii=False, separators=(",", ":")).encode()
        # spaces keep the header's length, because the tensors must not move
        if len(text) <= length:
            file.seek(8)
            file.write(text.ljust(length))
    return len(text) <= length


def _open_tensors(path: Path) -> dict[str, NDArray]:
    """Return the arrays of a safetensors file; large files are memory-mapped. If another program
    shortens such a file, the system ends the process that reads it.
    """
    small = path.stat().st_size <= SMALL
    data = np.fromfile(path, np.uint8) if small else np.memmap(path, np.uint8, "r")
    first = 8 + int.from_bytes(data[:8].tobytes(), "little")
    types = {"F32": np.float32, "F64": np.float64, "I32": np.int32, "U8": np.uint8}
    arrays, cut = {}, _refusal(path, "it was cut short while it was read.")
    if first > len(data):
        raise cut
    for name, entry in json.loads(data[8:first].tobytes()).items():
        if name != "__metadata__" and entry["dtype"] in types:
            start, end = (first + offset for offset in entry["data_offsets"])
            if end > len(data):
                raise cut
            arrays[name] = data[start:end].view(types[entry["dtype"]]).reshape(entry["shape"])
    return arrays


def save_tensors(
    tensors: Mapping[str, NDArray], path: Path, metadata: Mapping[str, str] | None = None
) -> None:
    """Write arrays and metadata to one safetensors file.

    Raises:
        OSError: If the file cannot be written, for example because the disk is full.
    """
    try:
        whole = {name: np.ascontiguousarray(array) for name, array in tensors.items()}
        path.touch()
        mode = path.stat().st_mode  # safetensors makes files that only the owner can read
        save_file(whole, path, dict(metadata or {}))
        path.chmod(mode)
    except SafetensorError as error:
        number = re.search(r"\(os error (\d+)\)", str(error))
        if number is None:
            raise OSError(str(error)) from error
        raise OSError(int(number[1]), os.strerror(int(number[1])), str(path)) from error
