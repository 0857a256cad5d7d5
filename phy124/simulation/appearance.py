"""Appearance: how the Gaussians of each material are shown as they move; nothing of the motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.materials import AnyMaterial
from phy124.materials.base import FLOWING, SHADING
from phy124.monitor.tearing import APART
from phy124.particles import Particles
from phy124.particles.grains import add_grains, tint, vary_brightness
from phy124.scene import Scene
from phy124.simulation.deform import of_gaussians


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
    flows: NDArray[np.bool_]
    """Which of those that move are of what comes apart, whose F grows without bound."""
    holds: NDArray[np.float64]
    """Largest stretch that the material of each that moves can hold; may be infinite."""
    kinds: NDArray[np.int64]
    """The material of each that moves."""

    def limits(self) -> dict[str, NDArray]:
        """Return the arguments of `Deformer` that limit the shapes."""
        return {
            "max_stretch": self.max_stretch,
            "rounds": self.rounds,
            "flows": self.flows,
            "holds": self.holds,
        }

    def shine(self, materials: Sequence[AnyMaterial]) -> dict[str, list[list[int]]]:
        """Which Gaussians are of a law that shines: runs of the first and one past the last.

        Args:
            materials: The materials.
        """
        laws = np.array([section.law for section in materials])[self.kinds]
        found = {}
        for law in sorted({section.law for section in materials if section.shines}):
            own = np.zeros(len(self.moves) + 2, np.int8)
            own[np.flatnonzero(self.moves)[laws == law] + 1] = 1
            found[law] = np.flatnonzero(np.diff(own)).reshape(-1, 2).tolist()
        return found

    def shapes(self, clip: Clip, materials: Sequence[AnyMaterial]) -> dict[str, dict[str, float]]:
        """How long the Gaussians of each law become in a clip, and how opaque they are.

        Args:
            clip: The clip; Gaussians that it has beyond these are balls.
            materials: The materials.

        Returns:
            For each law the largest ratio of the longest axis to the middle one, `needle`, and to
            the shortest one, `axis_ratio`, and the largest `opacity`.
        """
        laws, moving = np.array([section.law for section in materials]), np.flatnonzero(self.moves)
        found = {}
        for law in np.unique(laws[self.kinds]):
            own = moving[laws[self.kinds] == law]
            needle = flat = 1.0
            for scales in clip.scales:
                # A sixth of the time of sorting three numbers each.
                a, b, c = np.maximum(scales[own], np.finfo(np.float32).tiny).T
                low, high = np.minimum(a, b), np.maximum(a, b)
                longest, middle = np.maximum(high, c), np.maximum(low, np.minimum(high, c))
                needle = max(needle, float((longest / middle).max()))
                flat = max(flat, float((longest / np.minimum(low, c)).max()))
            opacity = float(clip.opacities[own].max())
            found[str(law)] = {"needle": needle, "axis_ratio": flat, "opacity": opacity}
        return found


def appearance(
    gaussians: Gaussians,
    particles: Particles,
    moves: NDArray[np.bool_],
    materials: Sequence[AnyMaterial],
    scene: Scene,
    spacing: float,
) -> Appearance:
    """How an object is shown.

    Args:
        gaussians: The object at rest, N Gaussians, m.
        particles: The particles that move.
        moves: Which of the Gaussians move [N].
        materials: The materials of the particles.
        scene: Says whether grains are shown.
        spacing: Distance of neighbouring particles, m.
    """
    surface = len(gaussians)
    if scene.grains:
        gaussians, particles = add_grains(gaussians, particles, moves, materials, spacing)
    moves = np.append(moves, np.ones(len(gaussians) - surface, bool))
    kinds = of_gaussians(gaussians.select(moves), particles, particles.material)
    flows = np.array([section.rounds for section in materials])[kinds]
    shades = np.zeros(len(gaussians))
    if scene.grains:
        shades[moves] = np.array([section.shade for section in materials])[kinds]
    for index, section in enumerate(materials):
        if section.tint is not None:
            chosen = moves.copy()
            chosen[moves] = kinds == index
            gaussians = tint(gaussians, chosen, section.tint, SHADING)
    return Appearance(
        vary_brightness(gaussians, shades, scene.seed) if shades.any() else gaussians,
        particles,
        moves,
        max_stretch=np.array([section.longest for section in materials])[kinds],
        # Grains are below the surface: as balls they would show through where it is thin.
        rounds=flows & (np.flatnonzero(moves) < surface),
        flows=flows,
        kinds=kinds,
        holds=np.array([_holds(section, scene) for section in materials])[kinds],
    )


def _holds(section: AnyMaterial, scene: Scene) -> float:
    """Largest stretch of F that a material can hold.

    Elastic material is torn where its particles have been drawn so far apart that they share no
    nodes. The F of plastic flow has no bound.
    """
    if section.device_law.project is None:
        return APART * scene.particles_per_axis
    return np.inf if section.rounds else FLOWING
