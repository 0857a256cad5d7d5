"""The finite elements that judge the ball: against Hertz, theory of strain, and themselves."""

import math

import numpy as np
import pytest

from phy124.studies.validation.experiments.elastic_ball import (
    Elements,
    Law,
    fit_law,
    make_mesh,
    plate_forces,
)
from phy124.studies.validation.experiments.experiment import find_root
from phy124.studies.validation.experiments.hertz import NU, RADIUS, E

LAME = 0.5 / (1 + NU), NU / ((1 + NU) * (1 - 2 * NU))


def tatara(depth: float) -> float:
    """Hertz for a ball between two plates [N], each of which moves what the other one touches.

    Tatara (1989) adds F f(a) / (pi E) to the approach, with the contact's radius a.
    """

    def force(a: float) -> float:
        return 4 * E / (1 - NU**2) * a**3 / (3 * RADIUS)

    def missing(a: float) -> float:
        reach = a * a + 4 * RADIUS**2
        f = 2 * (1 + NU) * RADIUS**2 / reach**1.5 + (1 - NU**2) / math.sqrt(reach)
        return a * a / RADIUS - force(a) * f / (math.pi * E) - depth

    return force(find_root(missing, 1e-9, RADIUS))


def test_a_ball_that_swells_is_under_the_pressure_of_its_law():
    """u = e x: the work of the forces is the volume times the trace of the stress."""
    ball = make_mesh(8, whole=True)
    elements, (mu, lam), e = Elements.of(ball), LAME, 0.05
    inner, _ = elements.forces(e * ball.x.ravel(), mu, lam)
    stress = mu * (1 + e - 1 / (1 + e)) + 3 * lam * math.log1p(e) / (1 + e)
    assert inner @ ball.x.ravel() == pytest.approx(3 * elements.volume.sum() * stress)
    assert elements.weights.sum() == pytest.approx(4 / 3 * math.pi, rel=0.02)


def test_stiffness_is_the_derivative_of_the_forces():
    ball = make_mesh(3, whole=False)
    elements, rng = Elements.of(ball), np.random.default_rng(0)
    u, way = rng.normal(size=(2, ball.x.size)) * 0.02 * (np.arange(ball.x.size) % 2)
    _, stiffness = elements.forces(u, *LAME)
    more, less = (elements.forces(u + side * 1e-6 * way, *LAME)[0] for side in (1, -1))
    said = np.zeros(ball.x.size)
    np.add.at(said, elements.dofs, np.einsum("mde,me->md", stiffness, way[elements.dofs]))
    np.testing.assert_allclose((more - less) / 2e-6, said, atol=1e-7)


def test_a_ball_that_is_hardly_pressed_follows_hertz():
    """Deeper it is stiffer, between two plates as Tatara says; on one plate still more."""
    depths = 0.004, 0.03, 0.06
    half = [Law(NU).force(depth) for depth in depths]
    two, first = (plate_forces(depths, NU, whole=whole) / half for whole in (False, True))
    assert two[0] == pytest.approx(1, abs=0.04) and first[0] == pytest.approx(1, abs=0.06)
    for depth, hertz, result in list(zip(depths, half, two, strict=True))[1:]:
        assert result == pytest.approx(tatara(0.5 * depth) / (hertz * 1e5 * 0.25), rel=0.02)
    assert first[2] > two[2] + 0.1


def test_twice_as_many_elements_agree_within_a_per_cent():
    coarse, fine = (plate_forces((0.06, 0.1), NU, whole=False, fine=n) for n in (12, 24))
    np.testing.assert_allclose(coarse, fine, rtol=0.01)


def test_law_matches_elements_and_its_slope():
    fitted = fit_law(NU, whole=False)
    result = plate_forces((0.02, 0.1), NU, whole=False)
    np.testing.assert_allclose([fitted.force(d) for d in (0.02, 0.1)], result, rtol=0.01)
    slope = (fitted.force(0.05 + 1e-6) - fitted.force(0.05 - 1e-6)) / 2e-6
    assert fitted.slope(0.05) == pytest.approx(slope)
    assert Law(NU).force(0.04) == pytest.approx(4 / 3 / 0.91 * 0.008)
