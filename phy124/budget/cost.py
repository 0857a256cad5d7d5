"""Estimates time and memory in closed form, within a factor of two, from the scene and a few
counts.

The number of substeps follows from the stability limit (phy124.mpm.timestep). `Rates` are the costs
per unit of `Work` on a machine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.forces import Grab, Wind
from phy124.gaussians import Gaussians
from phy124.kernels.lattice.simd import has_stress
from phy124.liquid.clock import CELLS, WAVES
from phy124.mpm.timestep import CELLS_PER_STEP, ELASTIC_LIMIT, STRAIN_PER_STEP, beside_elastic
from phy124.particles import Particles
from phy124.scene import Scene
from phy124.scene.energies import acts_for, duration, effect, wall_speed

GAUSSIANS = 50_000
"""Number of Gaussians that `relief` makes from a picture."""
FILLED = 0.19
"""Volume of a typical object, relative to the cube of its longest side."""
DOUBLE = 1.7
"""Time of a substep in float64, relative to float32 (docs/lab/accuracy.md)."""
PASS = 0.7
"""Time of each further transfer pass, relative to a substep (docs/lab/transfers.md)."""
STEP = 6.0
"""Time of a step of a projected liquid, relative to an MPM substep."""
VECTOR = 0.25
"""Time per lattice point with kernels for vector units, relative to an MPM particle."""
PLAIN = 2.4
"""Time per lattice point with all other kernels, relative to an MPM particle."""
LAUNCHES = 3600.0
"""Time to launch the kernels of a lattice's substep, relative to an MPM particle."""
UNDAMPED = 1.5
"""Longest stable substep of an undamped lattice at rest, in units of sqrt(cfl) dx / c."""
DAMPED = 0.235
"""Damping ratio of a lattice's fastest vibration, times the viscous limit of the substep, divided
by dx / c.
"""
WINDOW = 11
"""Number of nodes per axis in addition to the nodes across the object."""
ACCELERATED = 0.5
"""Longest time [s] in which a force is assumed to accelerate an object."""
GRAVITY = 9.81
"""Acceleration that limits the time step of a projected liquid [m/s^2]."""
BYTES_PER_PARTICLE = 400
"""Memory per particle for its state, a snapshot, and temporary arrays [bytes]."""
BYTES_PER_POINT = 1100
"""Memory per lattice point, with the arrays from which the lattice is built [bytes]."""
BYTES_PER_NODE = 32
BYTES_PER_CELL = 4 * 1250
"""Memory of a projected liquid per cell that the liquid fills at rest [bytes]. A cell takes 1 kB,
or 1.25 kB with viscosity, and a liquid in a basin may spread over four times as many cells.
"""
BYTES_PER_GAUSSIAN = 40
"""Memory per Gaussian and frame [bytes]."""
AT_REST = 450
"""Memory per Gaussian while it is bound, deformed and drawn [bytes] (docs/lab/sizes.md)."""
HELD = 256e6
"""Largest total size of the frames that a run keeps in memory [bytes]. If the frames are larger, a
frame is computed again from the motion whenever it is read.
"""
BYTES_PER_SHAPE = 250
"""Memory per Gaussian on the device that deforms the Gaussians [bytes]."""


@dataclass(frozen=True)
class Rates:
    """Time that a machine takes for one unit of each kind of work."""

    generate: float = 3.0
    substep: float = 3e-5
    """Seconds per substep to launch kernels."""
    particle: float = 1.1e-7
    """Seconds per particle and substep."""
    node: float = 1.1e-9
    """Seconds per grid node and substep."""
    frame: float = 0.06
    """Seconds per frame, in addition to the substeps."""
    video: float = 0.15
    """Seconds per video, in addition to the pixels."""
    pixel: float = 1.2e-7
    """Seconds to render and encode one pixel."""
    shine: float = 1e-7
    """Seconds per Gaussian with a surface or highlights of its own, and per picture."""
    rest: float = 1.5
    """Seconds for all other work of a run."""

    def seconds(self, work: Work) -> dict[str, float]:
        """Return the seconds of each stage."""
        return {
            "generate": self.generate,
            "simulate": self.substep * work.substeps
            + self.particle * work.particles
            + self.node * work.nodes,
            "deform": self.frame * work.frames,
            "film": self.video * work.videos + self.pixel * work.pixels + self.shine * work.redrawn,
        }

    def minimum(self, other: Rates) -> Rates:
        """Return rates; each rate is the smaller value of `self` and `other`."""
        return Rates(**{name: min(value, vars(other)[name]) for name, value in vars(self).items()})


USUAL = {"cpu": Rates(), "cuda": Rates(substep=4.5e-5, particle=3.3e-10, node=1.5e-11, frame=4e-3)}
"""Typical rates of a device; cuda was measured on an H200 (docs/lab/cuda.md)."""


@dataclass(frozen=True)
class Work:
    """Amounts of work in a run, in the units of `Rates`."""

    substeps: float
    particles: float
    """Particles times substeps, times the relative cost of precision and transfer."""
    nodes: float
    """Nodes times substeps, times the relative cost of precision and transfer."""
    frames: int
    videos: int
    pixels: float
    """Pixels in all frames of all videos and outputs."""
    redrawn: float
    """Gaussians of materials such as metal and liquids, whose surfaces are computed once for each
    frame, and whose highlights are computed once for each picture.
    """

    @classmethod
    def of(cls, scene: Scene, gaussians: int = GAUSSIANS) -> Work:
        """Estimate the work of a scene for a number of Gaussians of each object."""
        counts = count_substeps(scene), count_particles(scene, gaussians), scene.time.frames
        return cls.from_counts(scene, *counts, count_gaussians(scene, gaussians))

    @classmethod
    def from_counts(
        cls,
        scene: Scene,
        substeps: float,
        particles: float,
        frames: int,
        gaussians: float = 0.0,
        *,
        nodes: float | None = None,
    ) -> Work:
        """Return the amounts of work in a run.

        Args:
            scene: The scene.
            substeps: Total number of substeps.
            particles: Number of particles.
            frames: Number of frames.
            gaussians: Number of Gaussians in the videos.
            nodes: Number of grid nodes; None: as for an object that fills its bounding cube.
        """
        slower = DOUBLE if scene.precision == "float64" else 1.0
        slower *= 1 + PASS * scene.resolution.passes
        slower *= STEP if scene.projects and not scene.mixes else 1.0
        view, nodes = scene.view, count_nodes(scene) if nodes is None else nodes
        views, pictures = len(view.sides), view.count_pictures(frames)
        drawn = pictures + frames * len(view.outputs)
        redrawn = [any(m.redrawn for m in materials) for materials in scene.object_materials]
        share = view.shine * sum(redrawn) / len(redrawn)
        launches = 0.0
        if _only_lattices(scene):
            slower *= VECTOR if _has_vectors(scene) else PLAIN
            launches, nodes = LAUNCHES, 0.0
        return cls(
            substeps=substeps,
            particles=(slower * particles + launches) * substeps,
            nodes=slower * nodes * substeps,
            frames=frames,
            videos=views,
            pixels=drawn * views * math.prod(view.size),
            redrawn=share * gaussians * (frames + views * pictures),
        )


def count_substeps(scene: Scene) -> int:
    """Estimate the number of substeps from the stability limits and the expected speed."""
    cells = CELLS if scene.projects and not scene.mixes else CELLS_PER_STEP
    speed = cells * scene.dx / max(largest_speed(scene), 1e-9)
    steps = np.minimum(longest_substeps(scene), speed)
    # Each frame has a whole number of substeps.
    return int(np.maximum(1, np.ceil(1 / scene.time.fps / steps)).sum())


def count_particles(scene: Scene, gaussians: int = GAUSSIANS) -> int:
    """Estimate the number of particles, including the particles that fill the interior."""
    fillings = [FILLED * (body.size / scene.spacing) ** 3 for body in scene.every_object]
    bound = gaussians if scene.binding == "particles" else 0
    return round(sum(filling + bound for filling in fillings))


def count_gaussians(scene: Scene, gaussians: int = GAUSSIANS) -> int:
    """Estimate the number of Gaussians in the videos, including the grains of the interior."""
    objects = zip(scene.every_object, scene.object_materials, strict=True)
    grains = [
        FILLED * (body.size / scene.spacing) ** 3 * any(m.grains for m in materials)
        for body, materials in objects
    ]
    return round(sum(grains) + gaussians * len(grains))


def count_nodes(scene: Scene) -> int:
    """Return the number of grid nodes at rest if each object fills its bounding cube."""
    return len(scene.names) * (scene.resolution.cells + WINDOW) ** 3


def largest_speed(scene: Scene) -> float:
    """Estimate the largest speed of objects and walls [m/s].

    The speed of an object is its initial speed, plus the speeds due to impulses, plus the
    accelerations multiplied by their duration (at most `ACCELERATED` [s]). Wind causes at most its
    own speed.
    """
    speed = max(
        math.hypot(*body.velocity) + math.hypot(*body.spin) * body.size / 2
        for body in scene.every_object
    )
    mass, end = FILLED * scene.object.size**3 * scene.material.density, duration(scene)
    walls = [wall_speed(wall, scene.object.size, end) for wall in scene.with_solids().boundaries]
    for force in scene.acting:
        if isinstance(force, Grab):
            walls.append(force.target().fastest(0.0, end))
            continue
        kick, pull = effect(force, mass, scene)
        gain = pull * min(acts_for(force, end), ACCELERATED)
        if isinstance(force, Wind):
            gain = min(gain, math.hypot(*force.v))
        speed += (kick + gain) * force.track((1.0, 0.0, 0.0)).largest(0.0, end)
    return max([speed, *walls])


def rest_substeps(scene: Scene) -> float:
    """Return the number of substeps if all objects stayed at rest."""
    return float((1 / scene.time.fps / longest_substeps(scene)).sum())


def longest_substeps(scene: Scene) -> NDArray[np.float64]:
    """Return the longest stable substep at rest for each frame after the first [T-1], s."""
    materials = scene.materials
    if scene.mixes:
        # Only the other materials count, because the liquid takes fewer steps.
        materials = [section for section in materials if section.law != "fluid"]
    elif scene.projects:
        longest = min(WAVES * math.sqrt(scene.dx / GRAVITY), scene.time.ceiling)
        return np.full(scene.time.frames - 1, longest)
    fraction = scene.resolution.fraction
    viscous = min(section.viscous_limit(scene.dx) for section in materials)
    rotation = math.sqrt(2) * max(math.hypot(*body.spin) for body in scene.every_object)
    longest = min(scene.time.ceiling, STRAIN_PER_STEP / max(rotation, 1e-9))
    crossing = scene.dx / max(section.wave_speed() for section in materials)
    elastic = fraction * ELASTIC_LIMIT[scene.resolution.gradient] * crossing
    factors = scene.softnesses(np.arange(scene.time.frames - 1) / scene.time.fps)
    if _only_lattices(scene):
        damping = DAMPED * crossing / viscous
        elastic = UNDAMPED * math.sqrt(fraction) * crossing / (math.hypot(1, damping) + damping)
        factors = factors.clip(1)
    else:
        longest = min(longest, beside_elastic(fraction) * viscous)
    return np.minimum(elastic / np.sqrt(factors), longest)


def _only_lattices(scene: Scene) -> bool:
    return scene.on_lattice and not scene.couples


def _has_vectors(scene: Scene) -> bool:
    """Return whether kernels for vector units compute the stress on lattices."""
    single = scene.precision == "float32"
    return single and all(has_stress(section.device_law) for section in scene.materials)


class Estimate(NamedTuple):
    """Estimated time and memory of a simulation."""

    substeps: float
    seconds: float
    memory: float
    """Total memory [bytes]."""
    state: float
    """Memory on the device [bytes]."""


def estimate(
    gaussians: Gaussians, particles: Particles, scene: Scene, device: str, *, keep: bool = True
) -> Estimate:
    """Estimate the time and memory of a simulation.

    Args:
        gaussians: The object's Gaussians.
        particles: The object's particles.
        scene: The scene.
        device: Warp's name of the device.
        keep: Whether all frames stay in memory.
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
    """Return the total memory of a run, and the memory on the device [bytes].

    Args:
        scene: The scene.
        gaussians: Number of Gaussians.
        particles: Number of particles.
        nodes: Number of grid nodes.
        frames: Number of frames in memory.
    """
    double = 2 if scene.precision == "float64" else 1
    each = BYTES_PER_POINT if _only_lattices(scene) else BYTES_PER_PARTICLE
    node = BYTES_PER_CELL if scene.projects else BYTES_PER_NODE
    state = double * (each * particles + node * nodes)
    memory = state + min(BYTES_PER_GAUSSIAN * gaussians * frames, HELD) + AT_REST * gaussians
    return memory, state + BYTES_PER_SHAPE * gaussians
