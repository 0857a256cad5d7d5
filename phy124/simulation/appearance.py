"""Appearance: the visible Gaussians of each material; they do not affect the motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Gaussians
from phy124.io.clip import Clip
from phy124.materials import AnyMaterial
from phy124.materials.base import FLOWING, SHADING
from phy124.monitor.tearing import APART
from phy124.motion.deform import of_gaussians
from phy124.particles import Particles
from phy124.particles.grains import add_grains, tint, vary_brightness
from phy124.scene import Scene


class Appearance(NamedTuple):
    """The visible Gaussians: N on the surface, and G grains inside materials that separate."""

    gaussians: Gaussians
    """All Gaussians at rest, N + G, m; the grains come last."""
    particles: Particles
    """Particles of the solver; each moving Gaussian may have its own particle."""
    moves: NDArray[np.bool_]
    """Mask of the Gaussians that move [N + G]."""
    max_stretch: NDArray[np.float64]
    """Largest ratio of each moving Gaussian's longest axis to its longest axis at rest; may be
    infinite.
    """
    rounds: NDArray[np.bool_]
    """Mask of the moving Gaussians that become balls when they are stretched."""
    flows: NDArray[np.bool_]
    """Mask of the moving Gaussians of materials that separate, whose F grows without bound."""
    holds: NDArray[np.float64]
    """Largest stretch of each moving Gaussian's material before it tears; may be infinite."""
    kinds: NDArray[np.int64]
    """Index of the material of each moving Gaussian."""

    def limits(self) -> dict[str, Any]:
        """Return the arguments of `Deformer` that limit the shapes."""
        return {
            "max_stretch": self.max_stretch,
            "rounds": self.rounds,
            "flows": self.flows,
            "holds": self.holds,
        }

    def shine(self, materials: Sequence[AnyMaterial]) -> dict[str, list[list[int]]]:
        """Return, for each glossy law, the spans of its Gaussians: first and one past the last."""
        spans = {}
        for law in sorted({section.law for section in materials if section.shines}):
            inside = np.zeros(len(self.moves) + 2, np.int8)
            inside[self._of_law(law, materials) + 1] = 1
            spans[law] = np.flatnonzero(np.diff(inside)).reshape(-1, 2).tolist()
        return spans

    def shapes(self, clip: Clip, materials: Sequence[AnyMaterial]) -> dict[str, dict[str, float]]:
        """Return the elongation and opacity of each law's Gaussians in a clip.

        Args:
            clip: The clip; its Gaussians beyond these are balls.
            materials: The materials.

        Returns:
            For each law, the largest ratio of the longest axis to the middle axis, `needle`, and to
            the shortest axis, `axis_ratio`, and the largest `opacity`.
        """
        rows = {}
        for law in sorted({section.law for section in materials}):
            chosen = self._of_law(law, materials)
            if not len(chosen):
                continue
            needle = flat = 1.0
            for scales in clip.scales:
                # This takes a sixth of the time of sorting three numbers each.
                a, b, c = np.maximum(scales[chosen], np.finfo(np.float32).tiny).T
                low, high = np.minimum(a, b), np.maximum(a, b)
                longest, middle = np.maximum(high, c), np.maximum(low, np.minimum(high, c))
                needle = max(needle, float((longest / middle).max()))
                flat = max(flat, float((longest / np.minimum(low, c)).max()))
            opacity = float(clip.opacities[chosen].max())
            rows[law] = {"needle": needle, "axis_ratio": flat, "opacity": opacity}
        return rows

    def _of_law(self, law: str, materials: Sequence[AnyMaterial]) -> NDArray[np.int64]:
        """Return the indices of the moving Gaussians whose material has a law."""
        chosen = np.array([section.law == law for section in materials])[self.kinds]
        return np.flatnonzero(self.moves)[chosen]


def make_appearance(
    gaussians: Gaussians,
    particles: Particles,
    moves: NDArray[np.bool_],
    materials: Sequence[AnyMaterial],
    scene: Scene,
    spacing: float,
) -> Appearance:
    """Return the appearance of an object.

    Args:
        gaussians: The object at rest, N Gaussians, m.
        particles: The particles that move.
        moves: Mask of the Gaussians that move [N].
        materials: The materials of the particles.
        scene: The scene, which defines whether grains are shown.
        spacing: Distance between neighbouring particles [m].
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
        # Grains are below the surface: as balls they would show through thin parts.
        rounds=flows & (np.flatnonzero(moves) < surface),
        flows=flows,
        kinds=kinds,
        holds=np.array([_max_stretch(section, scene) for section in materials])[kinds],
    )


def _max_stretch(section: AnyMaterial, scene: Scene) -> float:
    """Return the largest stretch before a material tears.

    Elastic material tears if its particles are too far apart to share nodes. The F of plastic flow
    has no bound.
    """
    if section.device_law.project is None:
        return APART * scene.particles_per_axis
    return np.inf if section.rounds else FLOWING
