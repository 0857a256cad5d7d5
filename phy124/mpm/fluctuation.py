"""Fluctuation: the part of the particles' motion that the grid does not represent.

APIC discards the fluctuation; AFLIP and XPIC restore a part of the fluctuation.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.fluctuation import make_carry, make_fluctuation, make_keep, make_rpic
from phy124.mpm.grid import Grid
from phy124.mpm.model import Model, State
from phy124.mpm.stage import Recorded
from phy124.mpm.timestep import beside_rpic
from phy124.mpm.workers import Part

STAGE = "fluctuation"
"""Name under which reports list the time for the fluctuation."""


class Scheme(NamedTuple):
    """The scheme of the transfers between particles and grid: APIC, AFLIP, XPIC or RPIC."""

    passes: int = 0
    """Number of transfers to the grid and back in a substep: 0 for APIC, 1 for AFLIP, m >= 2 for
    XPIC(m).
    """
    share: float = 1.0
    """Fraction of the fluctuation that is restored: between 0 (as for APIC) and 1."""
    rpic: float = 0.0
    """Rate at which the symmetric part of the velocity gradients C decays [1/s]."""


APIC = Scheme()


def usable_rpic(scheme: Scheme, cfl: float) -> float:
    """Return the rate [1/s] at which a transfer scheme damps the velocity gradients C.

    Raises:
        ValueError: With damping, substeps of `cfl` times the elastic limit are unstable.
    """
    if scheme.rpic > 0 and cfl > beside_rpic(1.0):
        raise ValueError(f"RPIC needs a model with cfl up to 0.707, but this model has {cfl:g}")
    return scheme.rpic


@dataclass(frozen=True, eq=False)
class Fluctuation:
    """The kernel launches of AFLIP or XPIC."""

    model: Model
    state: State
    scheme: Scheme
    v: wp.array
    """Velocities that the grid does not represent in this substep [P,3], m/s."""
    C: wp.array
    """Velocity gradients that the grid does not represent in this substep [P,3,3], 1/s."""
    v_noise: wp.array
    """Velocities left after several transfers [P,3], m/s; zero after one transfer."""
    C_noise: wp.array
    """Velocity gradients left after several transfers [P,3,3], 1/s; zero after one transfer."""
    still: wp.array
    """A clock with a time step of zero, with which the grid update does not change velocities."""

    @classmethod
    def of(cls, model: Model, state: State, scheme: Scheme) -> Fluctuation:
        """Allocate the arrays; a substep writes them before it reads them."""
        t, count = types(model.real), len(model)
        v, v_noise = (wp.zeros(count, dtype=t.vec3, device=model.device) for _ in range(2))
        C, C_noise = (wp.zeros(count, dtype=t.mat33, device=model.device) for _ in range(2))
        still = wp.zeros(3, dtype=model.real, device=model.device)
        return cls(model, state, scheme, v, C, v_noise, C_noise, still)

    def carry(self, part: Part, turn: int) -> Recorded:
        """Record the transfer of the motion to the grid in pass `turn`. After pass 0, only the
        motion that remains from the previous pass is transferred.
        """
        model, run = self.model, part.particles
        v, C = self._left(turn)
        inputs = [part.chosen, model.mass[run], part.nodes.lattice, part.nodes.window]
        inputs += [self.state.x[run], v[run], C[run]]
        kernel = make_carry(model.real, model.form)
        return STAGE, model.launch(kernel, part.count, inputs, [part.nodes.nodes])

    def remain(self, part: Part, grid: Grid, turn: int) -> Recorded:
        """Record the computation of the motion that remains after a pass over the grid."""
        model, run = self.model, part.particles
        v, C = self._left(turn)
        inputs = [part.chosen, grid.lattice, grid.window, grid.nodes, self.state.x[run]]
        outputs = [array[run] for array in self._left(turn + 1)]
        kernel = make_fluctuation(model.real, model.form)
        return STAGE, model.launch(kernel, part.count, [*inputs, v[run], C[run]], outputs)

    def keep(self, part: Part) -> Recorded:
        """Record the kernel launch that restores the fluctuation after the gather."""
        model, run = self.model, part.particles
        read = [array[run] for array in (self.v, self.C, self.v_noise, self.C_noise)]
        outputs = [self.state.v[run], self.state.C[run]]
        inputs = [part.chosen, self.scheme.share, *read]
        return STAGE, model.launch(make_keep(model.real), part.count, inputs, outputs)

    def _left(self, turn: int) -> tuple[wp.array, wp.array]:
        """Return the motion that a pass transfers: the remainder of the previous pass."""
        if turn == 0:
            return self.state.v, self.state.C
        return (self.v, self.C) if turn == 1 else (self.v_noise, self.C_noise)


def kernels(scheme: Scheme, real: Any, form: str) -> Iterator[Any]:
    """Yield the kernels of a transfer scheme, except the transfers themselves."""
    if scheme.rpic > 0:
        yield make_rpic(real)
    if scheme.passes:
        yield from (make_carry(real, form), make_fluctuation(real, form), make_keep(real))
