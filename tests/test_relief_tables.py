"""relief: tables, stools and chairs have legs and a top that are right from all sides."""

import numpy as np
import pytest

from phy124.generators.relief import relief
from phy124.generators.relief.boards import Board
from phy124.generators.relief.table_fit import find_table, has_legs
from phy124.generators.relief.tables import CHAIR, ROUND_TABLES, SQUARE_TABLE, Sizes, Table
from support.drawings import SIZE, X, Y, extents, picture

DISTANCE = 496.0
MIDDLE = np.array([124.0, 124.0])
SEEN = Sizes(
    elevation=np.radians(20),
    yaw=np.radians(30),
    right=0,
    down=-10,
    half=50,
    deep=50,
    thick=9,
    leg=5.5,
    high=95,
    back=100,
    wide=50,
    rear=1,
    tops=0.85,
    feet=0.85,
)
LOW = SEEN._replace(half=85, deep=55, down=-40)


def drawn(kind, sizes=SEEN):
    return Table(kind, sizes, DISTANCE).draw((248, 248), MIDDLE, 1) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "sizes"),
    [(CHAIR, SEEN), (SQUARE_TABLE, LOW), (ROUND_TABLES[1], LOW._replace(deep=LOW.half))],
)
def test_the_silhouette_shows_sizes_and_elevation(kind, sizes):
    table = find_table(drawn(kind, sizes), MIDDLE, DISTANCE, None)
    assert table is not None
    assert table.kind is kind
    assert np.degrees(table.sizes.elevation) == pytest.approx(20, abs=4)
    assert np.divide(table.sizes.deep, sizes.deep) == pytest.approx(1, abs=0.12)
    assert np.divide(table.sizes.high, sizes.high) == pytest.approx(1, abs=0.1)
    if kind is CHAIR:
        assert np.degrees(table.sizes.yaw) == pytest.approx(30, abs=6)


@pytest.mark.parametrize(
    "solid",
    [
        np.hypot(X - 96, Y - 96) < 80,  # a ball
        # two crossed boards
        ((abs(X - Y) < 12) | (abs(X + Y - 192) < 12)) & (np.hypot(X - 96, Y - 96) < 80),
        # a car from its side
        pytest.param(
            ((abs(X - 96) < 80) & (abs(Y - 96) < 25)) | (np.hypot(abs(X - 96) - 50, Y - 120) < 18),
            marks=pytest.mark.slow,
        ),
    ],
)
def test_other_outlines_show_no_table(solid):
    middle = np.array([96.0, 96.0])
    assert find_table(solid, middle, 2.0 * SIZE, None) is None


def test_legs_are_several_thin_parts_below():
    assert has_legs(drawn(SQUARE_TABLE, LOW))
    assert not has_legs(np.maximum.accumulate(drawn(SQUARE_TABLE, LOW)))  # down to the floor


def test_a_chair_has_a_seat_as_deep_as_wide_and_an_open_backrest():
    seen = drawn(CHAIR, SEEN._replace(yaw=0.0))
    top = np.flatnonzero(seen.any(axis=1))[0]
    hole = seen & (abs(np.mgrid[:248, :248][0] - top - 45) < 12)
    hole &= abs(np.mgrid[:248, :248][1] - 124) < 25
    made = relief(picture(seen & ~hole), count=6000)
    assert extents(made, -0.05, 0.05)[0] == pytest.approx(np.ptp(made.means[:, 1]), rel=0.2)
    x, y, z = made.means.T
    feet = z < z.min() + 0.1
    assert np.ptp(x[feet]) > 0.3
    assert abs(x[feet] - x[feet].mean()).min() > 0.05  # nothing between front and rear legs
    back = x < x.min() + 0.08
    open_ = back & (abs(y) < 0.06) & (abs(z - (z.max() - 0.19)) < 0.02)
    assert np.count_nonzero(back) > 500
    assert not open_.any()


def test_view_rays_enter_and_leave_a_board():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-2, 2) for z in (-3, 3)], float)
    board = Board(corners, "top", np.eye(3))
    enter, leave = board.intersect(np.array([0.0, 0, 9]), np.array([[0.0, 0, -1], [3.0, 0, -1]]))
    assert (enter[0], leave[0]) == (pytest.approx(6), pytest.approx(12))
    assert enter[1] > leave[1]
