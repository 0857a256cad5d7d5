"""Turns Gaussians into material particles: cleaning, size, interior, volume, mass.

There are two ways to bind them. With `lattice` a regular lattice through the solid carries the
physics, and the Gaussians are interpolated from it (`phy124.simulation.deform`), so that their
number hardly affects the simulation; where the object is thin, there are particles at its
Gaussians, too, half as far apart. `particles` is the paper's form (Phy124, arXiv 2409.07179): every
Gaussian is an MPM particle, and the closed interior is filled with more (as PhysGaussian, arXiv
2311.12198, does).
"""

from phy124.particles.cleaning import (
    Cleaning,
    clean,
    compute_bounds,
    scale_to_size,
    size_transform,
    visible_area,
)
from phy124.particles.seeding import (
    BINDINGS,
    Particles,
    by_object,
    fill,
    is_in_box,
    make_particles,
)
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
