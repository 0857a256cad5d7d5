"""Smooths the motion of particles before Gaussians follow it.

A grid does not resolve waves of one or two cells. Elastic material pushes such waves back, but
plastic material keeps them: the rim of pressed plasticine would be wavy. Therefore, the
displacement u and the gradient F of each particle are averaged over its neighbours at rest. The
smooth weights w sum to 1:

    u' = sum w_j u_j + (F' - 1) (X - sum w_j X_j),   F' = sum w_j F_j.

Smoothing does not change affine motions, even at the surface, where neighbours are on one side.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from phy124.gaussians import Particles

REACH = 1.25
"""The motion of a particle is averaged over the particles up to this distance [cells]."""
NEIGHBOURS = 64
"""Largest number of neighbours over which the motion of a particle is averaged."""
LARGEST = 0.25
"""Largest displacement of a particle by the smoothing [cells]: larger than the height of the
smoothed waves, but too small to close a gap in torn material.
"""


class Smoothing:
    """Smooths the motion of some particles, as a mean over the particles' neighbours."""

    def __init__(self, particles: Particles, chosen: NDArray[np.bool_], cell: float) -> None:
        """Find the neighbours of the particles whose motion is smoothed.

        Args:
            particles: P particles at rest.
            chosen: Mask of the particles to smooth [P]. The other particles are not changed, and
                have no weight.
            cell: Cell size of the simulation's grid, m.
        """
        body = np.zeros(len(particles), int) if particles.body is None else particles.body
        kinds = np.stack([particles.material, body], axis=1)[chosen]
        places, self._largest = np.flatnonzero(chosen), LARGEST * cell
        order, parts = [], []
        for kind in np.unique(kinds, axis=0):
            part = places[(kinds == kind).all(axis=1)]
            order.append(part)
            parts.append(_weights(particles.x[part], REACH * cell))
        self._chosen = np.concatenate(order)
        self._weights: Any = scipy.sparse.block_diag(parts, format="csr").astype(np.float32)
        self._rest = particles.x[self._chosen]
        self._aside = self._rest - self._weights @ self._rest

    def __call__(self, x: NDArray, F: NDArray) -> tuple[NDArray, NDArray]:
        """Return the smooth positions [P,3] m and gradients [P,3,3] of all particles."""
        raw, strain = x[self._chosen], F[self._chosen] - np.eye(3, dtype=F.dtype)
        mean = (self._weights @ strain.reshape(-1, 9)).reshape(-1, 3, 3)
        turned = (mean @ self._aside[:, :, None])[..., 0]
        shift = self._rest + self._weights @ (raw - self._rest) + turned - raw
        length = np.sqrt(np.einsum("ni,ni->n", shift, shift))
        share = np.minimum(1, self._largest / np.maximum(length, 1e-12))[:, None]
        x, F = x.copy(), F.copy()
        x[self._chosen] += share * shift
        F[self._chosen] += share[:, :, None] * (mean - strain)
        return x, F


def _weights(x: NDArray, reach: float) -> Any:
    """Return the weights [P,P] of neighbours of particles at x [P,3], m; each row sums to 1."""
    count = min(NEIGHBOURS, len(x))
    result = scipy.spatial.KDTree(x).query(x, count, distance_upper_bound=reach, workers=-1)
    away, index = (np.asarray(array).reshape(len(x), count) for array in result)
    near = np.isfinite(away)
    weights = (1 - (away[near] / reach) ** 2) ** 2
    starts = np.append(0, np.cumsum(near.sum(axis=1)))
    rows = scipy.sparse.csr_matrix((weights, index[near], starts), (len(x), len(x)))
    return scipy.sparse.diags(1 / np.asarray(rows.sum(axis=1)).ravel()) @ rows
