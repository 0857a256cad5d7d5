"""Creates the visible Gaussians of each material."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import Array, Gaussians
from phy124.materials import AnyMaterial
from phy124.materials.base import FLOWING
from phy124.materials.fluid import Fluid
from phy124.monitor.tearing import APART
from phy124.motion.binding import pick_values
from phy124.particles import Particles
from phy124.particles.grains import add_grains, roughen, tint, vary_brightness
from phy124.scene import Scene

SEEN = {"visibility", "viscosity"}
BLOCK = 1 << 15
"""Number of Gaussians that are measured at a time; their data stay in the cache."""


class Appearance(NamedTuple):
    """The visible Gaussians: N on the surface, and G grains inside materials that separate."""

    gaussians: Gaussians
    """All N + G Gaussians at rest, in metres; the grains come last."""
    particles: Particles
    moves: NDArray[np.bool_]
    """Mask of the moving Gaussians [N + G]."""
    max_stretch: NDArray[np.float64]
    """Largest length of each moving Gaussian's longest axis, relative to its length at rest."""
    rounds: NDArray[np.bool_]
    """Whether each moving Gaussian becomes a ball when the material is stretched."""
    flows: NDArray[np.bool_]
    """Whether the deformation gradient F of each moving Gaussian's material grows without bound."""
    holds: NDArray[np.float64]
    """Largest stretch of each moving Gaussian's material before the material tears."""
    kinds: NDArray[np.int64]
    """Index of the material of each moving Gaussian."""

    def limits(self) -> dict[str, Any]:
        """Return the arguments of `Deformer` that limit the shapes of Gaussians."""
        return {
            "max_stretch": self.max_stretch,
            "rounds": self.rounds,
            "flows": self.flows,
            "holds": self.holds,
        }

    def shine(self, materials: Sequence[AnyMaterial]) -> dict[str, list[list[int]]]:
        """For each glossy law, return the index ranges of its Gaussians."""
        laws = sorted({section.law for section in materials if section.shines})
        return {law: self._spans(self._has_law(law, materials)) for law in laws}

    def liquids(self, materials: Sequence[AnyMaterial]) -> list[dict[str, Any]]:
        """Return a dict for each liquid: its visibility [m] or None, its viscosity [Pa s], the
        index ranges (`runs`) of its Gaussians, and for each range the volume of a Gaussian
        (`volumes`) [m^3].

        Materials that differ only in their colours are one liquid: no surface separates them.
        """
        liquids: dict[str, dict[str, Any]] = {}
        for k, section in enumerate(materials):
            if isinstance(section, Fluid):
                runs, volumes = self._volumes(k)
                empty = {"runs": [], "volumes": [], **section.model_dump(include=SEEN)}
                liquid = liquids.setdefault(section.model_dump_json(exclude={"tint"}), empty)
                liquid["runs"] += runs
                liquid["volumes"] += volumes
        return list(liquids.values())

    def matte(self, materials: Sequence[AnyMaterial]) -> list[dict[str, Any]]:
        """For each material that a lamp lights, return the index ranges (spans) of its Gaussians,
        and the volume of a Gaussian in each range [m^3].

        Without grains, a material is hollow and is not lit.
        """
        filled = set(self.kinds[~self.rounds].tolist())
        lit = [
            self._volumes(k) for k, section in enumerate(materials) if section.lit and k in filled
        ]
        return [{"runs": runs, "volumes": volumes} for runs, volumes in lit]

    def dents(self, materials: Sequence[AnyMaterial]) -> list[list[list[int]]]:
        """For each solid that keeps dents and has no gloss, return the index ranges of its
        Gaussians.
        """
        solids = [k for k, section in enumerate(materials) if section.dents and not section.shines]
        return self._spans_of(solids)

    def fragments(self, materials: Sequence[AnyMaterial]) -> list[list[list[int]]]:
        """For each material with grains that crumbles, return the index ranges of its Gaussians."""
        filled = set(self.kinds[~self.rounds].tolist())
        return self._spans_of(
            [k for k, section in enumerate(materials) if section.crumbles and k in filled]
        )

    def _spans_of(self, kinds: Sequence[int]) -> list[list[list[int]]]:
        spans = [self._spans(self.kinds == k) for k in kinds]
        return [span for span in spans if span]

    def _volumes(self, kind: int) -> tuple[list[list[int]], list[float]]:
        """Return the index ranges of a material's Gaussians, and the volume of a Gaussian in each.

        A grain has the volume of a particle. The remaining volume of the material is divided among
        the Gaussians on the surface.
        """
        particles = self.particles.volume[self.particles.material == kind]
        surface = self._spans(self.rounds & (self.kinds == kind))
        grains = self._spans(~self.rounds & (self.kinds == kind))
        each = float(particles.sum() / max(len(particles), 1))
        left = each * (len(particles) - _count(grains)) / max(_count(surface), 1)
        return surface + grains, [left] * len(surface) + [each] * len(grains)

    def _spans(self, chosen: NDArray[np.bool_]) -> list[list[int]]:
        """Return the index ranges of the chosen moving Gaussians among all Gaussians."""
        inside = np.zeros(len(self.moves) + 2, np.int8)
        inside[np.flatnonzero(self.moves)[chosen] + 1] = 1
        return np.flatnonzero(np.diff(inside)).reshape(-1, 2).tolist()

    def elongation(
        self, materials: Sequence[AnyMaterial]
    ) -> Callable[[Mapping[str, Array]], NDArray[np.float64]]:
        """Return a function that measures the Gaussians of a frame.

        For each law, in alphabetical order, the function returns the largest ratios of a Gaussian's
        longest axis to the middle and to the shortest axis [L,2].
        """
        every = [self._of_law(law, materials) for law in _laws(materials)]

        def measure(frame: Mapping[str, Array]) -> NDArray[np.float64]:
            scales = frame["scales"]
            return np.array([_elongation(scales, chosen) for chosen in every]).reshape(-1, 2)

        return measure

    def shapes(
        self, ratios: Sequence[NDArray], opacities: Array, materials: Sequence[AnyMaterial]
    ) -> dict[str, dict[str, float]]:
        """Return the elongation and opacity of each law's Gaussians in a clip.

        Returns:
            For each law, `needle` (largest ratio of the longest to the middle axis), `axis_ratio`
            (largest ratio of the longest to the shortest axis), and the largest `opacity`.
        """
        rows, largest = {}, np.maximum.reduce([np.asarray(frame) for frame in ratios])
        for law, (needle, flat) in zip(_laws(materials), largest.tolist(), strict=True):
            chosen = self._of_law(law, materials)
            if len(chosen):
                opacity = float(opacities[chosen].max())
                rows[law] = {"needle": needle, "axis_ratio": flat, "opacity": opacity}
        return rows

    def _of_law(self, law: str, materials: Sequence[AnyMaterial]) -> NDArray[np.int64]:
        return np.flatnonzero(self.moves)[self._has_law(law, materials)]

    def _has_law(self, law: str, materials: Sequence[AnyMaterial]) -> NDArray[np.bool_]:
        return np.array([section.law == law for section in materials])[self.kinds]


def _count(spans: list[list[int]]) -> int:
    return sum(last - first for first, last in spans)


def _laws(materials: Sequence[AnyMaterial]) -> list[str]:
    return sorted({section.law for section in materials})


def _elongation(scales: Array, chosen: NDArray[np.int64]) -> tuple[float, float]:
    """Return the largest ratios of the longest axis to the middle and to the shortest axis."""
    needle = flat = 1.0
    for start in range(0, len(chosen), BLOCK):
        # Sorting the three lengths of each Gaussian would take six times as long.
        some = scales[chosen[start : start + BLOCK]]
        a, b, c = np.maximum(some, np.finfo(np.float32).tiny).T
        low, high = np.minimum(a, b), np.maximum(a, b)
        longest, middle = np.maximum(high, c), np.maximum(low, np.minimum(high, c))
        needle = max(needle, float((longest / middle).max()))
        flat = max(flat, float((longest / np.minimum(low, c)).max()))
    return needle, flat


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
        particles: The particles.
        moves: Mask of the Gaussians that move [N].
        materials: The materials.
        scene: The scene.
        spacing: Distance between neighbouring particles [m].
    """
    surface = len(gaussians)
    if scene.grains:
        gaussians, particles = add_grains(gaussians, particles, moves, materials, spacing)
    moves = np.append(moves, np.ones(len(gaussians) - surface, bool))
    kinds = pick_values(gaussians.select(moves), particles, particles.material)
    flows = np.array([section.rounds for section in materials])[kinds]
    shades, rough = np.zeros((2, len(gaussians)))
    # Only grains on the surface are shaded: grains inside are larger, and would look like blotches.
    above = np.flatnonzero(moves) < surface
    rough[moves] = above * np.array([section.rough for section in materials])[kinds]
    if scene.grains:
        shades[moves] = above * np.array([section.shade for section in materials])[kinds]
    for index, section in enumerate(materials):
        if section.tint is not None:
            chosen = moves.copy()
            chosen[moves] = kinds == index
            gaussians = tint(gaussians, chosen, section.tint, section.shading, section.lit)
    if shades.any():
        gaussians = vary_brightness(gaussians, shades, scene.seed)
    if rough.any():
        gaussians = roughen(gaussians, rough, scene.seed)
    return Appearance(
        gaussians,
        particles,
        moves,
        max_stretch=np.array([section.longest for section in materials])[kinds],
        # Grains are below the surface; as balls they would be visible through thin parts.
        rounds=flows & above,
        flows=flows,
        kinds=kinds,
        holds=np.array([_max_stretch(section, scene) for section in materials])[kinds],
    )


def _max_stretch(section: AnyMaterial, scene: Scene) -> float:
    """Return the largest stretch at which a material does not tear.

    Elastic material tears if its particles are too far apart to have common nodes. The deformation
    gradient F of plastic material has no bound.
    """
    if section.device_law.project is None:
        return APART * scene.particles_per_axis
    return np.inf if section.rounds else FLOWING
