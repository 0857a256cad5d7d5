"""Gaussians outside the surface points of a body."""

from dataclasses import replace

import numpy as np
import pytest

from phy124.boundaries import HalfSpace
from phy124.forces import Gravity
from phy124.particles.lattice import surface_points
from phy124.particles.protrusions import ABOVE, ASIDE, STRAY, find_protrusions
from support.lattices import DAMPED, DX, block, make

SIZE, LOW = 0.4, 0.1
HANGING = np.array([[0.22, 0.3, LOW - 0.6 * DX], [0.38, 0.27, LOW - 0.6 * DX]])
"""Gaussians below a block, close to the same cell from two sides."""


def stuffed(means):
    """Return a block of Gaussians with some of their centres."""
    return replace(block((SIZE,) * 3, (LOW,) * 3), means=np.asarray(means, np.float32))


@pytest.mark.parametrize(
    ("means", "is_protrusion"),
    [
        ((0.3, 0.3, LOW + SIZE + (ABOVE - 0.05) * DX), False),
        ((0.3, 0.3, LOW + SIZE + (ABOVE + 0.05) * DX), True),
        ((0.3, 0.3, LOW + SIZE + (STRAY + 0.05) * DX), False),
        ((LOW - 0.4 * DX, LOW - 0.4 * DX, LOW + 0.05 * DX), True),
        ((0.3, 0.3, 0.3), False),
    ],
)
def test_gaussians_outside_the_surface_are_protrusions(means, is_protrusion):
    assert ABOVE < ASIDE < STRAY
    solid = stuffed([means])
    protrusions = find_protrusions(solid, surface_points(solid, DX), DX)
    assert len(protrusions) == is_protrusion
    assert not is_protrusion or np.allclose(protrusions[0, :3], means)


def test_protrusions_move_linearly_with_the_body(rng):
    solver = make(stuffed(HANGING))
    surface, A = solver.surface, rng.normal(size=(3, 3))
    assert np.allclose(np.sort(surface.x[surface.is_protrusion], axis=0), np.sort(HANGING, axis=0))
    moved = surface.place(solver.lattice.x @ A.T + 0.3) - surface.x - surface.x @ A.T
    assert np.allclose(moved[surface.is_protrusion], 0.3, rtol=0, atol=1e-6)


def test_protrusions_land_on_the_floor():
    corners = [(x, y, LOW - 0.6 * DX) for x in (0.15, 0.45) for y in (0.15, 0.45)]
    pull, floor = Gravity(g=(0, 0, -1.0)), HalfSpace()
    solver = make(stuffed(corners), DAMPED, forces=[pull], boundaries=[floor])
    solver.advance(3.0)
    surface = solver.surface
    height = surface.place(solver.nodes_state.u.numpy())[:, 2]
    assert -0.05 * DX < height[surface.is_protrusion].min() < 0.05 * DX
    assert height[~surface.is_protrusion].min() > 0.35 * DX


def test_protrusions_of_bodies_do_not_touch_each_other():
    """A rough surface would lift the other body."""
    solver = make(stuffed(HANGING))
    meeting = solver.meetings.of_bodies[0]
    assert solver.surface.is_protrusion.any()
    assert not solver.surface.is_protrusion[meeting._mine].any()
