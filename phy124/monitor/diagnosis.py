"""Diagnosis: words for the particle that went wrong; looked for only after something has."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from phy124.monitor.diagnostics import speeds
from phy124.mpm import Clock, Model, State

LIMITS = {
    "elastic": "the stiffness of the material",
    "speed": "its speed",
    "gradient": "its rate of strain",
    "viscous": "its viscosity or damping",
    "user": "time.substep",
}
"""What limits a substep, in words."""


def broken(state: State) -> NDArray[np.intp]:
    """The particles whose state is not finite, in order."""
    arrays = [np.asarray(array.numpy()) for array in state.arrays().values() if len(array)]
    flat = [array.reshape(len(state.x), -1) for array in arrays]
    return np.flatnonzero(~np.isfinite(np.concatenate(flat, axis=1)).all(axis=1))


def first_broken(state: State) -> int | None:
    """The lowest index of a particle whose state is not finite; None if all are."""
    found = broken(state)
    return int(found[0]) if len(found) else None


def law_of(model: Model, index: int) -> str:
    """The name of the law of a particle."""
    return next(g.law.name for g in model.groups if g.start <= index < g.stop)


def particle(model: Model, state: State, index: int) -> str:
    """A particle in words: its number, law, position and speed."""
    rest, now = _place(model.rest[index]), np.asarray(state.x.numpy())[index]
    words = f"number {index} of law {law_of(model, index)}, at {rest} m at rest"
    speed = speeds(state)[index]
    if np.isfinite(now).all() and np.isfinite(speed):
        words += f" and now at {_place(now)} m with {speed:.3g} m/s"
    return words


def substep(model: Model, state: State, clock: Clock) -> str:
    """How short substeps are now, why, and which particle moves fastest, in words."""
    limit = clock.stable()
    fastest = particle(model, state, int(speeds(state).argmax()))
    return (
        f"a substep is {limit.dt:.1e} s, limited by {LIMITS[limit.limiter]}; fastest is {fastest}"
    )


def _place(x: NDArray[Any]) -> str:
    return f"({', '.join(f'{c:.3g}' for c in x)})"
