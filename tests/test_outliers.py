"""The window around the particles, and those that leave it and come back."""

import numpy as np
import pytest
import warp as wp

from phy124.forces import Gravity
from phy124.materials import NeoHookean
from phy124.mpm import Grid, Unstable
from phy124.studies.validation.bodies import block, make_solver


def test_the_window_forgets_a_particle_that_flew_off():
    """One leaves at 1 km/s: the window is that of the others again, and nobody is lost."""
    x = np.concatenate([block(middle=(0, 0, 0.24)), [[1500.0, 0, 0.2]]])
    v = np.zeros_like(x)
    v[-1] = [0, 600, 1000]
    s = make_solver(x, np.full(len(x), 1e-4), [NeoHookean(E=1e4)], dx=0.125, v=v)
    s.advance(0.02)
    assert s.outliers.indices.numpy().tolist() == [216]
    assert s.grid.count < 5000
    fallen = s.state.x.numpy()[-1] - x[-1]
    np.testing.assert_allclose(fallen, [0, 12, 20], atol=2e-3)


@pytest.mark.parametrize("threads", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_particles_beyond_the_domain_fall_once_per_substep(rng, threads):
    """Debris that leaves and debris that comes back: all fall as one, to rounding."""
    way = rng.normal(size=(20, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    start = way * np.repeat([4.0, 9.0], 10)[:, None]
    x = np.concatenate([block(middle=(0, 0, 0.24)), start, [[1500.0, 0, 0.2]]])
    v = np.zeros_like(x)
    v[216:236] = way * np.repeat([60.0, -60.0], 10)[:, None]
    options = {"forces": [Gravity()], "precision": "float64", "threads": threads}
    s = make_solver(x, np.full(len(x), 1e-4), [NeoHookean(E=1e2)], dx=0.125, v=v, **options)
    mass = s.model.mass.numpy()
    before = mass @ s.state.v.numpy()
    crossed = set()
    for frame in range(1, 13):
        s.advance(0.01 * frame)
        crossed.add(tuple(s.outliers.indices.numpy().tolist()))
    assert len(crossed) > 5
    inputs = mass @ s.state.v.numpy() - before
    fallen = mass.sum() * np.array([0, 0, -9.81]) * (s.clock.time - s.clock.last_dt / 2)
    np.testing.assert_allclose(inputs, fallen, rtol=0, atol=1e-9 * np.abs(fallen).max())


def test_a_window_far_too_large_on_one_side_shrinks():
    grid = Grid((0, 0, 0), 1.0, real=wp.float32, device="cpu")
    grid.fit(np.zeros(3), np.array([100.0, 5, 5]))
    assert grid.fit(np.zeros(3), np.full(3, 5.0))
    assert grid.size.max() < 20
    with pytest.raises(Unstable, match="crossed more cells"):
        grid.fit(np.zeros(3), np.array([5.0, 5, 50]))
    with pytest.raises(Unstable, match=r"particles moved 1e\+09 cells away"):
        grid.fit(np.zeros(3), np.array([5.0, 5, 1e10]))
