"""Saves a paused simulation as one safetensors file and continues it later, bit for bit."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save_file

from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians
from phy124.harmonics import rotate_sh
from phy124.io.files import replacing
from phy124.progress import Progress, silent
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.simulation import Simulation

FORMAT = "phy124-pause"
GAUSSIANS = ("means", "quats", "scales", "opacities", "sh")
Tensors = dict[str, NDArray]


def save(
    run: Simulation, path: str | os.PathLike[str], *, about: dict[str, Any] | None = None
) -> None:
    """Write a paused run, as it was after its last frame; `about` is returned by `read_about`.

    Raises:
        InputError: If the file cannot be written.
    """
    solver = run.solver
    tensors: Tensors = {f"given.{name}": getattr(run.given, name) for name in GAUSSIANS}
    tensors |= {f"state.{name}": a.numpy() for name, a in solver.state.arrays().items()}
    tensors |= {f"deformer.{name}": a for name, a in run.deformer.memory().items()}
    if run.sleep.anchor is not None:
        tensors["sleep.anchor"] = run.sleep.anchor
    tensors |= _frames(run)
    rejected, threads = solver.rejection.rejected, solver.threads
    facts = {
        "scene": run.scene.data(),
        "solver": {**solver.memory(), "rejected": rejected, "threads": threads},
        "watchdog": run.watchdog.memory(),
        "external_work": run.watchdog.external.memory(),
        "sleep": run.sleep.memory(),
        "frames": {"count": run.count, "keep": run.keep, "retried": run.retried},
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
    progress: Progress = silent,
    watch: Stopwatch | None = None,
) -> Simulation:
    """A saved run, ready to be iterated on.

    Args:
        path: The file.
        device: Warp's name of the device.
        progress: Called as ("simulate", frames done, frames in all).
        watch: A stopwatch to which the seconds spent before the pause are added.

    Raises:
        InputError: If the file is missing, cut short or not a paused run.
    """
    metadata, tensors = _read(Path(path))
    given = Gaussians(*(tensors[f"given.{name}"] for name in GAUSSIANS))
    left, top, right, bottom = metadata["crop"]
    frames, watch = metadata["frames"], watch or Stopwatch()
    run = Simulation(
        given,
        Scene.from_data(metadata["scene"], str(path)),
        device=device,
        progress=progress,
        watch=watch,
        crop=(left, top, right, bottom),
        threads=metadata["solver"]["threads"],
        keep=frames["keep"],
    )
    watch.add(metadata["spent"]["stages"], metadata["spent"]["total"])
    run.count, run.retried = frames["count"], frames["retried"]
    run.sleep.recall(metadata["sleep"], tensors.get("sleep.anchor"))
    _put_solver(run, metadata, tensors)
    memory = {k.removeprefix("deformer."): v for k, v in tensors.items() if k.startswith("def")}
    run.deformer.recall(memory)
    _put_frames(run, tensors)
    _turn_last(run)
    return run


def read_about(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What was saved about a run: its `scene`, the `frames` so far, and what the caller added."""
    metadata, _ = _read(Path(path), tensors=False)
    return {**metadata["about"], "scene": metadata["scene"], "frames": metadata["frames"]["count"]}


def _put_solver(run: Simulation, metadata: dict[str, Any], tensors: Tensors) -> None:
    solver, memory = run.solver, metadata["solver"]
    for name, array in solver.state.arrays().items():
        array.assign(tensors[f"state.{name}"])
    if "watchdog" in metadata:
        run.watchdog.recall(metadata["watchdog"], metadata["external_work"])
    solver.rejection.rejected = memory["rejected"]
    solver.recall({**solver.memory(), **memory})


def _frames(run: Simulation) -> Tensors:
    """The frames so far."""
    tensors: Tensors = {"frames.times": np.array([f.time for f in run.frames])}
    if run.frames:
        for name in ("means", "quats", "scales"):
            stack = [getattr(frame.gaussians, name) for frame in run.frames]
            tensors[f"frames.{name}"] = np.stack(stack)
        velocities = [f.velocities for f in run.frames if f.velocities is not None]
        if velocities:
            tensors["frames.velocities"] = np.stack(velocities)
    if run.rotations:
        tensors["frames.rotations"] = np.stack(run.rotations)
    return tensors


def _put_frames(run: Simulation, tensors: Tensors) -> None:
    rest, velocities = run.gaussians, tensors.get("frames.velocities")
    times = tensors["frames.times"].tolist()
    for index, time in enumerate(times):
        means, quats, scales = (
            tensors[f"frames.{name}"][index] for name in ("means", "quats", "scales")
        )
        gaussians = Gaussians(means, quats, scales, rest.opacities, rest.sh)
        v = None if velocities is None else velocities[index]
        run.frames.append(Frame(run.count - len(times) + index, time, gaussians, v))
    run.rotations = list(tensors.get("frames.rotations", []))


def _turn_last(run: Simulation) -> None:
    """Rotate the colours of the last frame with the material: it is shown again if all rests."""
    if run.frames and run.rotations:
        last = run.frames[-1]
        turned = replace(last.gaussians, sh=rotate_sh(last.gaussians.sh, run.rotations[-1]))
        run.frames[-1] = replace(last, gaussians=turned)


def _read(path: Path, *, tensors: bool = True) -> tuple[dict[str, Any], Tensors]:
    """The facts and the arrays of a file."""
    remedy = "Give a file written by phy124.io.resume.save."
    if not path.is_file():
        raise InputError("paused run", path, "there is no such file.", remedy)
    try:
        with safe_open(path, framework="np") as file:
            metadata = dict(file.metadata() or {})
            names = file.keys() if tensors else ()
            arrays = {name: file.get_tensor(name) for name in names}
    except (SafetensorError, OSError) as error:
        raise InputError("paused run", path, f"it cannot be read ({error}).", remedy) from error
    found = metadata.pop("format", None)
    if found != FORMAT:
        raise InputError("paused run", path, "it is not a paused run.", remedy)
    facts = {name: json.loads(text) for name, text in metadata.items()}
    return (_of_earlier_build(facts) if "clock" in facts else facts), arrays


def _of_earlier_build(facts: dict[str, Any]) -> dict[str, Any]:
    """Facts of earlier builds, which saved the clock only; windows, balance, times start anew."""
    solver = {**facts["clock"], "limiters": facts["limiters"], "rejected": 0}
    frames = {**facts["frames"], "retried": []}
    spent = {"stages": {}, "total": 0.0}
    return {**facts, "solver": solver, "frames": frames, "spent": spent, "about": {}}
