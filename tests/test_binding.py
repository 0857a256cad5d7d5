"""Which particles carry a Gaussian, and with which weights."""

import numpy as np
import pytest

from phy124.gaussians import Gaussians
from phy124.motion.binding import find_carriers
from phy124.motion.deform import Deformer
from phy124.particles import Particles
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import lattice


def test_weights_sum_to_one_and_vary_smoothly(rng):
    particles = rng.random((300, 3))
    line = np.linspace([0.2, 0.2, 0.2], [0.8, 0.8, 0.8], 2001)
    index, weights = find_carriers(line, particles)
    dense = np.zeros((2001, 300))
    np.put_along_axis(dense, index, weights, axis=1)
    assert np.abs(dense.sum(axis=1) - 1).max() < 1e-6
    assert np.abs(np.diff(dense, axis=0)).max() < 0.02
    for few in (1, 2, 5):
        index, weights = find_carriers(line, particles[:few])
        assert index.max() < few
        assert np.abs(weights.sum(axis=1) - 1).max() < 1e-6
    _, weights = find_carriers(line, np.zeros((20, 3)))
    assert np.isfinite(weights).all()


def test_carriers_are_the_nearest_particles(rng):
    """Points inside, on and far outside a sparse cloud, compared with a search of all distances."""
    particles = rng.random((400, 3), np.float32) ** 3 * (1, 3, 0.1)
    points = np.concatenate([particles[:50], 4 * rng.random((200, 3)) - 1]).astype(np.float32)
    index, weights = find_carriers(points, particles.astype(np.float32), 0.3)
    far = np.linalg.norm(points[:, None].astype(float) - particles.astype(np.float32), axis=2)
    near = np.sort(far, axis=1)[:, :9]
    assert np.allclose(np.take_along_axis(far, index, axis=1), near[:, :8], rtol=0, atol=1e-12)
    reach = np.minimum(near[:, 8:], 2 * near[:, 7:8])
    reach = np.minimum(reach, np.maximum(0.3, 2 * near[:, :1]))
    expected = (1 - np.minimum(near[:, :8] / reach, 1) ** 2) ** 2 + 1e-9
    assert np.allclose(weights, expected / expected.sum(axis=1, keepdims=True), atol=1e-6)


def test_far_particles_do_not_carry_a_tip():
    """A loose tip of two particles follows them, and not the body four cells away."""
    body = lattice([5] * 3, 0.5) + (0, 0, 4.5)
    tip = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.4]])
    index, weights = find_carriers(tip[:1], np.concatenate([tip, body]), 2.0)
    assert weights[0, index[0] < 2].sum() == pytest.approx(1, abs=1e-6)
    _, alone = find_carriers(tip[:1], body, 2.0)
    assert alone.max() < 0.5, "a Gaussian far from all particles has several carriers"


def test_field_follows_bending_to_second_order(rng):
    """Halving the particle distance of a curved motion cuts the error about fourfold."""
    points = rng.uniform(0.2, 0.8, (400, 3))
    gaussians = Gaussians.from_rgb(
        points, np.tile([1, 0, 0, 0], (400, 1)), np.full((400, 3), 0.01), np.ones(400), points
    )

    def bend(x):
        return x + np.stack([0 * x[:, 0], 0 * x[:, 0], 0.5 * x[:, 0] ** 2], axis=1)

    errors = []
    for cells in (10, 20):
        x = lattice([cells] * 3, 1 / cells).astype(np.float32)
        F = np.tile(np.eye(3), (len(x), 1, 1))
        F[:, 2, 0] = x[:, 0]
        first = np.ones(len(x))
        particles = Particles(x, first, first, first.astype(np.int32), -first.astype(np.int32))
        frame = Deformer(gaussians, particles)(bend(x), F, index=0, time=0)
        errors.append(np.abs(frame.gaussians.means - bend(points)).mean())
    assert errors[0] < 2e-3
    assert errors[0] / errors[1] > 3


@pytest.mark.parametrize("apart", [(0.0, 0.0, 1.0), (0.3, 0.2, 1.0)])
def test_gaussians_of_a_cloud_of_two_stay_with_their_particles(apart):
    """One particle turns and stretches as it likes; the other is sixteen cells away."""
    x = np.array([(0.0, 0, 0), apart], np.float32)
    scales, grey = np.full((2, 3), 0.02), np.full((2, 3), 0.5)
    quats = np.tile((1.0, 0, 0, 0), (2, 1))
    two = Gaussians.from_rgb(x, quats, scales, np.full(2, 0.9), grey)
    accuracy = {"cells": 16, "solver": "mpm"}
    scene = Scene.named("drop").replaced({"accuracy": accuracy, "time.frames": 24})
    run = Simulation(prepare(two, scene))
    clip = run.run()
    assert clip.means[..., 2].min() > -0.3 * scene.dx
    assert len(run.setup.particles) == 2
