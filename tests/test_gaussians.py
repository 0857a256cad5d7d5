import numpy as np
import pytest

from phy124.gaussians import Gaussians, quaternions, rotation_matrices


def random_quats(rng: np.random.Generator, n: int) -> np.ndarray:
    q = rng.normal(size=(n, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def test_quaternions_and_matrices_are_inverse(rng):
    q = np.concatenate([random_quats(rng, 500), np.eye(4)])
    r = rotation_matrices(q)
    assert np.abs(r @ r.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12
    assert np.allclose(np.linalg.det(r), 1)
    back = quaternions(r)
    assert np.abs(np.abs((back * q).sum(axis=1)) - 1).max() < 1e-12


def test_quarter_turn_about_z_takes_x_to_y():
    half = np.sqrt(0.5)
    assert np.allclose(rotation_matrices(np.array([[half, 0, 0, half]]))[0] @ [1, 0, 0], [0, 1, 0])


def test_covariances_have_squared_scales_as_eigenvalues(three_gaussians):
    values = np.linalg.eigvalsh(three_gaussians.covariances())
    assert np.allclose(values, np.sort(three_gaussians.scales.astype(float) ** 2), rtol=1e-6)


def test_deviations_are_roots_of_the_covariance_diagonal(rng):
    quats, scales = random_quats(rng, 200).astype(np.float32), rng.random((200, 3))
    some = Gaussians.from_rgb(np.zeros((200, 3)), quats, scales, np.ones(200), np.ones((200, 3)))
    diagonal = np.einsum("nii->ni", some.covariances())
    assert np.allclose(some.deviations(), np.sqrt(diagonal), rtol=1e-12)
    assert np.array_equal(some.longest, some.scales.max(axis=1))


def test_colours_survive_the_change_to_harmonics(three_gaussians):
    assert np.allclose(three_gaussians.rgb, np.eye(3), atol=1e-6)
    assert three_gaussians.sh_degree == 0


def test_moving_scales_means_and_scales(three_gaussians):
    moved = three_gaussians.transform(2.0, np.array([1, 0, 0]))
    assert np.allclose(moved.means, three_gaussians.means * 2 + [1, 0, 0])
    assert np.allclose(moved.scales, three_gaussians.scales * 2)


def test_selecting_keeps_order(three_gaussians):
    assert np.array_equal(
        three_gaussians.select(np.array([2, 0])).means, three_gaussians.means[[2, 0]]
    )


@pytest.mark.parametrize("count", [2, 5, 25])
def test_other_harmonic_counts_are_refused(three_gaussians, count):
    g = three_gaussians
    with pytest.raises(ValueError, match="coefficients, wanted one of 1, 4, 9, 16"):
        Gaussians(g.means, g.quats, g.scales, g.opacities, np.zeros((3, count, 3)))


def test_wrong_shapes_are_refused(three_gaussians):
    g = three_gaussians
    with pytest.raises(ValueError, match=r"quats has shape \(2, 4\), wanted \(3, 4\)"):
        Gaussians(g.means, g.quats[:2], g.scales, g.opacities, g.sh)
