"""Energies: sums the work on bodies in every substep, for each cause separately."""

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.lattice import work as at
from phy124.kernels.lattice.contact import DRIVEN
from phy124.kernels.work import WORK
from phy124.lattice.crew import Crew
from phy124.lattice.impulses import ContactWork
from phy124.lattice.meetings import Meetings
from phy124.lattice.shock import LatticeClock, in_shock_only
from phy124.lattice.solids import Solids
from phy124.lattice.walls import Nodes, Walls
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model
from phy124.mpm.stage import Named
from phy124.mpm.tracks import Tracks

STAGE = "dissipation"
"""Name under which reports list the time to sum the work."""
EXTERNAL = "external work"
"""Name under which reports list the time to sum impulse and work of forces on points."""
ROOM = 24
"""Length of each worker's array of sums, chosen so that no two workers write to one cache line."""


class Works(NamedTuple):
    """Work on all bodies since the start [J], by cause; negative if the bodies lost energy."""

    forces: float
    """Work of the uniform acceleration and of forces on points."""
    walls: float
    """Work due to the motion of walls."""
    held: float
    """Work due to the motion of clamps."""
    solids: float
    """Work of freely moving rigid solids, including friction."""
    elastic: float
    """Work of the elastic stress."""
    viscous: float
    """Work of the viscosity of materials."""
    shock: float
    """Work of the artificial viscosity."""
    friction: float
    """Work of the tangential impulses of walls."""
    impacts: float
    """Work of the normal impulses of walls and clamps, except the work due to their motion."""
    itself: float
    """Work of contact of bodies with themselves."""
    pairs: float
    """Work of contact between bodies."""


class Energies(Kept):
    """Adds kernel launches that sum work; sums nothing until `start` is called."""

    kept = ("_sums", "_clamps")

    def __init__(self, model: Model, nodes: Nodes, crew: Crew, clock: LatticeClock) -> None:
        self._model, self._nodes, self._crew, self._clock = model, nodes, crew, clock
        self._walls: Walls | None = None
        shape = len(crew.workers), ROOM
        self._sums = wp.zeros(shape, dtype=wp.float64, device=model.device)
        self._on = False
        self.pushes: wp.array | None = None
        """Sums of impulse and work of forces on points, per worker [W,16]; None if not summed."""
        self._clamps = np.zeros(2)
        """Work of replaced clamps, and the part due to the clamps' motion [J]."""

    def start(self) -> None:
        """Sum the work of all causes, starting when the kernel launches are next recorded."""
        crew = self._crew
        self._on, self._pools = True, {at.SHOCK: crew.new_pool()}
        if crew.viscous:
            self._pools[at.VISCOUS] = crew.new_pool()

    def attach(self, tracks: Tracks, walls: Walls, meetings: Meetings, free: Solids) -> None:
        """Sum the work of contact; call this before contact's kernel launches are recorded again.

        Args:
            tracks: The tracks of the run, with the clock.
            walls: The walls.
            meetings: Contact between bodies.
            free: Freely moving rigid solids.
        """
        self._clamps += self._of_clamps() if self._walls is not walls else 0
        self._walls, self._tracks = walls, tracks
        if self._on:
            first = cast("wp.array", self._sums[0])
            work = ContactWork(self._model, self._nodes, tracks, first)
            walls.work = meetings.work = free.work = work

    def extend(self, *, pushed: bool) -> None:
        """Insert phases into a substep, before the nodes move, that sum the work of the forces.

        `pushed` states whether forces act on points.
        """
        forces = [at.STRESS, at.PUSHED] if pushed else [at.STRESS]
        for index, worker in enumerate(self._crew.workers):
            works = []
            if self._on:
                works = [self._fill(index), self._multiply(index, forces)]
            if pushed and self.pushes is not None:
                works.append(self._exchange(index, self.pushes))
            worker.phases[-1:-1] = works

    def _fill(self, index: int) -> list[Named]:
        crew, worker = self._crew, self._crew.workers[index]
        pools = {key: crew.part_of(pool, index) for key, pool in self._pools.items()}
        clock = self._clock.values
        shock = [("clear", pools[at.SHOCK].zero_), *crew.shock(worker, clock, pools[at.SHOCK])]
        filled = in_shock_only(self._clock, shock)
        if at.VISCOUS in pools:
            filled += [("clear", pools[at.VISCOUS].zero_)]
            filled += crew.viscosity(worker, pools[at.VISCOUS])
        return _rename(filled)

    def _multiply(self, index: int, forces: Sequence[int]) -> list[Named]:
        crew, works = self._crew, []
        worker, known = crew.workers[index], (self._tracks, cast("wp.array", self._sums[index]))
        for key in forces:
            works += crew.work(worker, key, *known)
        for key, pool in self._pools.items():
            work = crew.work(worker, key, *known, pool)
            works += in_shock_only(self._clock, work) if key == at.SHOCK else work
        return _rename(works)

    def _exchange(self, index: int, sums: wp.array) -> list[Named]:
        crew, row = self._crew, cast("wp.array", sums[index])
        work = crew.push_work(crew.workers[index], self._tracks, row)
        return [(EXTERNAL, launch) for _, launch in work]

    def read(self) -> Works:
        """Return the work on all bodies since the start."""
        total: NDArray[Any] = np.asarray(self._sums.numpy()).sum(axis=0)
        walls = total[at.WALLS : at.WALLS + 3]
        clamps, held = self._clamps + self._of_clamps()
        viscous, shock = total[at.VISCOUS], total[at.SHOCK]
        works = Works(
            forces=total[at.UNIFORM] + total[at.PUSHED],
            walls=walls[at.DRIVEN],
            held=held,
            solids=total[at.SOLIDS : at.SOLIDS + 3].sum(),
            elastic=total[at.STRESS] - viscous - shock,
            viscous=viscous,
            shock=shock,
            friction=walls[at.RUBBED],
            impacts=walls[at.PRESSED] + clamps - held,
            itself=total[at.ITSELF : at.ITSELF + 3].sum(),
            pairs=total[at.PAIRS : at.PAIRS + 3].sum(),
        )
        return Works(*map(float, works))

    def clear(self) -> None:
        """Set all sums of work to zero."""
        self._sums.zero_()
        self._clamps = -self._of_clamps()

    def _of_clamps(self) -> NDArray[np.float64]:
        """Return the work of clamps, and the part due to the clamps' motion [2], J."""
        if self._walls is None:
            return np.zeros(2)
        rows = np.asarray(self._walls.sums.numpy(), np.float64)[self._walls.holding]
        return np.asarray(rows[:, [WORK, DRIVEN]].sum(axis=0), np.float64)


def _rename(launches: Sequence[Named]) -> list[Named]:
    """Rename kernel launches, so that reports count their time as time for summing work."""
    return [(STAGE, launch) for _, launch in launches]
