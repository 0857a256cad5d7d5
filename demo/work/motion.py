"""From a cut-out to a clip: Gaussians, then their motion."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from phy124 import pipeline
from phy124.clip import Clip
from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians
from phy124.generators import make as make_generator
from phy124.io.ply import write_ply
from phy124.parts import crop_of
from phy124.runtime.stopwatch import Stopwatch
from phy124.simulation import Simulation, Stopped

from ..pictures import HOW, how_cut
from .limits import Limits, easier
from .order import Order, Reused, Step, Tell
from .shows import glimpses, lives


def gaussians_of(order: Order, path: Path, tell: Tell) -> Gaussians:
    """The Gaussians of an order, made if they are not there."""
    if path.exists():
        tell(Reused("generate"))
        return Clip.load(path).frame(0).gaussians
    tell(Step("generate", 0, 1))
    make: Any = make_generator(order.generator)
    if order.generator == "relief":
        make = partial(make, count=order.gaussians)
    with Image.open(order.cutout) as cutout:
        gaussians = make(
            cutout,
            seed=order.scene.seed,
            progress=lambda _, done, total: tell(Step("generate", done, total)),
        )
    Clip.from_frames([Frame(0, 0.0, gaussians)]).save(path)
    return gaussians


def simulate(
    gaussians: Gaussians, order: Order, out: Path, limits: Limits, watch: Stopwatch
) -> None:
    """A folder with the clip, its Gaussians, its scene and what the run did."""
    tell = limits.tell
    frames = order.scene.time.frames
    tell(Step("simulate", 0, frames, "preparing"))
    with Image.open(order.cutout) as cutout:
        crop, about = crop_of(cutout), {**dict(order.about), HOW: how_cut(cutout)}
    run = Simulation(
        gaussians, order.scene, device=order.device, watch=watch, crop=crop,
        progress=lambda _, done, total: limits.simulated(
            Step("simulate", done, total, _count(run))
        ),
    )  # fmt: skip
    if len(run.particles) > order.max_particles:
        raise InputError(
            "accuracy",
            f"{len(run.particles):,} particles",
            f"one run may have {order.max_particles:,} here.",
            "Choose a coarser accuracy.",
        )
    motion = Motion()
    shows = (glimpses(order, tell), lives(order, tell))
    try:
        for frame in run:
            motion.add(run, frame.time)
            for show in shows:
                show(frame)
    except Stopped as stop:
        run.stopped = str(stop)
    if not run.frames:
        raise InputError("time", "over", "Not one frame was ready in time.", easier(order.scene))
    launches = sum(count for _, count in run.solver.timings.values())
    watch.launches["simulate"] = int(launches)
    tell(Step("simulate", frames, frames, _count(run)))
    with pipeline.staged(out) as folder:
        clip = run.clip()
        report = {**about, **clip.report, "motion": motion.data()}
        report |= pipeline.circumstances(order.device, watch)
        clip.with_report(report).save(folder / "clip.safetensors")
        write_ply(folder / "gaussians.ply", run.gaussians)
        # Uploads are named without the place where they lie.
        text = order.scene.to_toml().replace(f"{order.folder / 'uploads'}/", "")
        (folder / "scene.toml").write_text(text, "utf-8")
        write_json(folder / "report.json", report)


def _count(run: Simulation) -> str:
    return f"{run.solver.substeps} substeps"


class Motion:
    """How a run moved, frame by frame: what shows whether it stayed stable."""

    def __init__(self) -> None:
        self.rows: list[tuple[float, float, float, float]] = []

    def add(self, run: Simulation, time: float) -> None:
        """Measure the particles as they are now."""
        state = run.solver.state
        v = state.v.numpy().astype(np.float64)
        volumes = np.linalg.det(state.deformation.numpy().astype(np.float64))
        energy = 0.5 * (run.solver.mass.numpy() * (v**2).sum(axis=1)).sum()
        speed = np.linalg.norm(v, axis=1).max()
        self.rows.append((time, float(volumes.min()), float(speed), float(energy)))

    def data(self) -> dict[str, list[float]]:
        """Columns: time [s], smallest J, greatest speed [m/s], kinetic energy [J]."""
        names = ("time", "smallest_J", "greatest_speed", "kinetic_energy")
        columns = zip(*self.rows, strict=True) if self.rows else ((),) * 4
        return {name: list(column) for name, column in zip(names, columns, strict=True)}


def write_json(path: Path, data: dict[str, Any]) -> None:
    """Write plain data into a file."""
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n", "utf-8")
