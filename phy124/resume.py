"""Saves a paused simulation as one safetensors file and continues it later.

On a CPU that is bit for bit; on a GPU, which sums in no fixed order, to within rounding.
"""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians, of_walls, stacked
from phy124.harmonics import rotate_sh
from phy124.io.files import replacing
from phy124.io.opening import obstacle
from phy124.monitor.wrenches import pair_names
from phy124.progress import Progress, silent
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.simulation import Simulation

FORMAT = "phy124-pause-5"
GAUSSIANS = ("means", "quats", "scales", "opacities", "sh")
OBJECTS = "given.object_id"
Tensors = dict[str, NDArray]
ARRAY = "array"
"""In place of an array, which is stored beside."""


def save(
    run: Simulation, path: str | os.PathLike[str], *, about: dict[str, Any] | None = None
) -> None:
    """Write a paused run, as it was after its last frame; `about` is returned by `read_about`.

    Raises:
        InputError: If the file cannot be written.
    """
    run.scene.refuse_nameless()
    tensors: Tensors = {f"given.{name}": getattr(run.given, name) for name in GAUSSIANS}
    if run.given.object_id is not None:
        tensors[OBJECTS] = run.given.object_id
    tensors |= _frames(run)
    facts = {
        "run": _plain(run.snapshot(), tensors, "run"),
        "scene": run.scene.data(),
        "threads": len(run.solver.workers),
        "along": run.along,
        "frames": {"count": run.count, "keep": run.keep},
        "crop": run.crop,
        "about": about or {},
        "spent": {"stages": run.watch.seconds, "total": run.watch.total},
    }
    metadata = {"format": FORMAT, **{name: json.dumps(fact) for name, fact in facts.items()}}
    with replacing(path) as temporary:
        save_file({k: np.ascontiguousarray(v) for k, v in tensors.items()}, temporary, metadata)


def load(
    path: str | os.PathLike[str],
    *,
    device: str = "cpu",
    threads: int | None = None,
    progress: Progress = silent,
    watch: Stopwatch | None = None,
) -> Simulation:
    """A saved run, ready to be iterated on.

    Args:
        path: The file.
        device: Warp's name of the device.
        threads: CPU threads; None: as many as before the pause, so that the run goes on bit for
            bit. With another number it goes on to within rounding, which its report notes.
        progress: Called as ("simulate", frames done, frames in all).
        watch: A stopwatch to which the seconds spent before the pause are added.

    Raises:
        InputError: If the file is missing, cut short or not a paused run.
    """
    metadata, tensors = _read(Path(path))
    means, quats, scales, opacities, sh = (tensors[f"given.{name}"] for name in GAUSSIANS)
    given = Gaussians(means, quats, scales, opacities, sh, tensors.get(OBJECTS))
    left, top, right, bottom = metadata["crop"]
    watch = watch or Stopwatch()
    run = Simulation(
        given,
        Scene.from_data(metadata["scene"], str(path)),
        device=device,
        progress=progress,
        watch=watch,
        crop=(left, top, right, bottom),
        threads=metadata["threads"] if threads is None else threads,
        along=metadata["along"],
        keep=metadata["frames"]["keep"],
    )
    watch.add(metadata["spent"]["stages"], metadata["spent"]["total"])
    run.restore(_whole(metadata["run"], tensors, "run"))
    run.remarks += _threads_differ(metadata["threads"], len(run.solver.workers))
    _put_frames(run, tensors)
    _turn_last(run)
    return run


def _threads_differ(before: int, now: int) -> list[str]:
    """A note if a run goes on with another number of threads."""
    if before == now:
        return []
    return [
        f"The run was paused with {before} CPU thread(s) and went on with {now}: from there on it "
        "is what it would have been to within rounding, not bit for bit."
    ]


def read_about(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What was saved about a run: its `scene`, the `frames` so far, and what the caller added."""
    metadata, _ = _read(Path(path), tensors=False)
    return {**metadata["about"], "scene": metadata["scene"], "frames": metadata["frames"]["count"]}


def _plain(tree: Any, tensors: Tensors, name: str) -> Any:
    """A snapshot without its arrays, which go to `tensors` under their path."""
    if isinstance(tree, dict):
        return {key: _plain(value, tensors, f"{name}.{key}") for key, value in tree.items()}
    if isinstance(tree, (np.ndarray, wp.array)):
        tensors[name] = np.asarray(tree if isinstance(tree, np.ndarray) else tree.numpy())
        return {ARRAY: True}
    return tree


def _whole(tree: Any, tensors: Tensors, name: str) -> Any:
    """A snapshot with its arrays."""
    if not isinstance(tree, dict):
        return tree
    if ARRAY in tree:
        return tensors[name]
    return {key: _whole(value, tensors, f"{name}.{key}") for key, value in tree.items()}


def _frames(run: Simulation) -> Tensors:
    """The frames so far."""
    tensors: Tensors = {"frames.times": np.array([f.time for f in run.frames])}
    if run.frames:
        for name in ("means", "quats", "scales"):
            stack = [getattr(frame.gaussians, name) for frame in run.frames]
            tensors[f"frames.{name}"] = np.stack(stack)
        for name in ("velocities", "contacts"):
            kept = [getattr(f, name) for f in run.frames if getattr(f, name) is not None]
            if kept:
                tensors[f"frames.{name}"] = np.stack(kept)
    if run.frames and run.frames[-1].wrenches is not None:
        tensors["frames.wrenches"] = stacked(run.frames)
    if run.rotations:
        tensors["frames.rotations"] = np.stack(run.rotations)
    return tensors


def _put_frames(run: Simulation, tensors: Tensors) -> None:
    rest, kept = run.shown, [tensors.get(f"frames.{n}") for n in ("velocities", "contacts")]
    times, walls = tensors["frames.times"].tolist(), tensors.get("frames.wrenches")
    names = (*(run.wrenches.walls if run.wrenches.asked else ()), *pair_names(run.solver))
    for index, time in enumerate(times):
        means, quats, scales = (
            tensors[f"frames.{name}"][index] for name in ("means", "quats", "scales")
        )
        gaussians = replace(rest, means=means, quats=quats, scales=scales)
        v, forces = (None if values is None else values[index] for values in kept)
        wrenches = None if walls is None else of_walls(names, walls[index])
        frame = Frame(run.count - len(times) + index, time, gaussians, v, forces, wrenches)
        run.frames.append(frame)
    run.rotations = list(tensors.get("frames.rotations", []))


def _turn_last(run: Simulation) -> None:
    """Rotate the colours of the last frame with the material: it is shown again if all rests."""
    if run.frames and run.rotations:
        last = run.frames[-1]
        turned = replace(last.gaussians, sh=rotate_sh(last.gaussians.sh, run.rotations[-1]))
        run.frames[-1] = replace(last, gaussians=turned)


def _read(path: Path, *, tensors: bool = True) -> tuple[dict[str, Any], Tensors]:
    """The facts and the arrays of a file."""
    remedy = "Give a file written by phy124.resume.save."
    if hindrance := obstacle(path):
        raise InputError("paused run", path, hindrance[0], remedy)
    try:
        with safe_open(path, framework="np") as file:
            metadata = dict(file.metadata() or {})
            names = file.keys() if tensors else ()
            arrays = {name: file.get_tensor(name) for name in names}
    except (SafetensorError, OSError) as error:
        raise InputError("paused run", path, f"it cannot be read ({error}).", remedy) from error
    found = metadata.pop("format", "")
    if found != FORMAT and found.startswith(FORMAT.rpartition("-")[0]):
        limit = "another version of phy124 wrote it, which computes otherwise."
        raise InputError("paused run", path, limit, "Run it anew, without --resume.")
    if found != FORMAT:
        raise InputError("paused run", path, "it is not a paused run.", remedy)
    return {name: json.loads(text) for name, text in metadata.items()}, arrays
