"""Region: boxes and the cylinders that fit them."""

import numpy as np
import pytest
from pydantic import ValidationError

from phy124.schema.region import Region


def test_a_cylinder_is_as_wide_as_the_shorter_side_of_its_box(rng):
    x = rng.uniform(-2, 2, (1000, 3))
    region = Region(lower=(-1, -0.5, -1), upper=(1, 0.5, 1), cylinder="z")
    wanted = (np.hypot(x[:, 0], x[:, 1]) <= 0.5) & (np.abs(x[:, 2]) <= 1)
    assert np.array_equal(region.contains(x), wanted)
    assert 0 < wanted.sum() < Region(lower=(-1, -0.5, -1), upper=(1, 0.5, 1)).contains(x).sum()
    across = Region(lower=(-1e9, 0.1, -1), upper=(1e9, 1.1, 1), cylinder="x")
    assert np.array_equal(across.contains(x), np.hypot(x[:, 1] - 0.6, x[:, 2]) <= 0.5)


def test_a_cylinder_has_a_width():
    for upper in ((1e9, 1e9, 1e9), (1, 1e9, 1)):
        with pytest.raises(ValidationError, match="the extent on the two other axes must be given"):
            Region(lower=(0, 0, 0), upper=upper, cylinder="z")
