"""Functions of symmetric matrices: against NumPy's decompositions, at the accuracy they promise."""

from functools import cache

import numpy as np
import pytest
import warp as wp
from numpy.typing import NDArray

from phy124.kernels import elastic, hencky, spectral
from phy124.kernels.arguments import types
from phy124.kernels.build import kernel
from reference.material_point import REALS
from reference.oracle import from_axes, signed_svd

FUNCTIONS = {
    "exponential": spectral.exponential,
    "log_strain": hencky.log_strain,
    "stretch": elastic.stretch,
    "gram": spectral.gram,
    "deviator": spectral.deviator,
}


@cache
def make_map(name: str, precision: str):
    function, mat33 = FUNCTIONS[name], types(REALS[precision]).mat33

    @kernel(f"phy124_test_{name}_{precision}")
    def apply(a: wp.array(dtype=mat33), out: wp.array(dtype=mat33)):
        out[wp.tid()] = function(a[wp.tid()])

    return apply


def mapped(name: str, a: NDArray, precision: str) -> NDArray:
    """A device function of N matrices."""
    mat33 = types(REALS[precision]).mat33
    out = wp.zeros(len(a), dtype=mat33)
    inputs = [wp.array(a.astype(precision), dtype=mat33)]
    wp.launch(make_map(name, precision), len(a), inputs=inputs, outputs=[out])
    return out.numpy().astype(np.float64)


def rotations(rng: np.random.Generator, count: int) -> NDArray:
    q, _ = np.linalg.qr(rng.standard_normal((count, 3, 3)))
    return q * np.sign(np.linalg.det(q))[:, None, None]


def with_stretches(rng: np.random.Generator, sigma: NDArray) -> NDArray:
    """F = U diag(sigma) V^T with random rotations."""
    return rotations(rng, len(sigma)) * sigma[:, None] @ rotations(rng, len(sigma))


STRETCHES = {
    "at rest": lambda rng: np.exp(
        10 ** rng.uniform(-12, -3, (500, 1)) * rng.uniform(-1, 1, (500, 3))
    ),
    "near rest": lambda rng: np.exp(0.01 * rng.standard_normal((500, 3))),
    "series": lambda rng: rng.uniform(0.8, 1.25, (500, 3)),
    "its edge": lambda rng: rng.uniform(0.7, 1.42, (500, 3)),
    "beyond": lambda rng: rng.uniform(0.2, 4.0, (500, 3)),
    "two alike": lambda rng: rng.uniform(0.2, 4.0, (500, 2))[:, [0, 0, 1]],
    "nearly alike": lambda rng: 2.0 + rng.uniform(-1e-7, 1e-7, (500, 3)),
    "all alike": lambda rng: np.repeat(rng.uniform(0.2, 4.0, (500, 1)), 3, axis=1),
    "thin": lambda rng: rng.uniform(0.5, 2.0, (500, 3)) * [1, 1, 1e-3],
}


@pytest.mark.parametrize("state", STRETCHES)
@pytest.mark.parametrize(("precision", "close"), [("float32", 6e-7), ("float64", 3e-8)])
def test_log_and_stretch_are_those_of_the_singular_values(state, precision, close, rng):
    F = with_stretches(rng, STRETCHES[state](rng)).astype(precision).astype(np.float64)
    U, s, _ = signed_svd(F)
    log = mapped("log_strain", F, precision)
    # A thin axis is known to the rounding of F itself: its log to that over the stretch.
    known = close * np.maximum(1, s[:, 0] / np.abs(s[:, 2]))[:, None, None]
    assert np.all(np.abs(log - from_axes(U, np.log(np.abs(s)))) < 2 * known)
    V = mapped("stretch", F, precision)
    assert np.all(np.abs(V - from_axes(U, s)) < 2 * close * s[:, :1, None])


def test_stretch_of_the_inverted_has_one_negative_value(rng):
    F = with_stretches(rng, rng.uniform(0.3, 3.0, (200, 3)) * [1, 1, -1])
    U, s, _ = signed_svd(F)
    V = mapped("stretch", F, "float64")
    np.testing.assert_allclose(V, from_axes(U, s), atol=1e-7)
    assert np.all(np.linalg.det(V) < 0)


@pytest.mark.parametrize("size", [1e-9, 1e-6, 1e-5, 1e-4, 1e-3, 0.1, 0.2, 1.0, 5.0])
@pytest.mark.parametrize(("precision", "close"), [("float32", 3e-7), ("float64", 1e-13)])
def test_exponential(size, precision, close, rng):
    a = rng.standard_normal((300, 3, 3)) * size / 3
    a = ((a + np.swapaxes(a, 1, 2)) / 2).astype(precision).astype(np.float64)
    values, axes = np.linalg.eigh(a)
    exact = from_axes(axes, np.exp(values))
    # Each doubling doubles the relative error.
    doubled = max(1.0, 16 * size)
    scale = np.abs(exact).max((1, 2))[:, None, None]
    error = np.abs(mapped("exponential", a, precision) - exact) / scale
    assert error.max() < close * doubled


def test_simple_functions(rng):
    a = rng.standard_normal((50, 3, 3))
    np.testing.assert_allclose(
        mapped("gram", a, "float64"), a @ np.swapaxes(a, 1, 2), rtol=0, atol=1e-14
    )
    a = a + np.swapaxes(a, 1, 2)
    mean = np.trace(a, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    np.testing.assert_allclose(mapped("deviator", a, "float64"), a - mean, rtol=0, atol=1e-14)


@kernel("phy124_test_eigenvalues")
def eigenvalues(a: wp.array(dtype=wp.mat33d), out: wp.array(dtype=wp.vec3d)):
    out[wp.tid()] = spectral.eigenvalues(a[wp.tid()])


@kernel("phy124_test_eigenvalues_float32")
def eigenvalues_float32(a: wp.array(dtype=wp.mat33), out: wp.array(dtype=wp.vec3)):
    out[wp.tid()] = spectral.eigenvalues(a[wp.tid()])


@pytest.mark.parametrize("apart", [0.0, 1e-7, 1e-5, 1e-3, 1.0])
def test_close_eigenvalues_are_exact_to_rounding_in_float32(apart, rng):
    """The arc cosine of Smith's formula alone would lose half of the digits."""
    U, low = rotations(rng, 500), rng.uniform(-1, 1, (500, 1))
    sigma = np.hstack([low, low + apart, rng.uniform(-1, 1, (500, 1))])
    a = from_axes(U, sigma).astype(np.float32)
    out = wp.zeros(500, dtype=wp.vec3)
    wp.launch(eigenvalues_float32, 500, [wp.array(a, dtype=wp.mat33)], [out])
    exact = np.linalg.eigvalsh(a.astype(np.float64))[:, ::-1]
    assert np.abs(out.numpy() - exact).max() < 2e-6


@pytest.mark.parametrize("scale", [1e-20, 1.0, 1e20])
def test_eigenvalues_at_every_scale(scale, rng):
    a = rng.standard_normal((500, 3, 3))
    a = scale * (a @ np.swapaxes(a, 1, 2))
    a[0], a[1], a[2] = scale * np.eye(3), np.zeros((3, 3)), scale * np.diag([1.0, 1.0, 0.0])
    out = wp.zeros(500, dtype=wp.vec3d)
    wp.launch(eigenvalues, 500, inputs=[wp.array(a, dtype=wp.mat33d)], outputs=[out])
    exact = np.linalg.eigvalsh(a)[:, ::-1]
    error = np.abs(out.numpy() - exact) / np.maximum(exact[:, :1], 1e-300)
    assert error.max() < 3e-15
