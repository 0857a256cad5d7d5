"""Solids: freely moving rigid solids, which exchange impulses with the surface points of bodies.

Each impulse acts on the solid and, with the opposite sign, on the body, so that momentum is
conserved.
"""

import itertools
import math
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from typing import Any, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.free import make_walls
from phy124.kernels.lattice import solids as kernels
from phy124.kernels.lattice.contact import MOMENT, SUMS, make_account
from phy124.kernels.lattice.rows import rows_for
from phy124.kernels.lattice.work import SOLIDS
from phy124.kernels.launches import put
from phy124.kernels.work import EXCHANGE, IMPULSE
from phy124.lattice.clamps import PassedOn, distances_from
from phy124.lattice.equal import find_equal
from phy124.lattice.gaps import initial_gaps
from phy124.lattice.impulses import ContactWork
from phy124.lattice.surface import EVEN, Surface
from phy124.lattice.walls import AHEAD, CLOSE, REACH, Nodes
from phy124.mpm.free import POINTS, STAGE, FreeBodies, FreeBody, Plane
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model
from phy124.mpm.stage import Named, launches
from phy124.mpm.tracks import Tracks

DEEPEST = 0.5
"""If a point on a flat part of a body's surface is at most this deep inside a box [cells], the
contact force may be normal to the body's surface.
"""
LISTED = 1.0
"""Smallest margin added to the contact distance when points near a solid are listed [cells]."""


class Solids(FreeBodies):
    """All freely moving rigid solids of a run on lattices."""

    kept = ("_bodies", "_sums", "_begun", "_impulses", "_reach_points", "_approach", "_touches")

    def __init__(
        self, model: Model, solids: Sequence[FreeBody], surface: Surface, nodes: Nodes
    ) -> None:
        """Place the solids in their initial states.

        Raises:
            InputError: A solid is thinner than two cells.
        """
        self._nodes, self._surface = nodes, surface
        self.work: ContactWork | None = None
        shape = len(solids), model.bodies, SUMS
        self._sums = wp.zeros(shape, dtype=wp.float64, device=model.device)
        """Sums of the impulses of each solid on each body [F,bodies,16], laid out as for walls."""
        self._impulses: list[wp.array] = []
        self._planes: list[Hashable] = []
        """Keys of the flat walls."""
        super().__init__(model, solids)
        self.recovery = 0.0
        """Speed at which points inside a solid are moved out, divided by their depth [1/s]."""
        self._touches: list[_Touch] = []
        self._reach_points = 0.0
        """Surface points at most this far from a solid may touch the solid before the next
        measurement [m].
        """
        self._approach = LISTED * model.dx
        """Largest approach of a point to a solid until the next measurement [m]."""

    def _total(self) -> NDArray[np.float64]:
        """Return the sums of impulse and work of each solid on each body [F,bodies,EXCHANGE]."""
        sums = np.asarray(self._sums.numpy(), np.float64)
        moment, rest = sums[..., MOMENT : MOMENT + 3], sums[..., IMPULSE + 3 : EXCHANGE]
        return np.concatenate([sums[..., :3], moment, rest], axis=-1)

    def rows(self) -> wp.array:
        """Return the sums of the impulses of each solid on each body, one row per pair."""
        return self._sums.reshape((len(self.all) * self._model.bodies, SUMS))

    def bind(self, planes: Sequence[Plane], tracks: Tracks) -> None:
        """Replace the flat walls that stop the solids; equal walls keep the impulses of the last
        substep.

        The walls' displacements are added to the tracks.
        """
        earlier, before = self._impulses, self._planes
        super().bind(planes, tracks)
        ends = [np.ravel(plane.geometry(self._model)[:2]).tolist() for plane in planes]
        kinds = [plane.contact for plane in planes]
        self._planes = [(*end, kind) for end, kind in zip(ends, kinds, strict=True)]
        equal = find_equal(before, self._planes)
        for impulses, kept, solid in zip(self._impulses, earlier, self.all, strict=False):
            shape = -1, POINTS[solid.shape], 3
            old, new = kept.numpy().reshape(shape), impulses.numpy().reshape(shape)
            for i, j in equal:
                new[j] = old[i]
            impulses.assign(new.reshape(-1, 3))

    def prepare(self, tracks: Tracks, recovery: float) -> None:
        """Prepare the contact with bodies; call after `bind` and after the upload of the tracks.

        `recovery` [1/s] is the speed at which points inside a solid are moved out, divided by
        depth.
        """
        self.recovery, earlier = recovery, [touch.snapshot() for touch in self._touches]
        self._touches = [
            _Touch(self, index, body, tracks)
            for index, body in itertools.product(range(len(self.all)), self._met)
        ]
        for touch, kept in zip(self._touches, earlier, strict=False):
            touch.restore(kept)
        self._list(turn=not earlier)

    def put(self, index: int, motion: Sequence[Any]) -> None:
        """Set the motion of a solid, as `FreeBodies.put` does, and reset its contact."""
        super().put(index, motion)
        for touch in self._touches:
            if touch.solid == index:
                touch.forget()

    def forget(self, body: int) -> None:
        """Reset the contact of a body with all solids, after the body has been moved."""
        for touch in self._touches:
            if touch.body == body:
                touch.forget()

    def stages(self, passed: PassedOn | None) -> list[list[Named]]:
        """Return the launches of a substep that apply, correct and sum the impulses of solids."""
        model, tracks = self._model, getattr(self, "_tracks", None)
        if tracks is None:
            return [[], [], []]
        begin, finish = [], []
        for index, solid in enumerate(self.all):
            moments, state = wp.vec3d(*solid.moments), self._bodies[index]
            inputs = [solid.mass, moments, wp.vec3d(*solid.half), POINTS[solid.shape]]
            inputs += [self._walls[0], self._impulses[index], tracks.clock, tracks.values]
            kernel = kernels.make_solid_begin(model.real)
            begin.append((STAGE, model.launch(kernel, 1, inputs, [state, self._trials[index]])))
            kernel = kernels.make_solid_finish(model.real)
            read = [moments, self._trials[index]]
            finish.append((STAGE, model.launch(kernel, 1, read, [state])))
        for touch in self._touches:
            touch.add_sums(self.work, passed)
        touch, resist, account = (
            [(STAGE, touch.stage(number)) for touch in self._touches] for number in range(3)
        )
        return [[*launches(begin), *touch], [*resist, *launches(finish)], account]

    def list_near(self, step: float, ahead: float) -> None:
        """List the surface points that may touch a solid until the next measurement.

        A point approaches a solid by at most `step` [m] in a substep, and by at most `ahead` [m]
        until the next measurement.
        """
        dx = self._model.dx
        self._approach = max(LISTED * dx, ahead)
        self._reach_points = min(REACH * dx, 2 * AHEAD * step + CLOSE * dx)
        self._list(turn=True)

    def _list(self, *, turn: bool) -> None:
        """List the surface points near each solid; if `turn` is true, update the normals near
        boxes.

        A restored run does not update the normals.
        """
        for touch in self._touches:
            touch.list_near(self._reach_points, self._approach, turn=turn)

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        super().restore(snapshot)
        self._list(turn=False)


class _Touch(Kept):
    """The contact of the surface points of one body with one solid."""

    kept = ("force", "side", "space")

    def __init__(self, solids: Solids, index: int, body: int, tracks: Tracks) -> None:
        model, self._surface = solids._model, solids._surface
        surface, self._mine = self._surface, self._surface.body == body
        self.solid, self.body = index, body
        t, count, device = types(model.real), surface.count, model.device
        self._near: NDArray[np.int32] = np.zeros(0, np.int32)
        self._list = wp.zeros(count, dtype=int, device=device)
        self.force = wp.zeros(count, dtype=t.vec3, device=device)
        """Mean force of the solid on each point in the last substep [S,3], N."""
        self._gaps = wp.zeros(count, dtype=model.real, device=device)
        self._gap = gap = wp.zeros(count, dtype=t.vec4, device=device)
        self._work: wp.Launch | None = None
        self._passed: wp.Launch | None = None
        place = wp.zeros_like(self.force)
        yields = wp.zeros_like(self._gaps)
        solid, nodes, points = solids.all[index], solids._nodes, solids._nodes.points
        self._u, self._is_box = nodes.u, solid.shape == "box"
        self._points = points[:2]
        self._sums = sums = cast("wp.array", solids._sums[index, body])
        shape, moments = t.mat33(*np.ravel(solid.geometry())), wp.vec3d(*solid.moments)
        state, trial = solids._bodies[index], solids._trials[index]
        inputs = [shape, *points, nodes.u, state]
        self._look = model.launch(
            kernels.make_solid_near(solid.shape, model.real, nodes.rows),
            count,
            inputs,
            [self._gaps],
        )
        self.side = wp.zeros_like(self.force)
        """Normals of the surface points near a box and on flat parts of the surface [S,3]."""
        space = np.full(count, -np.inf)
        if solid.sticky:
            local = (surface.x - solid.place) @ solid.axes
            far = distances_from(solid.shape, solid.geometry(), model, local)
            normal = far[:, :3] @ solid.axes.T
            space = initial_gaps(far[:, 3], normal, surface.normal, model.dx)
            space[surface.is_inner] = -np.inf
        self.space = model.array(space, model.real)
        """Distance from the solid at which contact with each point begins [S], m; -inf before the
        point is first near the solid.
        """
        deepest = DEEPEST * model.dx
        inputs = [self._list, 0, 0.0, deepest, shape, solid.mass, moments, *points, self.side]
        inputs += [nodes.movable, nodes.u, tracks.clock, state]
        outputs = [self.space, trial, nodes.v, gap, place, yields, self.force]
        kernel = kernels.make_solid_touch(solid.shape, model.real, nodes.rows)
        self._launches = [cast("wp.Launch", model.launch(kernel, 1, inputs, outputs))]
        inputs = [self._list, 0, solids.recovery, solid.friction, solid.mass, moments]
        inputs += [*points[:2], nodes.movable, gap, place, yields, tracks.clock, state]
        kernel = kernels.make_solid_resist(solid.sticky, model.real, nodes.rows)
        launch = model.launch(kernel, 1, inputs, [trial, nodes.v, self.force])
        self._launches.append(cast("wp.Launch", launch))
        inputs = [self._list, *points[:2], place, self.force, tracks.clock, nodes.before, nodes.v]
        launch = model.launch(make_account(model.real, nodes.rows), max(1, count), inputs, [sums])
        self._launches.append(cast("wp.Launch", launch))

    def forget(self) -> None:
        """Reset the contact with all points."""
        self.force.zero_()
        self.space.fill_(-math.inf)

    def stage(self, number: int) -> Callable[[], None]:
        """Return a stage of the substep that applies, corrects or sums impulses."""

        def act() -> None:
            if len(self._near):
                self._launches[number].launch()
                if number == 2 and self._passed is not None:
                    self._passed.set_dim(len(self._near))
                    self._passed.launch()
                if number == 2 and self._work is not None:
                    self._work.set_param_at_index(1, len(self._near))
                    self._work.launch()

        return act

    def add_sums(self, work: ContactWork | None, passed: PassedOn | None) -> None:
        """Set whether the last stage also sums work and passes impulses on to clamps."""
        near = self._list, self._points, self.force
        self._passed = None if passed is None else passed.of(*near, self._sums)
        known = self._list, self._points, self._gap, self.force
        self._work = None if work is None else work.of(SOLIDS, *known)

    def list_near(self, reach: float, more: float, *, turn: bool) -> None:
        """List the surface points within `reach` + `more` [m] of the solid."""
        if self._look is None:
            return
        self._look.launch()
        gaps = self._gaps.numpy() - np.maximum(self.space.numpy(), 0)
        near = np.flatnonzero((gaps < reach + more) & self._mine)
        if not np.array_equal(near, self._near):
            gone = np.setdiff1d(self._near, near)
            if len(gone):
                force = self.force.numpy()
                force[gone] = 0
                self.force.assign(force)
            self._near = near.astype(np.int32)
            put(self._list, self._near)
        if turn and len(near) and self._is_box:
            self._turn(near)
        touch, resist, account = self._launches
        touch.set_param_at_index(2, reach)
        for launch in (touch, resist):
            launch.set_param_at_index(1, len(near))
        account.set_dim(max(1, len(near)))

    def _turn(self, points: NDArray[np.int64]) -> None:
        surface = self._surface
        points = points[surface.evenness[points] == EVEN]
        side = np.zeros((surface.count, 3))
        side[points] = surface.deform(points, self._u.numpy())[2]
        self.side.assign(side)


def kernels_of(shapes: Iterable[str], real: Any, device: str) -> Iterator[Any]:
    """Yield the kernels for contact with freely moving solids of the given shapes."""
    distinct, rows = list(dict.fromkeys(shapes)), rows_for(real, device)
    if not distinct:
        return
    yield from (kernels.make_solid_begin(real), kernels.make_solid_finish(real))
    yield from (kernels.make_solid_resist(False, real, rows), make_account(real, rows))
    yield make_walls(True, real)
    for shape in distinct:
        yield kernels.make_solid_near(shape, real, rows)
        yield kernels.make_solid_touch(shape, real, rows)
