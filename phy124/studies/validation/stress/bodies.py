"""Builds the bodies of the stress tests, and measures their state."""

import math
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.materials import Material, NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.mpm import Solver
from phy124.studies.validation.bodies import host, make_solver
from phy124.studies.validation.stress.case import Check, Setting, at_most, equal, lower

Array = NDArray[np.float64]
REORDERED = {"float32": 1e-5, "float64": 1e-12}
"""Maximum relative difference due to another order of summation in a short run."""
DX = 0.125
"""Grid spacing [m]; a power of two."""
JELLY = NeoHookean(E=1e4, nu=0.3)


def body(
    x: Array, setting: Setting, material: Material = JELLY, *, size: float = 0.375, **options: Any
) -> Solver:
    """Create a solver for particles that share the volume of a cube equally.

    Args:
        x: Positions [P,3], m.
        setting: Device and precision.
        material: Material of all particles.
        size: Edge of the cube [m].
        **options: Options of `make_solver`.
    """
    volume = options.pop("volume", size**3 / len(x))
    return make_solver(x, volume, [material], **{"dx": DX, **setting.options, **options})


def vibrating(x: Array, strain_rate: float) -> dict[str, Any]:
    """Return velocities v [P,3] and their gradients C [P,3,3] for an extension along x.

    The extension preserves volume. `strain_rate` is in 1/s.
    """
    C = strain_rate * np.diag([1.0, -0.5, -0.5])
    return {"v": (x - x.mean(axis=0)) @ C.T, "C": np.broadcast_to(C, (len(x), 3, 3)).copy()}


def finite(solver: Solver) -> bool:
    """Return whether all values of the solver's state are finite."""
    return all(bool(np.isfinite(a.numpy()).all()) for a in solver.state.arrays().values())


def volume_ratios(solver: Solver) -> Array:
    """Return det F of each particle [P], in double precision."""
    return np.linalg.det(host(solver.state.F))


def deform(solver: Solver, F: Array) -> None:
    """Set all deformation gradients to F, [P,3,3] or [3,3]."""
    assign(solver, "F", np.broadcast_to(F, (len(solver.model.rest), 3, 3)))


def assign(solver: Solver, name: str, values: Array) -> None:
    """Overwrite an array of the solver's state."""
    array, real = getattr(solver.state, name), solver.model.real
    scalars = values.astype(np.float32 if real is wp.float32 else np.float64)
    array.assign(wp.array(scalars, dtype=array.dtype, device="cpu"))


def stable_dt(solver: Solver) -> float:
    """Return the limit on the substep of an isolated particle at rest, dx / sqrt(A / rho0) [s]."""
    return solver.model.dx / solver.model.materials[0].wave_speed()


def steps(solver: Solver, count: int, dt: float) -> None:
    """Take `count` substeps of length `dt` [s].

    The first substep advances velocities by half a substep (leapfrog).
    """
    for k in range(count):
        solver.step(dt / 2 if k == 0 and solver.clock.last_dt == 0 else dt, dt)
        solver.clock.last_dt = dt


def relative(value: Array, reference: Array) -> float:
    """Return the largest absolute difference divided by the reference's largest absolute value."""
    return float(np.abs(value - reference).max() / max(np.abs(reference).max(), math.ulp(0.0)))


def alike(what: str, value: Array, reference: Array, setting: Setting) -> Check:
    """Check that two results are equal: bitwise on a CPU, up to rounding on a GPU.

    The order of summation varies on a GPU.

    Args:
        what: Name of the quantity.
        value: Measured values.
        reference: Expected values.
        setting: Device and precision.
    """
    if setting.device == "cpu":
        return equal(f"bitwise equal {what}", np.array_equal(value, reference))
    difference = relative(value, reference)
    return at_most(f"{what}: difference / size", difference, REORDERED[setting.precision])


class Meter:
    """Measures the energy and the momenta of a run in chosen substeps.

    Positions are half a substep ahead of velocities. The kinetic energy is therefore the mean of
    the values half a substep before and after.
    """

    def __init__(self, solver: Solver) -> None:
        self.solver = solver
        start = diagnose(solver)
        self.first = self.last = start.energy
        self.start, self.end = start, start
        self.max_energy, self.min_J = 1.0, start.min_J
        mass = host(solver.model.mass)[:, None]
        self.moved = float((mass * np.abs(host(solver.state.v))).sum())

    def read(self, dt: float) -> float:
        """Take a substep of length `dt` [s]; return energy / initial energy at its start."""
        before = diagnose(self.solver)
        steps(self.solver, 1, dt)
        after = diagnose(self.solver)
        self.last = before.elastic + (before.kinetic + after.kinetic) / 2
        fraction = self.last / self.first if math.isfinite(self.last) else math.inf
        self.max_energy = max(self.max_energy, fraction)
        self.min_J = lower(self.min_J, after.min_J)
        self.end = after
        return fraction

    @property
    def momentum_drift(self) -> float:
        """Change of the total momentum, relative to the sum of the initial |momenta|."""
        return float(np.linalg.norm(self.end.momentum - self.start.momentum) / self.moved)

    @property
    def angular_drift(self) -> float:
        """Relative change of the total angular momentum."""
        change = np.linalg.norm(self.end.angular - self.start.angular)
        return float(change / np.linalg.norm(self.start.angular))
