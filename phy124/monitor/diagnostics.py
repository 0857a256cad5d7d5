"""Measures momentum, energy and volume ratios of a state, and finds invalid particles."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels import diagnostics as at
from phy124.kernels.diagnostics import make_energies, make_totals
from phy124.kernels.reduction import shared_out
from phy124.mpm import Clock, Model, State
from phy124.mpm.model import Group, part_of

if TYPE_CHECKING:
    from phy124.liquid import AnySolver

NO_PARTICLE = 2**31 - 1
LIMITS = {
    "elastic": "the stiffness of the material",
    "speed": "its speed",
    "gradient": "its rate of strain",
    "viscous": "its viscosity or damping",
    "user": "time.substep",
    "retry": "half the substep of a first attempt, which failed",
    "wave": "the waves on its surface",
}
"""Phrase for each limit of the substep."""


@dataclass(frozen=True, eq=False)
class Diagnostics:
    """Sums and extremes over the particles of a state."""

    momentum: NDArray[np.float64]
    """Momentum [3], kg m/s."""
    angular: NDArray[np.float64]
    """Angular momentum about the origin [3], kg m^2/s."""
    kinetic: float
    """Kinetic energy [J] at the time of the velocities, which is half a substep before the time of
    the positions.
    """
    elastic: float
    """Elastic energy [J]."""
    lag: float
    """Change of the kinetic energy [J] from the time of the velocities to the time of the
    positions.
    """
    middle: NDArray[np.float64]
    """Sum of mass times position [3], kg m."""
    min_J: float
    """Smallest volume ratio."""
    max_J: float
    """Largest volume ratio."""
    broken: int
    """Number of particles whose state is not finite."""
    inverted: int
    """Number of particles with det F < 0."""
    first_broken: int
    """Lowest index of a particle that is not finite."""
    first_inverted: int
    """Lowest index of an inverted particle."""

    @property
    def energy(self) -> float:
        """Sum of kinetic and elastic energy at the same time [J].

        The value is the sum of `m/2 v(t - dt/2) . v(t + dt/2)` and `psi(t)`. Leapfrog integration
        conserves this sum exactly in a vibration.
        """
        return self.kinetic + self.elastic + self.lag


class Totals:
    """Sums over the particles of a state, in float64."""

    on_lattice = False

    def __init__(self, model: Model, state: State) -> None:
        device, sums = model.device, at.SUMS
        self._numbers = wp.zeros(sums + 2, dtype=wp.float64, device=device)
        self._counts = wp.zeros(4, dtype=int, device=device)
        self._empty = np.array([0.0] * sums + [-math.inf] * 2), np.array([0, 0] + [NO_PARTICLE] * 2)
        outputs = [*_split(self._numbers, sums), *_split(self._counts, 2)]
        self._model, self._state = model, state
        self._launches = [launch for group in model.groups for launch in self._sum(group, outputs)]

    def _sum(self, group: Group, outputs: list[wp.array]) -> list[wp.Launch | None]:
        model, state, part = self._model, self._state, group.particles
        threads, *fraction = shared_out(len(group), model.device)
        inputs = [
            *fraction, group.theta, model.mass[part], model.volume[part], model.dx,
            group.start, state.x[part], state.v[part], state.C[part], state.F[part],
            part_of(state.history, part),
        ]  # fmt: skip
        kernel = make_totals(group.law, model.real, on_lattice=self.on_lattice)
        return [model.launch(kernel, threads, inputs, outputs)]

    def read(self, clock: Clock) -> Diagnostics:
        """Return the diagnostics of the current state."""
        self._numbers.assign(self._empty[0])
        self._counts.assign(self._empty[1])
        for launch in self._launches:
            if launch is not None:
                launch.launch()
        total: NDArray[Any] = np.array(self._numbers.numpy())
        least_J, largest_J = total[at.SUMS :].tolist()
        broken, inverted, first_broken, first_inverted = self._counts.numpy().tolist()
        return Diagnostics(
            momentum=total[at.MOMENTUM : at.MOMENTUM + 3],
            angular=total[at.ANGULAR : at.ANGULAR + 3],
            kinetic=float(total[at.KINETIC]),
            elastic=float(total[at.ELASTIC]),
            lag=clock.lag(float(total[at.POWER]), total[at.MOMENTUM : at.MOMENTUM + 3]),
            middle=total[at.MIDDLE : at.MIDDLE + 3],
            min_J=-least_J,
            max_J=largest_J,
            broken=broken,
            inverted=inverted,
            first_broken=first_broken,
            first_inverted=first_inverted,
        )


def _split(array: wp.array, count: int) -> tuple[wp.array, wp.array]:
    return cast("wp.array", array[:count]), cast("wp.array", array[count:])


def diagnose(solver: AnySolver) -> Diagnostics:
    """Return the diagnostics of a solver's state."""
    return Totals(solver.model, solver.state).read(solver.clock)


def compute_energies(model: Model, state: State) -> NDArray[np.float64]:
    """Return the kinetic plus elastic energy of each particle [P], J; infinity instead of NaN."""
    energy = wp.zeros(len(model), dtype=wp.float64, device=model.device)
    for group in model.groups:
        part = group.particles
        inputs = [group.theta, model.mass[part], model.volume[part], model.dx]
        inputs += [state.v[part], state.C[part], state.F[part], part_of(state.history, part)]
        kernel = make_energies(group.law, model.real)
        wp.launch(kernel, len(group), inputs=inputs, outputs=[energy[part]], device=model.device)
    return _finite_or_infinity(energy.numpy())


def compute_speeds(state: State) -> NDArray[np.float64]:
    """Return the speed of each particle [P], m/s; infinity instead of NaN."""
    velocities: NDArray[Any] = state.v.numpy()
    return _finite_or_infinity(np.linalg.norm(velocities.astype(np.float64), axis=1))


def _finite_or_infinity(values: NDArray) -> NDArray[np.float64]:
    return np.where(np.isfinite(values), values, np.inf)


def find_broken(state: State) -> NDArray[np.intp]:
    """Return the indices of particles that are not finite, in ascending order."""
    arrays = [np.asarray(array.numpy()) for array in state.arrays().values() if len(array)]
    flat = [array.reshape(len(state.x), -1) for array in arrays]
    return np.flatnonzero(~np.isfinite(np.concatenate(flat, axis=1)).all(axis=1))


def name_law(model: Model, index: int) -> str:
    """Return the name of a particle's law in scene files."""
    kernel = next(g.law.name for g in model.groups if g.start <= index < g.stop)
    sections = [section for section in model.materials if section.device_law.name == kernel]
    # A law from outside phy124 may have no name.
    return " or ".join(sorted({str(getattr(section, "law", kernel)) for section in sections}))


def describe_particle(model: Model, state: State, index: int) -> str:
    """Return a phrase with a particle's index, law, position and speed."""
    rest, now = _position(model.rest[index]), np.asarray(state.x.numpy())[index]
    words = f"particle {index} of law {name_law(model, index)}, at {rest} m at rest"
    speed = compute_speeds(state)[index]
    if np.isfinite(now).all() and np.isfinite(speed):
        words += f" and now at {_position(now)} m with {speed:.3g} m/s"
    return words


def describe_substep(model: Model, state: State, clock: Clock) -> str:
    """Return a phrase with the substep, its limit, and the fastest particle."""
    limit = clock.stable()
    fastest = describe_particle(model, state, int(compute_speeds(state).argmax()))
    return (
        f"a substep is {limit.dt:.1e} s, limited by {LIMITS[limit.limiter]}; fastest is {fastest}"
    )


def _position(x: NDArray[Any]) -> str:
    return f"({', '.join(f'{c:.3g}' for c in x)})"
