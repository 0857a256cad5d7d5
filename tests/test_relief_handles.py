"""Slopes of handles of vessels."""

import numpy as np
import pytest

from phy124.generators.relief.handles import STRIP, _tilt


def bow(slope: float, parts: tuple[tuple[int, int], ...]):
    """Return positions of the two arms of a handle, in some ranges of horizontal positions."""
    out = np.concatenate([np.arange(*part, dtype=float) for part in parts])
    arms = [100 + slope * out + side for side in (-20.0, 20.0)]
    return np.concatenate([out, out]), np.concatenate(arms)


@pytest.mark.parametrize("slope", [-0.2, 0.0, 0.15])
def test_slope_of_a_handle_is_that_of_its_middle(slope):
    assert _tilt(*bow(slope, ((50, 100),))) == pytest.approx(slope, abs=1e-9)


def test_strips_without_pixels_do_not_change_the_slope():
    wide = int(STRIP)
    parts = (50, 50 + wide), (50 + 4 * wide, 50 + 8 * wide)
    assert _tilt(*bow(0.1, parts)) == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize("pixels", [1, 2])
def test_handle_of_few_pixels_has_no_slope(pixels):
    out = np.arange(pixels, dtype=float)
    assert _tilt(out, np.full(pixels, 3.0)) == 0.0
    assert _tilt(out, 3.0 + out) == 0.0
