"""LatticeSolver: explicit substeps of elastic bodies on lattices of their shapes at rest.

The particles (points) serve only as integration points. The points' x, v, C and F are computed from
the nodes before forces on particles act, when limits are measured, and at the end of `advance`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.lattice.crew import Crew
from phy124.lattice.energies import Energies
from phy124.lattice.limits import Limits
from phy124.lattice.meetings import Meetings
from phy124.lattice.motion import make_nodes
from phy124.lattice.reach import cells_of
from phy124.lattice.rest import RestLattice
from phy124.lattice.shock import LatticeClock, in_shock_only, largest_calm_rate
from phy124.lattice.solids import Solids
from phy124.lattice.spectrum import Spectrum
from phy124.lattice.surface import make_surface
from phy124.lattice.walls import Boundary, Walls
from phy124.lattice.workers import PLACE, Division
from phy124.mpm.free import FreeBody
from phy124.mpm.grid import Grid
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model, State
from phy124.mpm.outliers import Outliers
from phy124.mpm.pairs import Pair, Pairs
from phy124.mpm.rejection import StepRejection
from phy124.mpm.repair import Repair
from phy124.mpm.runner import Runner
from phy124.mpm.stage import Accumulator, Attachable, Named, Stage, launches, push_launches
from phy124.mpm.tracks import Track, Tracks
from phy124.mpm.workers import FOLLOW, SCHEDULE, Timings, run_timed, usable_workers

NODES = ("u", "residue", "v", "lagging")
"""Names of the arrays of nodes that belong to the solver's state."""


class LatticeSolver(Kept):
    """Advances the nodes of bodies in time under forces, boundaries and contact."""

    kept = ("walls", "meetings", "pairs", "free", "clock", "spectrum")

    projects: ClassVar[bool] = False
    clock_type: ClassVar[type[LatticeClock]] = LatticeClock

    def __init__(
        self,
        model: Model,
        surface: NDArray,
        state: State | None = None,
        *,
        pairs: Sequence[Pair] = (),
        free: Sequence[FreeBody] = (),
        copies: NDArray | None = None,
        ceiling: float = math.inf,
        threads: int | None = None,
        vectors: bool = True,
        **acting: Any,
    ) -> None:
        """Build the lattices of a model whose particles are integration points.

        Args:
            model: The integration points, cell by cell (phy124/particles/lattice.py).
            surface: Surface points at rest [S,8], as in `Particles.surface`.
            state: The initial motion of the points; None: at rest.
            pairs: Pairs of bodies whose contact differs from the default.
            free: Freely moving rigid solids.
            copies: Copy of each of the 27 nodes that a cell uses [C,27]; None: no node has copies.
            ceiling: Longest substep allowed [s].
            threads: Number of CPU threads; None: chosen from the numbers of free cores and points.
            vectors: Whether to use vectorised CPU kernels if they exist.
            acting: Forces, boundaries, sums and planes, as in `bind`.

        Raises:
            InputError: The region of a force contains no particle, or a clamp fixes only some
                directions.
        """
        self.state = State.of(model) if state is None else state
        self.clock = self.clock_type(model, ceiling=ceiling)
        self.clock.calm = largest_calm_rate(model.materials, model.dx)
        # Viscosity is part of the measured stiffness.
        self.clock.viscous = math.inf
        # The frequency is measured, so `accuracy.cfl` is relative to the largest stable squared
        # frequency.
        self.clock.cfl = math.sqrt(model.cfl)
        mass, volume = (np.asarray(a.numpy(), np.float64) for a in (model.mass, model.volume))
        spans = [model.particles(body) for body in range(model.bodies)]
        self.lattice = RestLattice.of(model.rest, mass, volume, model.dx, spans, copies)
        self.model = model = replace(model, respond=self.lattice.respond)
        self.surface = make_surface(surface, self.lattice)
        self.nodes_state = make_nodes(
            model, self.lattice, self.surface, self.state, vectors=vectors
        )
        count = usable_workers(len(model), model.device, threads)
        self.crew = Crew(model, self.state, self.lattice, self.nodes_state, count, vectors=vectors)
        self.workers = self.crew.workers
        self.runner = Runner(self.workers)
        self.energies = Energies(model, self.nodes_state, self.crew, self.clock)
        self.grid = Grid(model.origin, model.dx, real=model.real, device=model.device)
        self.grid.size = np.ptp(self.lattice.index, axis=0) + 1
        self.pairs = Pairs(model, pairs, 1)
        self.free = Solids(model, free, self.surface, self.nodes_state)
        # The lattice solver does not use these attributes, but observers and reports read them.
        self.repair = Repair(model, self.state, needed=False)
        self.outliers = Outliers(model, self.state)
        self.boundaries: Sequence[Stage] = ()
        self.guests: list[Any] = []
        """Objects that compute further kinds of contact."""
        nodes, lattice = self.nodes_state, self.lattice
        with self.runner.on_threads():
            self.spectrum = Spectrum(model, self.crew, nodes, lattice, self.runner.complete)
        parts = self.crew, self.runner, self.spectrum, self.free
        self.limits = Limits(model, self.clock, *parts)
        self.bind(**acting)

    def bind(
        self,
        *,
        forces: Sequence[Attachable] = (),
        boundaries: Sequence[Boundary] = (),
        accumulators: Sequence[Accumulator] = (),
        planes: Sequence[Any] = (),
    ) -> None:
        """Replace the forces, the boundaries and the sums over points, from the next substep on.

        Contact forces and times of measurements are kept, so that live runs are bitwise
        reproducible.

        Args:
            forces: Forces, in the order in which they act.
            boundaries: Boundaries, in the order in which they act.
            accumulators: Sums that are updated in every substep.
            planes: Flat walls with which freely moving solids collide.

        Raises:
            InputError: The region of a force contains no particle, or a clamp fixes only some
                directions; in this case nothing has changed.
        """
        model, state = self.model, self.state
        tracks = Tracks(real=model.real, device=model.device)
        acting = [stage for item in forces for stage in item.attach(model, state, tracks)]
        surface, nodes = self.surface, self.nodes_state
        division = Division(model, self.runner.team)
        measures = self.limits.substep_at_rest, division, self.clock.time
        walls = Walls(boundaries, model, self.lattice, surface, nodes, tracks, *measures)
        sums = [stage for item in accumulators for stage in item.attach(model, state, tracks)]
        self.free.bind(planes, tracks)
        tracks.upload(self.clock.values)
        self.free.prepare(tracks, walls.recovery)
        kept = self.meetings.snapshot() if self.clock.substeps else None
        self.meetings = Meetings(
            surface, model, nodes, tracks, self.pairs, walls.recovery, division
        )
        if kept is not None:
            self.meetings.restore(kept)
            walls.continue_from(self.walls)
        self.tracks, self.walls, self._forces, self._sums = tracks, walls, acting, sums
        self._sample = tracks.record()
        self._sample.launch()
        self.rejection = StepRejection(model, state, tracks, acting, accumulators)
        self.limits.bind(walls, self.meetings, self.rejection)
        self.record()
        measured = self.limits.measured
        self.limits.look()
        self.limits.measured = measured

    def retarget(self, moved: Sequence[tuple[Track, Track]]) -> bool:
        """Replace some tracks, as `bind` would; return False if only `bind` can replace them.

        Each element of `moved` contains the present track and the new track.
        """
        known, every = self.tracks.tracks, [old for old, _ in moved]
        for old, new in moved:
            # Equal tracks may belong to different hands or walls.
            alike = known.count(old) == every.count(old) == moved.count((old, new))
            if not alike or len(old.keys) != len(new.keys):
                return False
        slots = [slot for slot, track in enumerate(known) if track in every]
        for slot in slots:
            self.tracks.put(slot, moved[every.index(known[slot])][1])
        self._sample.launch()
        return True

    def keep_pushes(self, sums: wp.array) -> None:
        """From now on, sum the impulse and the work of forces on points, in one row per worker."""
        self.energies.pushes = sums
        self.record()

    def keep_works(self) -> None:
        """From now on, sum the work of each cause."""
        self.energies.start()
        self.record()

    def record(self) -> None:
        """Record the kernel launches of one substep."""
        crew, pushed = self.crew, bool(self._forces)
        if pushed:
            crew.reach(cells_of(self._forces, len(self.lattice.rows)))
        self.energies.attach(self.tracks, self.walls, self.meetings, self.free)
        for index, worker in enumerate(self.workers):
            before = []
            if pushed:
                push = push_launches(self._forces, self.grid, index, len(self.workers))
                before = [crew.locate(worker), push]
            worker.phases = [
                *before,
                crew.force(worker, self.tracks if pushed else None),
                in_shock_only(self.clock, crew.shock(worker, self.clock.values)),
                crew.kick(worker, self.tracks, pushed=pushed),
                self._contact() if index == 0 else [],
                crew.drift(worker, self.tracks),
            ]
        last = [(stage.name, stage.record(self.grid)) for stage in self._sums]
        last += self.free.drift()
        self.workers[0].phases[-1] += launches(last)
        self.energies.extend(pushed=pushed)
        self._summed = 2 if pushed else 0
        """The phase of a substep that completes the forces on all nodes."""

    def _contact(self) -> list[Named]:
        """Return the kernel launches of all kinds of contact.

        All impulses of the last substep are applied before any impulse is corrected.
        """
        passed, parts = self.walls.passed_on(), (self.walls, self.meetings, self.free, *self.guests)
        everything = [part.stages(passed) for part in parts]
        return [
            stage for order in zip(*everything, strict=True) for part in order for stage in part
        ]

    @property
    def nodes(self) -> int:
        """Number of nodes of all lattices."""
        return len(self.lattice)

    @property
    def softened(self) -> float:
        """Current factor on the initial stiffness of all materials."""
        return self.limits.softened

    @softened.setter
    def softened(self, factor: float) -> None:
        self.limits.softened = factor
        self.clock.calm = largest_calm_rate(self.model.materials, self.model.dx, factor)

    @property
    def timings(self) -> Timings:
        """Seconds and number of kernel launches of each stage of a substep, in the first thread."""
        return self.workers[0].timings

    def start(self) -> None:
        """Do nothing; called once before the first step, after all observers have been bound."""

    def advance(
        self, until: float, *, after: Callable[[], None] | None = None, each: bool = False
    ) -> None:
        """Take substeps as `Solver.advance` does, then move the points with the nodes."""
        self.rejection.begin(self.clock.time, until)
        self.clock.interval = min(self.clock.interval, self.limits.interval())
        if len(self.workers) > 1:
            # Loading kernels is not thread-safe, so the measurement's kernels are loaded here.
            self.limits.measure_if_due()
        with self.runner.on_threads():
            while self.clock.time < until:
                self._stable_step(until)
                if after is not None:
                    run_timed(self.timings, FOLLOW, after)
            self.follow()

    def pinch(self) -> tuple[float, int, int]:
        """Return the result of `Walls.pinch` for the walls' current positions."""
        self._place_walls()
        return self.walls.pinch()

    def _place_walls(self) -> None:
        """Evaluate all tracks at the current time; the last substep evaluated the tracks at its
        start.
        """
        self.clock.begin(0.0, 0.0)
        self._sample.launch()

    def follow(self) -> None:
        """Compute x, v, C and F of the points from the nodes."""
        run_timed(self.timings, "follow", lambda: self.runner.complete(PLACE))

    def carry_nodes(
        self, carry: Callable[[NDArray, NDArray], tuple[NDArray, NDArray]], body: int = 0
    ) -> None:
        """Set positions and velocities of a body's nodes, and reset the body's contact.

        `carry` computes the new positions and velocities [N,3] from the current ones.
        """
        nodes, rest, mine = self.nodes_state, self.lattice.x, self.lattice.body == body
        x, v = (
            np.array(values, np.float64) for values in (rest + nodes.u.numpy(), nodes.v.numpy())
        )
        x[mine], v[mine] = carry(x[mine], v[mine])
        nodes.u.assign(x - rest)
        nodes.v.assign(v)
        nodes.lagging.assign(v)
        nodes.residue.zero_()
        for contacts in (self.walls, self.meetings, self.free):
            contacts.forget(body)
        self.crew.stray.zero_()
        self.limits.look()
        self.clock.expire()
        self.follow()

    def _stable_step(self, until: float) -> None:
        """Take one stable substep, whose length divides the remaining time evenly."""
        self.limits.measure_if_due()
        clock = self.clock
        limit = run_timed(self.timings, SCHEDULE, clock.stable)
        rest = until - clock.time
        dt = rest / max(1, math.ceil(rest / limit.dt - 1e-9))
        kick = max(0.0, (clock.last_dt + dt) / 2)
        taken = self.step(kick, dt)
        if taken == rest:
            clock.time = until
        # After a shortened substep, velocities are less than half a substep behind positions, or
        # even ahead.
        clock.last_dt = dt if taken == dt else clock.last_dt + 2 * (taken - kick)
        clock.count(limit.limiter, needed=dt / limit.dt)

    def step(self, kick: float, drift: float) -> float:
        """Take one substep: change velocities for `kick` [s], and displacements for `drift` [s].

        Returns: The time over which displacements changed [s]; shorter than `drift` if a point
        would be squeezed too much.
        """
        self.start_step(kick, drift)
        if self.clock.may_crush(self.limits.fastest(), drift):
            drift = self.limits.shorten(drift)
            self.clock.begin(kick, drift)
        self.end_step(drift)
        return drift

    def start_step(self, kick: float, drift: float) -> None:
        """Change the velocities of nodes by forces and contact: the first part of a substep."""
        self.limits.measure_if_due()
        self.clock.begin(kick, drift)
        self.clock.shocked += self.clock.in_shock
        if self.tracks.vary:
            run_timed(self.timings, "tracks", self._sample.launch)
        for phase in range(len(self.workers[0].phases) - 1):
            self.runner.run(phase)
            if self.limits.probing and phase == self._summed:
                self.limits.measure_frequency()

    def end_step(self, drift: float) -> None:
        """Move the nodes for the time `drift` [s]."""
        self.runner.run(len(self.workers[0].phases) - 1)
        self.runner.join()
        self.clock.finish(drift)
        if self.crew.measuring:
            self.limits.read(drift)
            # The stress was computed before the nodes moved.
            self.clock.seen = max(self.clock.seen, self.clock.time - drift)

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot from which `restore` continues bit for bit.

        The points are not part of the snapshot, because their state is computed from the nodes.
        """
        nodes = self.nodes_state
        return {
            **super().snapshot(),
            "nodes": {name: wp.clone(getattr(nodes, name)) for name in NODES},
            "limits": self.limits.snapshot(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        for name, array in snapshot["nodes"].items():
            getattr(self.nodes_state, name).assign(array)
        super().restore(snapshot)
        self.crew.stray.zero_()
        self.crew.take_maxima()
        # The distances from moving walls refer to the time of the snapshot.
        self._place_walls()
        self.limits.look()
        self.limits.restore(snapshot["limits"])
        self.follow()
