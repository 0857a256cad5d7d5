"""Couples a liquid to bodies of other materials, which another solver moves.

For the liquid, a body is a wall, whose shape is computed from the particles of the body. The bodies
move in substeps between the steps of the liquid.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.liquid import bodies as kernels
from phy124.kernels.liquid import films, shapes
from phy124.kernels.liquid.active import EMPTY
from phy124.liquid.cells import Cells, Region
from phy124.liquid.exchange import BodyWork
from phy124.liquid.layers import weigh_layers
from phy124.liquid.rigid import FreeSolids, Moments, Motion
from phy124.liquid.solids import Solids
from phy124.liquid.walls import Walls
from phy124.mpm import FreeBodies, Grid, Model, Stage, State
from phy124.mpm.kept import Kept
from phy124.mpm.model import part_of
from phy124.mpm.stage import Repeatable
from phy124.mpm.tracks import Tracks

STAGE = "bodies"
FIRST = 8
"""Number of steps in which the surface of a new body is fitted to the body's volume."""
MOST = 0.7
"""Largest shift of a body's surface [cells]."""
LIGHT = 0.05
"""A body is light if its density relative to the liquid is below this."""
YIELDED = 0.004


Expect = Callable[[float], tuple[wp.array, wp.array]]
"""Returns the mean velocities [m/s] and velocity gradients [1/s] of the particles in a step of a
duration [s].
"""


class Bodies(Kept):
    """The bodies of other materials in a run; each body is a wall for the liquid."""

    kept = (
        "_before",
        "_impulses",
        "_kick",
        "_shifts",
        "_centres",
        "_forces",
        "_films",
        "_period",
        "work",
    )

    def __init__(
        self,
        model: Model,
        state: State,
        grids: Sequence[Grid],
        free: FreeBodies,
        work: BodyWork,
        expect: Expect | None = None,
    ) -> None:
        """Allocate the arrays for the particles of the bodies.

        Args:
            model: The particles of the bodies and of the liquid.
            state: State of the particles.
            grids: Grid of each body; the grid's window covers the body.
            free: Freely moving rigid solids; they are numbered before the bodies.
            work: Object that sums the work of the pressure on the bodies.
            expect: Function that predicts the mean motion of the particles in a step; None: the
                present motion is used.
        """
        self._model, self._state, self._grids = model, state, grids
        self._expect, self._motion, self.work = expect, (state.v, state.C), work
        if expect is not None:  # The next motion is predicted under the last pressure.
            self.kept = (*self.kept, "limit", "pushes", "turns")
        self.numbers = work.numbers
        t, device, count = types(model.real), model.device, len(self.numbers)
        self.free, self.first = FreeSolids(model, free), len(free.all)
        self._moments = Moments(model, [model.particles(body) for body in self.numbers])
        self.pushes = wp.zeros(len(model), dtype=t.vec3, device=device)
        self.turns = wp.zeros(len(model), dtype=t.mat33, device=device)
        """Accelerations of the particles by the pressure [m/s^2], and the resulting rates of change
        of C [1/s^2].
        """
        self._most = wp.zeros(1, dtype=model.real, device=device)
        self._volumes = wp.zeros(3, dtype=wp.float64, device=device)
        self._rims = wp.zeros(6, dtype=wp.vec3d, device=device)
        self._shifts = np.full(model.bodies, np.nan)
        """Outward shift of each body's surface, which makes the enclosed volume equal to the body's
        volume [cells].
        """
        self._sizes = np.zeros(model.bodies)
        """Volume of each body in this step [cells]."""
        self.limit = 0.0
        """Largest acceleration of a body's particle by the pressure of the liquid [m/s^2]."""
        self._kick, self._pull = 0.0, np.zeros(3)
        self._period = self._lightest = math.inf
        """`period` and `light` with the initial stiffness [s]."""
        self._softened = 1.0
        """Current factor on the initial stiffness."""
        self._stiff = np.array([_stiffness(model, body) for body in self.numbers])
        self._stiffness = wp.array(self._stiff, dtype=wp.float64, device=device)
        every = self.first + count
        self._before = np.zeros((0, 2, 3))
        self._films = np.zeros((every, 2, 3))
        """Impulses and moments of thin films of liquid in the last step; `impulses` includes them.
        """
        self._centres, self._forces = np.zeros((every, 3)), np.zeros((every, 2, 3))
        """Centre of mass of each solid and body [m]; and the mean force [N] and torque [N m] on it
        in the last step, without the liquid's force and the weight.
        """
        self._impulses = np.zeros((every, 2, 3))
        """Impulse and moment of the liquid on each solid and body in the last step."""

    @property
    def names(self) -> list[str]:
        """Names of the bodies that are not liquid."""
        called = self._model.names or tuple(map(str, range(self._model.bodies)))
        return [called[body] for body in self.numbers]

    @property
    def impulses(self) -> NDArray[np.float64]:
        """Impulse [N s] and moment [N m s] of the liquid on each body in the last step [B,2,3].

        Moments are about the origin.
        """
        return self._impulses[self.first :]

    @property
    def period(self) -> float:
        """Shortest vibration period of bodies below a liquid [s]."""
        return self._period / math.sqrt(self._softened)

    @property
    def light(self) -> float:
        """Shortest vibration period of light bodies in the liquid [s]."""
        return self._lightest / math.sqrt(self._softened)

    def soften(self, factor: float) -> None:
        """Multiply the initial stiffness of all bodies by a factor."""
        self._softened = factor
        self._stiffness.assign(factor * self._stiff)

    def join(self, solids: Solids, mobility: wp.array) -> None:
        """Store the arrays of all solids; the bodies are the last entries."""
        self._solids, self._mobility = solids, mobility
        device, shape = self._model.device, (len(mobility), 2)
        self._present = wp.zeros(shape, dtype=wp.vec3d, device=device)
        self._exchanged = wp.zeros(shape, dtype=wp.vec3d, device=device)
        for body in self.numbers:
            volume, mass = _size(self._model, body)
            light = mass / volume * self._model.dx**3 < LIGHT * solids.scale
            if light and body not in self._model.held:
                period = 4 * volume ** (1 / 3) / _wave_speed(self._model, body)
                self._lightest = min(self._lightest, period)

    def attach(self, model: Model, state: State, tracks: Tracks) -> list[Stage]:
        """Return the stages that apply the pressure to the bodies in each substep."""
        kernel = kernels.make_body_push(model.real)

        def record(grid: Grid) -> wp.Launch | None:
            run = grid.run(len(model))
            inputs = [tracks.clock, self.pushes[run], self.turns[run]]
            outputs = [state.v[run], state.C[run]]
            return model.launch(kernel, run.stop - run.start, inputs, outputs)

        def limit(start: float, end: float) -> float:
            return self.limit

        return [Stage(STAGE, record, by_run=True, limit=limit), *self.free.attach(tracks)]

    def finish(self) -> None:
        """End the substeps of the bodies."""
        self.work.end(self.pushes, self.turns, self._drift)
        self.free.finish()
        self.limit = 0.0

    def fit(self, cells: Cells) -> None:
        """Allocate the arrays for a new window."""
        t, device, count = types(self._model.real), self._model.device, cells.count
        self._sheet = wp.zeros(count, dtype=t.vec4, device=device)
        self._full, self._level = (
            wp.zeros(count, dtype=self._model.real, device=device) for _ in range(2)
        )
        self._shares, self._vacant = wp.zeros_like(cells.shares), wp.zeros_like(cells.eighths)
        """Fractions of B-splines inside walls, and open fractions of the octants of cells, both
        without the bodies.
        """
        self.pressed, self._change, self._contact = (
            wp.zeros(count, dtype=t.vec3, device=device) for _ in range(3)
        )

    def describe(self, cells: Cells, walls: Walls, ahead: float) -> None:
        """Write the shape and the velocity of all bodies into the cells.

        The positions of bodies are extrapolated by `ahead` [s]; without this extrapolation, a
        floating body would gain energy.
        """
        self._ahead = ahead
        model, state, real = self._model, self._state, self._model.real
        if self._expect is not None and ahead > 0:
            self._motion = self._expect(2 * ahead)
        v, C = self._motion
        self._sheet.zero_()
        self._contact.zero_()
        wp.copy(self._shares, cells.shares)
        wp.copy(self._vacant, cells.eighths)
        for wall, body in enumerate(self.numbers, self._solids.first(walls) + self.first):
            self._full.zero_()
            self._level.fill_(float(EMPTY))
            run, region = model.particles(body), self._region(cells, body)
            inputs = [ahead, cells.lattice, cells.window, model.mass[run], model.volume[run]]
            inputs += [state.x[run], v[run], C[run], part_of(state.deformation, run)]
            kernel, count = shapes.make_body_scatter(real), run.stop - run.start
            self._launch(kernel, count, inputs, [self._sheet, self._full])
            size, box = int(np.prod(region.size)), region.box
            for _ in range(FIRST if np.isnan(self._shifts[body]) else 2):
                self._shape(cells, body, box, size)
            points = int(np.prod(2 * region.size + 1))
            inputs = [wall, cells.lattice, cells.window, box, self._level]
            outputs = [cells.distances, cells.owners]
            self._launch(shapes.make_body_distance(real), points, inputs, outputs)
            inputs, outputs = [cells.window, box, self._level], [cells.open, cells.eighths]
            self._launch(shapes.make_body_openings(real), size, inputs, outputs)
            inputs = [cells.window, box, self._level, cells.still[2], cells.open]
            self._launch(films.make_contact(real), size, inputs, [self._contact])
            for _, launch in [walls.share(cells, region, 0, 1)]:
                if launch is not None:
                    launch.launch()

    def _shape(self, cells: Cells, body: int, box: wp.array, count: int) -> None:
        real, shift = self._model.real, float(np.nan_to_num(self._shifts[body]))
        self._volumes.zero_()
        inputs = [shift, cells.lattice, cells.window, box, self._full, self._shares]
        outputs = [self._level, self._volumes]
        self._launch(shapes.make_body_level(real), count, inputs, outputs)
        inputs = [cells.window, box, self._level, self._vacant]
        self._launch(shapes.make_body_volume(real), count, inputs, [self._volumes])
        volume, inside, slope = np.asarray(self._volumes.numpy(), np.float64).tolist()
        self._sizes[body] = volume
        if volume > 0:
            shift += (volume - inside) / max(slope, 0.1 * float(volume ** (2 / 3)))
            self._shifts[body] = min(max(shift, -MOST), MOST)

    def plan(self, kick: float, pull: NDArray[np.float64]) -> None:
        """Predict the motion of solids and bodies in a step of `kick` [s] without the liquid's
        forces.

        `pull` [3] is the uniform acceleration [m/s^2].
        """
        motions = [*self.free.motions(), *self.motions()]
        expected = motions
        if self._expect is not None:
            predicted = self._moments.read(self._state.x, *self._motion)
            expected = [*motions[: self.first], *predicted]
        others = [self._other(index, motion, kick, pull) for index, motion in enumerate(motions)]
        plans, present, centres, mobility = (
            np.array(a.numpy())
            for a in (self._solids.plans, self._present, self._solids.centres, self._mobility)
        )
        for place, (motion, other) in enumerate(zip(motions, others, strict=True)):
            centres[place] = motion.centre + self._ahead * motion.momentum / motion.mass
            if place >= self.first and self.numbers[place - self.first] in self._model.held:
                mobility[place], plans[place], present[place] = 0.0, 0.0, 0.0
                continue
            mean = expected[place]
            present[place] = mean.momentum / mean.mass, mean.inverse @ mean.angular
            changed = motion.angular + other[1]
            plans[place] = (motion.momentum + other[0]) / motion.mass, motion.inverse @ changed
            scale = self._solids.scale
            mobility[place] = [scale / motion.mass, *(scale * motion.inverse).ravel()]
        self._solids.plans.assign(plans)
        self._solids.centres.assign(centres)
        self._present.assign(present)
        self._mobility.assign(mobility)
        self._exchanged.zero_()
        self.pressed.zero_()
        self._before = np.array([(motion.momentum, motion.angular) for motion in motions])
        self._centres = centres
        self._kick, self._pull = kick, pull

    def motions(self) -> list[Motion]:
        """Return the rigid motions of the bodies."""
        return self._moments.read(self._state.x, self._state.v, self._state.C)

    def _other(
        self, index: int, motion: Motion, kick: float, pull: NDArray[np.float64]
    ) -> tuple[NDArray, NDArray]:
        """Return the impulse [N s] and moment of all forces on a body except those of the liquid.

        A force other than the weight is included only as far as it acted in both of the last two
        steps, so an impact is not assumed to continue.
        """
        weight = np.stack([motion.mass * pull, np.zeros(3)])
        if not len(self._before) or self._kick == 0:
            return kick * weight[0], kick * weight[1]
        impulse, moment = self._impulses[index]
        moment = moment - np.cross(self._centres[index], impulse)
        before, angular = self._before[index]
        change = np.stack([motion.momentum - before - impulse, motion.angular - angular - moment])
        last, now = self._forces[index].copy(), change / self._kick - weight
        self._forces[index] = now
        both = np.where(last * now > 0, np.sign(now) * np.minimum(abs(now), abs(last)), 0.0)
        film = self._films[index] * kick / self._kick
        other, turn = kick * (weight + both) + film
        turn = turn - np.cross(self._centres[index], film[0])
        return other, turn

    def yields(self, cells: Cells, clock: wp.array, worker: int, real: Any) -> Repeatable | None:
        """Return a worker's kernel launch that adds the bodies' surfaces to the pressure equation.

        Args:
            cells: The cells.
            clock: Length of the step.
            worker: Index of the worker.
            real: Precision of the liquid.
        """
        inputs = [self.first, self._solids.scale, cells.lattice]
        inputs += [cells.window, clock, self._stiffness, cells.which, cells.jumps, self._sheet]
        inputs.append(self._present)
        inputs += [self._solids.centres, cells.pressure]
        outputs = [cells.diagonal, cells.right]
        return cells.record(worker, kernels.make_yield(real), inputs, outputs)

    def answer(self, walls: Walls, step: wp.array, model: Model) -> wp.Launch | None:
        """Return the kernel launch that writes the motions of solids and bodies after the pressure
        has acted.
        """
        inputs = [self._solids.first(walls), self._solids.scale, self._solids.plans]
        inputs += [self._solids.centres, self._mobility]
        outputs = [step, walls.motions, self._exchanged]
        return model.launch(kernels.make_answer(model.real), len(self._mobility), inputs, outputs)

    def receive(
        self, cells: Cells, tracks: Tracks, sums: wp.array, densities: wp.array | None, drift: float
    ) -> None:
        """Compute the accelerations of the bodies' particles due to the pressure of a step.

        Args:
            cells: The cells.
            tracks: Quantities that change over time.
            sums: Sums of the walls' impulses.
            densities: Relative densities in the cells; None if the density is uniform.
            drift: Duration over which the pressure acts on the bodies [s].
        """
        model, real = self._model, self._model.real
        self._drift = drift
        before = np.array(self._exchanged.numpy(), np.float64)
        self._period = math.inf
        for index in range(len(self.numbers)):
            self._press_film(cells, tracks, sums, densities, index)
            self._period = min(self._period, self._vibration(index))
        # The velocities of bodies are not half a step behind positions, so their first impulse is
        # not halved.
        exchanged, lasts = np.array(self._exchanged.numpy(), np.float64), drift / self._kick
        self._films, self._impulses = (exchanged - before) * lasts, exchanged * lasts
        solids = slice(self.first)
        self.free.receive(exchanged[solids], self._centres[solids], self._kick, drift)
        self._change.zero_()
        self._most.zero_()
        moving = [body for body in self.numbers if body not in model.held]
        for body in moving:
            region = self._region(cells, body)
            inputs = [cells.window, region.box, self._sheet, self.pressed, cells.jumps]
            count = int(np.prod(region.size))
            self._launch(kernels.make_body_change(real), count, inputs, [self._change])
        for body in moving:
            run = model.particles(body)
            inputs = [self._ahead, self._kick, cells.lattice, cells.window]
            inputs += [self._state.x[run], self._motion[0][run], self._change]
            outputs = [self.pushes[run], self.turns[run], self._most]
            self._launch(kernels.make_body_gather(real), run.stop - run.start, inputs, outputs)
        self.limit = float(self._most.numpy()[0])

    def _press_film(
        self, cells: Cells, tracks: Tracks, sums: wp.array, densities: wp.array | None, index: int
    ) -> None:
        real, solid = self._model.real, self.first + index
        region = self._region(cells, self.numbers[index])
        count, box = int(np.prod(region.size)), region.box
        self._rims.zero_()
        layers = weigh_layers(self._model, cells, region, densities, self._pull)
        grid = [box, cells.lattice, cells.window, tracks.clock, tracks.values]
        surface = [cells.which, cells.liquid, cells.jumps, cells.pressure]
        inputs = [solid, *layers, *grid, *surface, self._contact]
        self._launch(films.make_head(real), count, inputs, [self._rims])
        inputs = [solid, self._rims, self._solids.scale, *layers, *grid, *surface]
        fixed, owners, _ = cells.still
        inputs += [fixed, owners, self._contact]
        outputs = [self.pressed, sums, self._exchanged]
        self._launch(films.make_film(real), count, inputs, outputs)

    def _vibration(self, index: int) -> float:
        """Return the vibration period [s] of a body on a wall, with the initial stiffness: four
        times the time in which a wave crosses the body. The period is infinite if liquid surrounds
        the contact area.
        """
        _, rims, areas = np.asarray(self._rims.numpy(), np.float64).T
        dry = (areas > 0) & (rims < 2 * np.sqrt(areas))
        body = self.numbers[index]
        if body in self._model.held or not dry.any():
            return math.inf
        height = self._model.dx * self._sizes[body] / areas[dry].max()
        return 4 * float(height) / _wave_speed(self._model, body)

    def push_out(self, cells: Cells, walls: Walls, model: Model, x: Any) -> wp.Launch | None:
        """Return the kernel launch that moves particles of the liquid out of the bodies.

        Args:
            cells: The cells.
            walls: The walls.
            model: The particles of the liquid.
            x: Positions of a worker's particles [P,3], m.
        """
        inputs = [self._solids.first(walls) + self.first, cells.lattice, cells.window]
        inputs += [cells.distances, cells.owners]
        return model.launch(shapes.make_body_push_out(model.real), len(x), inputs, [x])

    def _region(self, cells: Cells, body: int) -> Region:
        grid = self._grids[body]
        region = Region(np.asarray(grid.size, int) + 2, self._model.device)
        region.place(np.asarray(grid.low, int) - 1 - cells.low)
        return region

    def _launch(self, kernel: Any, count: int, inputs: list, outputs: list) -> None:
        wp.launch(kernel, count, inputs=inputs, outputs=outputs, device=self._model.device)


Advance = Callable[[float], None]


def _stiffness(model: Model, body: int) -> float:
    """Return the stiffness of a body per surface cell [N/m]. A surface that is too stiff would
    create energy.
    """
    if body in model.held:
        return math.inf
    volume, mass = _size(model, body)
    limits = [getattr(m, "yield_stress", math.inf) / YIELDED for m in _materials(model, body)]
    modulus = min(mass / volume * _wave_speed(model, body) ** 2, *limits)
    return float(modulus * model.dx**2 / volume ** (1 / 3))


def _size(model: Model, body: int) -> tuple[float, float]:
    run = model.particles(body)
    volume, mass = (np.sum(a.numpy()[run], dtype=np.float64) for a in (model.volume, model.mass))
    return float(volume), float(mass)


def _wave_speed(model: Model, body: int) -> float:
    """Return the smallest speed of elastic waves in a body [m/s]."""
    return min(material.wave_speed() for material in _materials(model, body))


def _materials(model: Model, body: int) -> list[Any]:
    laws = {group.law.name for group in model.groups if group.body == body}
    return [material for material in model.materials if material.device_law.name in laws]
