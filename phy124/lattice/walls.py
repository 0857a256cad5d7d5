"""Records the kernel launches of walls and clamps on a lattice, with sums of impulse and work.

Walls act on surface points, and clamps act on nodes (phy124/lattice/clamps.py).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.lattice.contact import (
    SUMS,
    make_account,
    make_distances,
    make_exchange,
    make_meet,
    make_place,
    make_reach,
    make_resist,
    make_touch,
    make_yields,
)
from phy124.kernels.lattice.impulses import make_pass_on
from phy124.kernels.lattice.nodes import make_hold, make_pin
from phy124.kernels.lattice.partners import make_expose, make_flag, make_flag_simd, make_partner
from phy124.kernels.lattice.rows import SIMD, Rows, rows_for
from phy124.kernels.lattice.work import WALLS
from phy124.kernels.launches import put
from phy124.lattice.clamps import Clamp, PassedOn, acts_on, distances
from phy124.lattice.equal import find_equal
from phy124.lattice.gaps import initial_gaps
from phy124.lattice.impulses import ContactWork, Impulses
from phy124.lattice.rest import RestLattice
from phy124.lattice.surface import Surface
from phy124.lattice.workers import Division
from phy124.mpm.kept import Kept
from phy124.mpm.model import Model
from phy124.mpm.stage import Named, launches
from phy124.mpm.tracks import STILL, Tracks

REACH = 0.6
"""Distance from a wall [cells] up to which the wall holds points that have touched it."""
AHEAD, CLOSE, FAR = 2.0, 0.1, 3.0
"""Contact with a wall is computed up to a distance of `AHEAD` times the displacement in a substep,
plus `CLOSE`, but at most `FAR` [cells].
"""
TOUCHING = 0.5
"""Distance [cells] up to which a point inside one wall also counts as touching a second wall."""
DEEP, EXACT = 0.1, 1e-3
"""If a point is deeper than `DEEP` inside a wall, further sweeps over all points follow, until no
correction displaces a point by more than `EXACT` [cells].
"""
STEP = 0.5
"""Surface points near a wall are listed. While points may approach the wall, the distance up to
which they are listed grows in steps of this length [cells].
"""
RESTORE = {"separate": 0.65, "slip": 0.13, "sticky": 0.13}
"""Speed at which surface points inside a wall are moved out, divided by their depth. The unit of
this ratio is (pi / 2 H)^2 / dt for a body with a height of H cells and for substeps dt at rest. The
slowest vibration of a body that stands on a wall has the angular frequency pi c / 2 H, where c is
the speed of sound. Bodies that stick to a wall also rock and shear; these vibrations have lower
frequencies.
"""


class Boundary(Protocol):
    """The attributes of a boundary (phy124.boundaries) that are needed for contact on lattices."""

    holds: ClassVar[bool]
    """Whether the boundary fixes material instead of only blocking it."""

    def parts(self) -> list[Any]:
        """Return the simple walls that the boundary consists of."""
        ...


@dataclass(frozen=True, eq=False)
class Nodes:
    """Arrays of the nodes on the device."""

    rest: wp.array
    """Positions of the nodes at rest [N,3], m."""
    u: wp.array
    """Displacements of the nodes [N,3], m."""
    residue: wp.array
    """Rounding errors of the displacements [N,3], m; they are added in the next substep."""
    v: wp.array
    """Velocities of the nodes [N,3], m/s, half a substep behind the displacements."""
    before: wp.array
    """Velocities of the nodes before the kick of the current substep [N,3], m/s."""
    lagging: wp.array
    """Velocities of the nodes on which viscosity acts [N,3], m/s
    (phy124/kernels/lattice/nodes.py).
    """
    inverse: wp.array
    """Inverse masses of the nodes [N], 1/kg; 0 for tied nodes."""
    movable: wp.array
    """Inverse masses of the nodes [N], 1/kg; 0 for tied nodes and for nodes in a clamp."""
    points: tuple[wp.array, wp.array, wp.array]
    """Nodes [S,27], weights [S,27] and positions at rest [S,3], m, of the surface points."""
    rows: Rows
    """Scalar or vectorised functions that process the nodes of a surface point."""


class Walls:
    """All walls of a run, with their impulses and work on the bodies."""

    def __init__(
        self,
        boundaries: Sequence[Boundary],
        model: Model,
        lattice: RestLattice,
        surface: Surface,
        nodes: Nodes,
        tracks: Tracks,
        substep: float,
        division: Division,
        time: float = 0.0,
    ) -> None:
        """Prepare the walls of a run.

        `substep` is the length of a substep at rest [s]. From `time` [s] on, the walls act.

        Raises:
            InputError: A clamp fixes only some directions, which is not possible on lattices.
        """
        simple = [(boundary.holds, part) for boundary in boundaries for part in boundary.parts()]
        self.sums = wp.zeros((len(simple), SUMS), dtype=wp.float64, device=model.device)
        """Impulse, work and moment of each simple wall on the bodies [W,16]
        (kernels/lattice/contact.py).
        """
        self.impulses: Impulses | None = None
        """Sums of impulses on surface points and nodes; None before `keep_impulses`."""
        self.work: ContactWork | None = None
        self.holding = [number for number, (holds, _) in enumerate(simple) if holds]
        """Indices of the rows of `sums` that belong to clamps."""
        self._dx, self._listed = model.dx, 0
        self._around = model, surface.count, nodes, tracks
        slowest = (math.pi / 2 / lattice.across) ** 2 / substep
        self.recovery = RESTORE["separate"] * slowest
        """Speed at which points inside a wall are moved out, divided by their depth [1/s]."""
        self._holder = wp.zeros(len(nodes.rest), dtype=int, device=model.device)
        # Clamps that no longer exist have released their nodes.
        wp.copy(nodes.movable, nodes.inverse)
        self._clamps: list[Clamp] = []
        self._contacts: list[_Contact] = []
        for number, (holds, part) in enumerate(simple):
            sums = cast("wp.array", self.sums[number])
            if holds:
                record = sums, number, self._holder
                self._clamps.append(Clamp(part, model, lattice, nodes, tracks, *record))
            elif surface.count:
                everywhere = model, surface, nodes, tracks, division, slowest
                self._contacts.append(_Contact(part, *everywhere, sums, time))
        for contact in self._contacts:
            contact.clamped = bool(self._clamps)

    def __bool__(self) -> bool:
        return bool(self._clamps or self._contacts)

    def keep_impulses(self) -> None:
        """From now on, also sum the impulses on each surface point and each node."""
        self.impulses = Impulses(*self._around)

    def passed_on(self) -> PassedOn | None:
        """Return the object that passes contact impulses on to clamps; None without clamps."""
        if not self._clamps:
            return None
        model, _, nodes, tracks = self._around
        return PassedOn(model, nodes, tracks.clock, self._holder, self.sums, self.impulses)

    def stages(self, passed: PassedOn | None) -> list[list[Named]]:
        """Return the kernel launches of a substep that apply, correct and sum the impulses of
        walls.

        Clamps act before the impulses.
        """
        every = self._clamps
        records = [clamp.record(every[:i], every[i + 1 :]) for i, clamp in enumerate(every)]
        # The order is reversed, because after a clamp has released a node, contact may move the
        # node.
        ordered = [item for kind in zip(*records[::-1], strict=True) for item in kind]
        clamps = launches([("clamp", item) for item in ordered])
        if clamps and self.impulses is not None:
            held = np.unique(np.concatenate([clamp.nodes for clamp in self._clamps]))
            clamps = self.impulses.hold(clamps, held)
        stages = [contact.record(self.impulses, self.work, passed) for contact in self._contacts]
        touch, resist, account = (
            [("contact", contact[number]) for contact in stages] for number in range(3)
        )
        return [[*clamps, *touch], resist, account]

    def look(self) -> None:
        """Measure the distances of all surface points from the walls."""
        self._listed = 0
        for contact in self._contacts:
            contact.look()

    def list_near(self, approach: float, step: float) -> None:
        """List the surface points that may touch a wall.

        Args:
            approach: Largest distance by which a point may have approached a wall since the last
                call of `look` [m].
            step: Largest distance by which a point approaches a wall in a substep [m].
        """
        for contact in self._contacts:
            near = min(FAR * self._dx, AHEAD * step + CLOSE * self._dx)
            contact.limit(near if contact.separates else max(REACH * self._dx, near))
        width = STEP * self._dx
        steps = math.ceil(approach / width)
        if steps > self._listed:
            self._listed = steps
            for contact in self._contacts:
                contact.list_near(steps * width)

    def depth(self) -> tuple[float, int]:
        """Return the largest depth [cells] of a point inside a wall in the last substep, at least
        0, and the wall's index among the walls that are not clamps.
        """
        depths = [0.0, *(-contact.closest() / self._dx for contact in self._contacts)]
        deepest = int(np.argmax(depths))
        return depths[deepest], max(0, deepest - 1)

    def pinch(self) -> tuple[float, int, int]:
        """Return the largest depth [cells] of a point that is inside one wall and touches another
        wall.

        The result also contains the indices of both walls among the walls that are not clamps. The
        depth is at least 0. The positions of the walls are those at the last evaluation of the
        tracks.
        """
        if len(self._contacts) < 2:
            return 0.0, 0, 0
        gaps = np.array([contact.distances() for contact in self._contacts]) / self._dx
        inside, points = gaps.argmin(axis=0), np.arange(gaps.shape[1])
        depth = -gaps[inside, points]
        gaps[inside, points] = np.inf
        depth[gaps.min(axis=0) > TOUCHING] = 0.0
        deepest = int(depth.argmax())
        touching = int(gaps[:, deepest].argmin())
        return max(0.0, float(depth[deepest])), int(inside[deepest]), touching

    def forget(self, body: int) -> None:
        """Reset the contact of a body with all walls, after the body has been moved."""
        for contact in self._contacts:
            contact.forget(body)

    def continue_from(self, earlier: "Walls") -> None:
        """Continue the contact with the walls that are also among `earlier` walls."""
        keys = ([contact.key for contact in walls._contacts] for walls in (earlier, self))
        for old, new in find_equal(*keys):
            self._contacts[new].restore(earlier._contacts[old].snapshot())

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot: the sums and the contact of the walls."""
        contacts = {str(i): contact.snapshot() for i, contact in enumerate(self._contacts)}
        kept = {"sums": wp.clone(self.sums), "contacts": contacts}
        return kept if self.impulses is None else {**kept, "impulses": wp.clone(self.impulses.sums)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        self.sums.assign(snapshot["sums"])
        for i, contact in enumerate(self._contacts):
            contact.restore(snapshot["contacts"][str(i)])
        if self.impulses is not None:
            self.impulses.sums.assign(snapshot["impulses"])


class _Contact(Kept):
    """The contact of the surface points with one simple wall."""

    kept = ("force", "space")

    def __init__(
        self,
        part: Any,
        model: Model,
        surface: Surface,
        nodes: Nodes,
        tracks: Tracks,
        division: Division,
        slowest: float,
        sums: wp.array,
        time: float,
    ) -> None:
        t = types(model.real)
        self._model, self._nodes, self._tracks = model, nodes, tracks
        self._part, self._sums = part, sums
        self._division, self._slowest = division, slowest
        self._slot, self._body = tracks.add(part.track(model) or STILL), surface.body
        geometry = np.ravel(part.geometry(model)).tolist()
        self.key = part.outline(), *geometry, part.object, part.response()
        """Equal walls have equal keys, even if their motions or frictions differ."""
        self._shape = t.mat33(*geometry)
        self._near: NDArray[np.int32] = np.zeros(0, np.int32)
        self._affected = acts_on(part, model, surface.body)
        self.separates = part.response() == "separate"
        """Whether points may leave the wall."""
        space = np.full(surface.count, -np.inf)
        if not self.separates:
            u = nodes.u.numpy().astype(np.float64)
            moved = (part.track(model) or STILL).values(np.array([time]))[0]
            far = distances(part, model, surface.place(u) - moved)
            near = np.flatnonzero((np.abs(far[:, 3]) < model.dx) & ~surface.is_inner)
            normal = surface.deform(near, u)[2]
            space[near] = initial_gaps(far[near, 3], far[near, :3], normal, model.dx)
        self.space = model.array(space, model.real)
        """Distance from the wall at which contact with each point begins [S], m; -inf before the
        point is first near the wall.
        """
        self.reach = REACH * model.dx
        """Largest distance from the wall at which contact is computed [m]."""
        self.clamped = False
        """Whether the run has clamps. Clamps change the response of points to impulses between
        substeps.
        """
        self._count, device = (count := surface.count), model.device
        self._list = wp.zeros(count, dtype=int, device=device)
        self._gaps = wp.zeros(count, dtype=model.real, device=device)
        self.force = wp.zeros(count, dtype=t.vec3, device=device)
        """Mean force of the wall on each point in the last substep [S,3], N."""
        self._gap = wp.zeros(count, dtype=t.vec4, device=device)
        self._place = wp.zeros(count, dtype=t.vec3, device=device)
        self._yields = wp.zeros(count, dtype=model.real, device=device)

    def look(self) -> None:
        self._measure(self._count)

    def forget(self, body: int) -> None:
        """Reset the contact with the points of a body."""
        force, space = self.force.numpy().copy(), self.space.numpy().copy()
        mine = self._body == body
        force[mine], space[mine] = 0, -math.inf
        self.force.assign(force)
        self.space.assign(space)

    def distances(self) -> NDArray[np.float64]:
        """Return each surface point's distance from the wall [S], m; infinite where no contact is
        possible.
        """
        self.look()
        movable = self._affected & (self._yields.numpy() > 0)
        gaps: NDArray[Any] = self._gaps.numpy()
        return np.where(movable, gaps.astype(np.float64), np.inf)

    @cached_property
    def _measure(self) -> Callable[[int], None]:
        nodes = self._nodes
        inputs = [self._shape, self._slot, *nodes.points, nodes.u, self._tracks.values]
        kernel = make_reach(self._part.outline(), self._model.real, nodes.rows)
        return self._division.record(kernel, self._count, inputs, [self._gaps])

    def list_near(self, approach: float) -> None:
        """List the surface points that were within `reach` plus `approach` [m] of the wall."""
        gaps = self._gaps.numpy() - np.maximum(self.space.numpy(), 0)
        close = gaps < self.reach + approach
        near = np.flatnonzero(close & self._affected)
        if not np.array_equal(near, self._near):
            self._near = near.astype(np.int32)
            put(self._list, self._near)
            self._pass_count()

    def closest(self) -> float:
        """Return the smallest distance of a listed point [m]; infinite if no point is listed."""
        gap, space = self._gap.numpy()[self._near, 3], self.space.numpy()[self._near]
        counted = np.isfinite(space)
        return float((gap[counted] + space[counted]).min(initial=np.inf))

    def limit(self, reach: float) -> None:
        """Set the distance from the wall within which contact is computed [m]."""
        if reach != self.reach:
            self.reach = reach
            self._of_all[0].set_param_at_index(2, reach)

    def record(
        self, impulses: Impulses | None, work: ContactWork | None, passed: PassedOn | None
    ) -> list[Callable[[], None]]:
        """Return stages that find touching points, correct impulses, and sum impulses and work."""

        def account() -> None:
            for launch in sums if len(self._near) else ():
                launch.launch()

        def touch() -> None:
            if len(self._near):
                if self.clamped:
                    yields.launch()
                first.launch()

        self._of_each = [self._yield(), self._account()]
        if impulses is not None:
            self._of_each.append(impulses.press(self._list, self.force))
        points = self._nodes.points[:2]
        if passed is not None:
            self._of_each.append(passed.of(self._list, points, self.force, self._sums))
        self._of_all = [self._touch(), self._resist()]
        if work is not None:
            known = self._gap, self.force, self._slot
            self._of_all.append(work.of(WALLS, self._list, points, *known))
        (yields, *sums), (first, second, *works) = self._of_each, self._of_all
        # Responses of all points; they change only if clamps fix or release nodes.
        self._list.assign(np.arange(self._count, dtype=np.int32))
        yields.launch()
        put(self._list, self._near)
        self._pass_count()
        sums += works
        return [touch, lambda: second.launch() if len(self._near) else None, account]

    def _pass_count(self) -> None:
        for launch in self._of_all:
            launch.set_param_at_index(1, len(self._near))
        for launch in self._of_each:
            launch.set_dim(max(1, len(self._near)))

    def _yield(self) -> wp.Launch:
        """Record the kernel launch that computes the points' velocity change per unit impulse."""
        nodes = self._nodes
        inputs = [self._list, *nodes.points[:2], nodes.movable, nodes.inverse]
        kernel = make_yields(self._model.real, nodes.rows)
        return cast("wp.Launch", self._model.launch(kernel, self._count, inputs, [self._yields]))

    def _touch(self) -> wp.Launch:
        model, nodes, tracks = self._model, self._nodes, self._tracks
        inputs = [self._list, 0, self.reach, self._shape, self._slot, *nodes.points]
        inputs += [nodes.movable, self._yields, nodes.u, tracks.clock, tracks.values]
        outputs = [self.space, nodes.v, self._gap, self._place, self.force]
        kernel = make_touch(self._part.outline(), model.real, nodes.rows)
        return cast("wp.Launch", model.launch(kernel, 1, inputs, outputs))

    def _resist(self) -> wp.Launch:
        model, nodes, tracks, response = (
            self._model,
            self._nodes,
            self._tracks,
            self._part.response(),
        )
        restore = RESTORE[response] * self._slowest
        inputs = [self._list, 0, restore, self._part.friction, DEEP * model.dx, EXACT * model.dx]
        inputs += [self._slot, *nodes.points[:2]]
        inputs += [nodes.movable, self._gap, self._yields, tracks.clock, tracks.rates]
        kernel = make_resist(response, model.real, nodes.rows)
        return cast("wp.Launch", model.launch(kernel, 1, inputs, [nodes.v, self.force]))

    def _account(self) -> wp.Launch:
        nodes = self._nodes
        inputs = [self._list, *nodes.points[:2], self._place, self.force]
        inputs += [self._tracks.clock, nodes.before, nodes.v]
        kernel = make_account(self._model.real, nodes.rows)
        return cast("wp.Launch", self._model.launch(kernel, self._count, inputs, [self._sums]))


def kernels(
    boundaries: Sequence[Boundary], real: Any, device: str, *, several: bool = False
) -> Iterator[Any]:
    """Yield the kernels of walls, clamps and self-contact.

    Args:
        boundaries: The boundaries of the scene.
        real: wp.float32 or wp.float64.
        device: Name of the device.
        several: Whether the kernels of contact between bodies are yielded as well.
    """
    rows = rows_for(real, device)
    yield from (make_place(real, rows), make_meet(real, rows), make_resist("separate", real, rows))
    yield make_flag_simd() if rows is SIMD else make_flag(real)
    yield from (make_expose(real, rows), make_partner(real))
    if several:
        yield make_exchange(real)
    for boundary in boundaries:
        for part in boundary.parts():
            if boundary.holds:
                yield from (make_hold(real), make_pin(real), make_pass_on(real))
                yield make_distances(part.outline(), real)
            else:
                yield from (make_account(real, rows), make_yields(real, rows))
                yield make_reach(part.outline(), real, rows)
                yield make_touch(part.outline(), real, rows)
                yield make_resist(part.response(), real, rows)
