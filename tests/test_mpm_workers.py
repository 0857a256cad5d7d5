"""Workers share the particles evenly and the layers of the grid without gap."""

import itertools
from types import SimpleNamespace

import numpy as np
import warp as wp

from phy124.mpm.grid import MARGIN, Grid
from phy124.mpm.workers import cut, fit_part, layers_of, timed


def grid(low=(0, 0, 0), size=(0, 0, 0)) -> Grid:
    made = Grid((0.0, 0.0, 0.0), 0.1, real=wp.float32, device="cpu")
    made.low, made.size = np.array(low), np.array(size)
    return made


def test_each_run_of_particles_is_cut_evenly():
    assert cut([(0, 10), (10, 11)], 2) == [[(0, 5), (10, 10)], [(5, 10), (10, 11)]]
    for parts in (1, 2, 3):
        parts_of = cut([(3, 100)], parts)
        assert parts_of[0][0][0] == 3 and parts_of[-1][0][1] == 100
        assert all(a[0][1] == b[0][0] for a, b in itertools.pairwise(parts_of))


def test_two_workers_update_all_layers_once():
    first = SimpleNamespace(nodes=grid([2, 0, 0], [10, 4, 4]))
    second = SimpleNamespace(nodes=grid([8, 0, 0], [12, 4, 4]))
    whole = grid([0, 0, 0], [22, 4, 4])
    (start, middle), (again, end) = layers_of([first, second], whole)
    assert start == 0 and middle == again == 10 and end == 22
    assert layers_of([first], whole) == [None]


def test_private_nodes_are_whole_layers_and_stay_while_there_is_room():
    whole, part = grid(), grid()
    whole.fit(np.zeros(3), np.full(3, 2.0))
    low, high = np.full(3, 0.3), np.full(3, 0.6)
    assert fit_part(part, whole, low, high, force=False)
    assert (part.size[1:] == whole.size[1:]).all() and (part.low[1:] == whole.low[1:]).all()
    assert part.low[0] >= whole.low[0] and part.size[0] <= whole.size[0]
    assert not fit_part(part, whole, low, high, force=False)
    assert fit_part(part, whole, low, high, force=True)
    assert fit_part(part, whole, low + 0.1 * MARGIN, high + 0.1 * MARGIN, force=False)


def test_time_is_added_up_by_name():
    timings = {}
    for _ in range(3):
        timed(timings, "p2g", lambda: None)
    assert timings["p2g"][1] == 3 and timings["p2g"][0] >= 0
