"""Kernels whose threads are known to race, or known not to race."""

import numpy as np
import warp as wp

THREADS = 64
NAMES = (
    "write_write",
    "read_write",
    "write_atomic",
    "read_atomic",
    "mass_and_momentum",
    "mass",
    "counted",
    "separate",
)
VECTORS = {"mass_and_momentum": wp.vec4, "mass": wp.vec4, "separate": wp.vec3}
"""Type of the elements of kernels whose elements are not numbers."""


@wp.kernel(module="phy124_control", enable_backward=False)
def write_write(values_out: wp.array(dtype=float)):
    """Neighbouring threads write the same number."""
    i = wp.tid()
    values_out[i / 2] = float(i)


@wp.kernel(module="phy124_control", enable_backward=False)
def read_write(values_out: wp.array(dtype=float)):
    """Each thread reads the number that its neighbour writes."""
    i = wp.tid()
    values_out[i] = values_out[(i + 1) % 64] + 1.0


@wp.kernel(module="phy124_control", enable_backward=False)
def write_atomic(values_out: wp.array(dtype=float)):
    """One thread writes the number to which all threads add."""
    i = wp.tid()
    if i == 0:
        values_out[0] = 1.0
    wp.atomic_add(values_out, 0, 1.0)


@wp.kernel(module="phy124_control", enable_backward=False)
def read_atomic(values_out: wp.array(dtype=float)):
    """Each thread reads a maximum before it raises the maximum, which is harmless but reported."""
    value = float(wp.tid())
    if value > values_out[0]:
        wp.atomic_max(values_out, 0, value)


@wp.kernel(module="phy124_control", enable_backward=False)
def mass_and_momentum(nodes_out: wp.array(dtype=wp.vec4)):
    """Each thread reads a component of a vector to which other threads add."""
    i = wp.tid()
    if nodes_out[0][1] == 0.0:
        wp.atomic_add(nodes_out, 0, wp.vec4(0.0, float(i + 1), 0.0, 0.0))


@wp.kernel(module="phy124_control", enable_backward=False)
def mass(nodes_out: wp.array(dtype=wp.vec4)):
    """Each thread reads one component of a vector while others add to another component: no
    race."""
    i = wp.tid()
    if nodes_out[0][3] == 0.0:
        wp.atomic_add(nodes_out, 0, wp.vec4(0.0, float(i + 1), 0.0, 0.0))


@wp.kernel(module="phy124_control", enable_backward=False)
def counted(values_out: wp.array(dtype=float)):
    """All threads add to one number: no race."""
    wp.atomic_add(values_out, 0, 1.0)


@wp.kernel(module="phy124_control", enable_backward=False)
def separate(values_out: wp.array(dtype=wp.vec3)):
    """Each thread reads and writes a separate element: no race."""
    i = wp.tid()
    values_out[i] = values_out[i] + wp.vec3(1.0, 2.0, 3.0)


def run(name: str) -> np.ndarray:
    """Run one of these kernels; return its result."""
    kernel = globals()[name]
    values = wp.zeros(THREADS, dtype=VECTORS.get(name, float), device="cpu")
    wp.launch(kernel, THREADS, inputs=[values], device="cpu")
    return values.numpy()
