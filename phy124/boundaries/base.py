"""What all boundaries have in common: a shape, and a response to what touches it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Literal, Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray
from pydantic import Field

from phy124.boundaries.motion import AnyMotion
from phy124.errors import InputError
from phy124.kernels.arguments import types
from phy124.kernels.collide import FLAT, make_collider, make_contact, make_settle
from phy124.kernels.reduction import along_rows
from phy124.mpm import Grid, Model, Stage, State
from phy124.mpm.tracks import Track, Tracks
from phy124.schema.bounds import Name
from phy124.schema.region import Vector
from phy124.schema.section import Section

Contact = Literal["sticky", "slip", "separate"]
REACH = -0.15
"""Signed distance [cells] below which a node that responds to a wall by itself does so.

A solid rests 0.6 to 0.9 cells above the last plane of nodes that moves freely. On average, the
plane that stops it must therefore lie about 0.65 cells inside the wall for the body to touch it.
Flowing material keeps no such distance and sinks to that plane, so this applies only to nodes that
belong to no column.
"""
MARGIN = 2.0
"""How far in front of a wall [cells] nodes may respond to it."""
SWEEPS = 2
"""How often columns that cross respond in a substep: each sees the others' changes in the next."""
THINNEST = 1.0
"""Smallest half thickness of a solid [cells]: nodes must lie inside it to stop anything."""
Corners = tuple[NDArray[np.float64], NDArray[np.float64]]
Recorder = Callable[[Grid], "wp.Launch | None"]


class Rest(Protocol):
    """The object at rest, on which the shape of a boundary may depend."""

    @property
    def rest(self) -> NDArray[np.float64]:
        """Positions at rest [P,3], m."""
        ...

    def rest_of(self, name: str | None) -> NDArray[np.float64]:
        """Positions at rest of the object of a name; None: of all."""
        ...


@dataclass(frozen=True, eq=False)
class AtRest:
    """An object at rest without a model of it."""

    rest: NDArray[np.float64]
    """Positions at rest [P,3], m."""

    def rest_of(self, name: str | None) -> NDArray[np.float64]:
        """Return all positions, since objects are not known here."""
        return self.rest


class Boundary(Section):
    """Base class of all boundaries: how they respond to material that touches them."""

    shape: ClassVar[str]
    thing: ClassVar[str] = "it"
    """What messages call the part that may be too thin."""

    holds: ClassVar[bool] = False
    """Whether it holds material in place instead of standing in its way."""

    contact: Contact = Field(
        default="separate", description="sticky, slip, or separate (may leave, with friction)."
    )
    friction: float = Field(default=0.4, ge=0, le=10, description="Coulomb friction coefficient.")
    object: Name | None = Field(
        default=None,
        exclude_if=lambda name: name is None,
        examples=["object"],
        description="Name of the only object that meets it; all do if absent.",
    )

    def geometry(self, model: Rest) -> tuple[Vector, Vector, Vector]:
        """Three vectors that the shape's distance function reads [m]."""
        raise NotImplementedError

    def extent(self, model: Model) -> Corners:
        """Corners of a box that contains the shape at rest [m]."""
        return np.full(3, -np.inf), np.full(3, np.inf)

    def bounds(self, model: Model) -> Corners:
        """Corners of a box that contains every node that may respond to the shape at rest [m]."""
        low, high = self.extent(model)
        margin = MARGIN * model.dx if self.at_surface(model.dx) else 0.0
        return low - margin, high + margin

    def at_surface(self, dx: float) -> bool:
        """Return whether contact is at the surface, between the nodes, and not node by node."""
        return self.reach(dx) is None

    def columns_overlap(self, dx: float) -> bool:
        """Return whether columns of nodes overlap, so that some nodes are in several."""
        return self.at_surface(dx) and self.outline() not in FLAT

    @property
    def moves(self) -> bool:
        """Whether it ever moves."""
        return False

    @property
    def tracked(self) -> bool:
        """Whether it has a track: it moves, or it ends."""
        return self.moves

    def kernels(self, real: Any, dx: float) -> list[Any]:
        """The kernels of its walls on a grid of spacing `dx` [m]."""
        overlap = any(part.columns_overlap(dx) for part in self.parts())
        settle = [make_settle(real)] if overlap else []
        return [part.kernel(real, dx, moving=part.tracked) for part in self.parts()] + settle

    def kernel(self, real: Any, dx: float, *, moving: bool) -> Any:
        """The kernel of a simple wall."""
        make = make_contact if self.at_surface(dx) else make_collider
        return make(self.outline(), self.response(), moving, real)

    def gentler(self) -> dict[str, Any]:
        """Return its fields with values for half the strength."""
        return {}

    def parts(self) -> list[Any]:
        """The simple walls that it consists of."""
        return [self]

    def part_names(self) -> list[str]:
        """Return a name for each of its simple walls, in their order."""
        return [str(number) for number in range(1, len(self.parts()) + 1)]

    def outline(self) -> str:
        """Name of its distance function."""
        return self.shape

    def response(self) -> str:
        """Return the name of the nodes' response (`kernels.columns.RESPONSES`)."""
        return self.contact

    def track(self, model: Rest) -> Track | None:
        """Displacement over time [m]; None if it never moves."""
        return None

    def thickness(self) -> float:
        """Half thickness of the solid [m]."""
        return np.inf

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Its collider; if columns cross, then what settles how their nodes change.

        Args:
            model: What stays the same during the run.
            state: Not used here.
            tracks: Where its displacement over time is registered.

        Raises:
            InputError: The solid is too thin for the grid.
        """
        self.refuse_thin(model)
        del state
        name, recorders = type(self).__name__.lower(), [self._recorder(model, tracks)]
        if self.columns_overlap(model.dx):
            recorders = SWEEPS * [*recorders, self._settler(model)]
        alone = self.spans(model)
        recorders = [self._of_object(model, recorder) for recorder in recorders]
        return [Stage(name, recorder, alone=alone) for recorder in recorders]

    def _of_object(self, model: Model, recorder: Recorder) -> Recorder:
        """Return a recorder that records nothing for objects that do not meet the wall."""
        if self.object is None:
            return recorder
        particles = model.named(self.object)
        return lambda grid: recorder(grid) if grid.particles == particles else None

    def spans(self, model: Model) -> bool:
        """Return whether its columns may cross layers of nodes along x."""
        if not self.at_surface(model.dx):
            return False
        _, normal, _ = self.geometry(model)
        return self.outline() not in FLAT or abs(normal[0]) > 0.999 * max(map(abs, normal[1:]))

    def refuse_thin(self, model: Model) -> None:
        """Make sure that nothing passes through the solid.

        Raises:
            InputError: It is thinner than two cells.
        """
        if self.thickness() < THINNEST * model.dx:
            raise InputError(
                f"boundaries.{type(self).__name__.lower()}",
                f"{2 * self.thickness():g} m",
                f"{self.thing} is thinner than two grid cells of {model.dx:g} m, "
                "so things would pass through it.",
                "Make it thicker or the grid finer.",
            )

    def reach(self, dx: float) -> float | None:
        """Signed distance below which a node responds [m]; None: depends on the material."""
        return None

    def _settler(self, model: Model) -> Callable[[Grid], wp.Launch | None]:
        """Return the recorder that settles the nodes of its columns, two cells past it."""
        low, high = self._swept_bounds(model)

        def record(grid: Grid) -> wp.Launch | None:
            start, extent = grid.nodes_within(low - 2 * grid.dx, high + 2 * grid.dx)
            inputs, outputs = [wp.vec3i(*start.tolist()), grid.window], [grid.changes, grid.nodes]
            return model.launch(make_settle(model.real), tuple(extent), inputs, outputs)

        return record

    def _swept_bounds(self, model: Model) -> Corners:
        """Corners of a box that contains every node that may ever respond to it [m]."""
        bounds, track = self.bounds(model), self.track(model)
        return bounds if track is None else swept(bounds, track)

    def _recorder(self, model: Model, tracks: Tracks) -> Callable[[Grid], wp.Launch | None]:
        t, track = types(model.real), self.track(model)
        slot = 0 if track is None else tracks.add(track)
        bounds, columns_overlap = self._swept_bounds(model), self.columns_overlap(model.dx)
        shape = t.mat33(*np.ravel(self.geometry(model)))
        at_surface, reach = self.at_surface(model.dx), self.reach(model.dx)
        kernel = self.kernel(model.real, model.dx, moving=track is not None)

        def record(grid: Grid) -> wp.Launch | None:
            start, extent = grid.nodes_within(*bounds)
            wall = [shape, self.friction, REACH * grid.dx if reach is None else reach, slot]
            wall.append(wp.vec3i(*start.tolist()))
            threads: tuple[int, ...] = tuple(extent)
            if at_surface:
                threads, each = along_rows(extent, model.device)
                wall.append(each)
                wall.append(wp.vec2i(*(grid.layers or (0, int(grid.size[0])))))
                wall += [lightest(model), contact_mass_fraction(model), seep_distance(model)]
            inputs = [*wall, grid.lattice, grid.window, tracks.values, tracks.rates]
            outputs = [grid.nodes]
            if at_surface:
                outputs.append(grid.changes if columns_overlap else grid.nodes)
            return model.launch(kernel, threads, inputs, outputs)

        return record


class Movable(Boundary):
    """A boundary that may follow a path, or swing."""

    motion: AnyMotion | None = Field(
        default=None, description="Its displacement over time: path or swing; absent: fixed."
    )

    @property
    def moves(self) -> bool:
        """Whether it has a motion."""
        return self.motion is not None

    def track(self, model: Rest) -> Track | None:
        """Displacement over time [m]; None if it never moves."""
        return None if self.motion is None else self.motion.track()


def lightest(model: Model) -> float:
    """Mass of a node inside the lightest material [kg]; infinite if all is one solid.

    A solid needs no such bound: a cell that is heavier than at rest is one that is compressed. The
    particles of a material that yields crowd in places, up to 1.6 times as many in a cell, without
    being compressed.
    """
    densities = {section.density for section in model.materials}
    return min(densities) * model.dx**3 if yields(model) or len(densities) > 1 else math.inf


def contact_mass_fraction(model: Model) -> float:
    """Return the fraction of the expected mass at a wall above which a body touches it.

    0.9 for solids, which meet it 0.07 cells early: less makes them stiff where they begin to touch,
    more lets columns with few particles sink in. 0.8, or 0.15 cells, for what yields, whose
    particles are less regular.
    """
    return 0.8 if yields(model) else 0.9


def seep_distance(model: Model) -> float:
    """Return the distance [m] below which nodes respond singly to a wall that does not push.

    What comes apart into drops and grains seeps through a wall otherwise: those that got behind it
    go on while the rest moves away. What holds together would feel the wall before it is there.
    """
    apart = any(section.rounds for section in model.materials)
    return REACH * model.dx if apart else -math.inf


def yields(model: Model) -> bool:
    """Whether any of the materials yields: a solid at its yield stress, sand, snow, a liquid."""
    return any(section.device_law.project is not None for section in model.materials)


def vector(values: Iterable[float]) -> Vector:
    """Return three numbers as a tuple of floats."""
    x, y, z = values
    return float(x), float(y), float(z)


def swept(corners: Corners, track: Track) -> Corners:
    """Return the corners of a box that contains a moving box at all times [m]."""
    moves = np.array([key[1] for key in track.keys])
    return corners[0] + moves.min(axis=0), corners[1] + moves.max(axis=0)


def half_bounds(point: Vector, normal: Vector) -> Corners:
    """Corners around the solid side of a plane [m], if its normal is an axis; else all of space."""
    lower, upper = np.full(3, -np.inf), np.full(3, np.inf)
    across = np.flatnonzero(np.abs(normal) > 1e-9)
    if len(across) == 1:
        axis = across[0]
        (upper if normal[axis] > 0 else lower)[axis] = point[axis]
    return lower, upper


def box_of(lower: Vector, upper: Vector) -> tuple[Vector, Vector, Vector]:
    """Centre and half sizes of the box [m], and a third vector that is not used."""
    low, high = np.array(lower), np.array(upper)
    return vector((low + high) / 2), vector((high - low) / 2), (0.0, 0.0, 0.0)
