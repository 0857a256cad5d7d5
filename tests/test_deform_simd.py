"""Shapes of eight Gaussians at a time, against those of one after another."""

import numpy as np
import pytest
import warp as wp

from phy124.gaussians import Gaussians
from phy124.kernels import deform
from phy124.kernels.deform_simd import deform_shapes_simd


def gaussians(count: int, rng) -> Gaussians:
    """Gaussians whose axes are up to a hundred thousand times as long as others."""
    quats = rng.normal(size=(count, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    scales, grey = 10 ** rng.uniform(-5, 0, (count, 3)), np.full((count, 3), 0.5)
    return Gaussians.from_rgb(rng.random((count, 3)), quats, scales, rng.random(count), grey)


@pytest.mark.parametrize("count", [1, 8, 1003])
def test_eight_at_a_time_are_deformed_as_one_by_one(rng, count):
    """Of torn material, of what flows, needles, discs, points, turned over and turned far."""
    rest = gaussians(count, rng)
    rest.scales[::11, 1] = 0
    rest.scales[::13, 2] = 1e-20
    rest.scales[::23] = 0
    rest.scales[::5, 1] = rest.scales[::5, 0]
    holds = np.where(rng.random(count) < 0.2, 1.1, np.inf)
    limits = np.where(rng.random(count) < 0.3, 1.5, np.inf)
    balls = rng.random(count) < 0.3
    change = rng.normal(0, 0.4, (count, 3, 3))
    change[::7] *= 1e-3
    turned = np.where(rng.random(count) < 0.1, -1.0, 1.0)[:, None, None]
    carrier, found = rng.permutation(count).astype(np.int32), []
    for kernel, each in ((deform.deform_shapes, 1), (deform_shapes_simd, 8)):
        threads = -(-count // each)
        model = [
            wp.array(carrier, dtype=int),
            wp.array(rest.quats, dtype=wp.vec4f),
            wp.array(rest.scales, dtype=wp.vec3f),
            wp.array(holds, dtype=wp.float64),
            wp.array(limits, dtype=wp.float64),
            wp.array(balls, dtype=wp.bool),
        ]
        still = np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1))
        out = [wp.array(still, dtype=wp.vec4f), wp.array(rest.quats, dtype=wp.vec4f)]
        out.append(wp.zeros(count, dtype=wp.vec3f))
        frames = []
        for part in (0.3, 0.6, 1.0):
            F = turned * (np.eye(3) + part * change)
            inputs = [*model, wp.array(F, dtype=wp.mat33d)]
            wp.launch(kernel, threads, inputs, out, device="cpu")
            frames.append([array.numpy().copy() for array in out])
        found.append(frames)
    for one, eight in zip(*found, strict=True):
        for name, a, b in zip(("inner", "quats", "scales"), one, eight, strict=True):
            np.testing.assert_allclose(b, a, rtol=3e-6, atol=3e-7, err_msg=name)
