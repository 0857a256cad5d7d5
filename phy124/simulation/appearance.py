"""Appearance: how the Gaussians of each material are shown as they move; nothing of the motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.deform import of_gaussians
from phy124.gaussians import Gaussians
from phy124.materials import AnyMaterial
from phy124.particles import Particles
from phy124.particles.grains import shaded, with_grains
from phy124.scene import Scene


class Appearance(NamedTuple):
    """What is shown: N Gaussians on the surface, and G grains inside what falls apart."""

    gaussians: Gaussians
    """All of them at rest, N + G, m; the grains are the last."""
    particles: Particles
    """Those of the solver; each Gaussian that moves may have one."""
    moves: NDArray[np.bool_]
    """Which Gaussians move [N + G]."""
    max_stretch: NDArray[np.float64]
    """Longest axis of each that moves, relative to its longest axis at rest; may be infinite."""
    rounds: NDArray[np.bool_]
    """Which of those that move become balls as they are drawn out."""


def appearance(
    gaussians: Gaussians,
    particles: Particles,
    moves: NDArray[np.bool_],
    materials: Sequence[AnyMaterial],
    scene: Scene,
) -> Appearance:
    """How an object is shown.

    Args:
        gaussians: The object at rest, N Gaussians, m.
        particles: The particles that move.
        moves: Which of the Gaussians move [N].
        materials: The materials of the particles.
        scene: Says whether grains are shown.
    """
    surface = len(gaussians)
    if scene.grains:
        gaussians, particles = with_grains(gaussians, particles, moves, materials, scene.spacing)
    moves = np.append(moves, np.ones(len(gaussians) - surface, bool))
    kinds = of_gaussians(gaussians.select(moves), particles, particles.material)
    rounds = np.array([section.rounds for section in materials])[kinds]
    shades = np.zeros(len(gaussians))
    if scene.grains:
        shades[moves] = np.array([section.shade for section in materials])[kinds]
    return Appearance(
        shaded(gaussians, shades, scene.seed) if shades.any() else gaussians,
        particles,
        moves,
        max_stretch=np.array([section.longest for section in materials])[kinds],
        # Grains are below the surface: as balls they would show through where it is thin.
        rounds=rounds & (np.flatnonzero(moves) < surface),
    )
