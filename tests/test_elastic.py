"""The logarithm of the volume ratio as the neo-Hookean law has it, over its whole range."""

from functools import cache

import numpy as np
import pytest
import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.elastic import log_volume

NEAR = np.concatenate([np.linspace(0.79, 1.21, 20_001), [0.8, 1.2]])
FAR = np.concatenate([np.geomspace(1e-4, 1e4, 2001), np.linspace(-5, 1e-4, 101)])


@cache
def make_logs(real):
    @kernel(f"phy124_test_log_volume_{real.__name__}")
    def logs(J: wp.array(dtype=real), out: wp.array(dtype=real)):
        out[wp.tid()] = log_volume(J[wp.tid()])

    return logs


def logs(values: np.ndarray, real) -> tuple[np.ndarray, np.ndarray]:
    """The volume ratios as they are in that precision, and their logarithms."""
    J = wp.array(values, dtype=real, device="cpu")
    out = wp.empty_like(J)
    wp.launch(make_logs(real), len(values), [J], [out], device="cpu")
    return J.numpy().astype(float), out.numpy().astype(float)


@pytest.mark.parametrize(("real", "error"), [(wp.float32, 3e-7), (wp.float64, 1e-15)])
def test_near_one_it_is_the_logarithm_to_rounding(real, error):
    J, found = logs(NEAR, real)
    exact = np.log(J)
    assert (np.abs(found - exact) <= error * np.abs(exact)).all()


@pytest.mark.parametrize(("real", "error"), [(wp.float32, 1e-6), (wp.float64, 1e-14)])
def test_far_away_it_goes_on_as_a_line(real, error):
    J, found = logs(FAR, real)
    line = np.log(1e-4) + (J - 1e-4) / 1e-4
    exact = np.where(J > 1e-4, np.log(np.maximum(J, 1e-4)), line)
    assert (np.abs(found - exact) <= error * np.abs(exact)).all()


@pytest.mark.parametrize("real", [wp.float32, wp.float64])
def test_at_rest_it_is_nothing(real):
    assert logs(np.ones(1), real)[1][0] == 0
