"""phy124.kernels.launches: recorded launches are repeated with their present arguments."""

import numpy as np
import pytest
import warp as wp

from phy124.kernels.arguments import Ints
from phy124.kernels.build import kernel
from phy124.kernels.launches import Repeated, put, record


@kernel("phy124_test_launches")
def add(step: int, values_out: Ints):
    i = wp.tid()
    values_out[i] = values_out[i] + step


@pytest.fixture(params=[wp.config.version, "999.0.0"], ids=["known Warp", "another Warp"])
def launch(request, monkeypatch):
    monkeypatch.setattr(wp.config, "version", request.param)
    values = wp.zeros(4, dtype=int, device="cpu")
    launch = record(add, 3, [1], [values], "cpu")
    assert launch is not None
    assert isinstance(launch, Repeated) == (request.param != "999.0.0")
    return launch, values


def test_launches_repeat_their_arguments(launch):
    repeated, values = launch
    repeated.launch()
    repeated.launch()
    assert values.numpy().tolist() == [2, 2, 2, 0]


def test_launches_use_changed_arguments(launch):
    repeated, values = launch
    other = wp.zeros(4, dtype=int, device="cpu")
    repeated.set_param_at_index(0, 5)
    repeated.set_dim(4)
    repeated.launch()
    repeated.set_param_at_index(1, other)
    repeated.set_dim(1)
    repeated.launch()
    assert values.numpy().tolist() == [5, 5, 5, 5] and other.numpy().tolist() == [5, 0, 0, 0]


def test_launches_without_threads_are_not_recorded():
    assert record(add, 0, [1], [wp.zeros(0, dtype=int, device="cpu")], "cpu") is None


def test_put_copies_the_first_values():
    array = wp.zeros(4, dtype=wp.vec3, device="cpu")
    put(array, np.array([[1, 2, 3], [4, 5, 6]]))
    assert array.numpy().tolist() == [[1, 2, 3], [4, 5, 6], [0, 0, 0], [0, 0, 0]]
