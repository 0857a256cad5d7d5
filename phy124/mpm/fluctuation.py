"""Fluctuation: what particles keep of the motion that the grid does not carry.

APIC keeps nothing, and a run that asks for no more has none of these launches. Others send (v, C)
over the grid once more, or several times, before a substep scatters, and give
back after it gathers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import warp as wp

from phy124.kernels.arguments import types
from phy124.kernels.fluctuation import make_carry, make_fluctuation, make_keep, make_rpic
from phy124.mpm.grid import Grid
from phy124.mpm.model import Model
from phy124.mpm.stage import Recorded
from phy124.mpm.state import State
from phy124.mpm.timestep import beside_rpic
from phy124.mpm.workers import Part

STAGE = "fluctuation"
"""Name of the stages."""


class Scheme(NamedTuple):
    """How velocities come back from the grid."""

    passes: int = 0
    """Round trips over the grid: 0 is APIC, 1 AFLIP, m from 2 on XPIC(m)."""
    share: float = 1.0
    """How much of the fluctuation is kept, from 0 (APIC) to 1."""
    rpic: float = 0.0
    """Rate at which the symmetric part of C dies away [1/s]."""


APIC = Scheme()


def usable_rpic(scheme: Scheme, cfl: float) -> float:
    """The rate of a scheme's damping of C [1/s].

    Raises:
        ValueError: Substeps of a fraction `cfl` of the elastic limit are too long for it.
    """
    if scheme.rpic > 0 and cfl > beside_rpic(1.0):
        raise ValueError(f"RPIC needs a model with cfl up to 0.707, and this one has {cfl:g}")
    return scheme.rpic


@dataclass(frozen=True, eq=False)
class Fluctuation:
    """The launches of a scheme other than APIC."""

    model: Model
    state: State
    scheme: Scheme
    v: wp.array
    """What the grid did not carry of the velocities [P,3], m/s, in this substep."""
    C: wp.array
    """The same of their gradients [P,3,3], 1/s."""
    v_noise: wp.array
    """What none of the passes carried [P,3], m/s; zero if there is only one."""
    C_noise: wp.array
    """The same of the gradients [P,3,3], 1/s."""
    still: wp.array
    """A clock that stands still: the grid update then kicks nothing."""

    @classmethod
    def of(cls, model: Model, state: State, scheme: Scheme) -> Fluctuation:
        """With arrays of their own, which a substep fills before it reads them."""
        t, count = types(model.real), len(model)
        v, v_noise = (wp.zeros(count, dtype=t.vec3, device=model.device) for _ in range(2))
        C, C_noise = (wp.zeros(count, dtype=t.mat33, device=model.device) for _ in range(2))
        still = wp.zeros(3, dtype=model.real, device=model.device)
        return cls(model, state, scheme, v, C, v_noise, C_noise, still)

    def carry(self, part: Part, turn: int) -> Recorded:
        """A pass to the grid: of the particles' motion at first, then of what is left of it."""
        model, run = self.model, part.particles
        v, C = self._left(turn)
        inputs = [part.chosen, model.mass[run], part.nodes.lattice, part.nodes.window]
        inputs += [self.state.x[run], v[run], C[run]]
        kernel = make_carry(model.real, model.form)
        return STAGE, model.launch(kernel, part.count, inputs, [part.nodes.nodes])

    def remain(self, part: Part, grid: Grid, turn: int) -> Recorded:
        """What the grid did not carry in a pass."""
        model, run = self.model, part.particles
        v, C = self._left(turn)
        inputs = [part.chosen, grid.lattice, grid.window, grid.nodes, self.state.x[run]]
        outputs = [array[run] for array in self._left(turn + 1)]
        kernel = make_fluctuation(model.real, model.form)
        return STAGE, model.launch(kernel, part.count, [*inputs, v[run], C[run]], outputs)

    def keep(self, part: Part) -> Recorded:
        """Gives it back, after the gather."""
        model, run = self.model, part.particles
        read = [array[run] for array in (self.v, self.C, self.v_noise, self.C_noise)]
        outputs = [self.state.v[run], self.state.C[run]]
        inputs = [part.chosen, self.scheme.share, *read]
        return STAGE, model.launch(make_keep(model.real), part.count, inputs, outputs)

    def _left(self, turn: int) -> tuple[wp.array, wp.array]:
        """What goes into a pass, which is what the one before has left."""
        if turn == 0:
            return self.state.v, self.state.C
        return (self.v, self.C) if turn == 1 else (self.v_noise, self.C_noise)


def kernels(scheme: Scheme, real: Any, form: str) -> Iterator[Any]:
    """What a scheme launches beside the transfers."""
    if scheme.rpic > 0:
        yield make_rpic(real)
    if scheme.passes:
        yield from (make_carry(real, form), make_fluctuation(real, form), make_keep(real))
