"""Boxes seen from an edge: sizes from six corners, faces in their places, nothing else is a box."""

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from phy124.gaussians import rotation_matrices
from phy124.generators.relief import boxes, relief
from phy124.generators.relief.boxes import CORNERS, find_box
from phy124.generators.relief.surface import View

HALF = np.array([70.0, 60.0, 80.0])
DISTANCE = 496.0
FACES = {
    (2, 1): (200, 60, 50),
    (0, 1): (60, 60, 200),
    (0, -1): (60, 60, 200),
    (1, -1): (60, 200, 60),
}


def draw_box(yaw, pitch, distance=DISTANCE):
    """Return a picture [400,400,4] of a box whose front is red, sides blue and top green."""
    turn = Rotation.from_euler("yx", [yaw, pitch], degrees=True).as_matrix()
    points = (CORNERS * HALF) @ turn.T
    flat = points[:, :2] / (1 - points[:, 2:] / distance)
    middle = 199.5 - (flat.min(axis=0) + flat.max(axis=0)) / 2
    rgba = np.zeros((400, 400, 4), np.uint8)
    for (axis, side), colour in FACES.items():
        normal = side * turn[:, axis]
        if normal @ (np.array([0, 0, distance]) - side * HALF[axis] * turn[:, axis]) > 0:
            corners = flat[CORNERS[:, axis] == side][[0, 1, 3, 2]] + middle
            cv2.fillPoly(rgba, [np.round(corners).astype(np.int32)], (*colour, 255))
    return rgba


@pytest.mark.parametrize(
    ("yaw", "pitch", "distance"),
    [(-35, -25, DISTANCE), (30, 0, DISTANCE), (50, -40, DISTANCE), (45, -35, 10 * DISTANCE)],
)
def test_sizes_of_a_box_follow_from_its_corners(yaw, pitch, distance):
    mask = draw_box(yaw, pitch, distance)[..., 3] > 0
    box = find_box(mask, View.of(mask, DISTANCE))
    assert box is not None
    ratios = np.sort(box.half) / np.sort(HALF)
    np.testing.assert_allclose(ratios / ratios.mean(), 1, atol=0.08)


def round_corners(mask, radius=40):
    """Return a mask [H,W] whose outline has rounded corners."""
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    return cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, disc) > 0


@pytest.mark.parametrize(("yaw", "pitch"), [(-35, -25), (50, -40)])
def test_a_box_may_have_rounded_corners(yaw, pitch):
    mask = round_corners(draw_box(yaw, pitch)[..., 3] > 0)
    box = find_box(mask, View.of(mask, DISTANCE))
    assert box is not None
    ratios = np.sort(box.half) / np.sort(HALF)
    np.testing.assert_allclose(ratios / ratios.mean(), 1, atol=0.08)


def test_boxes_with_rounded_corners_stand_upright():
    """Tilted outlines, or those from the height of the box, may show many other objects."""
    level = round_corners(draw_box(40, -3)[..., 3] > 0)
    turned = draw_box(-35, -25)[..., 3]
    middle = cv2.getRotationMatrix2D((200, 200), 20, 1)
    askew = round_corners(cv2.warpAffine(turned, middle, (400, 400)) > 127)
    for mask in (level, askew):
        assert find_box(mask, View.of(mask, DISTANCE)) is None


def test_hidden_faces_have_the_colours_of_opposite_faces():
    """The bottom is green like the top, and the box is closed and flat."""
    gaussians = relief(Image.fromarray(draw_box(-35, -25)), count=5000)
    normals = rotation_matrices(gaussians.quats)[:, :, 2]
    channel = gaussians.rgb.argmax(axis=1)
    for sign in (1, -1):
        level = (normals[:, 2] * sign) > 0.8
        assert level.sum() > 500
        assert (channel[level] == 1).mean() > 0.95
    directions = np.unique(np.round(normals, 2), axis=0)
    assert len(directions) == 6


def test_hidden_faces_show_the_pattern_of_opposite_faces():
    """A white band around a carton continues on its back, at the same height."""
    rgba = draw_box(-35, 0)
    rgba[180:220, :, :3] = 255
    gaussians = relief(Image.fromarray(rgba), count=5000)
    normals = rotation_matrices(gaussians.quats)[:, :, 2]
    white = gaussians.rgb.min(axis=1) > 0.8
    front, back = (normals[:, 0] * sign > 0.3 for sign in (1, -1))
    assert 0.15 < white[front].mean() < 0.35
    assert white[back].mean() == pytest.approx(white[front].mean(), abs=0.05)
    heights = [gaussians.means[white & side, 2].mean() for side in (front, back)]
    assert heights[0] == pytest.approx(heights[1], abs=0.02)


def test_other_shapes_are_not_boxes():
    y, x = np.mgrid[:300, :300]
    disc = np.hypot(x - 150, y - 150) < 100
    square = np.maximum(abs(x - 150), abs(y - 150)) < 100
    star = np.hypot(x - 150, y - 150) < 80 + 30 * np.cos(6 * np.arctan2(y - 150, x - 150))
    lopsided = np.zeros((300, 300), np.uint8)
    corners = [[20, 150], [60, 40], [250, 20], [280, 100], [150, 280], [90, 260]]
    cv2.fillPoly(lopsided, [np.array(corners)], 1)
    for mask in (disc, square, star, lopsided > 0):
        assert find_box(mask, View.of(mask, DISTANCE)) is None


def test_distant_cameras_are_not_tried_for_an_outline_far_from_a_box(monkeypatch):
    """The fit takes most of the time of a picture whose outline has six edges."""
    tried = []
    fit = boxes._fit_box

    def record(corners, view):
        tried.append(view.distance)
        return fit(corners, view)

    monkeypatch.setattr(boxes, "_fit_box", record)
    lopsided = np.zeros((300, 300), np.uint8)
    corners = [[20, 150], [60, 40], [250, 20], [280, 100], [150, 280], [90, 260]]
    cv2.fillPoly(lopsided, [np.array(corners)], 1)
    assert find_box(lopsided > 0, View.of(lopsided > 0, DISTANCE)) is None
    assert tried == [DISTANCE]
