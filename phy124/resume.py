"""Save a paused simulation as one safetensors file and take it up again, bit for bit."""

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
from phy124.files import replacing
from phy124.gaussians import Frame, Gaussians
from phy124.harmonics import rotate_sh
from phy124.mpm.solver import CLOCK
from phy124.progress import Progress, silent
from phy124.scene import Scene
from phy124.simulation import Simulation
from phy124.timestep import Extremes

FORMAT = "phy124-pause"
GAUSSIANS = ("means", "quats", "scales", "opacities", "sh")
Tensors = dict[str, NDArray]


def save(run: Simulation, path: str | os.PathLike[str]) -> None:
    """Write a paused run; between two frames, so no substep is cut.

    Raises InputError if the place cannot be written.
    """
    solver = run.solver
    tensors: Tensors = {f"given.{name}": getattr(run.given, name) for name in GAUSSIANS}
    tensors |= {f"state.{name}": a.numpy() for name, a in solver.state.arrays().items()}
    tensors |= {f"deformer.{name}": a for name, a in run.deformer.memory().items()}
    if run.sleep.anchor is not None:
        tensors["sleep.anchor"] = run.sleep.anchor
    tensors |= _frames(run)
    clock = {name: getattr(solver, name) for name in CLOCK}
    metadata = {
        "format": FORMAT,
        "scene": json.dumps(run.scene.data()),
        "clock": json.dumps(clock | {"cfl": solver.cfl, "threads": solver.threads}),
        "limiters": json.dumps(solver.limiters),
        "sleep": json.dumps(run.sleep.memory()),
        "frames": json.dumps({"count": run.count, "keep": run.keep}),
        "crop": json.dumps(run.crop),
    }
    with replacing(path) as temporary:
        save_file({k: np.ascontiguousarray(v) for k, v in tensors.items()}, temporary, metadata)


def load(
    path: str | os.PathLike[str], *, device: str = "cpu", progress: Progress = silent
) -> Simulation:
    """The saved run, ready to be iterated on.

    Raises InputError if the file is missing, cut short or not a paused run.
    """
    metadata, tensors = _read(Path(path))
    given = Gaussians(*(tensors[f"given.{name}"] for name in GAUSSIANS))
    left, top, right, bottom = json.loads(metadata["crop"])
    clock, frames = json.loads(metadata["clock"]), json.loads(metadata["frames"])
    run = Simulation(
        given,
        Scene.from_data(json.loads(metadata["scene"]), str(path)),
        device=device,
        progress=progress,
        crop=(left, top, right, bottom),
        threads=clock.pop("threads"),
        keep=frames["keep"],
    )
    run.count = frames["count"]
    run.sleep.recall(json.loads(metadata["sleep"]), tensors.get("sleep.anchor"))
    for name, array in run.solver.state.arrays().items():
        array.assign(tensors[f"state.{name}"])
    clock["extremes"] = Extremes(*clock["extremes"])
    for name, value in clock.items():
        setattr(run.solver, name, value)
    run.solver.limiters = json.loads(metadata["limiters"])
    memory = {k.removeprefix("deformer."): v for k, v in tensors.items() if k.startswith("def")}
    run.deformer.recall(memory)
    _put_frames(run, tensors)
    _turn_last(run)
    return run


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
    """Colours of the last frame turned with the material, for it is shown again if all rests."""
    if run.frames and run.rotations:
        last = run.frames[-1]
        turned = replace(last.gaussians, sh=rotate_sh(last.gaussians.sh, run.rotations[-1]))
        run.frames[-1] = replace(last, gaussians=turned)


def _read(path: Path) -> tuple[dict[str, Any], Tensors]:
    remedy = "Give a file written by phy124.resume.save."
    if not path.is_file():
        raise InputError("paused run", path, "there is no such file.", remedy)
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError) as error:
        raise InputError("paused run", path, f"it cannot be read ({error}).", remedy) from error
    if metadata.get("format") != FORMAT:
        raise InputError("paused run", path, "it is not a paused run.", remedy)
    return metadata, tensors
