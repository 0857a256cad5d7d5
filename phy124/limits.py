"""Runs that would take hours or more memory than there is are refused before they start.

The forecast is rough on purpose (a factor of two): substeps from the wave speed, 110 ns per
particle and 1.1 ns per node of the window on one core. A refusal names a setting that would fit.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np

from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.particles import Particles
from phy124.scene import Scene
from phy124.timestep import STRAIN_PER_STEP, beside_elastic

PER_PARTICLE = {"cpu": 110e-9, "cuda": 1.5e-9}
"""Seconds per particle and substep."""
PER_NODE = {"cpu": 1.1e-9, "cuda": 0.05e-9}
"""Seconds per node and substep."""
PER_SUBSTEP = 30e-6
"""Seconds per substep for its launches."""
BYTES_PER_PARTICLE = 400
"""Of the state, its copy to go back to, and what preparing it takes."""
BYTES_PER_NODE = 32
BYTES_PER_GAUSSIAN = 40
"""Of one frame of the clip."""
MEMORY_SHARE = 0.8
"""Share of the free memory a run may take."""


class Demand(NamedTuple):
    """What a run is forecast to need."""

    substeps: float
    seconds: float
    memory: float
    """Bytes."""


def forecast(
    gaussians: Gaussians, particles: Particles, scene: Scene, device: str, *, keep: bool = True
) -> Demand:
    """A rough estimate of what a simulation needs; `keep`: all its frames."""
    substeps, kind = _substeps(scene), "cuda" if device.startswith("cuda") else "cpu"
    nodes = float(np.prod(np.ptp(particles.x, axis=0) / scene.dx + 11))
    each = PER_PARTICLE[kind] * len(particles) + PER_NODE[kind] * nodes + PER_SUBSTEP
    double = 2 if scene.resolution.precision == "float64" else 1
    memory = double * (
        BYTES_PER_PARTICLE * len(particles) + BYTES_PER_NODE * nodes
    ) + BYTES_PER_GAUSSIAN * len(gaussians) * (scene.time.frames if keep else 1)
    return Demand(substeps, substeps * each, memory)


def refuse_hopeless(
    gaussians: Gaussians,
    particles: Particles,
    scene: Scene,
    device: str = "cpu",
    *,
    keep: bool = True,
) -> Demand:
    """What the run needs; raises InputError if that is more than its patience or the memory."""
    demand = forecast(gaussians, particles, scene, device, keep=keep)
    patience = scene.time.patience
    if demand.seconds > patience:
        raise InputError(
            "time.patience",
            f"{patience:g} s",
            f"the run is forecast to take {duration(demand.seconds)} "
            f"({demand.substeps:.2g} substeps of {len(particles):,} particles).",
            _quicker(scene, demand.seconds / patience),
        )
    free = free_memory()
    if demand.memory > MEMORY_SHARE * free:
        fits = int(scene.time.frames * MEMORY_SHARE * free / demand.memory)
        raise InputError(
            "time.frames",
            scene.time.frames,
            f"the run is forecast to take {demand.memory / 1e9:.1f} GB of memory, "
            f"{free / 1e9:.1f} GB are free.",
            f"Use at most {fits} frames, or fewer Gaussians."
            if fits > 1
            else "Use fewer Gaussians or a coarser accuracy.",
        )
    return demand


def free_memory() -> float:
    """Bytes that programs may still take; infinity where the system does not tell."""
    try:
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return float(line.split()[1]) * 1024
    except OSError:
        pass
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    return math.inf


def _substeps(scene: Scene) -> float:
    """How many substeps the elastic limit, the user's or the spin ask for."""
    duration = (scene.time.frames - 1) / scene.time.fps
    longest = min(_elastic(scene), _viscous(scene))
    turning = math.sqrt(2) * math.hypot(*scene.object.spin)
    if turning > 0:
        longest = min(longest, STRAIN_PER_STEP / turning)
    if scene.time.substep is not None:
        longest = min(longest, scene.time.substep)
    return duration / longest


def _elastic(scene: Scene) -> float:
    """Longest substep that stiffness allows at rest [s]."""
    fastest = max(section.wave_speed() for section in scene.materials)
    return scene.resolution.cfl * scene.dx / fastest


def _viscous(scene: Scene) -> float:
    """Longest substep that friction allows [s]."""
    friction = min(section.viscous_limit(scene.dx) for section in scene.materials)
    return beside_elastic(scene.resolution.cfl) * friction


def _quicker(scene: Scene, excess: float) -> str:
    """A setting that fits: the cause of the many substeps, made `excess` times cheaper."""
    longest = scene.time.substep
    timing = scene.time.model_copy(update={"substep": None})
    automatic = scene.model_copy(update={"time": timing})
    if longest is not None and _substeps(automatic) < _substeps(scene) / 2:
        return f"Leave time.substep out, or allow {longest * excess:.2g} s."
    frames = max(1, int((scene.time.frames - 1) / excess) + 1)
    others = f"{frames} frames, or a coarser accuracy, or more time.patience."
    if _viscous(scene) < _elastic(scene) / 2 and not scene.parts:
        name = next(n for n in ("damping", "viscosity") if hasattr(scene.material, n))
        fits = getattr(scene.material, name) / excess
        return f"material.{name} = {fits:.2g} would fit, or {others}"
    E = getattr(scene.material, "simulated_E", getattr(scene.material, "E", None))
    if E is not None and not scene.parts:
        softer = f"material.E = {E / excess**2:.2g} would fit, or the law rigid, or "
    else:
        softer = "A softer material would fit, or "
    return f"{softer}{others}"


def duration(seconds: float) -> str:
    """A time in words."""
    if seconds < 5400:
        return f"{seconds:.0f} s"
    if seconds < 2 * 86400:
        return f"{seconds / 3600:.1f} hours"
    return f"{seconds / 86400:.3g} days"
