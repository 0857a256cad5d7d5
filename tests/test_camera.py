import numpy as np
import pytest

from phy124.camera import VIEWS, Camera


@pytest.mark.parametrize("view", list(VIEWS))
def test_the_target_is_in_the_middle_of_the_image(view):
    camera = Camera.orbit(VIEWS[view], 20, 2.0, (640, 480), (0.1, 0.2, 0.3))
    pixels, depths = camera.project(np.array([[0.1, 0.2, 0.3]]))
    assert np.allclose(pixels, [[320, 240]])
    assert np.allclose(depths, 2.0)


def test_from_the_front_y_is_right_and_z_is_up():
    camera = Camera.orbit(0, 0, 2.0, 100)
    assert np.allclose(camera.eye, [2, 0, 0])
    (right, _), (_, up) = camera.project(np.array([[0, 0.1, 0], [0, 0, 0.1]]))[0]
    assert right > 50
    assert up < 50


def test_from_the_right_minus_x_is_right():
    """The camera stands on +y; what was nearest to the front camera is now on the left."""
    camera = Camera.orbit(90, 0, 2.0, 100)
    assert np.allclose(camera.eye, [0, 2, 0])
    assert camera.project(np.array([[-0.1, 0, 0]]))[0][0, 0] > 50


def test_positive_elevation_looks_down():
    assert Camera.orbit(0, 30, 2.0, 64).eye[2] > 0


def test_field_of_view_spans_the_height():
    camera = Camera.orbit(0, 0, 2.0, 128, fov_y=60)
    top = 2.0 * np.tan(np.radians(30))
    assert np.allclose(camera.project(np.array([[0, 0, top]]))[0], [[64, 0]])


@pytest.mark.parametrize("elevation", [90, -90])
def test_straight_up_and_down_have_a_proper_view(elevation):
    view = Camera.orbit(0, elevation, 2.0, 64).view
    assert np.allclose(view[:3, :3] @ view[:3, :3].T, np.eye(3))
    assert np.isclose(np.linalg.det(view[:3, :3]), 1)
