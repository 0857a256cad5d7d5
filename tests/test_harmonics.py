import numpy as np
import pytest

from phy124.gaussians import rotate_sh, rotation_matrices, sh_basis


def test_basis_is_orthonormal_on_the_sphere():
    """Integrals by a product rule that is exact to degree 15."""
    z, weights = np.polynomial.legendre.leggauss(8)
    angles = np.arange(16) * 2 * np.pi / 16
    z, angles = np.meshgrid(z, angles, indexing="ij")
    r = np.sqrt(1 - z * z)
    directions = np.stack([r * np.cos(angles), r * np.sin(angles), z], axis=-1)
    basis = sh_basis(directions, 16)
    areas = np.broadcast_to(weights[:, None] * 2 * np.pi / 16, z.shape)
    assert np.abs(np.einsum("abi,abj,ab->ij", basis, basis, areas) - np.eye(16)).max() < 1e-12


@pytest.mark.parametrize("count", [1, 4, 9, 16])
def test_turned_colours_seen_from_turned_directions_are_the_same(rng, count):
    sh, quats = rng.normal(size=(20, count, 3)), rng.normal(size=(20, 4))
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    seen = np.einsum("nk,nkc->nc", sh_basis(directions, count), sh)
    turned = np.einsum("nij,nj->ni", rotation_matrices(quats), directions)
    again = np.einsum("nk,nkc->nc", sh_basis(turned, count), rotate_sh(sh, quats))
    assert np.abs(seen - again).max() < 1e-5
