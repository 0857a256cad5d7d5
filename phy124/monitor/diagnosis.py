"""The particle behind a violation: asked only once something is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.diagnostics import make_energies

if TYPE_CHECKING:
    from phy124.mpm import Solver

LIMITS = {
    "elastic": "the stiffness of the material",
    "speed": "its speed",
    "gradient": "its rate of strain",
    "viscous": "its viscosity or damping",
    "user": "time.substep",
}
"""What limits a substep, in words."""


def energies(solver: Solver) -> NDArray[np.float64]:
    """Kinetic and elastic energy of each particle [P], J; infinite where it is not a number."""
    found = wp.zeros(len(solver.rest), dtype=wp.float64, device=solver.device)
    s = solver.state
    for group in solver.groups:
        part = slice(group.start, group.stop)
        history = s.history[part] if len(s.history) else s.history
        model = [group.theta, solver.mass[part], solver.volume[part], solver.dx]
        wp.launch(
            make_energies(group.law, solver.real),
            group.stop - group.start,
            inputs=[*model, s.v[part], s.C[part], s.F[part], history],
            outputs=[found[part]],
            device=solver.device,
        )
    return _known(found.numpy())


def speeds(solver: Solver) -> NDArray[np.float64]:
    """Speed of each particle [P], m/s; infinite where it is not a number."""
    velocities: NDArray[Any] = solver.state.v.numpy()
    return _known(np.linalg.norm(velocities.astype(np.float64), axis=1))


def first_broken(solver: Solver) -> int | None:
    """The lowest index of a particle whose state is not finite."""
    state = [np.asarray(array.numpy()) for array in solver.state.arrays().values() if len(array)]
    flat = [array.reshape(len(solver.rest), -1) for array in state]
    found = np.flatnonzero(~np.isfinite(np.concatenate(flat, axis=1)).all(axis=1))
    return int(found[0]) if len(found) else None


def law_of(solver: Solver, index: int) -> str:
    """The name of the law of a particle."""
    return next(g.law.name for g in solver.groups if g.start <= index < g.stop)


def describe(solver: Solver, index: int) -> str:
    """A particle in words: its number, law and place, and how it moves."""
    rest, now = _place(solver.rest[index]), np.asarray(solver.state.x.numpy())[index]
    words = f"number {index} of law {law_of(solver, index)}, at {rest} m at rest"
    speed = speeds(solver)[index]
    if np.isfinite(now).all() and np.isfinite(speed):
        words += f" and now at {_place(now)} m with {speed:.3g} m/s"
    return words


def substep(solver: Solver) -> str:
    """How short a substep is at the moment, why, and the particle that moves fastest."""
    limit = solver.substep()
    fastest = describe(solver, int(speeds(solver).argmax()))
    return (
        f"a substep is {limit.dt:.1e} s, limited by {LIMITS[limit.limiter]}; fastest is {fastest}"
    )


def _place(x: NDArray) -> str:
    return f"({', '.join(f'{c:.3g}' for c in x)})"


def _known(values: NDArray) -> NDArray[np.float64]:
    return np.where(np.isfinite(values), values, np.inf)
