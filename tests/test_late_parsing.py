"""Device functions of phy124 are parsed when a kernel needs them, all others at once."""

import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import warp as wp

from phy124.kernels.native import _define

TWICE = "@wp.func\ndef twice(x: float) -> float:\n    return 2.0 * x\n"
BUILD = "@wp.kernel(enable_backward=False, module='late_trial')\n"
FILL = BUILD + "def fill(x_out: wp.array(dtype=float)):\n    x_out[wp.tid()] = twice(4.0)\n"


def declare(module: str, source: str = TWICE, name: str = "twice", **known: Any) -> Any:
    """Return the function that a source text declares in a module."""
    like: Any = SimpleNamespace(__module__=module, __annotations__={})
    return _define(source, name, like, **known)


@pytest.mark.parametrize(("module", "late"), [("phy124.kernels.trial", True), ("trial", False)])
def test_only_functions_of_phy124_are_parsed_late(module: str, late: bool) -> None:
    adj = declare(module).adj
    assert ("tree" in vars(adj)) is not late
    assert adj.fun_name == "twice"
    assert "tree" in vars(adj)
    with pytest.raises(AttributeError):
        _ = adj.colour


def test_a_kernel_calls_a_function_that_is_parsed_late() -> None:
    module = "phy124.kernels.trial"
    twice = declare(module)
    fill = declare(module, FILL, "fill", twice=twice)
    values = wp.zeros(2, dtype=float, device="cpu")
    wp.launch(fill, dim=2, outputs=[values], device="cpu")
    np.testing.assert_array_equal(values.numpy(), 8.0)


def test_a_function_with_a_constant_expression_is_parsed_at_once() -> None:
    source = TWICE.replace("2.0 * x", "wp.static(1.0 + 1.0) * x")
    adj = declare("phy124.kernels.trial", source).adj
    assert "tree" in vars(adj)
    assert adj.resolved_static_expressions


def test_threads_parse_a_function_once() -> None:
    adj = declare("phy124.kernels.trial").adj
    started, trees = threading.Barrier(4), []

    def read() -> None:
        started.wait()
        trees.append(adj.tree)

    threads = [threading.Thread(target=read) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(trees) == 4
    assert len({id(tree) for tree in trees}) == 1
