"""Saves a paused simulation as a safetensors file, and continues it later.

On a CPU, the continued run equals an uninterrupted run bit for bit. On a GPU, the two runs differ
by rounding errors, because a GPU adds numbers in no fixed order.
"""

import json
import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open

from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians, of_walls, rotate_sh, stack_wrenches, walls_of
from phy124.io.clip import save_tensors
from phy124.io.files import replacing
from phy124.io.growing import MOVING, SHAPES, Growing
from phy124.io.opening import obstacle
from phy124.monitor.observer import Observer
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare

FORMAT = "phy124-pause-16"
GAUSSIANS = ("means", "quats", "scales", "opacities", "sh")
OBJECTS = "given.object_id"
FILE = "file."
Tensors = dict[str, NDArray]
ARRAY = "array"


def save(
    run: Simulation,
    path: str | os.PathLike[str],
    *,
    about: dict[str, Any] | None = None,
    frames: Growing | None = None,
    files: Mapping[str, bytes] | None = None,
) -> None:
    """Write the state of a paused run after its last frame.

    Args:
        run: The run.
        path: The file to write.
        about: Further entries, for `read_about`.
        frames: The frame file in the same folder; None: the frames are written to `path`.
        files: Result files by name, for `read_files`.

    Raises:
        InputError: The folder is missing, or a file cannot be created in it.
        OSError: The disk is full.
    """
    run.scene.require_serialisable()
    tensors: Tensors = {f"given.{name}": getattr(run.setup.source, name) for name in GAUSSIANS}
    if run.setup.source.object_id is not None:
        tensors[OBJECTS] = run.setup.source.object_id
    tensors |= _frames(run) if frames is None else {}
    for name, content in (files or {}).items():
        tensors[FILE + name] = np.frombuffer(content, np.uint8)
    place = {} if frames is None else {"growing": frames.place()}
    walls, watch = walls_of(run.frames), run.setup.context.watch
    facts = {
        "run": _plain(run.snapshot(), tensors, "run"),
        "scene": run.scene.data(),
        "threads": len(run.solver.workers),
        "along": run.setup.along,
        "frames": {"count": run.count, "keep": run.setup.keep, "walls": walls, **place},
        "crop": run.setup.crop,
        "about": about or {},
        "spent": {"stages": watch.seconds, "total": watch.total},
    }
    facts["checksum"] = _checksum(tensors)
    metadata = {"format": FORMAT, **{name: json.dumps(fact) for name, fact in facts.items()}}
    with replacing(path) as temporary:
        save_tensors(tensors, temporary, metadata)


def load(
    path: str | os.PathLike[str],
    context: RunContext | None = None,
    *,
    frames: Growing | None = None,
    observers: Sequence[type[Observer]] | None = None,
) -> Simulation:
    """Load a paused run; the run continues when its next frames are requested.

    Args:
        path: The file.
        context: Device, threads, progress and stopwatch. Without a number of threads, the previous
            number is used. With another number, the result differs by rounding errors.
        frames: The frame file, if it is already open (`frames_of`).
        observers: Classes of observers, as for `prepare`.

    Raises:
        InputError: The file is missing, truncated or not a paused run.
    """
    context = context or RunContext()
    metadata, tensors = _read(Path(path))
    if frames is None and (frames := frames_of(path)) is not None:
        frames.close()  # releases the lock; the frames can still be read
    saved = _saved_frames(metadata, tensors, frames)
    means, quats, scales, opacities, sh = (tensors[f"given.{name}"] for name in GAUSSIANS)
    left, top, right, bottom = metadata["crop"]
    if context.threads is None:
        context = replace(context, threads=metadata["threads"])
    setup = prepare(
        Gaussians(means, quats, scales, opacities, sh, tensors.get(OBJECTS)),
        Scene.from_data(metadata["scene"], str(path)),
        context,
        crop=(left, top, right, bottom),
        along=metadata["along"],
        keep=metadata["frames"]["keep"],
        observers=observers,
    )
    run = Simulation(setup)
    context.watch.add(metadata["spent"]["stages"], metadata["spent"]["total"])
    run.restore(_whole(metadata["run"], tensors, "run"))
    run.remarks += _threads_differ(metadata["threads"], len(run.solver.workers))
    _put_frames(run, saved, metadata["frames"]["walls"])
    _turn_last(run)
    return run


def frames_of(path: str | os.PathLike[str]) -> Growing | None:
    """Open the frame file of a paused run; None if there is no separate file.

    Raises:
        InputError: The file is missing, or another process is continuing the run.
    """
    place = read_frames(path)
    return None if place is None else Growing.there(Path(path).parent, place)


def read_frames(path: str | os.PathLike[str]) -> dict[str, Any] | None:
    """Return the description of the frame file; None if there is no separate file."""
    return _read(Path(path), tensors=False)[0]["frames"].get("growing")


def read_files(path: str | os.PathLike[str]) -> dict[str, bytes]:
    """Return the result files that were saved with a run, by name."""
    tensors = _read(Path(path))[1]
    files = {name: array for name, array in tensors.items() if name.startswith(FILE)}
    return {name.removeprefix(FILE): array.tobytes() for name, array in files.items()}


def _saved_frames(metadata: dict[str, Any], tensors: Tensors, frames: Growing | None) -> Tensors:
    if frames is not None:
        count = metadata["frames"]["count"]
        return {name: rows[:count] for name, rows in frames.arrays.items() if name in MOVING}
    start = "frames."
    return {n.removeprefix(start): a for n, a in tensors.items() if n.startswith(start)}


def _threads_differ(before: int, now: int) -> list[str]:
    if before == now:
        return []
    return [
        f"The run was paused with {before} CPU thread(s) and continued with {now}: from then on, "
        "the results differ from those of an uninterrupted run by rounding errors."
    ]


def read_about(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return a saved run's `scene`, number of `frames`, and entries `about`."""
    metadata, _ = _read(Path(path), tensors=False)
    return {**metadata["about"], "scene": metadata["scene"], "frames": metadata["frames"]["count"]}


def _plain(tree: Any, tensors: Tensors, name: str) -> Any:
    """Return a snapshot without its arrays; move the arrays to `tensors`."""
    if isinstance(tree, dict):
        return {key: _plain(value, tensors, f"{name}.{key}") for key, value in tree.items()}
    if isinstance(tree, (np.ndarray, wp.array)):
        tensors[name] = np.asarray(tree if isinstance(tree, np.ndarray) else tree.numpy())
        return {ARRAY: True}
    return tree


def _whole(tree: Any, tensors: Tensors, name: str) -> Any:
    if not isinstance(tree, dict):
        return tree
    if ARRAY in tree:
        return tensors[name]
    return {key: _whole(value, tensors, f"{name}.{key}") for key, value in tree.items()}


def _frames(run: Simulation) -> Tensors:
    tensors: Tensors = {"frames.times": np.array([f.time for f in run.frames])}
    if run.frames:
        for name in ("means", "quats", "scales"):
            stack = [getattr(frame.gaussians, name) for frame in run.frames]
            tensors[f"frames.{name}"] = np.stack(stack)
        carried = [frame.carried for frame in run.frames if frame.carried is not None]
        if carried:
            x, F = zip(*carried, strict=True)
            tensors |= {"frames.carried_x": np.stack(x), "frames.carried_F": np.stack(F)}
        for name in ("velocities", "contacts"):
            kept = [getattr(f, name) for f in run.frames if getattr(f, name) is not None]
            if kept:
                tensors[f"frames.{name}"] = np.stack(kept)
    if run.frames and run.frames[-1].wrenches is not None:
        tensors["frames.wrenches"] = stack_wrenches(run.frames)
    if run.rotations:
        tensors["frames.rotations"] = np.stack(run.rotations)
    return tensors


def _put_frames(run: Simulation, kept: Tensors, names: Sequence[str]) -> None:
    walls = kept.get("wrenches")
    times = kept["times"].tolist()
    for index, time in enumerate(times):
        shape = {name: kept[name][index] for name in SHAPES if name in kept}
        more = {name: kept[name][index] for name in ("velocities", "contacts") if name in kept}
        wrenches = None if walls is None else of_walls(names, np.array(walls[index]))
        shown = run.setup.shown.select(np.zeros(0, int)) if run.light else run.setup.shown
        gaussians, place = replace(shown, **shape), run.count - len(times) + index
        if "carried_x" in kept:
            more["carried"] = (kept["carried_x"][index], kept["carried_F"][index])
        run.frames.append(Frame(place, time, gaussians, **more, wrenches=wrenches))
    run.rotations = list(kept.get("rotations", []))


def _turn_last(run: Simulation) -> None:
    """Rotate the colours of the last frame, because a run at rest repeats this frame."""
    if run.frames and run.rotations:
        last = run.frames[-1]
        turned = replace(last.gaussians, sh=rotate_sh(last.gaussians.sh, run.rotations[-1]))
        run.frames[-1] = replace(last, gaussians=turned)


def _read(path: Path, *, tensors: bool = True) -> tuple[dict[str, Any], Tensors]:
    remedy = "Give a file that a stopped run left, or run without --resume."
    if hindrance := obstacle(path):
        raise InputError("paused run", path, hindrance[0], remedy)
    try:
        with safe_open(path, framework="np") as file:
            metadata = dict(file.metadata() or {})
            names = file.keys() if tensors else ()
            arrays = {name: file.get_tensor(name) for name in names}
    except (SafetensorError, OSError) as error:
        raise InputError("paused run", path, f"it cannot be read ({error}).", remedy) from error
    version = metadata.pop("format", "")
    if version != FORMAT and version.startswith(FORMAT.rpartition("-")[0]):
        limit = "it was written by another version of phy124, whose results differ."
        raise InputError("paused run", path, limit, "Start the run again, without --resume.")
    if version != FORMAT:
        raise InputError("paused run", path, "it is not a paused run.", remedy)
    facts = {name: json.loads(text) for name, text in metadata.items()}
    if tensors and facts.get("checksum") != _checksum(arrays):
        raise InputError("paused run", path, "it was changed or damaged.", remedy)
    return facts, arrays


def _checksum(tensors: Tensors) -> int:
    total = 0
    for name in sorted(tensors):
        total = zlib.crc32(np.ascontiguousarray(tensors[name]).data, total)
    return total
