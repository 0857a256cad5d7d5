"""Estimates of time and memory in closed form, from the scene and a few counts.

The number of substeps follows from the stability limit (phy124.mpm.timestep), that of particles
from the Gaussians and the filling. `Rates` are the costs per unit of `Work` on a machine: `USUAL`
ones are constants, and the page measures its own from finished runs. Estimates are correct within a
factor of two, which is enough to refuse a run before it starts.
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
"""Gaussians that `relief` makes from a picture."""
FILLED = 0.19
"""Volume of a typical object relative to the cube of its longest side."""
DOUBLE = 1.7
"""Time of a substep in float64 relative to float32 (docs/lab/accuracy.md)."""
PASS = 0.7
"""Relative time that each additional pass of a transfer takes (docs/lab/transfers.md)."""
WINDOW = 11
"""Nodes per axis by which the grid's window is wider than the object in it."""
BYTES_PER_PARTICLE = 400
"""State of a particle, its snapshot, and temporary memory of its preparation [bytes]."""
BYTES_PER_NODE = 32
BYTES_PER_GAUSSIAN = 40
"""Memory of a Gaussian in a frame of the clip [bytes]."""
BYTES_PER_SHAPE = 250
"""Memory of a Gaussian on the device that deforms it [bytes]."""


@dataclass(frozen=True)
class Rates:
    """Costs per unit of work on a machine."""

    generate: float = 3.0
    """Seconds to make Gaussians from a picture."""
    substep: float = 3e-5
    """Seconds per substep for its launches, for any number of particles."""
    particle: float = 1.1e-7
    """Seconds per particle and substep."""
    node: float = 1.1e-9
    """Seconds per node of the grid and substep."""
    frame: float = 0.06
    """Seconds per simulated frame, in addition to its substeps."""
    video: float = 0.15
    """Seconds per video, for any number of pixels."""
    pixel: float = 1.2e-7
    """Seconds per drawn and encoded pixel."""
    rest: float = 1.5
    """Seconds for everything else."""

    def seconds(self, work: Work) -> dict[str, float]:
        """Return the seconds of each stage."""
        return {
            "generate": self.generate,
            "simulate": self.substep * work.substeps
            + self.particle * work.particles
            + self.node * work.nodes,
            "deform": self.frame * work.frames,
            "film": self.video * work.videos + self.pixel * work.pixels,
        }

    def minimum(self, other: Rates) -> Rates:
        """Return the smaller value of each rate."""
        return Rates(**{name: min(value, vars(other)[name]) for name, value in vars(self).items()})


USUAL = {"cpu": Rates(), "cuda": Rates(particle=1.5e-9, node=5e-11)}
"""Typical rates for each kind of device."""


@dataclass(frozen=True)
class Work:
    """Amount of work of a run."""

    substeps: float
    particles: float
    """Particles times substeps, weighted by the cost of precision and transfer."""
    nodes: float
    """Nodes of the grid times substeps, with the same weights."""
    frames: int
    videos: int
    pixels: float
    """Pixels of all frames of all videos and outputs."""

    @classmethod
    def of(cls, scene: Scene, gaussians: int = GAUSSIANS) -> Work:
        """Estimate the work of a scene."""
        particles = count_particles(scene, gaussians)
        return cls.from_counts(scene, count_substeps(scene), particles, scene.time.frames)

    @classmethod
    def from_counts(
        cls,
        scene: Scene,
        substeps: float,
        particles: float,
        frames: int,
        *,
        nodes: float | None = None,
    ) -> Work:
        """Return the work of a run whose counts are known.

        Args:
            scene: The scene.
            substeps: Total number of substeps.
            particles: Number of particles.
            frames: Number of frames.
            nodes: Number of grid nodes; None: estimated for an object that fills its cube.
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
    """Estimate the substeps until the last frame, from stability limits and expected speed."""
    length = (scene.time.frames - 1) / scene.time.fps
    speed = CELLS_PER_STEP * scene.dx / max(_max_speed(scene, length), 1e-9)
    steps = np.minimum(longest_substeps(scene), speed)
    # Each frame has a whole number of substeps.
    return int(np.maximum(1, np.ceil(1 / scene.time.fps / steps)).sum())


def count_particles(scene: Scene, gaussians: int = GAUSSIANS) -> int:
    """Estimate the number of particles, including those that fill the inside."""
    fillings = [FILLED * (body.size / scene.spacing) ** 3 for body in scene.every_object]
    bound = gaussians if scene.binding == "particles" else 0
    return round(sum(filling + bound for filling in fillings))


def count_nodes(scene: Scene) -> int:
    """Return the nodes of the objects' windows at rest, if each object fills its cube."""
    return len(scene.names) * (scene.resolution.cells + WINDOW) ** 3


def _max_speed(scene: Scene, length: float) -> float:
    """Return an upper bound on an object's speed [m/s], from initial velocity and forces."""
    initial = max(
        math.hypot(*body.velocity) + math.hypot(*body.spin) * body.size / 2
        for body in scene.every_object
    )
    pushes = [getattr(force, "g", None) or getattr(force, "a", None) for force in scene.forces]
    gain = sum(math.hypot(*push) for push in pushes if push is not None)
    return initial + gain * min(length, 0.5)


def rest_substeps(scene: Scene) -> float:
    """Return the number of substeps that a scene needs even at rest."""
    return float((1 / scene.time.fps / longest_substeps(scene)).sum())


def longest_substeps(scene: Scene) -> NDArray[np.float64]:
    """Return the longest stable substep at rest for each frame after the first [T-1], s.

    The limits are stiffness, viscosity, spin and `time.substep`.
    """
    fraction = scene.resolution.fraction
    viscous = min(section.viscous_limit(scene.dx) for section in scene.materials)
    longest = beside_elastic(fraction) * viscous
    rotation = math.sqrt(2) * max(math.hypot(*body.spin) for body in scene.every_object)
    if rotation > 0:
        longest = min(longest, STRAIN_PER_STEP / rotation)
    if scene.time.substep is not None:
        longest = min(longest, scene.time.substep)
    elastic = fraction * scene.dx / max(section.wave_speed() for section in scene.materials)
    factors = scene.softnesses(np.arange(scene.time.frames - 1) / scene.time.fps)
    return np.minimum(elastic / np.sqrt(factors), longest)


class Estimate(NamedTuple):
    """Estimated time and memory of a simulation."""

    substeps: float
    seconds: float
    memory: float
    """Total memory [bytes]."""
    state: float
    """Memory on the device during the run [bytes]."""


def estimate(
    gaussians: Gaussians, particles: Particles, scene: Scene, device: str, *, keep: bool = True
) -> Estimate:
    """Estimate time and memory of a simulation.

    Args:
        gaussians: The object's Gaussians.
        particles: The object's particles.
        scene: The scene.
        device: Warp's name of the device.
        keep: Whether all frames are kept in memory.
    """
    nodes = float(np.prod(np.ptp(particles.x, axis=0) / scene.dx + WINDOW))
    work = Work.from_counts(
        scene, rest_substeps(scene), len(particles), scene.time.frames, nodes=nodes
    )
    rates = USUAL["cuda" if device.startswith("cuda") else "cpu"]
    frames = scene.time.frames if keep else 1
    memory, state = estimate_memory(scene, len(gaussians), len(particles), nodes, frames)
    return Estimate(work.substeps, rates.seconds(work)["simulate"], memory, state)


def estimate_memory(
    scene: Scene, gaussians: int, particles: float, nodes: float, frames: int
) -> tuple[float, float]:
    """Return the total memory of a run and the part of it on the device [bytes].

    Args:
        scene: The scene.
        gaussians: Number of Gaussians.
        particles: Number of particles.
        nodes: Number of grid nodes.
        frames: Number of frames that are kept.
    """
    double = 2 if scene.resolution.precision == "float64" else 1
    state = double * (BYTES_PER_PARTICLE * particles + BYTES_PER_NODE * nodes)
    memory = state + BYTES_PER_GAUSSIAN * gaussians * frames
    return memory, state + BYTES_PER_SHAPE * gaussians
