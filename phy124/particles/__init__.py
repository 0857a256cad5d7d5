"""Turns Gaussians into material particles: cleans the Gaussians; finds size, interior and mass.

There are two bindings of Gaussians to particles:

- `lattice`: a regular lattice of particles fills the solid, and the motion of the Gaussians is
  interpolated from the particles (`phy124.motion.deform`). The number of Gaussians therefore hardly
  affects the simulation. Thin parts have additional particles at the positions of Gaussians, at
  half the spacing. Particles of sand are moved to random positions in their lattice cells
  (`phy124.particles.scatter`).
- `particles`, the method of the paper (Phy124, arXiv 2409.07179): every Gaussian is an MPM
  particle, and further particles fill the closed interior, as in PhysGaussian (arXiv 2311.12198).
"""

from phy124.gaussians import Particles, by_object
from phy124.particles.cleaning import (
    Cleaning,
    clean,
    compute_bounds,
    scale_to_size,
    size_transform,
    visible_area,
)
from phy124.particles.seeding import BINDINGS, fill, is_in_box, make_particles
from phy124.particles.solid import Solid, find_solid

__all__ = [
    "BINDINGS",
    "Cleaning",
    "Particles",
    "Solid",
    "by_object",
    "clean",
    "compute_bounds",
    "fill",
    "find_solid",
    "is_in_box",
    "make_particles",
    "scale_to_size",
    "size_transform",
    "visible_area",
]
