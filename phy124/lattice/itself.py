"""Contact between the surface points of two bodies, or of two parts of a body.

Every point is paired with an opposite position on the other surface. The weights of the pair are
the weights of the point minus the weights of the opposite position. An impulse along the surface's
normal therefore acts on both parts along one line, with opposite signs.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial import KDTree

from phy124.kernels.arguments import types
from phy124.kernels.lattice.contact import NODES, make_exchange, make_meet, make_resist
from phy124.kernels.lattice.partners import SIDEWAYS
from phy124.kernels.lattice.work import ITSELF, PAIRS
from phy124.kernels.launches import put
from phy124.lattice.clamps import PassedOn
from phy124.lattice.gaps import initial_gaps
from phy124.lattice.impulses import ContactWork
from phy124.lattice.partners import REACH, Partners
from phy124.lattice.surface import Surface
from phy124.lattice.walls import DEEP, EXACT, Nodes
from phy124.mpm.model import Model
from phy124.mpm.stage import Named
from phy124.mpm.tracks import Tracks

MOVED = 0.6
"""Half the relative displacement [cells] after which two parts of a body are compared again."""
BETWEEN = 0.15
"""Half the relative displacement [cells] after which two bodies are compared again."""
SLID = 0.4
"""Displacement along the other surface [cells] after which the pairs are determined again."""
FRICTION = 0.5
"""Friction coefficient for contact of a body with itself, and default for pairs of objects."""


class Meeting:
    """Contact of the surfaces of two bodies, or of a body with itself."""

    def __init__(
        self,
        surface: Surface,
        model: Model,
        nodes: Nodes,
        tracks: Tracks,
        partners: Partners,
        restore: float,
        sample: NDArray[np.int64],
        bodies: tuple[int, int],
        *,
        friction: float,
        sticky: bool = False,
        sums: wp.array | None = None,
    ) -> None:
        """Prepare the contact; initially, no points touch.

        `restore` [1/s] is the speed at which penetrating points separate, divided by their depth.
        `sample` [K] contains the indices of the sampled points. `sums` are impulse and moment of
        the first body on the second.
        """
        self.bodies, self._sums = bodies, sums
        self._restore, self._friction = restore, friction
        self.reach = REACH * model.dx
        """Largest distance between two surface points for which contact is computed [m]."""
        self._response = "sticky" if sticky else "separate"
        self._surface, self._model, self._nodes, self._tracks = surface, model, nodes, tracks
        self._partners = partners
        self._between = bodies[0] != bodies[1]
        self._sample = sample
        self._mine = np.flatnonzero(np.isin(surface.body, bodies) & surface.meets_bodies)
        self._nearest = np.zeros(len(self._mine), np.int64)
        for body in set(bodies):
            those, chosen = surface.body[self._mine] == body, surface.body[sample] == body
            if those.any():
                _, nearest = KDTree(surface.x[sample[chosen]]).query(surface.x[self._mine[those]])
                self._nearest[those] = np.flatnonzero(chosen)[nearest]
        self._points: NDArray[np.int64] = np.zeros(0, np.int64)
        """Indices of the surface points that touch a partner on another surface [K]."""
        self.most = 0
        """Largest number of pairs of touching points so far."""
        self._work: ContactWork | None = None
        self._passed: PassedOn | None = None
        self._reserve(0)
        self._seen: NDArray[np.float64] = surface.x[sample]
        self._flagged: NDArray[np.bool_] = np.zeros(len(sample), bool)
        """Whether pairs near each sampled point were determined."""
        self.slack = 0.0
        """Relative displacement that remains until the surfaces are compared again [m]."""
        self._space = np.zeros(surface.count)
        """Distance between the surfaces at which contact of each point begins [S], m."""
        self._starts = sticky
        """Whether points that are near each other in the next call begin to stick."""
        self._away = self._between or bool(surface.side[sample].any())
        """Whether the next call must determine the pairs."""

    def _reserve(self, count: int) -> None:
        model, nodes, clock = self._model, self._nodes, self._tracks.clock
        real, device, t = model.real, model.device, types(model.real)

        def zeros(kind: Any, *shape: int) -> wp.array:
            return wp.zeros(shape, dtype=kind, device=device)

        self._pairs = pairs = {
            "nodes": zeros(int, count, 2 * NODES),
            "weights": zeros(real, count, 2 * NODES),
            "rest": zeros(t.vec3, count),
            "shift": zeros(t.vec3, count),
            "normal": zeros(t.vec3, count),
            "slopes": zeros(t.vec3, count, NODES),
            "back": zeros(t.mat33, count),
            "force": zeros(t.vec3, count),
            "sign": zeros(real, count),
        }
        """For each surface point with a partner: the arguments of `make_meet`, the mean force on
        the point, and 1 if the point is on the second body or -1 if it is on the first.
        """
        self._launches: list[Any] = []
        if not count:
            return
        gap, yields = zeros(t.vec4, count), zeros(real, count)
        every = wp.array(np.arange(count, dtype=np.int32), dtype=int, device=device)
        read = [pairs[name] for name in ("nodes", "normal", "slopes", "back")]
        changed = [pairs[name] for name in ("weights", "rest", "shift")]
        limits = [SIDEWAYS * model.dx, self.reach, int(self._between)]
        meet = model.launch(
            make_meet(real, nodes.rows),
            1,
            [0, *limits, *read, nodes.movable, nodes.inverse, nodes.u, clock],
            [*changed, nodes.v, gap, yields, pairs["force"]],
        )
        response = self._restore, self._friction, DEEP * model.dx, EXACT * model.dx
        tail = [nodes.movable, gap, yields, clock, self._tracks.rates]
        resist = model.launch(
            make_resist(self._response, real, nodes.rows),
            1,
            [every, 0, *response, 0, pairs["nodes"], pairs["weights"], *tail],
            [nodes.v, pairs["force"]],
        )
        self._launches = [(meet, 0), (resist, 1)]
        if self._sums is not None:
            place = [pairs["nodes"], pairs["weights"], nodes.rest, nodes.u]
            inputs = [0, pairs["sign"], *place, pairs["force"], clock]
            self._launches.append((model.launch(make_exchange(real), 1, inputs, [self._sums]), 0))
        if self._work is not None:
            at, points = PAIRS if self._between else ITSELF, (pairs["nodes"], pairs["weights"])
            known = at, every, points, gap, pairs["force"]
            self._launches.append((self._work.of(*known, clamped=self._between), 1))
        if self._passed is not None:
            points = pairs["nodes"], pairs["weights"]
            self._pass = self._passed.of(every, points, pairs["force"])

    def record(self, work: ContactWork | None, passed: PassedOn | None) -> list[Named]:
        """Return the stages of a substep that apply, correct and sum the contact impulses."""
        # Pairs of a body with itself never use nodes in clamps.
        passed = passed if self._between else None
        if work is not self._work or passed is not self._passed:
            kept, self._work, self._passed = self.snapshot(), work, passed
            self._reserve(len(self._points))
            self._fill(self._points, kept)

        def stage(*numbers: int) -> Named:
            def act() -> None:
                for number in numbers if len(self._points) else ():
                    self._launches[number][0].launch()
                if 2 in numbers and self._passed is not None and len(self._points):
                    self._pass.set_dim(len(self._points))
                    self._pass.launch()

            return "self-contact" if self._sums is None else "pairs", act

        sums = range(2, 2 + (self._sums is not None) + (work is not None))
        return [stage(0), stage(1), *([stage(*sums)] if sums else [])]

    def limit(self, reach: float) -> None:
        """Set the distance within which contact is computed [m], unless points stick together."""
        if self._response == "separate" and reach != self.reach:
            self.reach = reach
            for launch, _ in self._launches[:1]:
                launch.set_param_at_index(2, reach)

    def follow(self, x: NDArray[np.float64]) -> None:
        """Determine the pairs again if the sampled points, now at x [K,3], m, have moved enough."""
        moved = x - self._seen
        most = 2 * (BETWEEN if self._between else MOVED) * self._model.dx
        # Reducing the three columns separately is five times as fast as `axis=0`.
        self.slack = most - (max(map(np.ptp, moved.T)) if len(x) else 0.0)
        if self._away or self.slack < 0:
            self._look(x)
            self.slack = most
        self._starts = False

    def part(self) -> None:
        """Remove all pairs of touching points, because the two bodies are far from each other."""
        self.forget()
        self._starts = False

    def forget(self) -> None:
        """Remove all pairs of touching points, and determine them again in the next call."""
        self._points, self._away = self._points[:0], True
        self._space[:] = 0

    def _look(self, x: NDArray[np.float64]) -> None:
        self._seen, self._away = x, False
        flagged = self._flag(x)
        if not flagged.any():
            self._points, self._flagged = self._points[:0], flagged
            return
        shift = self._pairs["shift"].numpy()[: len(self._points)]
        slid = np.abs(shift).max(initial=0.0) > SLID * self._model.dx
        if self._between or slid or (flagged & ~self._flagged).any():
            self._flagged = flagged
            self._list(self._mine[flagged[self._nearest]])

    @cached_property
    def _flag(self) -> Callable[[NDArray], NDArray[np.bool_]]:
        return self._partners.flagger(self._sample, between=self._between)

    def _list(self, points: NDArray[np.int64]) -> None:
        """Determine the pairs of some surface points; a point that had a pair keeps its force."""
        surface = self._surface
        partners = self._partners.find(points, between=self._between)
        a, b, gap, n = *(partners.pop(name) for name in ("a", "b", "gap")), partners["normal"]
        way, slopes = surface.x[a] - surface.x[b], surface.slopes[b]
        if self._starts:
            self._space[a] = initial_gaps(gap, n, surface.normal[a], surface.dx)
        if self._between:
            # Contact begins at the depth at which a point is first near the other body, because
            # moving the point out would create energy. Its depth may only decrease.
            inside = np.minimum(gap, 0)
            known = np.isin(a, self._points) | (self._space[a] > 0)
            self._space[a] = np.where(known, np.maximum(self._space[a], inside), inside)
        # The other surface is extended, so that impulses along it have no moment either.
        step = (partners["back"] @ (self._space[a][:, None] * n)[:, :, None])[:, :, 0]
        stretched = surface.weights[b] + (slopes @ step[:, :, None])[:, :, 0]
        forces = np.zeros((surface.count, 3))
        forces[self._points] = self._pairs["force"].numpy()[: len(self._points)]
        pairs = {
            "nodes": np.concatenate([surface.nodes[a], surface.nodes[b]], axis=1),
            "weights": np.concatenate([surface.weights[a], -stretched], axis=1),
            "rest": way - step + self._overlap(a, b)[:, None] * n,
            "shift": np.zeros((len(a), 3)),
            "slopes": slopes,
            "sign": np.where(surface.body[a] == self.bodies[1], 1.0, -1.0),
            "force": forces[a],
        }
        self._fill(a, {**pairs, **partners})

    def _overlap(self, a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the depth by which pieces of a body overlap at rest, for each pair of points [K],
        m.

        Surfaces are only as exact as voxels, so they may overlap at rest. Contact does not push
        such surfaces apart.
        """
        surface = self._surface
        way = surface.x[a] - surface.x[b]
        heights = [(way * n).sum(axis=1) for n in (surface.normal[b], -surface.normal[a])]
        overlap: NDArray[np.float64] = np.maximum(-np.minimum(*heights), 0)
        apart = (surface.side[a] != surface.side[b]) & (surface.body[a] == surface.body[b])
        return np.where(apart, overlap, 0)

    def _fill(self, points: NDArray[np.int64], pairs: dict[str, NDArray]) -> None:
        self._points, self.most = points, max(self.most, len(points))
        if len(points) > len(self._pairs["sign"]):
            self._reserve(min(len(self._mine), 2 * len(points)))
        if len(points):
            for name, array in self._pairs.items():
                put(array, pairs[name])
            for launch, place in self._launches:
                launch.set_param_at_index(place, len(points))

    def snapshot(self) -> dict[str, Any]:
        """Return a snapshot: the pairs of touching points and their forces."""
        count = len(self._points)
        pairs = {name: array.numpy()[:count].copy() for name, array in self._pairs.items()}
        places = {"seen": self._seen.copy(), "flagged": self._flagged.copy(), "away": self._away}
        places |= {"reach": self.reach, "space": self._space.copy(), "starts": self._starts}
        return {"points": self._points.copy(), **places, **pairs}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Restore the state from a snapshot."""
        self._seen, self._flagged = (np.array(snapshot[name]) for name in ("seen", "flagged"))
        self._away, self._starts = bool(snapshot["away"]), bool(snapshot["starts"])
        self._space = np.array(snapshot["space"])
        self.limit(float(snapshot["reach"]))
        self._fill(np.array(snapshot["points"]), snapshot)
