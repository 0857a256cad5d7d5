"""Drives a law over many states at once, without particles or a grid."""

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.transfer import Law, types
from phy124.materials import Material

REALS = {"float32": wp.float32, "float64": wp.float64}


class Point(NamedTuple):
    """What a law says about N states."""

    stress: NDArray
    """tau [N,3,3], Pa."""
    modulus: NDArray
    """A [N], Pa."""
    energy: NDArray
    """psi [N], J/m^3."""
    F: NDArray
    """F after the return mapping [N,3,3]."""
    history: NDArray
    """History after the return mapping [N,2]."""


@cache
def make_probe(law: Law, real: Any):
    """Kernel: everything a law says about one state."""
    t = types(real)
    theta_type = wp.types.vector(law.width, real)
    stress, modulus, energy = law.stress, law.modulus, law.energy
    plastic, project = law.project is not None, law.project

    @wp.kernel(module=f"phy124_probe_{law.name}_{real.__name__}", enable_backward=False)
    def probe(
        theta: wp.array(dtype=theta_type), F: wp.array(dtype=t.mat33), C: wp.array(dtype=t.mat33),
        h: wp.array(dtype=t.vec2), dt: real,
        stress_out: wp.array(dtype=t.mat33), modulus_out: wp.array(dtype=real),
        energy_out: wp.array(dtype=real), F_out: wp.array(dtype=t.mat33),
        h_out: wp.array(dtype=t.vec2),
    ):  # fmt: skip
        p = wp.tid()
        stress_out[p] = stress(F[p], C[p], h[p], theta[0])
        modulus_out[p] = modulus(F[p], h[p], theta[0])
        energy_out[p] = energy(F[p], h[p], theta[0])
        if wp.static(plastic):
            elastic, after = project(F[p], h[p], theta[0], dt)
            F_out[p] = elastic
            h_out[p] = after

    return probe


def evaluate(
    material: Material,
    F: NDArray,
    *,
    C: NDArray | None = None,
    h: NDArray | None = None,
    dt: float = 1e-3,
    precision: str = "float64",
) -> Point:
    """What the device law of a material says about the states F [N,3,3]."""
    real, law = REALS[precision], material.device_law
    t, scalar, n = types(real), np.dtype(precision), len(F)
    C = np.zeros((n, 3, 3)) if C is None else C
    h = np.tile(material.history(), (n, 1)) if h is None else h

    def array(values: object, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(values, dtype=scalar), dtype=dtype)

    outputs = [wp.zeros(n, dtype=d) for d in (t.mat33, real, real, t.mat33, t.vec2)]
    inputs = [
        array([material.theta()], wp.types.vector(law.width, real)),
        array(F, t.mat33), array(C, t.mat33), array(h, t.vec2), dt,
    ]  # fmt: skip
    wp.launch(make_probe(law, real), n, inputs=inputs, outputs=outputs)
    return Point(*(out.numpy().astype(np.float64) for out in outputs))
