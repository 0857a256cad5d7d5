import numpy as np
import pytest

from phy124.accuracy.convergence import distances, extrapolated, fitted_order, richardson

H = np.array([1 / 16, 1 / 24, 1 / 32, 1 / 48])


def results(order: float, scale: float = 3.0) -> list[np.ndarray]:
    """Levels whose errors are exactly scale h^order along one field."""
    field = np.random.default_rng(0).normal(size=(5, 40, 3))
    field /= np.sqrt((field**2).sum(axis=-1).mean())
    return [7.0 + scale * h**order * field for h in H]


@pytest.mark.parametrize("order", [0.7, 1.0, 1.3, 2.0])
def test_order_and_own_error_of_the_finest_are_found(order):
    found = richardson(H, distances(results(order)))
    assert found.order == pytest.approx(order, abs=0.01)
    assert found.error == pytest.approx(3.0 * H[-1] ** order, rel=0.02)
    assert not found.why_not
    assert not found.note


def test_levels_that_do_not_come_closer_have_no_number():
    levels = results(1.0)
    levels[1], levels[2] = levels[2], levels[1]
    found = richardson(H, distances(levels))
    assert found.order is None
    assert found.error is None
    assert found.why_not == "not converging: finer grids do not come closer"


def test_two_levels_show_no_order():
    assert "fewer than three" in richardson(H[:2], distances(results(1.0)[:2])).why_not


def test_an_order_out_of_range_is_said():
    found = richardson(H, distances(results(0.2)))
    assert found.order == 0.5
    assert "rough" in found.note


def test_scattered_levels_are_said(rng):
    levels = [x + 0.1 * rng.normal(size=x.shape) for x in results(1.0, scale=1.0)]
    levels[0] += 1.0
    levels[1] += 0.5
    levels[2] += 0.4
    assert richardson(H, distances(levels)).note


def test_levels_that_agree_have_no_order_but_an_error():
    found = richardson(H, 1e-7 * distances(results(1.0)))
    assert found.order is None
    assert 0 < found.error < 1e-6
    assert "does not depend on the grid" in found.note


def test_fitted_order_is_the_slope():
    assert fitted_order(H, 5 * H**1.7) == pytest.approx(1.7)


def test_extrapolated_from_two_levels():
    coarse, fine = extrapolated((1 / 16, 1 / 24), 3 * (1 / 16 - 1 / 24), 1.0)
    assert (coarse, fine) == pytest.approx((3 / 16, 3 / 24))


def test_distances_are_a_metric():
    d = distances(results(1.0))
    assert np.array_equal(d, d.T)
    assert not d.diagonal().any()
    assert d[0, 3] <= d[0, 1] + d[1, 3] + 1e-12
