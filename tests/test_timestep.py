import math
from itertools import product

import numpy as np
import pytest

from phy124.mpm.timestep import (
    ELASTIC_LIMIT,
    MEASURE_EVERY,
    Extremes,
    beside_elastic,
    stable_substep,
)


@pytest.mark.parametrize(
    ("extremes", "dt", "limiter"),
    [
        (Extremes(0, 0, 100.0), 0.75 * 0.1 / 10, "elastic"),
        (Extremes(20, 0, 100.0), 0.5 * 0.1 / 20, "speed"),
        (Extremes(1, 500, 100.0), 0.4 / 500, "gradient"),
    ],
)
def test_the_tightest_limit_rules(extremes, dt, limiter):
    step = stable_substep(extremes, 0.1)
    assert step.limiter == limiter
    assert math.isclose(step.dt, dt)


def test_a_users_substep_is_a_ceiling_only():
    assert stable_substep(Extremes(0, 0, 100.0), 0.1, ceiling=1e-4) == (1e-4, "user")
    assert stable_substep(Extremes(0, 0, 100.0), 0.1, ceiling=1.0).limiter == "elastic"


def test_viscosity_limits_under_its_own_name():
    assert stable_substep(Extremes(0, 0, 100.0), 0.1, viscous=1e-4) == (1e-4, "viscous")
    assert stable_substep(Extremes(0, 0, 100.0), 0.1, viscous=1e-4, ceiling=1e-5).limiter == "user"


def test_friction_leaves_room_for_stiffness():
    """The strain and C of an isolated particle: stable while both roots are in the unit circle."""
    for (kind, limit), cfl in product(ELASTIC_LIMIT.items(), (0.3, 0.6, 0.8, 0.9)):
        g, a = {"affine": 4, "spline": 6}[kind], (cfl * limit) ** 2
        fraction = beside_elastic(cfl)
        for rate, stable in ((0.98 * fraction, True), (2 - 2 * cfl**2 + 0.02, False)):
            roots = np.linalg.eigvals([[1 - g * a, 1 - g / 4 * rate], [-4 * a, 1 - rate]])
            assert (np.abs(roots).max() <= 1 + 1e-9) == stable, (kind, cfl, rate)


def test_nothing_moves_and_nothing_is_stiff():
    assert stable_substep(Extremes(0, 0, 0), 0.1).dt == math.inf


def test_stiffness_is_forgotten_slowly():
    """A softer moment counts for no less than 0.95 of the stiffer one before; speeds do at once."""
    before, now = Extremes(5, 7, 100.0), Extremes(1, 2, 40.0)
    assert now.after(before, substeps=MEASURE_EVERY) == (1, 2, 95.0)
    assert before.after(now, substeps=MEASURE_EVERY) == before
