"""Free bodies: rigid solids without particles that push the material and are pushed back.

Their place, turn and motion are on the device (phy124/kernels/free has the mechanics). They meet
each body of particles after the bodies have met each other, and before walls act.
"""

from __future__ import annotations

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
from phy124.mpm.grid import Grid
from phy124.mpm.model import Model
from phy124.mpm.pairs import fill_of
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Track, Tracks

STAGE = "free"
"""Name of the stages of free bodies."""
SOLUTIONS = 3
"""How often the six equations are solved in a substep, as contact and friction are known better.
The nodes that approach are mostly known after the first, how much friction they have after the
second; what is left is corrected in the next substep."""
MARGIN = 1.5
"""How far from a body nodes may touch it [cells]."""
POINTS = {"sphere": 1, "capsule": 2, "box": 8}
"""At how many points a wall may act on a shape."""
Vector3 = NDArray[np.float64]


class FreeBody(NamedTuple):
    """A rigid solid at the start."""

    name: str
    shape: str
    """sphere, box, or capsule."""
    half: tuple[float, float, float]
    """Half its sides along its own axes [m]."""
    place: tuple[float, float, float]
    """Its centre [m]."""
    turn: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Unit quaternion wxyz from its own axes to the world's."""
    density: float = 1000.0
    """Density [kg/m^3]."""
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Velocity [m/s]."""
    spin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Angular velocity [rad/s]."""
    friction: float = 0.5
    """Coefficient of Coulomb friction with material."""
    sticky: bool = False
    """Whether material sticks to it."""

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        if self.shape == "box":
            return 8 * math.prod(self.half)
        radius, length = min(self.half), max(self.half) - min(self.half)
        return math.pi * radius**2 * (4 / 3 * radius + 2 * length)

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return self.density * self.volume

    @property
    def moments(self) -> Vector3:
        """Moments of inertia about its own axes [3], kg m^2."""
        half = np.array(self.half)
        if self.shape == "box":
            return self.mass / 3 * ((half**2).sum() - half**2)
        radius, length = half.min(), half.max() - half.min()
        rod = self.density * math.pi * radius**2 * 2 * length
        balls = self.density * 4 / 3 * math.pi * radius**3
        along = rod * radius**2 / 2 + balls * 2 / 5 * radius**2
        # Of a half ball about its end, whose middle is 3/8 of the radius outward.
        across = rod * (radius**2 / 4 + length**2 / 3)
        across += balls * (2 / 5 * radius**2 + length**2 + 3 / 4 * length * radius)
        found = np.full(3, across)
        found[int(half.argmax())] = along
        return found

    def start(self) -> Vector3:
        """The numbers of phy124/kernels/free/numbers.py at time 0."""
        angular = self.axes * self.moments @ self.axes.T @ np.array(self.spin)
        return np.array([*self.place, *self.turn, *self.velocity, *angular, 0.0])

    @property
    def axes(self) -> NDArray[np.float64]:
        """Its own axes as columns [3,3]."""
        return rotation_matrices(np.array([self.turn]))[0]

    def depth(self, x: NDArray) -> NDArray[np.float64]:
        """How deep points [P,3] are inside it at the start [P], m; negative: outside."""
        own = np.abs((np.asarray(x, np.float64) - self.place) @ self.axes)
        if self.shape == "box":
            return np.min(self.half - own, axis=1, initial=np.inf)
        least = min(self.half)
        core = np.maximum(own - (np.array(self.half) - least), 0.0)
        return least - np.linalg.norm(core, axis=1)

    def geometry(self) -> Vector3:
        """The three vectors that the distance function of its shape reads [3,3], m."""
        half, least = np.array(self.half), min(self.half)
        if self.shape == "box":
            return np.stack([np.zeros(3), half, np.zeros(3)])
        if self.shape == "sphere":
            return np.array([[0.0] * 3, [least, 0.0, 0.0], [0.0] * 3])
        return np.stack([least - half, half - least, [least, 0.0, 0.0]])


class Plane(Protocol):
    """A flat wall that a free body meets."""

    @property
    def friction(self) -> float:
        """Coulomb friction coefficient."""
        ...

    @property
    def contact(self) -> str:
        """sticky, slip or separate."""
        ...

    def geometry(self, model: Model) -> Any:
        """A point [m] and the normal out of the wall."""
        ...

    def track(self, model: Model) -> Track | None:
        """Displacement over time [m]; None if it never moves."""
        ...


class FreeBodies:
    """All free bodies of one run."""

    def __init__(self, model: Model, given: Sequence[FreeBody]) -> None:
        """Put them where they start.

        Args:
            model: The particles.
            given: The bodies.

        Raises:
            InputError: One is thinner than two cells.
        """
        self.all = tuple(given)
        self._model = model
        for one in given:
            refuse_thin(one, model.dx)
        self._bodies, self._trials, self._systems, self._given = (
            [self._zeros(size) for _ in given]
            for size in (kernels.SIZE, kernels.TRIAL, kernels.SYSTEM, kernels.GIVEN)
        )
        for numbers, one in zip(self._bodies, given, strict=True):
            numbers.assign(one.start())
        self._totals = [[self._zeros(kernels.GIVEN) for _ in range(model.bodies)] for _ in given]
        self._begun = self._total()
        self._fill = fill_of(model) if given else []
        self._contacts = [
            wp.zeros((2 * reach + 2,) * 3, dtype=types(model.real).vec4, device=model.device)
            for reach in map(self._reach, given)
        ]

    def _zeros(self, size: int) -> wp.array:
        return wp.zeros(size, dtype=wp.float64, device=self._model.device)

    def _reach(self, one: FreeBody) -> int:
        """How many nodes from its centre it may touch one, whichever way it is turned."""
        far = float(np.linalg.norm(one.half)) if one.shape == "box" else max(one.half)
        return math.ceil(far / self._model.dx + MARGIN)

    def bind(self, planes: Sequence[Plane], tracks: Tracks) -> None:
        """Meet these flat walls from now on.

        Args:
            planes: The walls.
            tracks: Where their displacements are registered.
        """
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
            wp.zeros(len(planes) * POINTS[one.shape], dtype=wp.vec3d, device=device)
            for one in self.all
        ]

    def record(self, grid: Grid, body: int) -> list[Recorded]:
        """The launches by which all free bodies meet one body of particles, in order."""
        found = [
            launch for index in range(len(self.all)) for launch in self._meet(index, grid, body)
        ]
        return [(STAGE, launch) for launch in found]

    def _meet(self, index: int, grid: Grid, body: int) -> Iterable[wp.Launch | None]:
        one, model, t = self.all[index], self._model, types(self._model.real)
        real, contacts, tracks = model.real, self._contacts[index], self._tracks
        state, trial, given = self._bodies[index], self._trials[index], self._given[index]
        reach, moments = self._reach(one), wp.vec3d(*one.moments)
        kick = [moments, tracks.clock, tracks.values]
        yield model.launch(kernels.make_begin(real), 1, kick, [state, trial])
        shape = [t.mat33(*np.ravel(one.geometry())), reach, self._fill[body]]
        around = [grid.lattice, grid.window]
        touch, nodes = kernels.make_touch(one.shape, real), tuple(contacts.shape)
        yield model.launch(touch, nodes, [*shape, *around, state, grid.nodes], [contacts])
        how = [reach, one.friction, int(one.sticky), *around]
        for _ in range(SOLUTIONS):
            read = [*how, state, trial, contacts, grid.nodes]
            yield model.launch(kernels.make_assemble(real), nodes[:2], read, [self._systems[index]])
            yield self._acted(index, drifts=False)
        outputs = [grid.nodes, given]
        yield model.launch(
            kernels.make_apply(real), nodes[:2], [*how, state, trial, contacts], outputs
        )
        total = self._totals[index][body]
        yield model.launch(kernels.make_finish(real), 1, [one.mass, trial], [given, state, total])

    def drift(self) -> list[Recorded]:
        """The launches that end a substep: all move on."""
        return [(STAGE, self._acted(index, drifts=True)) for index in range(len(self.all))]

    def _acted(self, index: int, *, drifts: bool) -> wp.Launch | None:
        """The launch in which walls act on a body."""
        one, tracks = self.all[index], self._tracks
        inputs = [one.mass, wp.vec3d(*one.moments), wp.vec3d(*one.half), POINTS[one.shape]]
        inputs += [*self._walls, tracks.clock, tracks.values, tracks.rates]
        outputs = [self._impulses[index], self._systems[index], self._trials[index]]
        kernel = kernels.make_walls(drifts, self._model.real)
        return self._model.launch(kernel, 1, inputs, [*outputs, self._bodies[index]])

    def begin(self) -> None:
        """Start counting what they are given."""
        self._begun = self._total()

    def _total(self) -> NDArray[np.float64]:
        """What each has given each body of particles [F,bodies,GIVEN]."""
        rows = [[sums.numpy() for sums in of_one] for of_one in self._totals]
        return np.array(rows, float).reshape(len(self.all), self._model.bodies, kernels.GIVEN)

    def given(self) -> NDArray[np.float64]:
        """What all particles were given since the start: the `GIVEN` sums of the kernels."""
        return self._total().sum(axis=(0, 1))

    @property
    def _met(self) -> list[int]:
        """The bodies of particles that they meet."""
        return [body for body in range(self._model.bodies) if body not in self._model.held]

    @property
    def names(self) -> tuple[str, ...]:
        """A name for each that a body of particles acts on: that of the latter comes first."""
        called = self._model.names or tuple(map(str, range(self._model.bodies)))
        return tuple(f"{called[body]}_on_{one.name}" for one in self.all for body in self._met)

    def wrenches(self, seconds: float) -> list[Wrench]:
        """Mean wrench on each by each body of particles, in the order of `names`.

        The torques are about the origin.

        Args:
            seconds: Time since `begin` [s].
        """
        sums = -(self._total() - self._begun)[:, self._met] / seconds
        rows = sums.reshape(-1, kernels.GIVEN)
        return [Wrench(row[:3], row[kernels.MOMENT : kernels.MOMENT + 3]) for row in rows]

    def poses(self) -> NDArray[np.float64]:
        """Centre [m] and turn (wxyz) of each [F,7]."""
        return np.array([body.numpy()[:7] for body in self._bodies], np.float64).reshape(-1, 7)

    def motions(self) -> NDArray[np.float64]:
        """Velocity [m/s] and angular velocity [rad/s] of each [F,6]."""
        found = [self._motion(index) for index in range(len(self.all))]
        return np.array(found, np.float64).reshape(-1, 6)

    def _motion(self, index: int) -> Vector3:
        numbers = np.asarray(self._bodies[index].numpy(), np.float64)
        one = self.all[index]
        axes = rotation_matrices(numbers[None, kernels.TURN : kernels.VELOCITY])[0]
        spin = axes @ (axes.T @ numbers[kernels.ANGULAR : kernels.KICKED] / one.moments)
        return np.array([*numbers[kernels.VELOCITY : kernels.ANGULAR], *spin], np.float64)

    def fastest(self) -> float:
        """Largest speed of a point of any [m/s]."""
        found = zip(self.motions(), self.all, strict=True)
        speeds = [
            np.linalg.norm(m[:3]) + np.linalg.norm(m[3:]) * np.linalg.norm(one.half)
            for m, one in found
        ]
        return float(max(speeds, default=0.0))

    def snapshot(self) -> dict[str, Any]:
        """The state to continue from; empty if there are none."""
        if not self.all:
            return {}
        return {
            "bodies": np.array([body.numpy() for body in self._bodies]),
            "totals": self._total(),
            "begun": self._begun.copy(),
        }

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot."""
        if not self.all:
            return
        for body, kept in zip(self._bodies, snapshot["bodies"], strict=True):
            body.assign(kept)
        for of_one, kept in zip(self._totals, snapshot["totals"], strict=True):
            for sums, row in zip(of_one, kept, strict=True):
                sums.assign(row)
        self._begun = np.asarray(snapshot["begun"])


_GRIP = {"sticky": 1e9, "slip": 0.0}
"""Friction that stands for a way of contact; a body may leave a sticky wall."""


def refuse_thin(one: FreeBody, dx: float) -> None:
    """Make sure that material cannot pass through a body.

    Raises:
        InputError: It is thinner than two cells.
    """
    if min(one.half) < dx:
        raise InputError(
            f"objects ({one.name})", f"{2 * min(one.half):g} m",
            f"it is thinner than two grid cells of {dx:g} m, so things would pass through it.",
            "Make it thicker or the grid finer.",
        )  # fmt: skip


def kernels_of(shapes: Iterable[str], real: Any) -> list[Any]:
    """What free bodies of these shapes launch."""
    touch = [kernels.make_touch(shape, real) for shape in dict.fromkeys(shapes)]
    if not touch:
        return []
    makers = (kernels.make_begin, kernels.make_assemble, kernels.make_apply, kernels.make_finish)
    walls = [kernels.make_walls(drifts, real) for drifts in (False, True)]
    return [*touch, *walls, *(make(real) for make in makers)]
