"""The order of solids and Gaussians as a camera sees them, and where on the screen solids are."""

import numpy as np
import pytest

from phy124.camera import Camera
from phy124.rendering.projection import FILTERS, make_view
from phy124.rendering.stage.frame import Solid
from support.device_functions import arranged

CAMERA = Camera.orbit(0, 0, 2.0, 65)
"""A camera that looks along -x from (2, 0, 0)."""
BOX = np.full(3, -0.2), np.full(3, 0.2)
TILTED = np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1.0]])


def pane(x: float, thick: float = 0.05) -> Solid:
    return Solid(np.array([x, 0, 0]), np.eye(3), np.array([thick, 0.4, 0.4]))


@pytest.mark.parametrize(
    ("solid", "counts"),
    [
        (pane(0.5), [1, 0, 0]),
        (pane(-0.5), [0, 0, 1]),
        (pane(0.0), [0, 1, 0]),
        (Solid(np.array([0, 0.5, 0]), np.eye(3), np.zeros(3), 0.1), [0, 0, 1]),
        (Solid(np.array([0.1, 0, 0]), np.eye(3), np.array([0.1, 0, 0]), 0.05), [0, 1, 0]),
    ],
    ids=["before", "behind", "within", "a ball beside", "a capsule within"],
)
def test_a_solid_is_before_among_or_behind_what_is_in_the_box(solid, counts):
    assert arranged([solid], CAMERA, BOX).counts == counts


def test_plate_may_enter_the_box_and_a_block_may_not():
    assert arranged([pane(0.24)], CAMERA, BOX).counts == [1, 0, 0]
    assert arranged([pane(0.23)], CAMERA, BOX).counts == [0, 1, 0]
    assert arranged([pane(0.39, thick=0.2)], CAMERA, BOX).counts == [0, 1, 0]


def test_solids_are_sorted_by_rank():
    places = (-0.5, 0.1, 0.7, -0.9, 0.5, 0.0)
    result = arranged([pane(x) for x in places], CAMERA, BOX)
    assert result.counts == [2, 2, 2]
    assert result.solids["centre"][:, 0] == pytest.approx([0.7, 0.5, 0.1, 0.0, -0.5, -0.9])


@pytest.mark.parametrize("broken", [np.nan, np.inf])
def test_around_what_is_nowhere_all_solids_are_among_it(broken):
    box = np.array([-0.2, broken, -0.2]), np.full(3, 0.2)
    assert arranged([pane(0.5), pane(-0.5)], CAMERA, box).counts == [0, 2, 0]


@pytest.mark.parametrize(
    "solid",
    [
        Solid(np.array([0.1, 0.2, 0.1]), TILTED, np.array([0.3, 0.2, 0.25])),
        Solid(np.array([0.1, -0.2, 0.1]), np.eye(3), np.zeros(3), 0.3),
        Solid(np.array([0.0, 0.1, 0.2]), TILTED, np.array([0.3, 0, 0]), 0.15),
    ],
    ids=["box", "ball", "capsule"],
)
def test_an_outline_holds_the_solid_and_little_else(rng, solid):
    """Points of the solid's box are inside, on the screen and in space; points far away are not."""
    camera = Camera.orbit(30, 25, 2.0, (64, 48), (0.1, 0.1, 0.1))
    view, outline = make_view(camera, FILTERS["dilate"]), arranged([solid], camera, BOX).outlines[0]
    sides, planes = (outline[name][: outline["count"]] for name in ("sides", "planes"))
    reach = solid.half + solid.radius
    points = solid.centre + (rng.uniform(-1, 1, (2000, 3)) * reach) @ solid.axes
    places, depths = on_screen(view, points)
    assert depths.min() >= outline["nearest"] - 1e-5
    assert (places @ sides.T).min() >= 0
    around = rng.uniform(0, [64, 48], (2000, 2))
    inside = (np.c_[around, np.ones(2000)] @ sides.T).min(axis=1) >= 0
    hull = np.array([np.linalg.norm(places[:, :2] - at, axis=1).min() for at in around])
    assert inside[hull < 0.2].all() and not inside[hull > 6].any()
    # A plane through the eye says the same of a ray.
    rays = np.c_[(around - np.array(view.centre)) / view.focal, np.ones(2000)]
    rays = rays @ np.array(view.rotation).reshape(3, 3)
    assert (((rays @ planes.T).min(axis=1) >= 0) == inside).mean() > 0.999


def on_screen(view, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places [N,3] with 1 as their third number, px, and depths [N], m."""
    turned = points @ np.array(view.rotation).reshape(3, 3).T + np.array(view.translation)
    places = view.focal * turned[:, :2] / turned[:, 2:] + np.array(view.centre)
    return np.c_[places, np.ones(len(points))], turned[:, 2]


def test_a_solid_around_the_camera_may_be_anywhere_on_the_screen():
    outline = arranged([Solid(np.zeros(3), np.eye(3), np.full(3, 5.0))], CAMERA, BOX).outlines[0]
    assert outline["count"] == 0
