"""Advances a projected liquid in steps, and bodies on lattices in substeps.

In each step, the bodies first take trial substeps under the last pressure. The liquid's step uses
the mean motion of the bodies in these substeps.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.lattice.coupled import copy_points, part_of_bodies
from phy124.lattice.shock import LatticeClock
from phy124.lattice.solver import LatticeSolver
from phy124.liquid.bodies import Bodies
from phy124.liquid.exchange import LatticeBodyWork
from phy124.liquid.impulses import WallImpulses
from phy124.liquid.mixed import MixedClock, OfModel, liquid_model, liquid_span, liquid_state
from phy124.liquid.solver import LiquidSolver
from phy124.mpm import Accumulator, Attachable, Model, Pair, State
from phy124.mpm.free import Plane
from phy124.mpm.grid import grids_of
from phy124.mpm.pairs import Pairs
from phy124.mpm.stage import divide_forces
from phy124.mpm.workers import Timings, run_timed
from phy124.runtime.weakly import weakly

MARGIN = 4
"""Margin between a body's integration points and the border of its window [cells]."""


class ImmersedClock(MixedClock, LatticeClock):
    """The clock of the bodies' substeps; it includes the delay of the liquid's velocities."""


class ImmersedLattices(LatticeSolver):
    """The solver of the bodies on lattices."""

    clock_type = ImmersedClock


class ImmersedSolver:
    """Advances a liquid and bodies on lattices in time."""

    projects: ClassVar[bool] = True

    def __init__(
        self,
        model: Model,
        surface: NDArray,
        state: State,
        *,
        forces: Sequence[Attachable] = (),
        boundaries: Sequence[Any] = (),
        walls: Sequence[tuple[str, Boundary]] = (),
        accumulators: Sequence[Accumulator] = (),
        planes: Sequence[Plane] = (),
        pairs: Sequence[Pair] = (),
        copies: NDArray | None = None,
        still: Sequence[int] = (),
        threads: int | None = None,
        **options: Any,
    ) -> None:
        """Divide the particles between the liquid solver and the lattice solver.

        Args:
            model: All particles; the liquid consists of the bodies `Model.wet`.
            surface: Surface points at rest [S,8], as in `Particles.surface`.
            state: Initial state of the particles.
            forces: Forces; if there are several liquids, no force acts on only one of them.
            boundaries: Boundaries for the bodies.
            walls: The boundaries for the liquid, with their names.
            accumulators: Sums that are updated in every substep.
            planes: Not used; there are no freely moving solids.
            pairs: Pairs of bodies whose contact differs from the default.
            copies: Numbers of the copies of its 27 nodes that each cell uses [C,27]; None: no node
                has copies.
            still: Bodies that never move.
            threads: Number of CPU threads; None: the fastest number.
            options: Further arguments of `LatticeSolver`.

        Raises:
            InputError: As in `LatticeSolver` and `LiquidSolver`.
        """
        self.model, self.state, self._accumulators = model, state, list(accumulators)
        self._numbers = [body for body in range(model.bodies) if body not in model.wet]
        part, self._index = part_of_bodies(model, self._numbers, still)
        motion = (
            np.asarray(array.numpy(), np.float64)[self._index] for array in (state.v, state.C)
        )
        rows = surface.copy()
        rows[:, 6] = np.searchsorted(self._numbers, rows[:, 6])
        place = {body: number for number, body in enumerate(self._numbers)}
        between = [
            pair._replace(first=place[pair.first], second=place[pair.second])
            for pair in pairs
            if {pair.first, pair.second} <= place.keys()
        ]
        self.lattice = ImmersedLattices(
            part, rows, State.of(part, *motion), forces=divide_forces(forces, part, model),
            boundaries=boundaries,
            accumulators=self._of_all(accumulators), pairs=between, copies=copies, threads=threads,
            **options,
        )  # fmt: skip
        self.pairs = Pairs(model, pairs, 1)
        points, crew = self.lattice.state, self.lattice.crew
        self._mean = wp.zeros_like(points.v), wp.zeros_like(points.C)
        self._grids = grids_of(part)
        self.lattice.follow()
        self._find_windows()
        work, expect = LatticeBodyWork(self.lattice), weakly(self._predict)
        self.bodies = Bodies(part, points, self._grids, self.lattice.free, work, expect)
        crew.lasting = crew.new_pool()
        self.lattice.record()
        span = liquid_span(model)
        wet = replace(liquid_model(model, span), names=_names_of_liquid(model))
        self.liquid = LiquidSolver(
            wet, liquid_state(state, span), forces=divide_forces(forces, wet, model),
            boundaries=walls,
            ceiling=self.clock.ceiling, threads=threads, bodies=self.bodies,
            advance_bodies=weakly(self._advance_bodies), whole=model,
        )  # fmt: skip
        self.liquid.pairs = self.pairs
        self.liquid.within = self.timings
        self.clock.follow(self.liquid, model.total_mass)
        self._after: Callable[[], None] | None = None
        self._pushed: wp.array | None = None

    @property
    def clock(self) -> Any:
        """The clock of the bodies' substeps."""
        return self.lattice.clock

    @property
    def softened(self) -> float:
        """Current factor on the stiffness of all materials."""
        return self.lattice.softened

    @softened.setter
    def softened(self, factor: float) -> None:
        self.bodies.soften(factor)
        self.lattice.softened = factor

    @property
    def impulses(self) -> WallImpulses:
        """Impulses of the walls on the liquid."""
        return self.liquid.impulses

    @property
    def crowding(self) -> float:
        """Largest mean excess of the liquid's density, relative to the rest density, that lasts for
        two frames.
        """
        return self.liquid.crowding

    @property
    def nodes(self) -> int:
        """Number of lattice nodes and of cells in the liquid's window."""
        return self.lattice.nodes + self.liquid.nodes

    @property
    def timings(self) -> Timings:
        """Seconds and number of kernel launches of each stage, in the lattices' first thread."""
        return self.lattice.timings

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "lattice":
            raise AttributeError(name)
        return getattr(self.lattice, name)

    def bind(
        self,
        *,
        forces: Sequence[Attachable] = (),
        boundaries: Sequence[Any] = (),
        accumulators: Sequence[Accumulator] = (),
        planes: Sequence[Plane] = (),
        walls: Sequence[tuple[str, Boundary]] = (),
    ) -> None:
        """Replace the forces, the boundaries and the sums over particles, from the next step on.

        Args:
            forces: Forces, as in `__init__`.
            boundaries: Boundaries for the bodies.
            accumulators: Sums that are updated in every substep.
            planes: Not used; there are no freely moving solids.
            walls: The boundaries for the liquid, with their names.

        Raises:
            InputError: As in `__init__`.
        """
        self._accumulators = list(accumulators)
        of_liquid, of_bodies = (
            divide_forces(forces, part.model, self.model) for part in (self.liquid, self.lattice)
        )
        self.liquid.bind(forces=of_liquid, boundaries=walls)
        sums = self._of_all(accumulators)
        self.lattice.bind(forces=of_bodies, boundaries=boundaries, accumulators=sums)

    def keep_pushes(self, of_bodies: wp.array, of_liquid: wp.array) -> None:
        """Sum impulse and work of forces on points and particles from now on, per worker."""
        self._pushed = of_bodies
        self.lattice.keep_pushes(of_bodies)
        self.liquid.keep_pushes(of_liquid)

    def keep_works(self) -> None:
        """Sum the work on the liquid and on the bodies by cause from now on."""
        self.lattice.keep_works()
        self.liquid.keep_works()
        self.bodies.work.start()

    def _of_all(self, accumulators: Sequence[Accumulator]) -> list[Any]:
        return [_OfAll(item, self.model, self.state) for item in accumulators]

    def advance(
        self, until: float, *, after: Callable[[], None] | None = None, each: bool = False
    ) -> None:
        """Take steps of the liquid, each followed by substeps of the bodies
        (`LiquidSolver.advance`).
        """
        self._after = after
        self.lattice.pairs.begin()
        self.liquid.clock.time = self.clock.time
        self.liquid.clock.bodies = self.clock.extremes.speed
        try:
            self.liquid.advance(until)
        finally:
            self._after = None
        self.clock.time = until
        for (first, second), (impulse, moment) in self.lattice.pairs.wrenches(1.0).items():
            self.pairs.add(self._numbers[first], self._numbers[second], impulse, moment)
        self._copy_state()

    def _advance_bodies(self, until: float) -> None:
        wet, bodies, lattice = min(self.model.wet), self.bodies, self.lattice
        for body, (impulse, moment) in zip(self._numbers, bodies.impulses, strict=True):
            self.pairs.add(wet, body, impulse, moment)
        self._press()
        bodies.work.begin()
        lattice.advance(until, after=self._after)
        bodies.work.end(bodies.pushes, bodies.turns, until - self.liquid.clock.time)
        self._find_windows()
        self.liquid.clock.bodies = self.clock.extremes.speed

    def _press(self) -> None:
        bodies, lattice = self.bodies, self.lattice
        lattice.rejection.pressed = bodies.limit
        run_timed(self.timings, "press", lambda: lattice.crew.press(bodies.pushes, bodies.turns))

    def _predict(self, duration: float) -> tuple[wp.array, wp.array]:
        """Return the mean velocities of the integration points, and the gradients of these
        velocities, in a step of `duration` [s] under the last pressure.
        """
        lattice, nodes = self.lattice, self.lattice.nodes_state
        sums = [item.snapshot() for item in self._accumulators]
        kept, u = lattice.snapshot(), nodes.u.numpy().copy()
        pushed = None if self._pushed is None else wp.clone(self._pushed)
        self._press()
        lattice.advance(lattice.clock.time + duration)
        mean = (nodes.u.numpy() - u) / duration
        lattice.restore(kept)
        if self._pushed is not None and pushed is not None:
            wp.copy(self._pushed, pushed)
        for item, values in zip(self._accumulators, sums, strict=True):
            item.restore(values)
        v = wp.clone(nodes.v)
        nodes.v.assign(mean)
        lattice.follow()
        for array, now in zip(self._mean, (lattice.state.v, lattice.state.C), strict=True):
            wp.copy(array, now)
        nodes.v.assign(v)
        lattice.follow()
        return self._mean

    def _find_windows(self) -> None:
        part, x = self.lattice.model, self.lattice.state.x.numpy()
        for body, grid in enumerate(self._grids):
            cells = np.floor((x[part.particles(body)] - part.origin) / part.dx).astype(int)
            grid.low = cells.min(axis=0) - MARGIN
            grid.size = cells.max(axis=0) + MARGIN + 1 - grid.low

    def _copy_state(self) -> None:
        copy_points(self.lattice.state, self.state, self._index)

    def carry_nodes(self, carry: Callable[[NDArray, NDArray], Any], body: int = 0) -> None:
        """Set the positions and velocities of a body's nodes, as in `LatticeSolver.carry_nodes`."""
        self.lattice.carry_nodes(carry, self._numbers.index(body))
        self._find_windows()
        self._copy_state()
        self.renew()

    def renew(self) -> None:
        """Measure all limits of a step again, after the state was changed from outside."""
        self.clock.expire()
        self.liquid.renew()

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot from which `restore` continues bit for bit."""
        return {
            "lattice": self.lattice.snapshot(),
            "liquid": self.liquid.snapshot(),
            "pairs": self.pairs.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore a snapshot; with an equal number of threads, the run continues bit for bit."""
        self.lattice.restore(snapshot["lattice"])
        self._find_windows()
        self.liquid.restore(snapshot["liquid"])
        self.pairs.restore(snapshot["pairs"])
        self._copy_state()


def _names_of_liquid(model: Model) -> tuple[str, ...]:
    return tuple(model.names[body] for body in model.wet) if len(model.wet) == 1 else ()


class _OfAll(OfModel):
    """Sums over all particles, also in substeps that move only some of the particles."""

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot of the sums over the particles."""
        sums: dict[str, Any] = self._item.snapshot()
        return sums

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the sums over the particles from a snapshot."""
        self._item.restore(snapshot)
