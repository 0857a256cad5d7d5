"""Axes: any direction may be up, any rotation is taken, and shapes and colours turn along."""

import numpy as np
import pytest

from phy124.errors import InputError
from phy124.gaussians import rotation_matrices, sh_basis
from phy124.io.axes import euler, orientation, parse_rotation, rotate_gaussians, upright
from support.shapes import random_gaussians


def random_rotation(rng) -> np.ndarray:
    return rotation_matrices(rng.normal(size=(1, 4)))[0]


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_places_shapes_and_colours_turn_by_any_rotation(rng, degree):
    gaussians, rotation = random_gaussians(rng, degree=degree), random_rotation(rng)
    made = rotate_gaussians(gaussians, rotation)
    assert np.allclose(made.means, gaussians.means @ rotation.T, atol=1e-6)
    assert np.allclose(
        made.covariances(), rotation @ gaussians.covariances() @ rotation.T, atol=1e-6
    )
    directions = rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    count = gaussians.sh.shape[1]
    before = np.einsum("dk,nkc->ndc", sh_basis(directions, count), gaussians.sh)
    after = np.einsum("dk,nkc->ndc", sh_basis(directions @ rotation.T, count), made.sh)
    assert np.abs(after - before).max() < 2e-5
    back = rotate_gaussians(made, rotation.T)
    assert np.allclose(back.means, gaussians.means, atol=1e-5)


def test_angles_are_about_x_then_y_then_z():
    """90 degrees about x take y to z, and so on."""
    assert np.allclose(euler([90, 0, 0]) @ [0, 1, 0], [0, 0, 1])
    assert np.allclose(euler([0, 90, 0]) @ [0, 0, 1], [1, 0, 0])
    assert np.allclose(euler([0, 0, 90]) @ [1, 0, 0], [0, 1, 0])
    assert np.allclose(euler([90, 0, 90]) @ [0, 1, 0], [0, 0, 1])
    assert np.allclose(euler([90, 90, 0]) @ [0, 1, 0], [1, 0, 0])


def test_a_quaternion_is_wxyz_of_any_length():
    half = np.radians(30) / 2
    assert np.allclose(
        parse_rotation(f"{3 * np.cos(half)} 0 0 {3 * np.sin(half)}"), euler([0, 0, 30])
    )


def test_up_is_any_direction_and_front_as_level_as_can_be(rng):
    for _ in range(20):
        up, front = rng.normal(size=(2, 3))
        matrix = orientation(",".join(map(str, up)), ",".join(map(str, front)))
        assert np.allclose(matrix @ matrix.T, np.eye(3)) and np.linalg.det(matrix) > 0
        assert np.allclose(matrix @ up, [0, 0, np.linalg.norm(up)])
        assert (matrix @ front)[0] > 0 and abs((matrix @ front)[1]) < 1e-9
        assert np.allclose(upright(up / np.linalg.norm(up)) @ up, [0, 0, np.linalg.norm(up)])
    assert np.array_equal(orientation("-y", "-z"), orientation())
    assert np.allclose(orientation("0,-2,0"), orientation("-y"))
    assert np.allclose(upright(np.array([0, 0, -1.0])) @ [0, 0, -1], [0, 0, 1])


def test_the_front_of_a_slanted_up_is_that_of_the_nearest_axis():
    tilted = orientation("0.1,-1,0.05")
    assert np.abs(tilted - orientation("-y")).max() < 0.12


def test_rotate_comes_first(rng):
    """A rotated file is read like the original if the rotation is undone."""
    rotation = euler([20, -35, 50])
    quaternion = "0.2,0.4,-0.1,0.3"
    assert np.allclose(orientation(rotate="20,-35,50"), orientation() @ rotation)
    assert np.allclose(
        orientation("z", rotate=quaternion), orientation("z") @ parse_rotation(quaternion)
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"up": "w"}, "up = w: It is not an axis or a direction. Choose one of"),
        ({"up": "0,0,0"}, "not an axis or a direction"),
        ({"up": "1,2"}, "three numbers such as 0.1,-1,0.2"),
        ({"up": "nan,1,2"}, "not an axis or a direction"),
        ({"up": "0,1,0", "front": "0.001,-3,0"}, "The front cannot lie along the up axis"),
        ({"rotate": "90"}, "neither three angles nor a quaternion"),
        ({"rotate": "0,0,0,0"}, "neither three angles nor a quaternion"),
        ({"rotate": "x,y,z"}, "Write degrees about x, y and z"),
    ],
)
def test_refusals(options, words):
    with pytest.raises(InputError, match=words):
        orientation(**options)
