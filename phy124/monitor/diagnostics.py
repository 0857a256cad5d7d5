"""Diagnostics of a state: momentum, energy, volume ratios, and unsound particles.

The functions that describe a particle or a substep are called only once something is wrong.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels import diagnostics as at
from phy124.kernels.diagnostics import make_energies, make_totals
from phy124.kernels.reduction import shared_out
from phy124.mpm import Clock, Model, Solver, State
from phy124.mpm.state import part_of

NOBODY = 2**31 - 1
"""An index above those of all particles."""
VECTORS = ("momentum", "angular", "middle")
"""Fields that are vectors."""
LIMITS = {
    "elastic": "the stiffness of the material",
    "speed": "its speed",
    "gradient": "its rate of strain",
    "viscous": "its viscosity or damping",
    "user": "time.substep",
}
"""Limit of the substep -> words."""


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """Sums and extremes over the particles of a state."""

    momentum: NDArray[np.float64]
    """Momentum [3], kg m/s."""
    angular: NDArray[np.float64]
    """Angular momentum about the origin [3], kg m^2/s."""
    kinetic: float
    """Kinetic energy [J] after the last kick, half a substep before the time of the positions."""
    elastic: float
    """Elastic energy [J]."""
    lag: float
    """Change of the kinetic energy [J] between its own time and that of the elastic energy."""
    middle: NDArray[np.float64]
    """Mass times position [3], kg m."""
    min_J: float
    """Smallest volume ratio."""
    max_J: float
    """Largest volume ratio."""
    broken: int
    """Number of particles that are not finite."""
    inverted: int
    """Number of particles turned inside out."""
    first_broken: int
    """The lowest index of a broken particle."""
    first_inverted: int
    """The lowest index of an inverted particle."""

    @classmethod
    def of(cls, model: Model, state: State, clock: Clock) -> Diagnostics:
        """Return the diagnostics of a state, summed in float64."""
        device = model.device
        sums = wp.zeros(at.SUMS, dtype=wp.float64, device=device)
        spread = wp.array([-math.inf, -math.inf], dtype=wp.float64, device=device)
        counts = wp.zeros(2, dtype=int, device=device)
        first = wp.array([NOBODY, NOBODY], dtype=int, device=device)
        for group in model.groups:
            part = group.particles
            threads, *fraction = shared_out(len(group), device)
            wp.launch(
                make_totals(group.law, model.real),
                threads,
                inputs=[
                    *fraction, group.theta, model.mass[part], model.volume[part], model.dx,
                    group.start, state.x[part], state.v[part], state.C[part], state.F[part],
                    part_of(state.history, part),
                ],
                outputs=[sums, spread, counts, first],
                device=device,
            )  # fmt: skip
        total: NDArray[Any] = sums.numpy()
        ends, bad, index = (np.asarray(array.numpy()) for array in (spread, counts, first))
        return cls(
            momentum=total[at.MOMENTUM : at.MOMENTUM + 3],
            angular=total[at.ANGULAR : at.ANGULAR + 3],
            kinetic=float(total[at.KINETIC]),
            elastic=float(total[at.ELASTIC]),
            lag=-clock.last_dt / 2 * float(total[at.POWER]),
            middle=total[at.MIDDLE : at.MIDDLE + 3],
            min_J=-float(ends[at.LEAST_J]),
            max_J=float(ends[at.LARGEST_J]),
            broken=int(bad[at.BROKEN]),
            inverted=int(bad[at.INVERTED]),
            first_broken=int(index[at.BROKEN]),
            first_inverted=int(index[at.INVERTED]),
        )

    @property
    def energy(self) -> float:
        """Return the kinetic plus elastic energy at one instant [J].

        m/2 v(t - dt/2) . v(t + dt/2) + psi(t), which leapfrog conserves exactly in a vibration.
        """
        return self.kinetic + self.elastic + self.lag

    def snapshot(self) -> dict[str, Any]:
        """Return the diagnostics as plain data."""
        return {**asdict(self), **{name: getattr(self, name).tolist() for name in VECTORS}}

    @classmethod
    def from_snapshot(cls, data: dict[str, Any]) -> Diagnostics:
        """Return the diagnostics from plain data."""
        return cls(**{**data, **{name: np.array(data[name]) for name in VECTORS}})


def diagnose(solver: Solver) -> Diagnostics:
    """Return the diagnostics of a solver's state."""
    return Diagnostics.of(solver.model, solver.state, solver.clock)


def energies(model: Model, state: State) -> NDArray[np.float64]:
    """Return kinetic plus elastic energy of each particle [P], J; infinity where not finite."""
    energy = wp.zeros(len(model), dtype=wp.float64, device=model.device)
    for group in model.groups:
        part = group.particles
        inputs = [group.theta, model.mass[part], model.volume[part], model.dx]
        inputs += [state.v[part], state.C[part], state.F[part], part_of(state.history, part)]
        kernel = make_energies(group.law, model.real)
        wp.launch(kernel, len(group), inputs=inputs, outputs=[energy[part]], device=model.device)
    return _finite_or_infinity(energy.numpy())


def speeds(state: State) -> NDArray[np.float64]:
    """Return the speed of each particle [P], m/s; infinity where not finite."""
    velocities: NDArray[Any] = state.v.numpy()
    return _finite_or_infinity(np.linalg.norm(velocities.astype(np.float64), axis=1))


def _finite_or_infinity(values: NDArray) -> NDArray[np.float64]:
    return np.where(np.isfinite(values), values, np.inf)


def broken_particles(state: State) -> NDArray[np.intp]:
    """Return the indices of particles whose state is not finite, in order."""
    arrays = [np.asarray(array.numpy()) for array in state.arrays().values() if len(array)]
    flat = [array.reshape(len(state.x), -1) for array in arrays]
    return np.flatnonzero(~np.isfinite(np.concatenate(flat, axis=1)).all(axis=1))


def law_of(model: Model, index: int) -> str:
    """Return the name of the law of a particle."""
    return next(g.law.name for g in model.groups if g.start <= index < g.stop)


def describe_particle(model: Model, state: State, index: int) -> str:
    """Return a particle's number, law, position and speed as a phrase."""
    rest, now = _position(model.rest[index]), np.asarray(state.x.numpy())[index]
    words = f"number {index} of law {law_of(model, index)}, at {rest} m at rest"
    speed = speeds(state)[index]
    if np.isfinite(now).all() and np.isfinite(speed):
        words += f" and now at {_position(now)} m with {speed:.3g} m/s"
    return words


def describe_substep(model: Model, state: State, clock: Clock) -> str:
    """Return the length of substeps now, its cause, and the fastest particle as a phrase."""
    limit = clock.stable()
    fastest = describe_particle(model, state, int(speeds(state).argmax()))
    return (
        f"a substep is {limit.dt:.1e} s, limited by {LIMITS[limit.limiter]}; fastest is {fastest}"
    )


def _position(x: NDArray[Any]) -> str:
    return f"({', '.join(f'{c:.3g}' for c in x)})"
