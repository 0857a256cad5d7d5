"""Make Gaussians from a cut-out, and a clip of their motion, with `phy124.pipeline`."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from phy124 import pipeline
from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians, as_objects
from phy124.generators import make as make_generator
from phy124.io.clip import Clip
from phy124.io.files import replacing
from phy124.particles.thinning import with_count
from phy124.runtime.stopwatch import Stopwatch
from phy124.simulation import Simulation

from ..pictures import HOW, how_cut
from ..progress import Reused, Step, Tell
from .limits import Limits
from .order import Order, hide_uploads
from .others import with_crops
from .shows import glimpses, lives


def gaussians_of(order: Order, path: Path, tell: Tell = lambda event: None) -> Gaussians:
    """Return the Gaussians of an order's objects; make the Gaussians that do not exist yet."""
    if path.exists():
        tell(Reused("generate"))
        return Clip.load(path).frame(0).gaussians
    pictures = 1 + len(order.others)
    tell(Step("generate", 0, pictures))
    with order.picture() as cutout:
        gaussians = _make_gaussians(order, order.extras.generator(order.generator), cutout, 0, tell)
    if order.others:
        objects = {index: gaussians.of_object(index) for index in range(len(order.scene.names))}
        for number, other in enumerate(order.others, 1):
            with Image.open(other.cutout) as cutout:
                generator = make_generator(other.generator)
                objects[other.index] = _make_gaussians(order, generator, cutout, number, tell)
        gaussians = as_objects({index: part for index, part in objects.items() if len(part)})
    Clip.from_frames([Frame(0, 0.0, gaussians)]).save(path)
    return gaussians


def _make_gaussians(
    order: Order, generator: Any, cutout: Image.Image, number: int, tell: Tell
) -> Gaussians:
    def progress(_: str, done: int, total: int) -> None:
        tell(Step("generate", number * total + done, (1 + len(order.others)) * total))

    make = with_count(generator, order.gaussians)
    return make(cutout, seed=order.scene.seed, progress=progress)


def simulate(
    gaussians: Gaussians, order: Order, out: Path, limits: Limits, watch: Stopwatch
) -> None:
    """Simulate, and write a folder with the clip, its Gaussians, its scene and the report.

    Args:
        gaussians: The object.
        order: The order (the request for a run).
        out: The folder to write.
        limits: Stops the job at its time limit, and passes events on.
        watch: Records the durations of the stages.
    """
    watching = Watching(order, limits)
    with order.picture() as cutout:
        about = {**dict(order.about), HOW: how_cut(cutout), "motion": watching.motion}
    if order.others:
        about["sources"] = {other.name: other.about for other in order.others}
    scene = with_crops(order.scene, order.others)
    pipeline.simulate(
        gaussians,
        scene,
        out,
        device=order.device,
        threads=order.threads,
        progress=watching.progress,
        watch=watch,
        about=about,
        crop=order.crop,
        films=False,
        rescues=False,
        each=watching.see,
    )
    watching.end()
    _hide_folders(out, order)


def _hide_folders(out: Path, order: Order) -> None:
    """Write the scene of a clip without the paths of uploads."""
    scene = out / "scene.toml"
    text = scene.read_text("utf-8")
    hidden = hide_uploads(order, text)
    if hidden == text:
        return
    with replacing(scene) as temporary:
        temporary.write_text(hidden, "utf-8")
    clip = Clip.load(out / "clip.safetensors")
    named = json.loads(hide_uploads(order, json.dumps(clip.scene)))
    replace(clip, scene=named).save(out / "clip.safetensors")


class Watching:
    """Shows the frames of a run to the visitor, and records the stability of the run."""

    def __init__(self, order: Order, limits: Limits) -> None:
        self.order, self.limits = order, limits
        self.shows = (glimpses(order, limits.tell), lives(order, limits.tell))
        self.note = "preparing"
        names = ("time", "min_J", "max_speed", "kinetic_energy")
        self.motion: dict[str, list[float]] = {name: [] for name in names}
        """Quantities that show the stability of each frame, in SI units."""
        limits.tell(Step("simulate", 0, order.scene.time.frames, self.note))

    def progress(self, stage: str, done: int, total: int) -> None:
        """Report the progress of the run; an exception raised in this method stops the run."""
        if stage == "compile":
            note = f"compiling, {done} of {total}"
            self.limits.tell(Step("simulate", 0, self.order.scene.time.frames, note))
            return
        self.limits.tell_simulating(Step("simulate", done, total, self.note))

    def see(self, run: Simulation, frame: Frame) -> None:
        """Show a frame to the visitor, and record the current state of the particles.

        Raises:
            InputError: There are more particles than the page allows.
        """
        self.note = f"{run.solver.clock.substeps} substeps"
        if len(run.setup.particles) > self.order.max_particles:
            raise InputError(
                "accuracy",
                f"{len(run.setup.particles):,} particles",
                f"The limit of this page is {self.order.max_particles:,} particles.",
                "Choose a coarser accuracy.",
            )
        for name, value in measure_motion(run, frame).items():
            self.motion[name].append(value)
        for show in self.shows:
            show(frame)

    def end(self) -> None:
        """Report the end of the simulation, even if a time limit ended it."""
        frames = self.order.scene.time.frames
        self.limits.tell(Step("simulate", frames, frames, self.note))


def measure_motion(run: Simulation, frame: Frame) -> dict[str, float]:
    """Record the time [s], smallest J, largest speed [m/s] and kinetic energy [J] of a frame."""
    state = run.solver.state
    v = state.v.numpy().astype(np.float64)
    volumes = np.linalg.det(state.deformation.numpy().astype(np.float64))
    energy = 0.5 * (run.solver.model.mass.numpy() * (v**2).sum(axis=1)).sum()
    return {
        "time": frame.time,
        "min_J": float(volumes.min()),
        "max_speed": float(np.linalg.norm(v, axis=1).max()),
        "kinetic_energy": float(energy),
    }
