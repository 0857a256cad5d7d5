"""Kernels that shape the Gaussians of a liquid into discs, compared with NumPy."""

import numpy as np
import pytest
import scipy

from phy124.kernels.splat import discs
from phy124.rendering.liquid import Field

CELL = 0.1


@pytest.fixture(scope="module")
def points():
    """Points [N,3] in a box of 0.5 x 0.3 x 0.4 m, with one point far outside."""
    x = np.random.default_rng(0).uniform(size=(2000, 3)) * [0.5, 0.3, 0.4]
    x[0] = 50.0
    return x.astype(np.float32)


@pytest.fixture(scope="module")
def field(points):
    return Field(points, CELL)


@pytest.fixture(scope="module")
def values(field):
    """Random values of the cells, of which a third is zero."""
    drawn = np.random.default_rng(1).uniform(-0.5, 1, field.size).astype(np.float32)
    return np.maximum(drawn, 0)


def at(field):
    """Return the positions of the points [N,3], in cells."""
    return (field.x - np.array(field.grid.corner)) / np.float32(field.cell)


def test_fields_are_interpolated_linearly(field, values):
    expected = scipy.ndimage.map_coordinates(values, at(field).T, order=1, mode="nearest")
    np.testing.assert_allclose(field.sample(values), expected, atol=1e-5)


def test_volumes_are_distributed_as_fields_are_interpolated(field, values):
    volumes = np.random.default_rng(2).uniform(size=len(field.x)).astype(np.float32)
    filled = field.add(volumes)
    assert filled.sum() * field.cell**3 == pytest.approx(volumes.sum(), rel=1e-4)
    expected = volumes @ field.sample(values)
    assert (filled * values).sum() * field.cell**3 == pytest.approx(expected, rel=1e-4)


def test_gradient_is_that_of_numpy(field, values):
    expected = np.stack(np.gradient(values), axis=-1).reshape(-1, 3)
    np.testing.assert_allclose(field.slopes(values), expected, atol=1e-6)


def test_lengths_of_liquid_end_at_dry_cells(field, values):
    filled = 3 * values
    lengths = field.lengths(filled).reshape(*field.size, 3)
    for axis in range(3):
        columns = np.moveaxis(np.minimum(filled, 1), axis, -1).reshape(-1, field.size[axis])
        measured = np.moveaxis(lengths[..., axis], axis, -1).reshape(columns.shape)
        for column, length in zip(columns[::5], measured[::5], strict=True):
            runs, count = scipy.ndimage.label(column > discs.WET)
            sums = scipy.ndimage.sum(column, runs, range(1, count + 1))
            expected = np.array([discs.LEAST_LENGTH, *sums])[runs]
            np.testing.assert_allclose(length, np.maximum(expected, discs.LEAST_LENGTH), rtol=1e-5)
