"""Diagnostics of a state: momentum, energy, volume ratios, and unsound particles."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels import diagnostics as at
from phy124.kernels.diagnostics import make_energies, make_totals
from phy124.kernels.reduction import shared_out
from phy124.kernels.transfer import Law
from phy124.mpm import Clock, Model, Solver, State
from phy124.mpm.state import part_of

NOBODY = 2**31 - 1
"""An index above those of all particles."""
VECTORS = ("momentum", "angular", "middle")


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
        """The diagnostics of a state, summed in float64."""
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
        ends, found, index = (np.asarray(array.numpy()) for array in (spread, counts, first))
        return cls(
            momentum=total[at.MOMENTUM : at.MOMENTUM + 3],
            angular=total[at.ANGULAR : at.ANGULAR + 3],
            kinetic=float(total[at.KINETIC]),
            elastic=float(total[at.ELASTIC]),
            lag=-clock.last_dt / 2 * float(total[at.POWER]),
            middle=total[at.MIDDLE : at.MIDDLE + 3],
            min_J=-float(ends[at.LEAST_J]),
            max_J=float(ends[at.LARGEST_J]),
            broken=int(found[at.BROKEN]),
            inverted=int(found[at.INVERTED]),
            first_broken=int(index[at.BROKEN]),
            first_inverted=int(index[at.INVERTED]),
        )

    @property
    def energy(self) -> float:
        """Kinetic plus elastic energy at one instant [J].

        m/2 v(t - dt/2) . v(t + dt/2) + psi(t), which leapfrog conserves exactly in a vibration.
        """
        return self.kinetic + self.elastic + self.lag

    def snapshot(self) -> dict[str, Any]:
        """The diagnostics as plain data."""
        return {**asdict(self), **{name: getattr(self, name).tolist() for name in VECTORS}}

    @classmethod
    def from_snapshot(cls, data: dict[str, Any]) -> Diagnostics:
        """The diagnostics from plain data."""
        return cls(**{**data, **{name: np.array(data[name]) for name in VECTORS}})


def diagnose(solver: Solver) -> Diagnostics:
    """The diagnostics of a solver's state."""
    return Diagnostics.of(solver.model, solver.state, solver.clock)


def energies(model: Model, state: State) -> NDArray[np.float64]:
    """Kinetic plus elastic energy of each particle [P], J; infinite where it is not finite."""
    found = wp.zeros(len(model), dtype=wp.float64, device=model.device)
    for group in model.groups:
        part = group.particles
        read = [group.theta, model.mass[part], model.volume[part], model.dx]
        own = [state.v[part], state.C[part], state.F[part], part_of(state.history, part)]
        wp.launch(
            make_energies(group.law, model.real),
            len(group),
            inputs=[*read, *own],
            outputs=[found[part]],
            device=model.device,
        )
    return _known(found.numpy())


def speeds(state: State) -> NDArray[np.float64]:
    """Speed of each particle [P], m/s; infinite where it is not finite."""
    velocities: NDArray[Any] = state.v.numpy()
    return _known(np.linalg.norm(velocities.astype(np.float64), axis=1))


def _known(values: NDArray) -> NDArray[np.float64]:
    return np.where(np.isfinite(values), values, np.inf)


def kernels(laws: Iterable[Law], real: Any) -> Iterator[Any]:
    """What sums up particles of these laws in every frame."""
    yield from (make_totals(law, real) for law in laws)
