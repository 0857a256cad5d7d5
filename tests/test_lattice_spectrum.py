"""Limits of a lattice's substep: frequencies, damping, shocks."""

import math

import numpy as np
import pytest

from support.lattices import DX, SOFT, block, make


def test_all_threads_look_for_the_frequency_at_rest():
    solver = make(block((0.2, 0.2, 0.2)), threads=2)
    assert solver.runner.team.seconds[1] > 0


def test_frequency_without_a_trial_stays():
    solver = make(block((0.2, 0.2, 0.2)))
    square = solver.spectrum.square
    solver.spectrum._trials.shape.zero_()
    solver.spectrum.follow()
    assert solver.spectrum.square == square


def test_frequency_follows_a_squeezed_body():
    solver = make(block((0.4, 0.3, 0.3)))
    squeezed = 0.5
    solver.nodes_state.u.assign((squeezed - 1) * solver.lattice.x)
    at_rest = solver.spectrum.square
    for _ in range(30):
        solver.workers[0].run(0)
        solver.limits.measure_frequency()
    # dP/ds of mu (s - 1/s) + lam log(J) / s along each axis, with J = s^3.
    lam, mu = 0.3 / (1.3 * 0.4), 1 / 2.6
    stiffer = mu * (1 + 1 / squeezed**2) + lam * (1 - math.log(squeezed**3)) / squeezed**2
    assert solver.spectrum.square / at_rest == pytest.approx(stiffer / (lam + 2 * mu), rel=0.15)


def test_measured_damping_covers_the_fastest_decay():
    solver = make(block((0.4, 0.3, 0.3)), SOFT.model_copy(update={"damping": 200.0}))
    spectrum = solver.spectrum
    assumed = 2 * spectrum._delay * spectrum._least
    start = np.random.default_rng(1).normal(size=(solver.nodes, 3))
    start[solver.lattice.tied] = 0
    spectrum._trials.shape.assign(start)
    largest = spectrum._iterate(0.0, 150, velocities=solver.nodes_state.lagging)
    assert largest < assumed < 1.25 * largest


def test_viscosity_damps_all_motion_at_substeps_at_rest():
    solver = make(block((0.2, 0.2, 0.2)), SOFT.model_copy(update={"damping": 3000.0}))
    start = 1e-6 * np.random.default_rng(1).normal(size=(solver.nodes, 3))
    solver.carry_nodes(lambda x, v: (x, start))
    for _ in range(300):
        rest = solver.limits.substep_at_rest
        solver.step(rest, rest)
    assert np.abs(solver.nodes_state.v.numpy()).max() < 0.5 * np.abs(start).max()


def test_a_stiffer_body_takes_shorter_substeps_at_once():
    solver = make(block((0.3, 0.2, 0.2)))
    limits = []
    for factor in (1.0, 25.0, 0.1):
        solver.softened = factor
        solver.clock.expire()
        solver.limits.measure_if_due()
        limits.append(solver.spectrum.substep_at_rest)
        assert solver.clock.stable().dt <= solver.clock.cfl * limits[-1] * (1 + 1e-9)
    assert limits == pytest.approx([limits[0], limits[0] / 5, limits[0]])


@pytest.mark.parametrize(
    ("damping", "speed", "shock"),
    [(0, 0.2, False), (0, 0.3, True), (300, 0.3, True), (400, 0.25, False)],
)
def test_slow_motion_of_flat_material_is_no_shock(damping, speed, shock):
    """The sides of a cell squeezed to a tenth approach at `speed` times the speed of sound."""
    solver = make(block((0.4, 0.3, 0.3)), SOFT.model_copy(update={"damping": damping}))
    flat = np.diag([1, 1, 0.1]) - np.eye(3)
    rate = speed * SOFT.wave_speed() / DX
    solver.nodes_state.u.assign(solver.lattice.x @ flat)
    solver.nodes_state.v.assign(solver.lattice.x * [0, 0, -rate])
    solver.limits.measure_if_due()
    assert solver.clock.in_shock == shock


def test_slow_motion_of_a_stiffened_body_is_no_shock():
    """The speed of sound is 5 times that of the material."""
    solver = make(block((0.4, 0.3, 0.3)))
    rate, shocks = 0.5 * SOFT.wave_speed() / DX, []
    solver.nodes_state.v.assign(solver.lattice.x * [0, 0, -rate])
    for factor in (1.0, 25.0):
        solver.softened = factor
        solver.limits.measure_if_due()
        shocks.append(solver.clock.in_shock)
    assert shocks == [True, False]


def test_a_shock_of_one_substep_ends_within_a_few():
    clock = make(block((0.2, 0.2, 0.2))).clock
    clock.closing, shocks = 1.25 * clock.calm, []
    for _ in range(8):
        clock.since_measured = 1
        clock.limit_by(clock.extremes, complete=True)
        shocks.append(clock.in_shock)
        clock.closing = 0.0
    assert shocks == sorted(shocks, reverse=True)
    assert 3 <= sum(shocks) <= 6


@pytest.mark.parametrize("damping", [0.0, 3000.0])
def test_only_the_frequency_of_a_damped_body_is_called_steady(damping):
    solver = make(block((0.2, 0.2, 0.2)), SOFT.model_copy(update={"damping": damping}))
    known = []
    for squeezed in (1.0, 1.0, 0.8, 0.8):
        solver.nodes_state.u.assign((squeezed - 1) * solver.lattice.x)
        solver.workers[0].run(0)
        solver.limits.measure_frequency()
        known.append(solver.spectrum.steady)
    expected = [True, True, False, True] if damping else [False] * 4
    assert known == expected
    solver.spectrum.steady = damping == 0
    solver.restore({**solver.snapshot(), "spectrum": {**solver.spectrum.snapshot()}})
    assert solver.spectrum.steady == (damping == 0)
