"""Free bodies: rigid solids without particles that move freely and exchange momentum with material.

The position, orientation and motion of free bodies are stored on the device; phy124/kernels/free
explains the mechanics.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.gaussians import Wrench, rotation_matrices
from phy124.kernels import free as kernels
from phy124.kernels.arguments import types
from phy124.mpm.depth import measure_depth
from phy124.mpm.grid import Grid
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model
from phy124.mpm.pairs import fill_of
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Track, Tracks

STAGE = "free"
"""Name under which reports list the time for freely moving solids."""
SOLUTIONS = 3
"""Number of times that a solid's six equations of motion are solved in each substep. The first
solution finds most of the nodes that approach the solid, and the second solution finds most of the
friction.
"""
MARGIN = 1.5
"""Nodes of the grid up to this distance from a solid can be in contact with the solid [cells]."""
POINTS = {"sphere": 1, "capsule": 2, "box": 8}
"""For each shape of a solid, the number of points at which a flat wall may act on the solid."""
Vector3 = NDArray[np.float64]


class FreeBody(NamedTuple):
    """A freely moving rigid solid in its initial state."""

    name: str
    shape: str
    """Shape of the solid: sphere, box, or capsule."""
    half: tuple[float, float, float]
    """Half of the solid's side lengths along its local axes [m]."""
    place: tuple[float, float, float]
    """Centre of the solid [m]."""
    turn: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Orientation of the solid: unit quaternion wxyz from its local axes to the world axes."""
    density: float = 1000.0
    """Density of the solid [kg/m^3]."""
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Initial velocity of the solid [m/s]."""
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Initial angular velocity of the solid [rad/s]."""
    friction: float = 0.5
    """Coefficient of Coulomb friction with material."""
    sticky: bool = False
    """Whether material sticks to the solid."""

    @property
    def volume(self) -> float:
        """Volume of the solid [m^3]."""
        if self.shape == "box":
            return 8 * math.prod(self.half)
        radius, length = min(self.half), max(self.half) - min(self.half)
        return math.pi * radius**2 * (4 / 3 * radius + 2 * length)

    @property
    def mass(self) -> float:
        """Mass of the solid [kg]."""
        return self.density * self.volume

    @property
    def moments(self) -> Vector3:
        """Moments of inertia of the solid about its local axes [3], kg m^2."""
        half = np.array(self.half)
        if self.shape == "box":
            return self.mass / 3 * ((half**2).sum() - half**2)
        radius, length = half.min(), half.max() - half.min()
        rod = self.density * math.pi * radius**2 * 2 * length
        balls = self.density * 4 / 3 * math.pi * radius**3
        along = rod * radius**2 / 2 + balls * 2 / 5 * radius**2
        # Moment of a half ball about its flat side; the centre of mass is 3/8 of the radius away
        # from this side.
        across = rod * (radius**2 / 4 + length**2 / 3)
        across += balls * (2 / 5 * radius**2 + length**2 + 3 / 4 * length * radius)
        moments = np.full(3, across)
        moments[int(half.argmax())] = along
        return moments

    @property
    def levers(self) -> Vector3:
        """For each local axis, 1 if pressure can turn the solid about the axis [3]; 0 for an axis
        of symmetry.
        """
        levers = np.full(3, float(self.shape != "sphere"))
        if self.shape == "capsule":
            levers[int(np.argmax(self.half))] = 0.0
        return levers

    def start(self) -> Vector3:
        """Return the state at time 0 in the layout of phy124/kernels/free/numbers.py."""
        angular = self.axes * self.moments @ self.axes.T @ np.array(self.spin)
        return np.array([*self.place, *self.turn, *self.velocity, *angular, 0.0])

    @property
    def axes(self) -> NDArray[np.float64]:
        """Local axes of the solid as columns [3,3]."""
        return rotation_matrices(np.array([self.turn]))[0]

    def measure_depth(self, x: NDArray) -> NDArray[np.float64]:
        """Return the initial depths [P], m, of points [P,3] inside the solid; negative outside."""
        local = (np.asarray(x, np.float64) - self.place) @ self.axes
        return measure_depth(self.shape, self.geometry(), local)

    def reach(self, direction: Vector3) -> float:
        """Return the extent of the solid from its centre along a unit vector [m]."""
        half, along = np.array(self.half), np.abs(direction @ self.axes)
        radius = 0.0 if self.shape == "box" else min(self.half)
        return float(radius + along @ (half - radius))

    def geometry(self) -> Vector3:
        """Return the three vectors that the shape's distance function reads [3,3], m."""
        half, least = np.array(self.half), min(self.half)
        if self.shape == "box":
            return np.stack([np.zeros(3), half, np.zeros(3)])
        if self.shape == "sphere":
            return np.array([[0.0] * 3, [least, 0.0, 0.0], [0.0] * 3])
        return np.stack([least - half, half - least, [least, 0.0, 0.0]])


class Plane(Protocol):
    """A flat wall with which freely moving solids collide."""

    @property
    def friction(self) -> float:
        """Coulomb friction coefficient of the wall."""
        ...

    @property
    def contact(self) -> str:
        """Kind of contact with the wall: sticky, slip or separate."""
        ...

    def geometry(self, model: Model) -> Any:
        """Return a point on the flat wall [m], and the normal that points out of the wall."""
        ...

    def track(self, model: Model) -> Track | None:
        """Return the displacement of the wall over time [m], or None if the wall never moves."""
        ...


class FreeBodies(Kept):
    """All freely moving solids of a run."""

    kept = ("_bodies", "_totals", "_begun")

    def __init__(self, model: Model, solids: Sequence[FreeBody]) -> None:
        """Place the solids in their initial states.

        Raises:
            InputError: A solid is thinner than two cells.
        """
        self.all = tuple(solids)
        self._model = model
        for solid in solids:
            refuse_thin(solid, model.dx)
        self._bodies, self._trials, self._systems, self._changes = (
            [self._zeros(size) for _ in solids]
            for size in (kernels.SIZE, kernels.TRIAL, kernels.SYSTEM, kernels.EXCHANGE)
        )
        for numbers, solid in zip(self._bodies, solids, strict=True):
            numbers.assign(solid.start())
        self._totals = [
            [self._zeros(kernels.EXCHANGE) for _ in range(model.bodies)] for _ in solids
        ]
        self._begun = self._total()
        self._fill = fill_of(model) if solids else []
        self._contacts = [
            wp.zeros((2 * reach + 2,) * 3, dtype=types(model.real).vec4, device=model.device)
            for reach in map(self._reach, solids)
        ]

    @property
    def numbers(self) -> list[wp.array]:
        """State of each solid on the device, in the layout of phy124/kernels/free/numbers.py."""
        return self._bodies

    def total(self, index: int) -> wp.array:
        """Return the sums [EXCHANGE] of a solid's impulse and work on the first particle body."""
        return self._totals[index][0]

    def _zeros(self, size: int) -> wp.array:
        return wp.zeros(size, dtype=wp.float64, device=self._model.device)

    def _reach(self, solid: FreeBody) -> int:
        """Return the largest distance between the solid's centre and a node that the solid can
        touch [nodes].
        """
        far = float(np.linalg.norm(solid.half)) if solid.shape == "box" else max(solid.half)
        return math.ceil(far / self._model.dx + MARGIN)

    def bind(self, planes: Sequence[Plane], tracks: Tracks) -> None:
        """Replace the flat walls that stop the solids, and add the walls' motions to the tracks."""
        if not self.all:
            return
        model, device = self._model, self._model.device
        moved = [plane.track(model) for plane in planes]
        slots = [-1 if track is None else tracks.add(track) for track in moved]
        ends = [np.array(plane.geometry(model)[:2], float) for plane in planes]
        planar = np.array(ends).reshape(len(planes), 2, 3)
        grips = [_GRIP.get(plane.contact, plane.friction) for plane in planes]
        self._tracks = tracks
        self._walls = [
            wp.array(planar, dtype=wp.vec3d, device=device),
            wp.array(np.array(grips, float), dtype=wp.float64, device=device),
            wp.array(np.array(slots, np.int32), dtype=int, device=device),
        ]
        self._impulses = [
            wp.zeros(len(planes) * POINTS[solid.shape], dtype=wp.vec3d, device=device)
            for solid in self.all
        ]

    def record(self, grid: Grid, body: int) -> list[Recorded]:
        """Return the launches for the contact of all solids with a particle body, in order."""
        solids = range(len(self.all))
        launches = (launch for index in solids for launch in self._meet(index, grid, body))
        return [(STAGE, launch) for launch in launches]

    def _meet(self, index: int, grid: Grid, body: int) -> Iterable[wp.Launch | None]:
        solid, model, t = self.all[index], self._model, types(self._model.real)
        real, contacts, tracks = model.real, self._contacts[index], self._tracks
        state, trial, changes = self._bodies[index], self._trials[index], self._changes[index]
        reach, moments = self._reach(solid), wp.vec3d(*solid.moments)
        kick = [moments, tracks.clock, tracks.values]
        yield model.launch(kernels.make_begin(real), 1, kick, [state, trial])
        shape = [t.mat33(*np.ravel(solid.geometry())), reach, self._fill[body]]
        around = [grid.lattice, grid.window]
        touch, nodes = kernels.make_touch(solid.shape, real), tuple(contacts.shape)
        yield model.launch(touch, nodes, [*shape, *around, state, grid.nodes], [contacts])
        how = [reach, solid.friction, int(solid.sticky), *around]
        for _ in range(SOLUTIONS):
            read = [*how, state, trial, contacts, grid.nodes]
            yield model.launch(kernels.make_assemble(real), nodes[:2], read, [self._systems[index]])
            yield self._walls_launch(index, drifts=False)
        outputs = [grid.nodes, changes]
        yield model.launch(
            kernels.make_apply(real), nodes[:2], [*how, state, trial, contacts], outputs
        )
        total = self._totals[index][body]
        yield model.launch(
            kernels.make_finish(real), 1, [solid.mass, trial], [changes, state, total]
        )

    def drift(self) -> list[Recorded]:
        """Return the kernel launches that move all solids at the end of a substep."""
        return [(STAGE, self._walls_launch(index, drifts=True)) for index in range(len(self.all))]

    def _walls_launch(self, index: int, *, drifts: bool) -> wp.Launch | None:
        solid, tracks = self.all[index], self._tracks
        inputs = [solid.mass, wp.vec3d(*solid.moments), wp.vec3d(*solid.half), POINTS[solid.shape]]
        inputs += [*self._walls, tracks.clock, tracks.values, tracks.rates]
        outputs = [self._impulses[index], self._systems[index], self._trials[index]]
        kernel = kernels.make_walls(drifts, self._model.real)
        return self._model.launch(kernel, 1, inputs, [*outputs, self._bodies[index]])

    def add(self, index: int, body: int, row: NDArray) -> None:
        """Add the impulse and the work of a solid on a particle body to the running sums.

        `row` [EXCHANGE] has the layout of phy124/kernels/free/numbers.py.
        """
        sums = self._totals[index][body]
        sums.assign(np.asarray(sums.numpy(), np.float64) + row)

    def begin(self) -> None:
        """Start summing the impulses between solids and particles."""
        self._begun = self._total()

    def _total(self) -> NDArray[np.float64]:
        """Return the sums of impulse and work of each solid on each body [F,bodies,EXCHANGE]."""
        rows = [[sums.numpy() for sums in of_one] for of_one in self._totals]
        return np.array(rows, float).reshape(len(self.all), self._model.bodies, kernels.EXCHANGE)

    def impulses(self) -> NDArray[np.float64]:
        """Return the sums of impulse and work of all solids on all particles [EXCHANGE]."""
        return self._total().sum(axis=(0, 1))

    def works(self) -> NDArray[np.float64]:
        """Return the work [J] of each solid on each body since the start of the run [F,bodies]."""
        return self._total()[..., kernels.WORK]

    @property
    def _met(self) -> list[int]:
        """Indices of the particle bodies that the solids can touch."""
        wet = sorted(self._model.wet)
        # The sums of all liquids are stored for the first liquid.
        still = self._model.held | set(wet[1:])
        return [body for body in range(self._model.bodies) if body not in still]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all pairs of a particle body and a solid, such as `body_on_solid`."""
        return tuple(f"{body}_on_{solid}" for body, solid in self.pairs)

    @property
    def pairs(self) -> list[tuple[str, str]]:
        """Names of the particle body and the solid of each pair."""
        called = self._model.names or tuple(map(str, range(self._model.bodies)))
        return [(called[body], solid.name) for solid in self.all for body in self._met]

    def wrenches(self, seconds: float) -> list[Wrench]:
        """Return the mean wrench of each particle body on each solid since the call of `begin`.

        `begin` was called `seconds` ago. The order is that of `names`. Torques are about the
        origin.
        """
        sums = -(self._total() - self._begun)[:, self._met] / seconds
        rows = sums.reshape(-1, kernels.EXCHANGE)
        return [Wrench(row[:3], row[kernels.MOMENT : kernels.MOMENT + 3]) for row in rows]

    def put(self, index: int, motion: Sequence[Any]) -> None:
        """Set the position [m], orientation (wxyz), velocity [m/s] and spin [rad/s] of a solid."""
        place, turn, velocity, spin = (tuple(map(float, each)) for each in motion)
        moved = self.all[index]._replace(place=place, turn=turn, velocity=velocity, spin=spin)
        self._bodies[index].assign(moved.start())

    def poses(self) -> NDArray[np.float64]:
        """Return the centre [m] and the orientation (wxyz) of each solid [F,7]."""
        return np.array([body.numpy()[:7] for body in self._bodies], np.float64).reshape(-1, 7)

    def motions(self) -> NDArray[np.float64]:
        """Return the velocity [m/s] and the angular velocity [rad/s] of each solid [F,6]."""
        rows = [self._motion(index) for index in range(len(self.all))]
        return np.array(rows, np.float64).reshape(-1, 6)

    def _motion(self, index: int) -> Vector3:
        numbers = np.asarray(self._bodies[index].numpy(), np.float64)
        solid = self.all[index]
        axes = rotation_matrices(numbers[None, kernels.TURN : kernels.VELOCITY])[0]
        spin = axes @ (axes.T @ numbers[kernels.ANGULAR : kernels.KICKED] / solid.moments)
        return np.array([*numbers[kernels.VELOCITY : kernels.ANGULAR], *spin], np.float64)

    def fastest(self) -> float:
        """Return an upper bound [m/s] of the speed of any point of a solid."""
        if not self.all:  # Lattices call this method several times per substep.
            return 0.0
        pairs = zip(self.motions(), self.all, strict=True)
        speeds = [
            np.linalg.norm(m[:3]) + np.linalg.norm(m[3:]) * np.linalg.norm(solid.half)
            for m, solid in pairs
        ]
        return float(max(speeds, default=0.0))


_GRIP = {"sticky": 1e9, "slip": 0.0}
"""Friction coefficients of the kinds of contact that do not use the scene's coefficient."""


def refuse_thin(solid: FreeBody, dx: float) -> None:
    """Check that a solid is thick enough to stop material.

    Raises:
        InputError: The solid is thinner than two cells.
    """
    if min(solid.half) < dx:
        thickness = f"{2 * min(solid.half):g} m"
        limit = f"it is thinner than two grid cells of {dx:g} m, so material would pass through it."
        remedy = "Make the solid thicker, or use a finer grid."
        raise InputError(f"objects ({solid.name})", thickness, limit, remedy)


def kernels_of(shapes: Iterable[str], real: Any) -> list[Any]:
    """Return the kernels for free bodies of the given shapes."""
    touch = [kernels.make_touch(shape, real) for shape in dict.fromkeys(shapes)]
    if not touch:
        return []
    makers = (kernels.make_begin, kernels.make_assemble, kernels.make_apply, kernels.make_finish)
    walls = [kernels.make_walls(drifts, real) for drifts in (False, True)]
    return [*touch, *walls, *(make(real) for make in makers)]
