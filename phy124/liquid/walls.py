"""Represents the boundaries of a scene as shapes with motion and friction, for a liquid."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp

from phy124.boundaries import Boundary
from phy124.kernels.arguments import types
from phy124.kernels.liquid import walls as kernels
from phy124.kernels.liquid.push_out import make_push_out
from phy124.kernels.liquid.solids import make_motions
from phy124.liquid.cells import Cells, Region
from phy124.mpm import FreeBodies, Model, State
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks

STAGE = "walls"


@dataclass(frozen=True, eq=False)
class Wall:
    """A single shape that the liquid does not enter."""

    name: str
    shape: str
    """Name of the distance function (phy124/kernels/distance.py); empty for a particle body."""
    geometry: Any
    """Three vectors, the arguments of the distance function [m]."""
    slot: int
    """Index of the track with the wall's displacement; 0: the wall never moves."""
    friction: float
    sticky: bool
    frame: wp.array
    """State of the freely moving solid (phy124/kernels/free/numbers.py); empty for other walls."""
    reach: float = math.inf
    """Largest distance from the centre of a freely moving solid to its surface [m]."""

    @property
    def moves(self) -> bool:
        """Whether the wall moves or disappears."""
        return self.slot > 0 or len(self.frame) > 0 or not self.shape


@dataclass(frozen=True, eq=False)
class Group:
    """Walls of one shape that all move or are all fixed; or one freely moving solid."""

    shape: str
    moves: bool
    reach: float
    """See `Wall.reach`."""
    first: int
    numbers: wp.array
    geometries: wp.array
    """Three vectors for each wall."""
    frame: wp.array
    """See `Wall.frame`."""


def walls_of(
    boundaries: Iterable[tuple[str, Boundary]], model: Model, tracks: Tracks
) -> Iterator[Wall]:
    """Yield the walls of boundaries; add the boundaries' motions to the tracks."""
    t = types(model.real)
    for name, boundary in boundaries:
        boundary.refuse_thin(model)
        parts = boundary.parts()
        for label, part in zip(boundary.part_names(), parts, strict=True):
            track = part.track(model)
            yield Wall(
                name if len(parts) == 1 else f"{name}_{label}",
                part.outline(),
                t.mat33(*np.ravel(part.geometry(model))),
                0 if track is None else tracks.add(track),
                0.0 if part.contact == "slip" else part.friction,
                part.contact == "sticky",
                wp.zeros(0, dtype=wp.float64, device=model.device),
            )


def walls_of_solids(bodies: FreeBodies, model: Model) -> Iterator[Wall]:
    """Yield the surfaces of solids as walls without friction."""
    t = types(model.real)
    for solid, frame in zip(bodies.all, bodies.numbers, strict=True):
        geometry = t.mat33(*np.ravel(solid.geometry()))
        reach = float(np.linalg.norm(solid.half))
        yield Wall(solid.name, solid.shape, geometry, 0, 0.0, False, frame, reach)


def walls_of_bodies(names: Iterable[str], model: Model) -> Iterator[Wall]:
    """Yield the surfaces of particle bodies as walls without friction."""
    none = wp.zeros(0, dtype=wp.float64, device=model.device)
    for name in names:
        yield Wall(name, "", None, 0, 0.0, False, none)


class Walls:
    """Kernel launches that write walls into the cells and move particles out of walls."""

    def __init__(self, model: Model, tracks: Tracks, walls: Sequence[Wall]) -> None:
        self._model, self._tracks, self.all = model, tracks, tuple(walls)
        t, device = types(model.real), model.device
        rows = [(wall.friction, float(wall.sticky)) for wall in walls] or [(0.0, 0.0)]
        self.frictions = model.array(rows, t.vec2)
        """For each wall: the coefficient of friction, and 1 if the liquid sticks to it, otherwise
        0.
        """
        slots = [wall.slot for wall in walls] or [0]
        self.slots = wp.array(np.array(slots, np.int32), dtype=int, device=device)
        """Index of each wall's track."""
        self.motions = wp.zeros((len(slots), 3), dtype=t.vec3, device=device)
        """Velocity, angular velocity and centre of each wall."""
        self.still = wp.zeros_like(self.motions)
        self.move = any(wall.moves for wall in walls)
        self.follow_tracks = any(slot > 0 for slot in slots)
        self.time = math.nan
        """Time for which the positions of the walls are stored in the cells [s]; NaN: unknown."""
        self._clock = wp.zeros(3, dtype=model.real, device=device)
        self._places, self._next = (wp.zeros_like(tracks.values) for _ in range(2))
        self._sample = tracks.record(self._clock, [self._next, wp.zeros_like(tracks.rates)])
        self._move = self._record_motions()
        self._groups = list(self._group_walls())
        self.rub = any(wall.friction > 0 or wall.sticky for wall in walls)

    def place(self, time: float) -> None:
        """Move all walls with tracks to their positions at a time [s]."""
        self.time = time
        if self.follow_tracks:
            self._clock.assign([0.0, 0.0, time])
            self._sample.launch()
            wp.copy(self._places, self._next)

    def lead(self, time: float) -> None:
        """Compute the mean velocities with which walls reach their positions at a time [s]."""
        if self.follow_tracks:
            self._clock.assign([0.0, 0.0, time])
            self._sample.launch()
            self._move.launch()

    def describe(
        self, cells: Cells, worker: int, workers: int, *, move: bool
    ) -> list[list[Recorded]]:
        """Return a worker's kernel launches that write the walls into the cells.

        Args:
            cells: The cells.
            worker: Index of the worker.
            workers: Number of workers.
            move: True: the moving walls are added; False: the fixed walls are written.

        Returns:
            Lists of launches; workers wait for each other between them. Each region has lists of
            its own, since a cell belongs to different workers in different regions.
        """
        regions: dict[Region, list[Group]] = {} if move else {cells.whole: []}
        for group in self._groups:
            if group.moves == move:
                regions.setdefault(cells.region(group.reach, group.first), []).append(group)
        distances, parts = [], []
        for region, groups in regions.items():
            each = [self._describe_group(cells, group, region, worker, workers) for group in groups]
            distances.append([distance for distance, _ in each])
            parts.append([part for _, parts_of_group in each for part in parts_of_group])
        shares = [self.share(cells, region, worker, workers) for region in regions]
        return [*distances, *parts, shares]

    def _describe_group(
        self, cells: Cells, group: Group, region: Region, worker: int, workers: int
    ) -> tuple[Recorded, list[Recorded]]:
        """Return the kernel launches for distances, and for the open parts of faces and cells."""
        model = self._model
        shape = [group.numbers, group.geometries, self.slots, cells.lattice, cells.window]
        shape += [self._places, group.frame, region.box]

        def record(make: Any, points: int, inputs: list, outputs: list) -> Recorded:
            first, count = span(points, worker, workers)
            kernel = make(group.shape, model.real)
            return STAGE, model.launch(kernel, count, [first, *shape, *inputs], outputs)

        size = region.size
        points, count = int(np.prod(2 * size + 1)), int(np.prod(size))
        near = [cells.distances]
        distance = record(kernels.make_wall_distance, points, [], [*near, cells.owners])
        openings = record(kernels.make_openings, count, near, [cells.open, cells.covers])
        return distance, [openings, record(kernels.make_eighths, 8 * count, near, [cells.eighths])]

    def share(self, cells: Cells, region: Region, worker: int, workers: int) -> Recorded:
        """Return a worker's kernel launch that computes the fractions of B-splines inside walls.

        Args:
            cells: The cells.
            region: Cells in which the fractions are computed.
            worker: Index of the worker.
            workers: Number of workers.
        """
        first, count = span(int(np.prod(region.size)), worker, workers)
        inputs = [first, cells.window, cells.lattice, region.box, cells.distances, cells.eighths]
        kernel = kernels.make_solid_shares(self._model.real)
        return STAGE, self._model.launch(kernel, count, inputs, [cells.shares])

    def _record_motions(self) -> Any:
        inputs = [self._tracks.clock, self._places, self._next, self.slots]
        kernel = make_motions(self._model.real)
        return self._model.launch(kernel, max(len(self.all), 1), inputs, [self.motions])

    def centre(self, cells: Cells) -> None:
        """Move the region around a freely moving solid to the solid's position."""
        for number, wall in enumerate(self.all):
            if len(wall.frame):
                region, x = cells.region(wall.reach, number), wall.frame.numpy()[:3]
                at = np.floor((np.asarray(x, np.float64) - cells.origin) / cells.dx).astype(int)
                region.place(at - cells.low - region.size // 2)

    def push_out(
        self, cells: Cells, run: slice, state: State, sums: wp.array, *, stops: bool
    ) -> list[Recorded]:
        """Return a worker's kernel launches that move particles out of all walls.

        Args:
            cells: The cells.
            run: The particles of the worker.
            state: Positions and velocities of all particles.
            sums: Sums of impulse, moment and work of each wall.
            stops: Whether the particles lose their velocity towards the wall.
        """
        model, tracks = self._model, self._tracks
        launches = []
        for group in self._groups:
            kernel = make_push_out(group.shape, model.real)
            inputs = [int(stops), group.numbers, group.geometries, self.slots, self.frictions]
            inputs += [model.mass[run], cells.lattice, cells.window, self._places]
            inputs += [tracks.clock, tracks.values, state.C[run]]
            inputs += [self.motions, group.frame, cells.distances]
            outputs = [state.x[run], state.v[run], sums]
            launch = model.launch(kernel, run.stop - run.start, inputs, outputs)
            launches.append((STAGE, launch))
        return launches

    def _group_walls(self) -> Iterator[Group]:
        t, device = types(self._model.real), self._model.device
        # Each freely moving solid is a separate group, since it has its own frame of reference.
        keys = [
            (wall.shape, wall.moves, wall.reach, number if len(wall.frame) else -1)
            for number, wall in enumerate(self.all)
        ]
        for key in dict.fromkeys(key for key in keys if key[0]):
            numbers = [index for index, other in enumerate(keys) if other == key]
            group = [self.all[index] for index in numbers]
            shapes = np.array([np.array(wall.geometry) for wall in group]).reshape(-1, 3, 3)
            yield Group(
                *key[:3],
                numbers[0],
                wp.array(np.array(numbers, np.int32), dtype=int, device=device),
                self._model.array(shapes, t.mat33),
                group[0].frame,
            )


def span(count: int, worker: int, workers: int) -> tuple[int, int]:
    """Return the first item of a worker, and the number of the worker's items."""
    first, last = (count * index // workers for index in (worker, worker + 1))
    return first, last - first


def wall_kernels(boundaries: Iterable[Boundary], solids: Iterable[str], real: Any) -> Iterator[Any]:
    """Yield the kernels for walls and for solids of these shapes."""
    yield from (kernels.make_solid_shares(real), make_motions(real))
    outlines = {part.outline() for wall in boundaries for part in wall.parts()}
    for shape in sorted(outlines | set(solids)):
        yield kernels.make_wall_distance(shape, real)
        yield from (make(shape, real) for make in (kernels.make_openings, kernels.make_eighths))
        yield make_push_out(shape, real)
