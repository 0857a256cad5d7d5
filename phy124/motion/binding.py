"""Binds Gaussians to particles: selects the particles that carry each Gaussian, with weights."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
import scipy
import warp as wp
from numpy.typing import NDArray

from phy124.gaussians import Gaussians, Particles, by_object
from phy124.kernels import carriers
from phy124.kernels.carriers import CARRIERS
from phy124.motion.blocks import BlockLauncher, Step
from phy124.runtime.cores import cores

PER_CELL = 2
"""Mean number of particles per cell of the search grid."""
MOST_CELLS = 256
"""Largest number of cells of the search grid along each axis."""
FARTHEST = 4.0
"""Several particles carry a Gaussian up to this distance, in mean distances between particles. A
Gaussian that is farther away follows only the nearest particle, because the grid does not connect
material that is so far apart.
"""


class Binding(NamedTuple):
    """The particles that carry each Gaussian, and their weights."""

    particles: NDArray[np.int32]
    """Indices of the K particles that carry each Gaussian [N,K], or of its single particle [N]."""
    weights: NDArray[np.float32] | None
    """Weights that sum to 1 [N,K]; None if each Gaussian follows a single particle."""

    def interpolate(
        self, values: NDArray[np.float64], alone: NDArray | float = 0.0
    ) -> NDArray[np.float32]:
        """Return weighted means [N,3] of values on the particles [P,3].

        The fraction `alone` [N] of each mean is replaced by the nearest particle's value.
        """
        if self.weights is None:
            return values[self.particles].astype(np.float32)
        out = np.zeros((len(self.weights), 3))
        for k in range(self.weights.shape[1]):
            out += self.weights[:, k, None] * values[self.particles[:, k]]
        out += np.reshape(alone, (-1, 1)) * (values[self.particles[:, 0]] - out)
        return out.astype(np.float32)

    def select(self, chosen: NDArray) -> Binding:
        """Return the binding of some of the Gaussians."""
        return Binding(
            self.particles[chosen], None if self.weights is None else self.weights[chosen]
        )


def bind(gaussians: Gaussians, particles: Particles | None) -> Binding:
    """Find the particles that carry each Gaussian.

    Raises:
        ValueError: The particles were made from other Gaussians.
    """
    if particles is None:
        return Binding(np.arange(len(gaussians), dtype=np.int32), None)
    bound = _bound_particles(len(gaussians), particles)
    return Binding(*_carriers_of(gaussians, particles)) if bound is None else Binding(bound, None)


def pick_values(gaussians: Gaussians, particles: Particles, values: NDArray) -> NDArray:
    """Return a value for each Gaussian [N] from the values of the particles [P].

    The value is that of the particle that represents the Gaussian. If no particle represents the
    Gaussian, the value is that of the nearest particle.
    """
    # If all values are equal, for example with a single material, no search is needed.
    if len(values) and (values == values[0]).all():
        return np.repeat(values[:1], len(gaussians), axis=0)
    particle = _bound_particles(len(gaussians), particles)
    if particle is None:
        particle = np.zeros(len(gaussians), np.int64)
        for ours, theirs in by_object(gaussians, particles):
            tree = scipy.spatial.KDTree(particles.x[theirs])
            particle[ours] = theirs[tree.query(gaussians.means[ours], workers=-1)[1]]
    return values[particle]


def _carriers_of(
    gaussians: Gaussians, particles: Particles
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the particles of the same separate piece that carry each Gaussian, and their
    weights.
    """
    several = particles.body is not None and gaussians.object_id is not None
    if not several and particles.piece is None:
        return _carriers_within(gaussians.means, particles.x, particles.volume)
    neighbours = np.zeros((len(gaussians), CARRIERS), np.int32)
    weights = np.zeros((len(gaussians), CARRIERS), np.float32)
    for ours, theirs in _by_piece(gaussians, particles):
        means, x, volume = gaussians.means[ours], particles.x[theirs], particles.volume[theirs]
        index, weights[ours] = _carriers_within(means, x, volume)
        neighbours[ours] = theirs[index]
    return neighbours, weights


def _by_piece(
    gaussians: Gaussians, particles: Particles
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Yield the Gaussians and the particles of each separate piece of each object.

    A Gaussian belongs to the piece of the nearest particle.
    """
    for ours, theirs in by_object(gaussians, particles):
        piece = None if particles.piece is None else particles.piece[theirs]
        if piece is None or not piece.any():
            yield ours, theirs
            continue
        tree = scipy.spatial.KDTree(particles.x[theirs])
        nearest = piece[tree.query(gaussians.means[ours], workers=-1)[1]]
        for k in np.unique(nearest):
            yield ours[nearest == k], theirs[piece == k]


def _carriers_within(
    means: NDArray, x: NDArray, volume: NDArray
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    # The distance is rounded, so that equal volumes and their mean give equal weights.
    index, weights = find_carriers(means, x, float(np.float32(FARTHEST * np.cbrt(volume.mean()))))
    if len(x) < CARRIERS:
        # A few particles do not determine the motion far away, so only the nearest particle is
        # used.
        weights[:] = np.eye(1, CARRIERS)
    return index, weights


def find_carriers(
    points: NDArray, particles: NDArray, farthest: float = math.inf
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the nearest particles of each point [N,K] and their weights [N,K], which sum to 1.

    The weight at the distance d is proportional to (1 - (d / R)^2)^2, where R is the distance of
    the nearest particle that is not chosen. R is at most twice the distance of the farthest chosen
    particle, and at most the larger of `farthest` and twice the distance of the nearest particle.
    The weights vary smoothly in space, since a particle enters and leaves the chosen set with
    weight 0. If there are fewer than K particles, the last weights are 0.
    """
    low, high = particles.min(axis=0).astype(np.float64), particles.max(axis=0)
    extent = np.maximum(high - low, 1e-9)
    cell = max(float(np.cbrt(extent.prod() * PER_CELL / len(particles))), extent.max() / MOST_CELLS)
    shape = np.floor(extent / cell).astype(np.int64) + 1
    place = np.minimum(((particles - low) / cell).astype(np.int64), shape - 1)
    flat = np.ravel_multi_index(tuple(place.T), tuple(shape))
    order = np.argsort(flat, kind="stable").astype(np.int32)
    starts = np.zeros(shape.prod() + 1, np.int32)
    np.cumsum(np.bincount(flat, minlength=shape.prod()), out=starts[1:])
    neighbours = np.empty((len(points), CARRIERS), np.int32)
    weights = np.empty((len(points), CARRIERS), np.float32)
    ordered, sorted_x = (np.ascontiguousarray(a, np.float32) for a in (points, particles[order]))
    written: list[Any] = [wp.array(a, device="cpu", copy=False) for a in (neighbours, weights)]
    shared = [wp.array(sorted_x, dtype=wp.vec3, device="cpu", copy=False)]
    shared += [wp.array(a, device="cpu", copy=False) for a in (order, starts)]
    numbers = [wp.vec3i(*shape.tolist()), wp.vec3d(*low.tolist()), cell, min(farthest, 1e100)]
    mine = [wp.array(ordered, dtype=wp.vec3, device="cpu", copy=False)]
    step = Step(carriers.find_carriers, mine, [*shared, *numbers], written)
    BlockLauncher(len(points), "cpu", cores()).run([step])
    return neighbours, weights


def _bound_particles(count: int, particles: Particles | None) -> NDArray[np.int32] | None:
    """Return the index of the particle that represents each Gaussian [N].

    The result is None if `particles` is None (one particle per Gaussian, in order), or if the
    binding is a lattice.
    """
    if particles is None or (particles.gaussian < 0).all():
        return None
    bound = np.flatnonzero(particles.gaussian >= 0)
    if not np.array_equal(np.sort(particles.gaussian[bound]), np.arange(count)):
        raise ValueError(f"the particles were not made from these {count} Gaussians")
    particle = np.empty(count, np.int32)
    particle[particles.gaussian[bound]] = bound
    return particle
