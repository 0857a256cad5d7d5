"""Several bodies: each has a grid of its own, and where two meet they touch."""

import numpy as np
import pytest

from phy124.boundaries import Ground
from phy124.forces import Gravity, ZoneForce
from phy124.materials import NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.watchdog import Watchdog
from phy124.mpm import Model, Pair
from phy124.mpm.pairs import STAGE
from support.solvers import make_solver

DX = 0.1
BOX = np.stack(np.meshgrid(*[(np.arange(8) + 0.5) / 20] * 3, indexing="ij"), -1).reshape(-1, 3)
"""A cube of 0.4 m."""


def two(apart: float, *, v: float = 0.5, precision: str = "float64", **options):
    """Two cubes, so far apart along x [m], each of which approaches the other at v / 2 [m/s]."""
    x = np.vstack([BOX, BOX * 1.1 + [0.4 + apart, 0.03, -0.02]])
    body = np.repeat([0, 1], len(BOX))
    options.setdefault("threads", 1)
    return make_solver(
        x,
        np.repeat([1, 1.1**3], len(BOX)) / 20**3,
        [NeoHookean(E=1e5)],
        dx=DX,
        body=body,
        v=np.where(body == 0, v / 2, -v / 2)[:, None] * [1.0, 0.3, 0.1],
        precision=precision,
        **options,
    )


def momentum(solver, body):
    run = solver.model.particles(body)
    return solver.model.mass.numpy()[run] @ solver.state.v.numpy()[run]


@pytest.mark.parametrize(("threads", "sticky"), [(1, False), (2, False), (1, True)])
def test_what_one_gives_the_other_gets(threads, sticky):
    s = two(0.01, threads=threads, pairs=[Pair(1, 0, friction=0.3, sticky=sticky)])
    before, whole = [momentum(s, body) for body in (0, 1)], diagnose(s)
    s.advance(0.1)
    gained = [momentum(s, body) - p for body, p in enumerate(before)]
    force, torque = s.pairs.wrenches(0.1)[(1, 0)]
    assert np.abs(gained[1]).max() > 10
    np.testing.assert_allclose(gained[0], 0.1 * force, rtol=1e-11)
    np.testing.assert_allclose(gained[0], -gained[1], rtol=1e-11)
    after = diagnose(s)
    np.testing.assert_allclose(after.angular, whole.angular, atol=1e-11)
    assert after.energy < whole.energy and np.linalg.norm(torque) > 1


def test_bodies_apart_launch_nothing_and_move_as_if_alone():
    apart, alone = two(1.2), two(1.2, pairs=[])
    apart.advance(0.05)
    names = [name for phase in apart.workers[0].phases for name, _ in phase]
    assert STAGE not in names and names.count("grid") == 2
    assert alone.nodes == 0 and apart.nodes == sum(grid.count for grid in apart.grids)
    assert np.allclose(apart.state.F.numpy(), np.eye(3), atol=1e-12)


@pytest.mark.parametrize("threads", [1, 2])
def test_a_body_that_is_held_takes_what_it_is_given(threads):
    external = ExternalWork()
    forces = external.forces([Gravity(g=(1.0, 0, -1.0)), ZoneForce()])
    s = two(
        0.01,
        held=[1],
        threads=threads,
        forces=forces,
        boundaries=external.boundaries([Ground(height=0.0)]),
        accumulators=[external],
    )
    dog, start = Watchdog(s, external), momentum(s, 0)
    for frame in (1, 2):
        dog.before()
        after = dog.follow()
        s.advance(0.05 * frame, after=after)
        assert dog.after() is None
    assert dog.balance.momentum_gain < 1e-12 and dog.balance.energy_gain < 1e-9
    assert start[0] - momentum(s, 0)[0] > 10, "it has been stopped"
    assert not s.state.v.numpy()[s.model.particles(1)].any()
    assert np.array_equal(s.state.x.numpy()[len(BOX) :], s.model.rest[len(BOX) :])


def test_bodies_must_come_in_their_order():
    x, volume = np.zeros((3, 3)), np.ones(3)
    for body in ([0, 1, 0], [1, 1, 2], [0, 2, 2]):
        with pytest.raises(ValueError, match="sorted by body"):
            Model.of(x, volume, [NeoHookean()], dx=1, body=np.array(body))
    with pytest.raises(ValueError, match="different ones of 2 bodies"):
        two(1.0, pairs=[Pair(0, 2)])


def test_a_pause_in_the_middle_of_contact_changes_nothing():
    kept, other = two(0.01), two(0.01)
    kept.advance(0.05)
    snapshot = kept.snapshot()
    kept.advance(0.08)
    other.restore(snapshot)
    other.advance(0.08)
    for name, array in kept.state.arrays().items():
        assert np.array_equal(array.numpy(), other.state.arrays()[name].numpy()), name
    assert np.array_equal(*(s.pairs.wrenches(1)[(0, 1)] for s in (kept, other)))
