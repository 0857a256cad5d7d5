"""What a run costs, in closed form: from the scene and a few counts, nothing is run.

Substeps follow from the stability limit (phy124.mpm.timestep), particles from the Gaussians and the
filling. `Rates` says what each unit of `Work` costs on a machine: `USUAL` ones are written here,
and the page learns its own from finished runs. It is rough on purpose (a factor of two):
`demand_of` is for what is refused before it starts. What a run takes to a few percent is measured
on the object itself: phy124/accuracy/forecast.py.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.mpm.timestep import CELLS_PER_STEP, STRAIN_PER_STEP, beside_elastic
from phy124.particles import Particles
from phy124.scene import Scene

GAUSSIANS = 50_000
"""What `relief` makes of a picture."""
FILLED = 0.19
"""Volume of a typical object, in cubes of its longest side: the filling's fraction of the grid."""
DOUBLE = 1.7
"""How much longer a substep takes in float64 (docs/results/accuracy.md)."""
PASS = 0.7
"""How much longer a substep takes for each pass of a transfer (docs/results/transfers.md)."""
WINDOW = 11
"""Nodes by which the grid's window is wider than what is in it."""
BYTES_PER_PARTICLE = 400
"""Of the state, its copy to go back to, and what preparing it takes."""
BYTES_PER_NODE = 32
BYTES_PER_GAUSSIAN = 40
"""Of one frame of the clip."""


BYTES_PER_SHAPE = 250
"""Of a Gaussian on the device that deforms it."""


@dataclass(frozen=True)
class Rates:
    """What the stages cost on this machine."""

    generate: float = 3.0
    """Seconds to make Gaussians of a picture."""
    substep: float = 3e-5
    """Seconds per substep for its launches, however few particles there are."""
    particle: float = 1.1e-7
    """Seconds per particle and substep."""
    node: float = 1.1e-9
    """Seconds per node of the grid and substep."""
    frame: float = 0.06
    """Seconds per simulated frame, besides its substeps."""
    video: float = 0.15
    """Seconds per video, however few pixels it has."""
    pixel: float = 1.2e-7
    """Seconds per drawn and encoded pixel."""
    rest: float = 1.5
    """Seconds for everything else."""

    def seconds(self, work: Work) -> dict[str, float]:
        """Seconds of each stage for an amount of work."""
        return {
            "generate": self.generate,
            "simulate": self.substep * work.substeps
            + self.particle * work.particles
            + self.node * work.nodes,
            "deform": self.frame * work.frames,
            "film": self.video * work.videos + self.pixel * work.pixels,
        }

    def quickest(self, other: Rates) -> Rates:
        """The smaller of each cost."""
        return Rates(**{name: min(value, vars(other)[name]) for name, value in vars(self).items()})


USUAL = {"cpu": Rates(), "cuda": Rates(particle=1.5e-9, node=5e-11)}
"""What the stages usually cost, by kind of device."""


@dataclass(frozen=True)
class Work:
    """How much a run has to do."""

    substeps: float
    particles: float
    """Particles times substeps, those in double precision counted for what they cost."""
    nodes: float
    """Nodes of the grid times substeps, counted in the same way."""
    frames: int
    videos: int
    pixels: float
    """Pixels of all frames of all videos and outputs."""

    @classmethod
    def of(cls, scene: Scene, gaussians: int = GAUSSIANS) -> Work:
        """What a run of a scene has to do."""
        particles = count_particles(scene, gaussians)
        return cls.done(scene, count_substeps(scene), particles, scene.time.frames)

    @classmethod
    def done(
        cls,
        scene: Scene,
        substeps: float,
        particles: float,
        frames: int,
        *,
        nodes: float | None = None,
    ) -> Work:
        """The work of a run whose counts are known.

        Args:
            scene: What is run.
            substeps: Number of substeps in all.
            particles: Number of particles.
            frames: Number of frames.
            nodes: Number of nodes of the grid; None: as if the object filled its cube.
        """
        slower = DOUBLE if scene.resolution.precision == "float64" else 1.0
        slower *= 1 + PASS * scene.resolution.passes
        views, nodes = len(scene.view.sides), count_nodes(scene) if nodes is None else nodes
        return cls(
            substeps=substeps,
            particles=slower * particles * substeps,
            nodes=slower * nodes * substeps,
            frames=frames,
            videos=views,
            pixels=frames * views * math.prod(scene.view.size) * (1 + len(scene.view.outputs)),
        )


def count_substeps(scene: Scene) -> int:
    """Substeps until the last frame, from what is known before the motion: its speed, too."""
    length = (scene.time.frames - 1) / scene.time.fps
    speed = CELLS_PER_STEP * scene.dx / max(_max_speed(scene, length), 1e-9)
    steps = np.minimum(longest_substeps(scene), speed)
    # Whole substeps in every frame.
    return int(np.maximum(1, np.ceil(1 / scene.time.fps / steps)).sum())


def count_particles(scene: Scene, gaussians: int = GAUSSIANS) -> int:
    """Gaussians and the particles that fill the inside."""
    each = [FILLED * (body.size / scene.spacing) ** 3 for body in scene.every_object]
    own = gaussians if scene.binding == "particles" else 0
    return round(sum(filling + own for filling in each))


def count_nodes(scene: Scene) -> int:
    """Nodes of a window around the objects at rest, as if each filled its cube."""
    return len(scene.names) * (scene.resolution.cells + WINDOW) ** 3


def _max_speed(scene: Scene, length: float) -> float:
    """How fast an object may become [m/s]: its own motion and what pushes it."""
    own = max(
        math.hypot(*body.velocity) + math.hypot(*body.spin) * body.size / 2
        for body in scene.every_object
    )
    pushes = [getattr(force, "g", None) or getattr(force, "a", None) for force in scene.forces]
    return own + sum(math.hypot(*push) for push in pushes if push is not None) * min(length, 0.5)


def rest_substeps(scene: Scene) -> float:
    """How many substeps a scene asks for whatever its motion does."""
    return float((1 / scene.time.fps / longest_substeps(scene)).sum())


def longest_substeps(scene: Scene) -> NDArray[np.float64]:
    """What stiffness, friction, spin and the user allow at rest, on the way to each frame but the
    first [T-1], s.
    """
    longest = _viscous(scene)
    turning = math.sqrt(2) * max(math.hypot(*body.spin) for body in scene.every_object)
    if turning > 0:
        longest = min(longest, STRAIN_PER_STEP / turning)
    if scene.time.substep is not None:
        longest = min(longest, scene.time.substep)
    factors = scene.softnesses(np.arange(scene.time.frames - 1) / scene.time.fps)
    return np.minimum(_elastic(scene) / np.sqrt(factors), longest)


def _elastic(scene: Scene) -> float:
    """Longest substep that stiffness allows at rest, before it changes in time [s]."""
    fastest = max(section.wave_speed() for section in scene.materials)
    return scene.resolution.fraction * scene.dx / fastest


def _viscous(scene: Scene) -> float:
    """Longest substep that friction allows [s]."""
    friction = min(section.viscous_limit(scene.dx) for section in scene.materials)
    return beside_elastic(scene.resolution.fraction) * friction


class Demand(NamedTuple):
    """What a run is forecast to need."""

    substeps: float
    seconds: float
    memory: float
    """Bytes."""
    state: float
    """Bytes of it that are on the device while it runs."""


def demand_of(
    gaussians: Gaussians, particles: Particles, scene: Scene, device: str, *, keep: bool = True
) -> Demand:
    """A rough estimate of what a simulation needs.

    Args:
        gaussians: Of the object.
        particles: Of the object.
        scene: What will be run.
        device: Warp's name of the device.
        keep: Whether all frames are kept in memory.
    """
    nodes = float(np.prod(np.ptp(particles.x, axis=0) / scene.dx + WINDOW))
    work = Work.done(scene, rest_substeps(scene), len(particles), scene.time.frames, nodes=nodes)
    rates = USUAL["cuda" if device.startswith("cuda") else "cpu"]
    frames = scene.time.frames if keep else 1
    memory, state = memory_of(scene, len(gaussians), len(particles), nodes, frames)
    return Demand(work.substeps, rates.seconds(work)["simulate"], memory, state)


def memory_of(
    scene: Scene, gaussians: int, particles: float, nodes: float, frames: int
) -> tuple[float, float]:
    """The memory of a run, and that part of it which is on the device [bytes].

    Args:
        scene: What is run.
        gaussians: How many there are.
        particles: How many there are.
        nodes: Nodes of the grid.
        frames: How many are kept.
    """
    double = 2 if scene.resolution.precision == "float64" else 1
    state = double * (BYTES_PER_PARTICLE * particles + BYTES_PER_NODE * nodes)
    memory = state + BYTES_PER_GAUSSIAN * gaussians * frames
    return memory, state + BYTES_PER_SHAPE * gaussians
