"""Evaluates a law for single states, to examine it by itself."""

from functools import cache
from typing import Any

import warp as wp

from phy124.kernels.build import kernel
from phy124.kernels.transfer import Law, types


@cache
def make_probe(law: Law, real: Any):
    """Kernel: stress, modulus, energy and return mapping of a law for single states."""
    t = types(real)
    theta_type = wp.types.vector(law.width, real)
    stress, modulus, energy, project = law.stress, law.modulus, law.energy, law.project
    plastic = project is not None

    @kernel(f"phy124_probe_{law.name}_{real.__name__}")
    def probe(
        # model
        theta: wp.array(dtype=theta_type), dt: real,
        # state in
        F: wp.array(dtype=t.mat33), C: wp.array(dtype=t.mat33), history: wp.array(dtype=t.vec2),
        # out
        stress_out: wp.array(dtype=t.mat33), modulus_out: wp.array(dtype=real),
        energy_out: wp.array(dtype=real), projected_out: wp.array(dtype=t.mat33),
        history_out: wp.array(dtype=t.vec2),
    ):  # fmt: skip
        p = wp.tid()
        stress_out[p] = stress(F[p], C[p], history[p], theta[0])
        modulus_out[p] = modulus(F[p], history[p], theta[0])
        energy_out[p] = energy(F[p], history[p], theta[0])
        projected_out[p] = F[p]
        history_out[p] = history[p]
        if wp.static(plastic):
            elastic, after = project(F[p], history[p], theta[0], dt)
            projected_out[p] = elastic
            history_out[p] = after

    return probe
