"""The window follows the particles; what it cannot follow is an error."""

import numpy as np
import pytest
import warp as wp

from phy124.mpm.grid import MARGIN, Grid, Unstable


@pytest.fixture
def grid() -> Grid:
    made = Grid((0.0, 0.0, 0.0), 0.1, real=wp.float32, device="cpu")
    assert made.fit(np.zeros(3), np.ones(3))
    return made


def test_the_window_leaves_room_and_moves_only_when_it_must(grid):
    first, last = grid.reach(np.zeros(3), np.ones(3))
    assert (grid.low <= first - MARGIN // 2).all()
    assert (grid.low + grid.size >= last + MARGIN // 2).all()
    low = grid.low.copy()
    assert not grid.fit(np.full(3, 0.05), np.full(3, 1.05))
    assert (grid.low == low).all()
    assert grid.fit(np.full(3, 0.3), np.full(3, 1.3))


def test_particles_that_crossed_too_many_cells_are_an_error(grid):
    with pytest.raises(Unstable, match="crossed more cells"):
        grid.fit(np.full(3, 5.0), np.full(3, 6.0))


def test_nodes_that_have_no_number_are_an_error(grid):
    grid.stale = True
    with pytest.raises(Unstable, match="cells away"):
        grid.fit(np.full(3, -1e9), np.full(3, 1e9))


def test_a_box_is_cut_to_the_window_and_to_layers(grid):
    start, extent = grid.nodes_within(np.full(3, -np.inf), np.full(3, np.inf))
    assert (start == 0).all() and (extent == grid.size).all()
    with grid.only((2, 5)):
        start, extent = grid.nodes_within(np.full(3, -np.inf), np.full(3, np.inf))
    assert start[0] == 2 and extent[0] == 3
    _, extent = grid.nodes_within(np.full(3, 50.0), np.full(3, 51.0))
    assert extent.min() <= 0
