"""Compilation of kernels: contracted, forward only, in addition to the user's flags."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import warp as wp

from phy124.kernels import build
from phy124.kernels.arguments import types
from phy124.kernels.build import CONTRACT, build_once, kernel


@pytest.fixture(scope="module")
def residue():
    @kernel("phy124_test_residue")
    def residue(a: wp.array(dtype=float), b: wp.array(dtype=float), out: wp.array(dtype=float)):
        out[wp.tid()] = a[wp.tid()] * b[wp.tid()] - 1.0

    return residue


def test_products_and_sums_are_rounded_once(residue):
    """(1 + e) (1 - e) - 1 = -e^2, which is lost if the product is rounded on its own."""
    e = np.float32(2.0**-13)
    a, b = (wp.array([1 + e * sign], dtype=float, device="cpu") for sign in (1, -1))
    out = wp.zeros(1, dtype=float, device="cpu")
    wp.launch(residue, 1, inputs=[a, b], outputs=[out], device="cpu")
    assert out.numpy()[0] == -(2.0**-26)


def test_user_options_of_the_compiler_are_kept(monkeypatch):
    monkeypatch.setattr(wp.config, "cpu_compiler_flags", "-fno-vectorize")
    kernel("phy124_test_flags")
    options = wp.get_module_options("phy124_test_flags")
    assert options["cpu_compiler_flags"] == f"-fno-vectorize {CONTRACT}"


def test_there_is_no_backward_pass(residue):
    assert residue.options["enable_backward"] is False


def test_named_arguments_have_their_declared_types():
    """In the order of the signature, whichever of them are annotated."""

    @kernel("phy124_test_arguments", wp.float64)
    def push(chosen, slot, rate: wp.float64, v_out):
        p = chosen[wp.tid()]
        v_out[p] = rate * wp.float64(slot) * v_out[p]

    assert [a.label for a in push.adj.args] == ["chosen", "slot", "rate", "v_out"]
    assert push.adj.args[3].type.dtype is types(wp.float64).vec3
    v = wp.array(np.ones((2, 3)), dtype=wp.vec3d, device="cpu")
    chosen = wp.array([1], dtype=int, device="cpu")
    wp.launch(push, 1, inputs=[chosen, 2, 3.0], outputs=[v], device="cpu")
    np.testing.assert_array_equal(v.numpy(), [[1, 1, 1], [6, 6, 6]])


def test_undeclared_arguments_are_refused():
    with pytest.raises(KeyError, match="speed_limit"):

        @kernel("phy124_test_arguments", wp.float32)
        def push(speed_limit):
            pass


def test_no_two_threads_build_variants_at_once():
    calls = []

    @build_once
    def make(real):
        calls.append(real)
        with ThreadPoolExecutor(1) as other:
            return other.submit(build.BUILDING.acquire, blocking=False).result()

    assert make(wp.float32) is make(wp.float32) is False
    assert calls == [wp.float32]
