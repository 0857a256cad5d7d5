"""Forces that act on a part of a body (phy124/lattice/reach.py)."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from phy124.forces import Acceleration, Grab, SetVelocity, Wind, WrenchForce
from phy124.lattice import reach
from phy124.schema.region import Region
from support.lattices import DAMPED, fork, make

END = Region(lower=(1.0, -1, -1), upper=(9, 9, 9))
GRAB = Grab(point=(1.1, 0.1, 0.05), radius=0.15, targets=((1.1, 0.1, 0.05), (1.4, 0.1, 0.5)))
PUSH = WrenchForce(force=(0, 1, 0), torque=(0.1, 0, 0), point=(1.1, 0.1, 0.2), radius=0.2)


@pytest.mark.parametrize("threads", [1, 3])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_motion_is_the_same_as_if_all_points_were_processed(monkeypatch, precision, threads):
    forces = [GRAB, PUSH, Acceleration(a=(0, 0, 5), region=END)]
    results, works = [], []
    for most in (reach.MOST, 0.0):
        monkeypatch.setattr(reach, "MOST", most)
        solver = make(fork(), DAMPED, forces=forces, precision=precision, threads=threads)
        cells = [worker.reach.cells for worker in solver.workers]
        assert all((part is None) == (most == 0) for part in cells)
        sums = wp.zeros((threads, 16), dtype=wp.float64)
        solver.keep_pushes(sums)
        solver.advance(0.02)
        state = solver.nodes_state
        results.append([getattr(state, name).numpy() for name in ("u", "v", "lagging", "before")])
        works.append(sums.numpy().sum(axis=0))
        assert np.abs(results[-1][0]).max() > 1e-3
    for some, every in zip(*results, strict=True):
        assert np.array_equal(some, every)
    # Sums of magnitudes depend on how nodes are grouped.
    assert works[0] == pytest.approx(works[1], rel=1e-3, abs=1e-12)


@pytest.mark.parametrize("force", [Wind(), SetVelocity(v=(0, 0, 1))])
def test_forces_on_whole_bodies_reach_all_cells(force):
    solver = make(fork(), DAMPED, forces=[force, GRAB], precision="float32")
    assert all(worker.reach.cells is None for worker in solver.workers)


def test_push_does_not_compute_the_mass_that_a_hand_feels():
    """A controller may push in every frame, and this mass takes as long as a frame."""
    solver = make(fork(), DAMPED, precision="float32")
    model = replace(solver.model, respond=lambda force: pytest.fail("the mass is computed"))
    assert PUSH.attach(model, solver.state, solver.tracks)
    with pytest.raises(pytest.fail.Exception):
        GRAB.attach(model, solver.state, solver.tracks)


def test_hands_with_equal_targets_are_not_confused():
    other, lifted = GRAB.model_copy(update={"point": (0.1, 0.1, 0.05)}), GRAB.targets[::-1]
    moved = [(other.target(), other.model_copy(update={"targets": lifted}).target())]
    assert not make(fork(), DAMPED, forces=[GRAB, other]).retarget(moved)
    assert make(fork(), DAMPED, forces=[other]).retarget(moved)
