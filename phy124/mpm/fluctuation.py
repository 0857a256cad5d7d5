"""Fluctuation: the motion of particles that the grid does not carry, and that a scheme keeps.

APIC keeps none of it and has no such launches. The other schemes send (v, C) over the grid once or
several times before a substep scatters, and restore the remaining part after it gathers.
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
"""Name of the stages."""


class Scheme(NamedTuple):
    """The scheme by which velocities return from the grid."""

    passes: int = 0
    """Round trips over the grid: 0 is APIC, 1 AFLIP, m from 2 on XPIC(m)."""
    share: float = 1.0
    """Fraction of the fluctuation that is kept, from 0 (APIC) to 1."""
    rpic: float = 0.0
    """Rate at which the symmetric part of C dies away [1/s]."""


APIC = Scheme()


def usable_rpic(scheme: Scheme, cfl: float) -> float:
    """Return the rate of a scheme's damping of C [1/s].

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
    """Part of the velocities [P,3], m/s, that the grid did not carry in this substep."""
    C: wp.array
    """Part of the velocity gradients [P,3,3], 1/s, that it did not carry."""
    v_noise: wp.array
    """Part that none of several passes carried [P,3], m/s; zero with a single pass."""
    C_noise: wp.array
    """The same for the gradients [P,3,3], 1/s."""
    still: wp.array
    """A clock that stands still, with which the grid update changes no velocity."""

    @classmethod
    def of(cls, model: Model, state: State, scheme: Scheme) -> Fluctuation:
        """Allocate arrays, which a substep fills before it reads them."""
        t, count = types(model.real), len(model)
        v, v_noise = (wp.zeros(count, dtype=t.vec3, device=model.device) for _ in range(2))
        C, C_noise = (wp.zeros(count, dtype=t.mat33, device=model.device) for _ in range(2))
        still = wp.zeros(3, dtype=model.real, device=model.device)
        return cls(model, state, scheme, v, C, v_noise, C_noise, still)

    def carry(self, part: Part, turn: int) -> Recorded:
        """Record a pass to the grid: first of the particles' motion, then of its remainder."""
        model, run = self.model, part.particles
        v, C = self._left(turn)
        inputs = [part.chosen, model.mass[run], part.nodes.lattice, part.nodes.window]
        inputs += [self.state.x[run], v[run], C[run]]
        kernel = make_carry(model.real, model.form)
        return STAGE, model.launch(kernel, part.count, inputs, [part.nodes.nodes])

    def remain(self, part: Part, grid: Grid, turn: int) -> Recorded:
        """Record the computation of the part that a pass did not carry."""
        model, run = self.model, part.particles
        v, C = self._left(turn)
        inputs = [part.chosen, grid.lattice, grid.window, grid.nodes, self.state.x[run]]
        outputs = [array[run] for array in self._left(turn + 1)]
        kernel = make_fluctuation(model.real, model.form)
        return STAGE, model.launch(kernel, part.count, [*inputs, v[run], C[run]], outputs)

    def keep(self, part: Part) -> Recorded:
        """Record the launch that restores the fluctuation after the gather."""
        model, run = self.model, part.particles
        read = [array[run] for array in (self.v, self.C, self.v_noise, self.C_noise)]
        outputs = [self.state.v[run], self.state.C[run]]
        inputs = [part.chosen, self.scheme.share, *read]
        return STAGE, model.launch(make_keep(model.real), part.count, inputs, outputs)

    def _left(self, turn: int) -> tuple[wp.array, wp.array]:
        """Return the input of a pass, which is the remainder of the previous pass."""
        if turn == 0:
            return self.state.v, self.state.C
        return (self.v, self.C) if turn == 1 else (self.v_noise, self.C_noise)


def kernels(scheme: Scheme, real: Any, form: str) -> Iterator[Any]:
    """Yield the kernels of a scheme besides the transfers."""
    if scheme.rpic > 0:
        yield make_rpic(real)
    if scheme.passes:
        yield from (make_carry(real, form), make_fluctuation(real, form), make_keep(real))
