"""Moves particles from a lattice to random positions, so that no rows are visible.

Sand that spreads in thin layers is stretched to several times its length. Particles of a regular
lattice would then form visible rows.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from phy124.gaussians import Particles
from phy124.materials import AnyMaterial
from phy124.particles.solid import Solid

LARGEST = 0.5
"""Largest shift along each axis, in particle spacings: half of a lattice cell."""


def scatter(
    particles: Particles,
    solid: Solid,
    materials: Sequence[AnyMaterial],
    *,
    spacing: float,
    seed: int,
) -> Particles:
    """Shift the particles of materials that spread in thin layers by random distances.

    A particle that would leave the object is not moved.

    Args:
        particles: P particles at rest.
        solid: The object's interior.
        materials: Materials of the particles; `scatters` selects those that are shifted.
        spacing: Distance between neighbouring particles [m].
        seed: Seed of the random numbers.
    """
    chosen = np.array([section.scatters for section in materials], bool)[particles.material]
    if not chosen.any():
        return particles
    shifts = np.random.default_rng(seed).uniform(-LARGEST, LARGEST, particles.x.shape) * spacing
    shifted = (particles.x + shifts).astype(np.float32)
    chosen &= solid.contains(shifted)
    return replace(particles, x=np.where(chosen[:, None], shifted, particles.x))
