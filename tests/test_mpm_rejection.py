"""Step rejection: which substeps are tried, and that a rejected one leaves nothing behind."""

import math

import numpy as np
import pytest

from phy124.boundaries import Ground, Sphere
from phy124.boundaries.motion import Path
from phy124.forces import Acceleration, Gravity, ParticleForce, SetVelocity, Wind
from phy124.gaussians import Gaussians
from phy124.materials import NeoHookean
from phy124.mpm import MEASURE_EVERY, Unstable
from phy124.mpm.timestep import MEMORY, Extremes
from phy124.mpm.tracks import Sine
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import block, make_solver

CALM = 1e-6
"""A substep in which nothing happens [s]."""
CALM_STRAIN = 0.2
"""Strain that changes no stiffness much."""


def solver(forces=(), **options):
    x = block(middle=(0, 0, 0.24))
    volume = np.full(len(x), 1e-4)
    return make_solver(x, volume, [NeoHookean(E=1e4)], dx=0.125, forces=list(forces), **options)


def test_a_calm_substep_is_not_tried_and_a_long_one_is():
    s = solver([Gravity()], v=np.tile([0.0, 0, -1], (216, 1)))
    s.advance(1e-4)
    speed = s.clock.extremes.speed
    assert speed == pytest.approx(1, rel=0.01)
    assert not s.rejection.must_try(s.clock, CALM)
    assert s.rejection.must_try(s.clock, s.model.dx / speed)


def test_acceleration_counts_newtons_by_the_lightest():
    assert solver([Gravity()]).rejection.acceleration == pytest.approx(9.81)
    s = solver([ParticleForce(f=(2, 0, 0))])
    lightest = min(1.0, float(s.model.mass.numpy().min()))
    assert s.rejection.acceleration == pytest.approx(2 / lightest)


def test_displacement_of_a_wall_is_no_acceleration():
    """Otherwise, a live run would take other substeps than its repetition, which knows the path."""
    path = Path(times=(0, 1, 2), points=((0, 0, 0), (0, 0, 0), (0, 3, 0)), smooth=False)
    wall = Sphere(centre=(0, -5, 0), radius=0.5, motion=path)
    push = ParticleForce(f=(2, 0, 0))
    alone, beside = (solver([push], boundaries=walls) for walls in ([], [wall]))
    assert beside.rejection.acceleration == alone.rejection.acceleration
    beside.rejection.begin(0, 0.5)
    assert beside.rejection.wall == 0
    beside.rejection.begin(1, 1.5)
    assert beside.rejection.wall == pytest.approx(3)


def test_only_sudden_forces_are_tried_at_the_start():
    assert not solver([Gravity()]).rejection.sudden(solver().clock)
    s = solver([SetVelocity(v=(0, 0, 3))])
    assert s.rejection.sudden(s.clock)


def test_violent_substep_is_shortened_to_one_cell():
    s = solver([ParticleForce(f=(3e4, 0, 0))])
    s.advance(1e-3)
    assert s.rejection.rejected > 0
    speed = np.linalg.norm(s.state.v.numpy(), axis=1).max()
    assert np.isfinite(s.state.x.numpy()).all() and speed * s.clock.last_dt <= s.model.dx * 1.01
    # Nothing of a rejected push remains: the momentum is that of the accepted time alone.
    pushed = 3e4 * len(s.model) * (s.clock.time - s.clock.last_dt / 2)
    momentum = float((s.model.mass.numpy()[:, None] * s.state.v.numpy()).sum(axis=0)[0])
    assert momentum == pytest.approx(pushed, rel=1e-4)


def test_measuring_is_rarer_only_where_nothing_moves_far_between():
    s = solver(measure_every=40)
    s.advance(1e-4)
    assert s.rejection.interval(s.clock, CALM_STRAIN) == 40
    s = solver(measure_every=40, v=np.tile([0.0, 0, -300], (216, 1)))
    s.advance(1e-4)
    assert MEASURE_EVERY <= s.rejection.interval(s.clock, CALM_STRAIN) < 40
    assert math.isfinite(s.clock.stable().dt)


def test_stiffening_snow_is_sound_at_any_interval():
    rng = np.random.default_rng(0)
    handle = rng.uniform((-0.5, -0.03, 0), (0.5, 0.03, 0.06), (800, 3))
    head = rng.uniform((0.35, -0.18, 0), (0.5, 0.18, 0.06), (400, 3))
    means = np.concatenate([handle, head])
    quats, scales = np.tile([1.0, 0, 0, 0], (1200, 1)), np.full((1200, 3), 0.012)
    hammer = Gaussians.from_rgb(means, quats, scales, np.full(1200, 0.9), np.full((1200, 3), 0.5))
    scene = Scene.named("snow").replaced({"accuracy": "draft", "time.frames": 16})
    often, rarely = (
        Simulation(
            prepare(hammer, scene.replaced({"checks.measure": every}), RunContext(threads=1))
        ).run()
        for every in (1, 16)
    )
    extents = [np.ptp(clip.means[-1], axis=0) for clip in (often, rarely)]
    np.testing.assert_allclose(*extents, atol=0.02)


def test_gusts_are_tried_only_where_they_are_fast():
    for speed, tried in ((3.0, False), (300.0, True)):
        s = solver([Wind(v=(speed, 0, 0), profile=Sine(frequency=3.0))], ceiling=1e-3)
        s.advance(1e-3)
        assert s.rejection.must_try(s.clock, 1e-3) == tried
        assert s.rejection.wall == pytest.approx(speed)


@pytest.mark.parametrize("cells", [0.1, 0.2, 0.24, 0.45])
def test_translation_never_leaves_the_window(cells):
    dt = 1e-3
    s = solver(measure_every=32, ceiling=dt, v=np.tile([cells * 0.125 / dt, 0, 0], (216, 1)))
    for frame in range(1, 9):
        s.advance(frame * 11.5e-3)
    assert s.flying and s.rejection.rejected == 0
    assert s.clock.limiters == {"user": 96}


@pytest.mark.parametrize("measure_every", [4, 32])
@pytest.mark.parametrize("cells", [0.01, 0.09, 0.11])
def test_acceleration_never_leaves_the_window(cells, measure_every):
    """A uniform one, of so many cells per substep squared, up to the limit of speed."""
    dt = 1e-3
    a = cells * 0.125 / dt**2
    s = solver([Acceleration(a=(a, 0, 0))], measure_every=measure_every, ceiling=dt)
    start = s.state.x.numpy()[:, 0].mean()
    for frame in range(1, 9):
        s.advance(frame * 11.5e-3)
    way = s.state.x.numpy()[:, 0].mean() - start
    assert way == pytest.approx(a * s.clock.time**2 / 2, rel=0.02)
    assert s.clock.limiters["speed"] > 0 or cells < 0.05


def test_flight_at_speed_is_not_tried():
    s = solver([Gravity()], boundaries=[Ground(height=-1.0)], v=np.tile([0.0, 0, -9], (216, 1)))
    s.advance(1e-3)
    assert s.flying and not s.rejection.must_try(s.clock, 0.01, flying=s.flying)
    assert s.rejection.must_try(s.clock, 0.01)
    s.advance(0.12)
    assert not s.flying, "the ground is within reach"


def counted(s) -> dict[str, int]:
    """Count how often a solver measures only speeds, and all limits, from now on."""
    counts = {"glance": 0, "measure": 0}
    inner = s._each_worker

    def count(measure) -> None:
        counts[measure.__name__] += 1
        inner(measure)

    s._each_worker = count
    return counts


def test_stiffness_is_measured_once_it_may_have_grown():
    s = solver(measure_every=16, ceiling=1e-3, v=np.tile([0.0, 0, -0.1], (216, 1)))
    s.advance(1e-3)
    counts = counted(s)
    s.advance(0.1)
    assert 0 < counts["measure"] <= s.clock.substeps / 12
    assert counts["glance"] == 0, "nothing strains it"
    C = np.tile(np.diag([8.0, 0, 0]), (216, 1, 1))
    s = solver(measure_every=32, ceiling=4e-3, C=C)
    counts = counted(s)
    for until in np.arange(1, 20) * 0.01:
        s.advance(until)
        assert s.clock.strain < s._calm_strain()
    assert counts["glance"] >= 1 and counts["measure"] >= 2


def test_memory_of_stiffness_counts_substeps():
    past = Extremes(1.0, 1.0, 100.0)
    now = Extremes(1.0, 1.0, 10.0)
    assert now.after(past, substeps=MEASURE_EVERY).stiffness == pytest.approx(100 * MEMORY)
    assert now.after(past, substeps=4 * MEASURE_EVERY).stiffness == pytest.approx(100 * MEMORY**4)


def test_particle_outside_the_window_ends_the_frame():
    s = solver(measure_every=16)
    s.advance(1e-4)
    x = s.state.x.numpy()
    x[5] += s.model.dx * (s.grid.size + 2)
    s.state.x.assign(x)
    s.clock.since_measured = s.clock.since_complete = 0
    with pytest.raises(Unstable, match="crossed more cells"):
        s.advance(2e-4)


def test_new_push_shortens_the_interval_at_once():
    s = solver([ParticleForce(f=(30, 0, 0), start=0.01)], measure_every=32)
    s.advance(0.005)
    assert s.clock.interval == 32
    s.advance(0.0101)
    assert s.clock.interval < 32


def test_advancing_by_no_time_measures_the_limits():
    s = solver([Gravity()])
    s.advance(s.clock.time)
    assert s.clock.extremes.stiffness > 0 and s.nodes > 0
