"""Draws broken material that crumbles, such as snow, as fragments with gaps in between.

Cracks in snow are narrower than a cell of the grid, so the simulated snow around a crack is
stretched and would look like dough. Therefore, the material is divided into fragments at rest, and
an affine motion is fitted to each fragment in each frame, as in shape matching (Mueller et al.
2005). A fragment that would be stretched keeps its shape, so gaps open around it.
"""

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

LUMP = 0.12
"""Mean size of lumps, which are divided into fragments, relative to the longest side at rest."""
SIZES = 0.11, 0.06, 0.04
"""Mean sizes of fragments, one for each lump, relative to the longest side at rest."""
WHOLE, BROKEN = 1.06, 1.3
"""A fragment deforms up to the first stretch, and keeps its shape above the second stretch."""
SMALLEST = 0.7
"""Smallest size of a fragment that was compressed before it broke, relative to its size at rest."""
NEWTON = 6
"""Number of Newton steps for a rotation; enough if stretches along the axes differ tenfold."""
FLAT = 1e-3
"""Weight of the lump's motion in the fit of a fragment, relative to the variance of the fragment's
positions. The lump's motion is needed because the few Gaussians of a small fragment may lie in a
plane.
"""


class Fragments:
    """The fragments of one material of a clip."""

    def __init__(self, which: NDArray[np.int64], x: NDArray) -> None:
        """Divide a material into fragments.

        `which` [n] are the indices of its Gaussians, and `x` [n,3], m, their positions at rest.
        """
        self.which = which
        lump, self._fragment = _divide(x, np.random.default_rng(0))
        self._lump = np.empty(self._fragment.max() + 1, np.int64)
        self._lump[self._fragment] = lump
        self._all = Affine(x, np.zeros_like(lump))
        self._lumps, self._fragments = Affine(x, lump), Affine(x, self._fragment)

    def shape(self, x: NDArray) -> NDArray[np.float32]:
        """Return the positions [n,3] m at which the fragments' Gaussians at x [n,3] are drawn."""
        drawn = np.array(x, np.float32)
        centred = drawn - drawn.mean(axis=0)
        whole = self._all.fit(centred, np.eye(3, dtype=np.float32))
        F = self._fragments.fit(centred, self._lumps.fit(centred, whole)[self._lump])
        stretch = _largest_stretch(F)
        torn = np.flatnonzero(stretch > WHOLE)
        share = np.clip((stretch[torn] - WHOLE) / (BROKEN - WHOLE), 0, 1)[:, None, None]
        rotation, volume = _polar(F[torn])
        size = np.clip(volume, SMALLEST**3, 1)[:, None, None] ** np.float32(1 / 3)
        F[torn] = share * (size * rotation - F[torn])
        moved = np.flatnonzero((stretch > WHOLE)[self._fragment])
        arms = self._fragments.arms[moved]
        drawn[moved] += np.einsum("nij,ni->nj", F[self._fragment[moved]], arms)
        return drawn


class Affine:
    """Fits affine motions to groups of points."""

    def __init__(self, x: NDArray, group: NDArray[np.int64]) -> None:
        """Set the positions x [n,3] of points at rest, m, and each point's group number [n]."""
        n, m = len(x), group.max() + 1
        middle = np.stack([np.bincount(group, side) for side in x.T], axis=1)
        middle /= np.bincount(group)[:, None]
        arms = x - middle[group]
        self.arms = arms.astype(np.float32)
        """Positions of the points relative to the middle of their group [n,3], m."""
        moments = np.zeros((m, 3, 3))
        np.add.at(moments, group, arms[:, :, None] * arms[:, None])
        spare = FLAT * np.trace(moments, axis1=1, axis2=2) + np.finfo(np.float32).tiny
        inverse = np.linalg.inv(moments + spare[:, None, None] * np.eye(3))
        self._share = (spare[:, None, None] * inverse).astype(np.float32)
        values = np.einsum("nij,nj->ni", inverse[group], arms).astype(np.float32)
        places = (3 * group[:, None] + np.arange(3)).ravel(), np.repeat(np.arange(n), 3)
        self._fit: Any = scipy.sparse.csr_matrix((values.ravel(), places), (3 * m, n))

    def fit(self, x: NDArray[np.float32], prior: NDArray) -> NDArray[np.float32]:
        """Return the transposed deformation gradients [G,3,3] of the groups of points at x [n,3],
        m.

        `prior` is used in directions in which a group has no extent.
        """
        F = (self._fit @ x).reshape(-1, 3, 3)
        return F + self._share @ prior


def _largest_stretch(F: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the largest stretch of each F [G,3,3], by Smith's formula for eigenvalues (1961)."""
    r = F.transpose(1, 2, 0)
    xx, yy, zz = (np.einsum("im,im->m", row, row) for row in r)
    xy, yz, zx = (np.einsum("im,im->m", r[k], r[k - 2]) for k in range(3))
    third = (xx + yy + zz) / 3
    xx, yy, zz = xx - third, yy - third, zz - third
    size = np.sqrt((xx * xx + yy * yy + zz * zz + 2 * (xy * xy + yz * yz + zx * zx)) / 6)
    det = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * zx) + zx * (xy * yz - yy * zx)
    ratio = np.clip(det / np.maximum(2 * size**3, 1e-30), -1, 1)
    return np.sqrt(third + 2 * size * np.cos(np.arccos(ratio) / 3))


def _polar(F: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the rotations R [G,3,3] of F = R U, and |det F| [G].

    R is computed by Newton steps (Higham 1986), which are scaled to det R = 1.
    """
    R = np.ascontiguousarray(F.transpose(1, 2, 0))
    volume = None
    for _ in range(NEWTON):
        (a, b, c), (d, e, f), (g, h, i) = R
        cofactors = np.stack([
            [e * i - f * h, f * g - d * i, d * h - e * g],
            [c * h - b * i, a * i - c * g, b * g - a * h],
            [b * f - c * e, c * d - a * f, a * e - b * d],
        ])  # fmt: skip
        det = (R[0] * cofactors[0]).sum(axis=0)
        size = np.maximum(abs(det), 1e-9)
        volume = size if volume is None else volume
        scale = np.cbrt(size)
        R = (R / scale + cofactors * (np.sign(det) * scale / size)) / 2
    assert volume is not None
    return R.transpose(2, 0, 1), volume


def _divide(x: NDArray, rng: np.random.Generator) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Divide points x [n,3] into lumps, and lumps into fragments; number both without gaps."""
    longest = float(np.ptp(x, axis=0).max())
    lump = _nearest(x, LUMP * longest, rng)
    kind = rng.integers(len(SIZES), size=lump.max() + 1)[lump]
    fragment = np.zeros(len(x), np.int64)
    for k, size in enumerate(SIZES):
        some = np.flatnonzero(kind == k)
        if len(some):
            fragment[some] = _nearest(x[some], size * longest, rng)
    return _number(lump), _number(lump * (fragment.max() + 1) + fragment)


def _nearest(x: NDArray, size: float, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return for each point x [n,3] the nearest of random centres at a mean distance `size` m."""
    low, sides = x.min(axis=0), np.ptp(x, axis=0)
    count = round(float(np.prod(sides / max(size, 1e-9) + 1)))
    centres = rng.uniform(low - size / 2, low + sides + size / 2, (count, 3))
    return scipy.spatial.KDTree(centres).query(x)[1]


def _number(values: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.unique(values, return_inverse=True)[1].reshape(-1)
