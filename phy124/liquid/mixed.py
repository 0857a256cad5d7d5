"""MixedSolver: advances a projected liquid in steps, and bodies of other materials in substeps.

The rigid motions of the bodies are part of the liquid's pressure equation.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from phy124.boundaries import Boundary
from phy124.liquid.bodies import Bodies
from phy124.liquid.clock import LiquidClock
from phy124.liquid.exchange import BodyWork
from phy124.liquid.impulses import WallImpulses
from phy124.liquid.rigid import Moments, Motion
from phy124.liquid.solver import LiquidSolver
from phy124.mpm import Accumulator, Attachable, Clock, Model, Solver, Stage, State
from phy124.mpm.free import Plane
from phy124.mpm.model import part_of
from phy124.mpm.stage import divide_forces
from phy124.mpm.tracks import Tracks
from phy124.runtime.weakly import weakly


class MixedClock(Clock):
    """The clock of the bodies' substeps; it includes the delay of the liquid's velocities."""

    liquid: LiquidClock
    share = 0.0
    """Mass of the liquid divided by the total mass."""

    def follow(self, solver: LiquidSolver, total: float) -> None:
        """Connect the clock with the liquid's solver; `total` is the mass of all particles [kg]."""
        self.liquid, self.share = solver.clock, solver.model.total_mass / total
        self._state = solver.state
        self._moments = Moments(solver.model, [slice(0, len(solver.model))])

    def wet(self) -> Motion:
        """Return the rigid motion of the liquid at present."""
        return self._moments.read(self._state.x, self._state.v, self._state.C)[0]

    @property
    def behind(self) -> float:
        """Mean delay of velocities behind positions [s], weighted by mass."""
        return (1 - self.share) * super().behind + self.share * self.liquid.behind

    def list_failed(self, dt: float) -> list[tuple[Clock, float]]:
        """Return the clocks to `halve` if a frame is repeated: this clock and the liquid's."""
        return [*super().list_failed(dt), *self.liquid.list_failed(self.liquid.last_dt)]

    def lag(self, power: float, momentum: NDArray) -> float:
        """Return the kinetic energy at the time of the positions, minus the kinetic energy at the
        time of the velocities [J].
        """
        return super().lag(power, momentum) + self.liquid.lag(0.0, self.wet().momentum)


class MixedSolver(Solver):
    """Advances a liquid and bodies of other materials in time."""

    projects = True
    clock_type = MixedClock

    def __init__(
        self,
        model: Model,
        state: State,
        *,
        forces: Sequence[Attachable] = (),
        on_liquid: Sequence[Attachable] = (),
        boundaries: Sequence[Attachable] = (),
        walls: Sequence[tuple[str, Boundary]] = (),
        accumulators: Sequence[Accumulator] = (),
        planes: Sequence[Plane] = (),
        threads: int | None = None,
        **options: Any,
    ) -> None:
        """Divide the particles between the liquid solver and the solver of the other materials.

        Args:
            model: All particles; the liquid consists of the bodies `Model.wet`.
            state: Initial state of the particles.
            forces: Forces for the bodies, in the order in which they act.
            on_liquid: The same forces, for the liquid.
            boundaries: Boundaries for the bodies.
            walls: The same boundaries, with their names, for the liquid.
            accumulators: Sums that are updated in every substep.
            planes: Flat walls with which freely moving solids collide.
            threads: Number of CPU threads; None: the fastest number.
            options: Further arguments of `Solver`.

        Raises:
            InputError: A force's region contains no particle, or a wall is too thin.
        """
        span = liquid_span(model)
        part = liquid_model(model, span)
        self.bodies: Bodies | None = None
        """The other bodies; None only while the solver is constructed."""
        self._liquid: LiquidSolver | None = None
        dry = frozenset(range(model.bodies)) - model.wet
        self._wet = replace(model, held=model.held | dry, free_mass=0.0)
        self._dry = replace(model, held=model.held | model.wet)
        super().__init__(
            model, state, boundaries=boundaries, accumulators=accumulators,
            planes=planes, threads=threads, graph=False, **options,
        )  # fmt: skip
        work = BodyWork(model, state)
        self.bodies = Bodies(model, state, self.grids, self.free, work)
        self._liquid = LiquidSolver(
            part, liquid_state(state, span), forces=self._divide(on_liquid, self._wet),
            boundaries=walls, free=self.free.all, ceiling=self.clock.ceiling, threads=threads,
            bodies=self.bodies, advance_bodies=weakly(self._advance_bodies),
            whole=model,
        )  # fmt: skip
        self._liquid.pairs = self.pairs
        self._liquid.within = self.timings
        assert isinstance(self.clock, MixedClock)
        self.clock.follow(self._liquid, model.total_mass)
        self._after: Callable[[], None] | None = None
        self._each = False
        super().bind(
            forces=[*self._divide(forces, self._dry), self.bodies], boundaries=boundaries,
            accumulators=accumulators, planes=planes,
        )  # fmt: skip
        self._liquid.bounds = self.rejection

    def _divide(self, forces: Sequence[Attachable], part: Model) -> list[Attachable]:
        divided = divide_forces(forces, part, self.model)
        return [OfModel(force, part, self.state) for force in divided]

    @property
    def liquid(self) -> LiquidSolver:
        """The solver of the liquid."""
        assert self._liquid is not None
        return self._liquid

    @property
    def softened(self) -> float:
        """Current factor on the initial stiffness of all particles."""
        return self._softened

    @softened.setter
    def softened(self, factor: float) -> None:
        self._softened = factor
        if self.bodies is not None:
            self.bodies.soften(factor)

    def keep_works(self) -> None:
        """Sum the work on the liquid by cause, and the liquid's work on bodies, from now on."""
        assert self.bodies is not None
        self.liquid.keep_works()
        self.bodies.work.start()

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
        """Number of nodes and of cells in all windows."""
        return super().nodes + (self._liquid.nodes if self._liquid is not None else 0)

    def bind(
        self,
        *,
        forces: Sequence[Attachable] = (),
        on_liquid: Sequence[Attachable] = (),
        walls: Sequence[tuple[str, Boundary]] = (),
        **acting: Any,
    ) -> None:
        """Replace the forces, the boundaries and the sums over particles, from the next step on.

        Args:
            forces: Forces for the bodies, in the order in which they act.
            on_liquid: The same forces, for the liquid.
            walls: The boundaries, with their names, for the liquid.
            acting: Further arguments of `Solver.bind`.

        Raises:
            InputError: For the same reasons as in `__init__`.
        """
        if self._liquid is not None and self.bodies is not None:
            self._liquid.bind(forces=self._divide(on_liquid, self._wet), boundaries=walls)
            forces = [*self._divide(forces, self._dry), self.bodies]
        super().bind(forces=forces, **acting)
        if self._liquid is not None:
            self._liquid.bounds = self.rejection

    def advance(
        self, until: float, *, after: Callable[[], None] | None = None, each: bool = False
    ) -> None:
        """Take steps of the liquid, each followed by substeps of the bodies."""
        self._after, self._each = after, each
        self.rejection.begin(self.clock.time, until)
        self._measure_if_due()
        self.liquid.clock.time, self.liquid.clock.bodies = (
            self.clock.time,
            self.clock.extremes.speed,
        )
        try:
            self.liquid.advance(until)
        finally:
            self._after = None
        self.clock.time = until

    def _advance_bodies(self, until: float) -> None:
        assert self.bodies is not None
        wet = min(self.model.wet)
        for body, (impulse, moment) in zip(self.bodies.numbers, self.bodies.impulses, strict=True):
            self.pairs.add(wet, body, impulse, moment)
        self.bodies.work.begin()
        super().advance(until, after=self._after, each=self._each)
        self.bodies.finish()
        self.liquid.clock.bodies = self.clock.extremes.speed

    def renew(self) -> None:
        """Measure all limits of a step again, after the state was changed from outside."""
        super().renew()
        self.liquid.renew()

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot from which `restore` continues bit for bit."""
        liquid = self.liquid.snapshot()
        del liquid["state"]
        return {**super().snapshot(), "liquid": liquid}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore a snapshot; with an equal number of threads, the run continues bit for bit."""
        super().restore(snapshot)
        self.liquid.restore(snapshot["liquid"])


class OfModel:
    """A force, or sums, that act on the particles of a model other than the solver's model."""

    def __init__(self, item: Any, model: Model, state: State) -> None:
        self._item, self._model, self._state = item, model, state

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages for the particles of the other model."""
        stages: list[Stage] = self._item.attach(self._model, self._state, tracks)
        return stages


def liquid_span(model: Model) -> slice:
    """Return the particles of the liquid."""
    runs = [model.particles(body) for body in sorted(model.wet)]
    return slice(runs[0].start, runs[-1].stop)


def liquid_model(model: Model, span: slice) -> Model:
    """Return a model of the particles in a span, as one body."""
    groups = [
        replace(group, start=group.start - span.start, stop=group.stop - span.start, body=0)
        for group in model.groups
        if span.start <= group.start < span.stop
    ]
    liquids = tuple(section for section in model.materials if section.device_law.name == "fluid")
    return replace(
        model,
        rest=model.rest[span],
        mass=part_of(model.mass, span),
        volume=part_of(model.volume, span),
        history=model.history[span],
        groups=tuple(groups),
        materials=liquids,
        held=frozenset(),
        wet=frozenset(),
        names=(),
        free_mass=0.0,
        least_stiffness=1.0,
    )


def liquid_state(state: State, span: slice) -> State:
    """Return the state of the particles in a span, in the same memory."""
    return State(**{name: part_of(array, span) for name, array in state.arrays().items()})
