import numpy as np
import pytest

from phy124.accuracy.convergence import (
    distances,
    fit_order,
    guess_errors,
    longest_convergence,
    richardson,
)

H = np.array([1 / 16, 1 / 24, 1 / 32, 1 / 48])


def results(order: float, scale: float = 3.0) -> list[np.ndarray]:
    """Levels whose errors are exactly scale h^order along one field."""
    field = np.random.default_rng(0).normal(size=(5, 40, 3))
    field /= np.sqrt((field**2).sum(axis=-1).mean())
    return [7.0 + scale * h**order * field for h in H]


@pytest.mark.parametrize("order", [1.0, 1.3, 2.0])
def test_order_and_errors_of_all_levels_are_found(order):
    result = richardson(H, distances(results(order)))
    assert result.order == pytest.approx(order, abs=0.01)
    assert result.errors == pytest.approx(3.0 * H**order, rel=0.02)
    assert not result.why_not
    assert not result.note


def test_any_result_has_an_error_by_its_distances():
    levels = results(1.5)
    result = richardson(H, distances(levels))
    other = levels[0] + 0.05 * np.random.default_rng(1).normal(size=levels[0].shape)
    apart = np.array([distances([other, level])[0, 1] for level in levels])
    exact = results(1.5, scale=0.0)[0]
    assert result.error_of(apart) == pytest.approx(distances([other, exact])[0, 1], rel=0.01)


@pytest.mark.parametrize(
    ("scatter", "count", "most"), [(0.05, 3, 1.4), (0.3, 3, 2.0), (0.1, 4, 1.1), (0.3, 4, 1.5)]
)
def test_scatter_between_grids_is_no_low_order(scatter, count, most):
    """The error of the finest level is estimated well, or too high, over many seeds."""
    rng, h, ratios = np.random.default_rng(1), H[:count], []
    for _ in range(40):
        levels = [
            x + 3.0 * scatter * n * rng.normal(size=x.shape) / np.sqrt(3)
            for x, n in zip(results(1.0)[:count], h, strict=True)
        ]
        true = distances([levels[-1], results(1.0, scale=0.0)[0]])[0, 1]
        ratios.append((richardson(h, distances(levels)).error or np.nan) / true)
    assert 0.95 < np.median(ratios) < most
    assert np.min(ratios) > 0.8


def test_errors_hold_until_levels_part():
    """Twelve frames of first order; from the ninth on one level follows another path."""
    levels = [np.stack([x.reshape(-1, 3)] * 12) for x in results(1.0)]
    parted = [x.copy() for x in levels]
    parted[3][8:] += 50
    result, frames = longest_convergence(H, parted)
    assert frames == 8 and result.order == pytest.approx(1, abs=0.02)
    assert result.errors == pytest.approx(3.0 * H, rel=0.02)
    assert longest_convergence(H, levels)[1] == 12
    parted[3] += 50
    parted[2] -= 50
    result, frames = longest_convergence(H, parted, size=2.0)
    assert not result.errors and frames == 12 and "no convergence" in result.why_not


def test_levels_that_do_not_come_closer_have_no_number():
    levels = results(1.0)
    levels[0], levels[2] = levels[2], levels[0]
    result = richardson(H, distances(levels))
    assert result.order is None
    assert result.error is None
    assert result.error_of(np.ones(4)) is None
    assert result.why_not == "no convergence: results on finer grids are no closer together"


def test_two_levels_show_no_order():
    assert "fewer than three" in richardson(H[:2], distances(results(1.0)[:2])).why_not


@pytest.mark.parametrize("order", [0.2, 0.7])
def test_low_order_is_reported_and_not_used(order):
    """Errors are about those of first order: the levels are too coarse to tell."""
    apart = distances(results(order))
    result = richardson(H, apart)
    assert result.order == pytest.approx(max(order, 0.5), abs=0.02)
    assert "outside 1 to 2, so the errors are rough estimates" in result.note
    first = apart[-2, -1] / (H[-2] - H[-1]) * H[-1]
    assert 0.8 * first < result.error < 1.5 * first


def test_levels_that_agree_have_no_order_but_an_error():
    result = richardson(H, 1e-7 * distances(results(1.0)))
    assert result.order is None
    assert 0 < result.error < 1e-6
    assert "does not depend on the grid" in result.note


def test_fitted_order_is_the_slope():
    assert fit_order(H, 5 * H**1.7) == pytest.approx(1.7)


def test_extrapolated_from_two_levels():
    coarse, fine = guess_errors((1 / 16, 1 / 24), 3 * (1 / 16 - 1 / 24), 1.0)
    assert (coarse, fine) == pytest.approx((3 / 16, 3 / 24))


def test_distances_are_a_metric():
    d = distances(results(1.0))
    assert np.array_equal(d, d.T)
    assert not d.diagonal().any()
    assert d[0, 3] <= d[0, 1] + d[1, 3] + 1e-12
