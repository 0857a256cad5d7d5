"""Points on implicit surfaces: F and its gradient, steps onto the surface, pushes of neighbours."""

import numpy as np
import pytest
import scipy
import warp as wp

from phy124.generators.relief.hull import Hull
from phy124.generators.relief.surface import Surface, share
from phy124.kernels.implicit import push

RADIUS, MIDDLE = 20.0, 30
Y, X = np.mgrid[: 2 * MIDDLE + 1, : 2 * MIDDLE + 1] - float(MIDDLE)
BALL = RADIUS**2 - X**2 - Y**2
CENTRE = np.array([MIDDLE, MIDDLE, 5.0])


@pytest.fixture
def ball() -> Surface:
    """A ball about CENTRE, whose slopes are exact."""
    flat = np.zeros_like(BALL)
    slopes = np.array([[-2 * X, -2 * Y], [flat, flat]])
    return Surface(BALL, np.full_like(BALL, CENTRE[2]), slopes)


@pytest.fixture
def hull() -> Hull:
    """A ball about the origin that is deeper at the top, cut off flat 15 pixels above and below."""
    front = np.stack([BALL, -2 * X, -2 * Y], axis=2)
    side = np.stack([-(X**2) * (1 + Y / 60), -2 * X * (1 + Y / 60), -(X**2) / 60], axis=2)
    return Hull(front, side, Y[:, 0], ((-1.0, -15.0, 40.0), (1.0, 15.0, 40.0)))


def test_a_balls_field_and_gradient_are_exact_at_pixels(ball, rng):
    points = np.concatenate([rng.integers(0, 61, (500, 2)), rng.normal(5, 15, (500, 1))], axis=1)
    values, gradients = ball.gradient(points)
    away = points - CENTRE
    np.testing.assert_allclose(values, RADIUS**2 - (away**2).sum(axis=1), rtol=0, atol=1e-10)
    np.testing.assert_allclose(gradients, -2 * away, rtol=0, atol=1e-11)


def test_fields_are_linear_inside_and_constant_beyond(rng):
    w, m = rng.normal(size=(2, 9, 12))
    points = rng.uniform(-3, 14, (1000, 3))
    values, gradients = Surface(w, m, rng.normal(size=(2, 2, 9, 12))).gradient(points)

    def at(field):
        return scipy.ndimage.map_coordinates(field, points[:, 1::-1].T, order=1, mode="nearest")

    np.testing.assert_allclose(values, at(w) - (points[:, 2] - at(m)) ** 2, rtol=0, atol=1e-10)
    np.testing.assert_allclose(gradients[:, 2], -2 * (points[:, 2] - at(m)), rtol=0, atol=1e-12)


def test_the_last_pixel_needs_no_other_beyond_it(rng):
    """What follows it in memory is the next row."""
    w = rng.normal(size=(9, 12))
    w[:, 0] = np.nan
    points = np.array([[11.0, row, 0.0] for row in range(9)])
    values, _ = Surface(w, np.zeros_like(w), np.zeros((2, 2, 9, 12))).gradient(points)
    np.testing.assert_array_equal(values, w[:, 11])


def test_points_land_on_the_surface_with_outer_normals(ball, rng):
    points = CENTRE + rng.normal(size=(2000, 3)) * 8
    landed = ball.project(points, rounds=60)
    away = landed - CENTRE
    np.testing.assert_allclose(np.linalg.norm(away, axis=1), RADIUS, atol=0.02)
    directions = away / np.linalg.norm(away, axis=1, keepdims=True)
    np.testing.assert_allclose(ball.normals(landed), directions, atol=1e-3)
    inset = ball.inset(landed, 100.0)
    np.testing.assert_allclose(inset[:, 0], RADIUS / 3, atol=0.02)


def test_no_step_is_longer_than_a_pixel_and_what_was_given_stays(ball, rng):
    points = CENTRE + rng.normal(size=(500, 3)) * 30
    before = points.copy()
    for rounds in (1, 3):
        moved = np.linalg.norm(ball.project(points, rounds) - points, axis=1)
        assert moved.max() <= rounds + 1e-12
        assert moved.max() > 0.99 * rounds
    np.testing.assert_array_equal(points, before)


def test_how_points_lie_in_memory_does_not_matter(ball, rng):
    points = CENTRE + rng.normal(size=(50, 3)) * 8
    across = np.asfortranarray(points)
    np.testing.assert_array_equal(ball.project(across), ball.project(points))
    np.testing.assert_array_equal(ball.normals(across), ball.normals(points))
    assert np.abs(ball.project(across) - points).max() > 0.5


def test_a_hull_is_the_sum_of_its_pictures_within_its_flat_ends(hull, rng):
    points = np.round(rng.uniform(-20, 20, (2000, 3)))
    values, gradients = hull.gradient(points)
    x, y, z = points.T
    solid = RADIUS**2 - x**2 - y**2 - z**2 * (1 + y / 60)
    slope = np.stack([-2 * x, -2 * y - z**2 / 60, -2 * z * (1 + y / 60)], axis=1)
    lid = 40 * (15 - np.abs(y))
    np.testing.assert_allclose(values, np.minimum(solid, lid), rtol=0, atol=1e-10)
    cut = lid < solid
    assert 20 < cut.sum() < 1900
    np.testing.assert_allclose(gradients[~cut], slope[~cut], rtol=0, atol=1e-10)
    assert (gradients[cut] == np.c_[0 * cut, -40 * np.sign(y), 0 * cut][cut]).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_non_finite_points_stay_within_the_fields(ball, hull, bad):
    points = np.full((3, 3), bad)
    for surface in (ball, hull):
        values, _ = surface.gradient(points)
        assert not (values > 0).any()
        assert surface.project(points).shape == (3, 3)


def pushed(points, normals, wanted, near):
    moved, spacing = np.empty_like(points), np.empty(len(points))
    inputs = [share(points), share(normals), share(wanted), near]
    wp.launch(push, len(points), inputs, [share(moved), share(spacing)], device="cpu")
    return moved, spacing


def test_near_neighbours_move_apart_on_the_surface():
    """Two points half as far apart as wanted, on a floor; one is 0.1 above the other."""
    points = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.1]])
    up = np.tile([0.0, 0.0, 1.0], (2, 1))
    moved, spacing = pushed(points, up, np.ones(2), np.array([[1], [0]], np.int32))
    distance = np.hypot(0.5, 0.1)
    by = 0.45 * (1 - distance / 1.25) * 0.5 / distance
    np.testing.assert_allclose(moved, points + [[-by, 0, 0], [by, 0, 0]], rtol=0, atol=1e-15)
    np.testing.assert_allclose(spacing, max(distance, 0.6))


def test_points_behind_a_thin_part_do_not_push():
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, -0.2], [0.9, 0.0, 0.0]])
    normals = np.array([[0, 0, 1.0], [0, 0, -1.0], [0, 0, 1.0]])
    near = np.array([[1, 2], [0, 2], [1, 0]], np.int32)
    moved, spacing = pushed(points, normals, np.full(3, 0.5), near)
    np.testing.assert_array_equal(moved, points)
    np.testing.assert_allclose(spacing, [0.8, 0.5, 0.8])  # 0.9, but at most 1.6 times as wanted


def test_pushes_are_those_of_the_formula(rng):
    """Many points, seven neighbours each; the six nearest tell the spacing."""
    points = rng.uniform(0, 8, (400, 3))
    normals = rng.normal(size=(400, 3)) + [0, 0, 1.5]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    wanted = rng.uniform(0.8, 1.6, 400)
    distance, near = scipy.spatial.KDTree(points).query(points, k=8)
    distance, near = distance[:, 1:], near[:, 1:].astype(np.int32)
    same = (normals[:, None] * normals[near]).sum(axis=2) > 0.3
    far = wanted[:, None]
    strength = 0.45 * np.where(same, np.maximum(0, 1 - distance / (1.25 * far)) * far, 0) / distance
    move = (strength[..., None] * (points[:, None] - points[near])).sum(axis=1)
    move -= (move * normals).sum(axis=1, keepdims=True) * normals
    mean = np.ma.masked_array(distance, ~same)[:, :6].mean(axis=1).filled(np.nan)
    mean = np.where(np.isnan(mean), wanted, mean)
    moved, spacing = pushed(points, normals, wanted, near)
    np.testing.assert_allclose(moved, points + move, rtol=0, atol=1e-13)
    np.testing.assert_allclose(spacing, np.clip(mean, 0.6 * wanted, 1.6 * wanted), rtol=1e-13)
    assert np.ptp(same.sum(axis=1)) > 2


def test_cores_leave_gradients_unchanged(ball, monkeypatch):
    points = np.random.default_rng(0).normal(CENTRE, RADIUS, (7, 3))
    alone = None
    for count in (1, 3, 8):
        monkeypatch.setattr("phy124.generators.relief.surface.cores", lambda count=count: count)
        values = [*ball.gradient(points), ball.project(points), ball.normals(points)]
        alone = alone or values
        assert all(np.array_equal(*pair) for pair in zip(values, alone, strict=True))
