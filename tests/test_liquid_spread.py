"""Velocities at faces beyond a liquid, from the velocities at a known neighbour."""

import numpy as np
import pytest
import warp as wp

from phy124.kernels.liquid.faces import sums
from phy124.kernels.liquid.spread import make_spread

SIZE = 5
KNOWN, FACE = np.ravel_multi_index([(2, 2), (2, 2), (2, 3)], (SIZE,) * 3)
"""Index of the cell whose faces are known, and of the cell above it."""


def spread(mass: float, *, viscosity=0.0, shut=False, body=9, displaces=False) -> np.ndarray:
    """Velocity at the faces above a cell whose velocity rises from (1, 2, 3) to (2, 3, 4) m/s.

    The faces have a velocity of (7, 8, 9) m/s before the step. The wall 1 is next to all faces.
    """
    count = SIZE**3
    known, velocity, cells = np.zeros(count, int), np.zeros((count, 4)), np.zeros((count, 8))
    known[KNOWN], velocity[KNOWN, :3] = 7, (2, 3, 4)
    cells[KNOWN, :3], cells[KNOWN, 4:7] = (1, 2, 3), 1
    cells[FACE, :3], cells[FACE, 4:7] = mass * np.array([7, 8, 9]), mass
    space = np.ones((count, 4))
    space[FACE] = 0.0 if shut else 1.0
    known, velocity = launch(
        known, velocity, cells[: 0 if displaces else None], space, body, viscosity
    )
    assert known[FACE] == 7
    return velocity[FACE, :3]


def launch(known, velocity, cells, space, body, viscosity, form="simd"):
    """The flags and the velocities after one layer of the inner cells has been filled."""
    count = SIZE**3
    inner = np.arange(count).reshape((SIZE,) * 3)[1:-1, 1:-1, 1:-1].ravel()
    ones, moved = np.ones((count, 4)), wp.array(velocity, dtype=wp.vec4)
    inputs = [0, wp.array(inner, dtype=int), wp.array([0, len(inner)], dtype=int), viscosity]
    inputs += [wp.array([(0,) * 3, (SIZE,) * 3], dtype=wp.vec3i), wp.array([0.5, 0.5], dtype=float)]
    inputs += [wp.array(known, dtype=int), *(wp.array(ones, dtype=wp.vec4) for _ in range(2))]
    inputs += [wp.array(cells, dtype=sums(wp.float32)), wp.array(space, dtype=wp.vec4)]
    inputs += [wp.ones((2 * SIZE + 1) ** 3, dtype=int), body]
    flags = wp.zeros(count, dtype=int)
    kernel = make_spread(wp.float32, form)
    wp.launch(kernel, len(inner), inputs, [moved, flags], device="cpu")
    return flags.numpy(), moved.numpy()


@pytest.mark.parametrize("displaces", [False, True])
def test_simd_and_plain_sums_over_neighbours_agree(rng, displaces):
    count = SIZE**3
    known, velocity = rng.integers(0, 8, count), rng.normal(size=(count, 4))
    cells = rng.normal(1, 1, size=(count, 8)) * rng.choice([0, 1, 1], (count, 8))
    values = known, velocity, cells[: 0 if displaces else None], np.ones((count, 4)), 9, 0.1
    (flags, simd), (same, plain) = (launch(*values, form) for form in ("simd", "plain"))
    np.testing.assert_array_equal(flags, same)
    np.testing.assert_allclose(simd, plain, rtol=1e-5, atol=1e-5)
    assert np.any(simd != velocity)


@pytest.mark.parametrize("shut", [False, True])
def test_face_with_mass_keeps_its_momentum(shut):
    np.testing.assert_allclose(spread(0.1, shut=shut), (8, 9, 10), rtol=1e-6)


def test_viscosity_reduces_the_difference_between_faces():
    """The velocity difference of 6 m/s is divided by 1 + k, with k = 4 / s * 0.5 s."""
    np.testing.assert_allclose(spread(0.1, viscosity=4.0), (4, 5, 6), rtol=1e-6)


@pytest.mark.parametrize("options", [{"mass": 0.0}, {"mass": 0.1, "displaces": True}])
def test_other_faces_copy_their_neighbours(options):
    np.testing.assert_allclose(spread(**options), (2, 3, 4), rtol=1e-6)


@pytest.mark.parametrize(("body", "expected"), [(1, (2, 3, 4)), (2, (8, 9, 10))])
def test_faces_inside_a_freely_moving_body_copy_their_neighbours(body, expected):
    np.testing.assert_allclose(spread(0.1, shut=True, body=body), expected, rtol=1e-6)
