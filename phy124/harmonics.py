"""Real spherical harmonics of 3D Gaussian splatting: evaluation and rotation, degrees 0 to 3.

Signs and order are those of Kerbl et al. 2023 (degree 1 is -y, z, -x).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from phy124.gaussians import SH_C0, rotation_matrices

C1 = 0.4886025119029199
C2 = (
    1.0925484305920792,
    -1.0925484305920792,
    0.31539156525252005,
    -1.0925484305920792,
    0.5462742152960396,
)
C3 = (
    -0.5900435899266435,
    2.890611442640554,
    -0.4570457994644658,
    0.3731763325901154,
    -0.4570457994644658,
    1.445305721320277,
    -0.5900435899266435,
)


def sh_basis(directions: NDArray, count: int) -> NDArray[np.float64]:
    """Values of the first `count` (1, 4, 9 or 16) harmonics at unit directions [..., 3]."""
    x, y, z = np.moveaxis(np.asarray(directions, dtype=np.float64), -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    values = [np.full_like(x, SH_C0), -C1 * y, C1 * z, -C1 * x]
    values += [C2[0] * x * y, C2[1] * y * z, C2[2] * (2 * zz - xx - yy), C2[3] * x * z]
    values += [C2[4] * (xx - yy), C3[0] * y * (3 * xx - yy), C3[1] * x * y * z]
    values += [C3[2] * y * (4 * zz - xx - yy), C3[3] * z * (2 * zz - 3 * xx - 3 * yy)]
    values += [C3[4] * x * (4 * zz - xx - yy), C3[5] * z * (xx - yy), C3[6] * x * (xx - 3 * yy)]
    return np.stack(values[:count], axis=-1)


def rotate_sh(sh: NDArray, quats: NDArray) -> NDArray[np.float32]:
    """Rotate each colour function with its Gaussian: c'(d) = c(R^T d).

    Each degree rotates within itself. Its matrix is found by requiring equality in fixed,
    well-spread directions, which is exact.

    Args:
        sh: Coefficients [N,K,3].
        quats: Rotations wxyz [N,4].
    """
    turned = np.array(sh, dtype=np.float64)
    rotations = rotation_matrices(quats)
    directions = spread_directions(16)
    for degree, band in ((1, slice(1, 4)), (2, slice(4, 9)), (3, slice(9, 16))):
        if sh.shape[1] < (degree + 1) ** 2:
            break
        solve = np.linalg.pinv(sh_basis(directions, 16)[:, band])
        # Row vector times R is R^T d: what the direction was before the turn.
        before = sh_basis(directions @ rotations, 16)[:, :, band]
        turned[:, band] = np.einsum("jd,ndk,nkc->njc", solve, before, turned[:, band])
    return turned.astype(np.float32)


def mirror_signs(count: int) -> NDArray[np.float64]:
    """Signs [count] that mirroring along x gives to the first harmonics: each is odd or even."""
    direction = np.array([0.3, 0.5, np.sqrt(0.66)])
    return np.sign(sh_basis(direction * [-1, 1, 1], count) * sh_basis(direction, count))


def spread_directions(count: int) -> NDArray[np.float64]:
    """Unit vectors spread evenly over the sphere (Fibonacci lattice) [count,3]."""
    i = np.arange(count) + 0.5
    z, angle = 1 - 2 * i / count, np.pi * (1 + 5**0.5) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
