"""Base class of boundaries. A boundary has a shape, and acts on material that touches the shape."""

import math
from collections.abc import Callable, Iterable
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
from phy124.mpm.tracks import STILL, Track, Tracks
from phy124.schema.bounds import Name
from phy124.schema.region import Vector
from phy124.schema.section import Section, omit_default

Contact = Literal["sticky", "slip", "separate"]
REACH = -0.15
"""A node whose signed distance from a wall [cells] is smaller responds individually, not together
with its column of nodes.

A solid rests 0.6 to 0.9 cells above the highest plane of nodes that the wall stops. If the highest
stopped plane of nodes lies about 0.65 cells inside the wall, the body therefore rests on the wall's
surface. Plastic and fluid materials sink to the highest stopped plane of nodes, so `REACH` is used
only for nodes that belong to no column.
"""
MARGIN = 2.0
"""Largest distance in front of a wall [cells] at which a node may still respond to the wall."""
SWEEPS = 2
"""Number of passes per substep over the columns of nodes perpendicular to a curved wall. Such
columns cross, so each pass uses the velocities that other columns computed in the previous pass.
"""
SAME = 1.001
"""Largest ratio of densities that count as equal."""
THINNEST = 1.0
"""Smallest allowed half thickness of a solid [cells]. A thinner solid may contain no grid nodes."""
Corners = tuple[NDArray[np.float64], NDArray[np.float64]]
Recorder = Callable[[Grid], "wp.Launch | None"]


class Rest(Protocol):
    """Positions of the objects at rest. Some boundaries compute their own shape from these
    positions.
    """

    @property
    def rest(self) -> NDArray[np.float64]:
        """Positions at rest [P,3], m."""
        ...

    def rest_of(self, name: str | None) -> NDArray[np.float64]:
        """Return the rest positions of the named object [Q,3], m; None: of all objects."""
        ...

    def top_of(self, name: str | None) -> float:
        """Return the height of the named object's top [m]; None: of all objects."""
        ...


class Boundary(Section):
    """Base class of all boundaries, with the fields that describe the contact with material."""

    shape: ClassVar[str]
    thing: ClassVar[str] = "it"
    """Name, used in messages, of the boundary's part that may be too thin."""

    holds: ClassVar[bool] = False
    """Whether the boundary fixes material in place instead of only blocking it."""

    contact: Contact = "separate"
    """Contact with the material: sticky (no motion), slip (no normal motion), or separate (material
    may leave the surface, with friction).
    """
    friction: float = Field(default=0.4, ge=0, le=10)
    """Coulomb friction coefficient."""
    object: Name | None = omit_default(None, examples=["object"])
    """Name of the object on which the boundary acts. Default: all objects."""

    def geometry(self, model: Rest) -> tuple[Vector, Vector, Vector]:
        """Return the three vectors that the shape's distance function reads [m]."""
        raise NotImplementedError

    def extent(self, model: Model) -> Corners:
        """Return the corners of a box that contains the shape at rest [m]."""
        return np.full(3, -np.inf), np.full(3, np.inf)

    def bounds(self, model: Model) -> Corners:
        """Return the corners [m] of a box around the nodes that may respond to the shape at
        rest.
        """
        low, high = self.extent(model)
        margin = MARGIN * model.dx if self.at_surface(model.dx) else 0.0
        return low - margin, high + margin

    def at_surface(self, dx: float) -> bool:
        """Return whether contact is enforced at the exact surface instead of node by node."""
        return self.reach(dx) is None

    def columns_overlap(self, dx: float) -> bool:
        """Return whether a node may be in several columns of nodes perpendicular to the wall."""
        return self.at_surface(dx) and self.outline() not in FLAT

    @property
    def moves(self) -> bool:
        """Whether the boundary ever moves."""
        return False

    @property
    def tracked(self) -> bool:
        """Whether the boundary has a track: a table of the boundary's displacement over time.

        A boundary needs a track if it moves or stops acting.
        """
        return self.moves

    def kernels(self, real: Any, dx: float) -> list[Any]:
        """Return the kernels of the boundary's walls on a grid of spacing `dx` [m]."""
        overlap = any(part.columns_overlap(dx) for part in self.parts())
        settle = [make_settle(real)] if overlap else []
        return [part.kernel(real, dx) for part in self.parts()] + settle

    def kernel(self, real: Any, dx: float) -> Any:
        """Return the kernel that makes grid nodes respond to a simple wall."""
        make = make_contact if self.at_surface(dx) else make_collider
        return make(self.outline(), self.response(), real)

    def gentler(self) -> dict[str, Any]:
        """Return new field values that halve the strength of the boundary's action."""
        return {}

    def parts(self) -> list[Any]:
        """Return the boundary's simple walls, such as the two pads of a gripper."""
        return [self]

    def part_names(self) -> list[str]:
        """Return a name for each simple wall, in the order of `parts`."""
        return [str(number) for number in range(1, len(self.parts()) + 1)]

    def outline(self) -> str:
        """Return the name of the function that computes the distance from the shape."""
        return self.shape

    def response(self) -> str:
        """Return the name of the rule by which nodes respond (`kernels.columns.RESPONSES`)."""
        return self.contact

    def track(self, model: Rest) -> Track | None:
        """Return the displacement over time [m], or None if the boundary never moves."""
        return None

    def thickness(self) -> float:
        """Return half of the thickness of the solid [m]."""
        return np.inf

    def measure_depth(self, x: NDArray[np.float64], model: Rest) -> NDArray[np.float64]:
        """Return the depths [P], m, of points [P,3] inside the solid in its initial position.

        The depth is negative outside the solid, and -inf if the boundary is not a solid (such as a
        clamp).
        """
        return np.full(len(x), -np.inf)

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the boundary's stages: the response of the columns, then of nodes in several
        columns.

        Raises:
            InputError: The solid is too thin for the grid.
        """
        self.refuse_thin(model)
        del state
        slot = tracks.add(self.track(model) or STILL)
        name, recorders = type(self).__name__.lower(), [self._recorder(model, tracks, slot)]
        if self.columns_overlap(model.dx):
            recorders = SWEEPS * [*recorders, self._settler(model)]
        alone, updating = self.spans(model), None
        if self.at_surface(model.dx) and self.outline() in FLAT and self.object is None:
            updating = self._updater(model, tracks, slot)
        recorders = [self._of_object(model, recorder) for recorder in recorders]
        return [Stage(name, recorder, alone=alone, with_update=updating) for recorder in recorders]

    def _of_object(self, model: Model, recorder: Recorder) -> Recorder:
        """Return a recorder that skips the grids of objects on which the wall does not act."""
        if self.object is None:
            return recorder
        particles = model.named(self.object)
        return lambda grid: recorder(grid) if grid.particles == particles else None

    def spans(self, model: Model) -> bool:
        """Return whether a column of nodes may extend over several layers of nodes along x."""
        if not self.at_surface(model.dx):
            return False
        _, normal, _ = self.geometry(model)
        return self.outline() not in FLAT or abs(normal[0]) > 0.999 * max(map(abs, normal[1:]))

    def refuse_thin(self, model: Model) -> None:
        """Check that the solid is thick enough to stop material.

        Raises:
            InputError: The solid is thinner than two cells.
        """
        if self.thickness() < THINNEST * model.dx:
            raise InputError(
                f"boundaries.{type(self).__name__.lower()}",
                f"{2 * self.thickness():g} m",
                f"{self.thing} is thinner than two grid cells of {model.dx:g} m, "
                "so material would pass through it.",
                "Make the solid thicker, or use a finer grid.",
            )

    def reach(self, dx: float) -> float | None:
        """Return a signed distance from the wall [m]; nodes with a smaller distance respond to the
        wall.

        The result is None if contact is enforced at the exact surface.
        """
        return None

    def _settler(self, model: Model) -> Callable[[Grid], wp.Launch | None]:
        low, high = self._swept_bounds(model)

        def record(grid: Grid) -> wp.Launch | None:
            start, extent = grid.nodes_within(low - 2 * grid.dx, high + 2 * grid.dx)
            inputs, outputs = [wp.vec3i(*start.tolist()), grid.window], [grid.changes, grid.nodes]
            return model.launch(make_settle(model.real), tuple(extent), inputs, outputs)

        return record

    def _swept_bounds(self, model: Model) -> Corners:
        """Return the corners [m] of a box around all nodes that may respond at any time."""
        bounds, track = self.bounds(model), self.track(model)
        return bounds if track is None else swept(bounds, track)

    def _recorder(self, model: Model, tracks: Tracks, slot: int) -> Recorder:
        bounds, columns_overlap = self._swept_bounds(model), self.columns_overlap(model.dx)
        at_surface = self.at_surface(model.dx)
        kernel = self.kernel(model.real, model.dx)

        def record(grid: Grid) -> wp.Launch | None:
            start, extent = grid.nodes_within(*bounds)
            wall = [*self._wall(model, slot), wp.vec3i(*start.tolist())]
            threads: tuple[int, ...] = tuple(extent)
            if at_surface:
                threads, each = along_rows(extent, model.device)
                wall += [each, *_columns(model, grid)]
            inputs = [*wall, grid.lattice, grid.window, tracks.values, tracks.rates]
            outputs = [grid.nodes]
            if at_surface:
                outputs.append(grid.changes if columns_overlap else grid.nodes)
            return model.launch(kernel, threads, inputs, outputs)

        return record

    def _updater(self, model: Model, tracks: Tracks, slot: int) -> Recorder:
        """Return a function that records one launch for both the flat wall and the grid update."""
        bounds = self._swept_bounds(model)

        def record(grid: Grid) -> wp.Launch | None:
            start, extent = grid.nodes_within(*bounds)
            if not extent.all():
                return None
            # The kernel is created here, since most runs on a CPU never need it.
            shape, response = self.outline(), self.response()
            kernel = make_contact(shape, response, model.real, updating=True)
            box = [wp.vec3i(*corner.tolist()) for corner in (start, extent)]
            inputs = [*self._wall(model, slot), *box, *_columns(model, grid), grid.lattice]
            inputs += [grid.window, tracks.clock, tracks.values, tracks.rates, grid.momenta]
            threads = grid.count + int(np.prod(extent))
            return model.launch(kernel, threads, inputs, [grid.nodes])

        return record

    def _wall(self, model: Model, slot: int) -> list[Any]:
        """Return the kernel inputs that describe the wall: shape, friction, reach and track."""
        shape = types(model.real).mat33(*np.ravel(self.geometry(model)))
        reach = self.reach(model.dx)
        return [shape, self.friction, REACH * model.dx if reach is None else reach, slot]


def _columns(model: Model, grid: Grid) -> list[Any]:
    layers = wp.vec2i(*(grid.layers or (0, int(grid.size[0]))))
    run = grid.particles
    touch = [lightest(model, run), contact_mass_fraction(model, run), seep_distance(model, run)]
    return [layers, *touch]


class Movable(Boundary):
    """A boundary that may move: along a path, or in an oscillation."""

    motion: AnyMotion | None = None
    """Displacement over time: path or swing. Default: fixed."""

    @property
    def moves(self) -> bool:
        """Whether the boundary has a motion."""
        return self.motion is not None

    def track(self, model: Rest) -> Track | None:
        """Return the displacement over time [m], or None if the boundary never moves."""
        return None if self.motion is None else self.motion.track()

    def gentler(self) -> dict[str, Any]:
        """Return new field values that halve the speed of the motion."""
        slower = {} if self.motion is None else self.motion.gentler()
        return {f"motion.{name}": value for name, value in slower.items()}


def lightest(model: Model, run: slice) -> float:
    """Return the mass [kg] of a node that is full of the lightest material of a body.

    The result is infinite if no material of the body yields and all are equally dense. `run`
    contains the body's particles. Other bodies have grids of their own.

    In a material that yields, cells may contain up to 1.6 times as many particles as at rest
    without being compressed. Elastic material is always compressed in a cell that
    contains more mass than at rest.
    """
    least, most = model.densities_in(run)
    return least * model.dx**3 if yields(model, run) or most > SAME * least else math.inf


def contact_mass_fraction(model: Model, run: slice) -> float:
    """Return a mass at a wall, relative to the expected mass; with more mass, a body touches the
    wall.

    The fraction is 0.9 for solids, so contact begins 0.07 cells before the surfaces meet. With a
    smaller fraction, solids are too stiff at first contact. With a larger fraction, columns with
    few particles sink into the wall. The fraction is 0.8 for materials that yield, because their
    particles are spaced less regularly. Contact then begins 0.15 cells early.
    """
    return 0.8 if yields(model, run) else 0.9


def seep_distance(model: Model, run: slice) -> float:
    """Return a signed distance from a wall [m]; nodes with a smaller distance respond individually.

    The distance is used for columns of nodes that the wall does not push. The distance is finite
    for material that separates into drops or grains. With an infinite distance, drops and grains
    behind a wall would stay there while the other material moves away. For cohesive material the
    distance is minus infinity, because individual nodes would stop the material before it touches
    the wall.
    """
    laws = {group.law.name for group in model.groups_in(run)}
    apart = any(section.rounds for section in model.materials if section.device_law.name in laws)
    return REACH * model.dx if apart else -math.inf


def yields(model: Model, run: slice) -> bool:
    """Return whether a material of a body has a return mapping: plastic solid, sand, snow or
    liquid.
    """
    return any(group.law.project is not None for group in model.groups_in(run))


def vector(values: Iterable[float]) -> Vector:
    """Return three numbers as a tuple of floats."""
    x, y, z = values
    return float(x), float(y), float(z)


def swept(corners: Corners, track: Track) -> Corners:
    """Return the corners [m] of a box that contains a moving box at all times."""
    moves = np.array([key[1] for key in track.keys])
    return corners[0] + moves.min(axis=0), corners[1] + moves.max(axis=0)


def half_bounds(point: Vector, normal: Vector) -> Corners:
    """Return the corners [m] of the bounding box of a half-space.

    If the normal is oblique, the box is all space.
    """
    lower, upper = np.full(3, -np.inf), np.full(3, np.inf)
    across = np.flatnonzero(np.abs(normal) > 1e-9)
    if len(across) == 1:
        axis = across[0]
        (upper if normal[axis] > 0 else lower)[axis] = point[axis]
    return lower, upper


def box_of(lower: Vector, upper: Vector) -> tuple[Vector, Vector, Vector]:
    """Return the centre and the half sizes of a box [m], and an unused third vector."""
    low, high = np.array(lower), np.array(upper)
    return vector((low + high) / 2), vector((high - low) / 2), (0.0, 0.0, 0.0)
