"""Self-contact: surface points of parts that come near each other do not pass through each other.

Every point is paired with the place opposite to it on the surface, which starts at the nearest
surface point and follows the point along the surface. The weights of the pair are those of the
point, minus those of the place, so that an impulse along the surface's normal acts on both parts on
one line, with opposite signs. It is found like the impulses of walls.

Pairs are listed again when a part has moved by 0.6 cells relative to the whole body. A sample
of the surface shows whether parts are near each other; if not, nothing else is computed.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy.spatial import KDTree

from phy124.kernels.arguments import types
from phy124.kernels.lattice.contact import NODES, make_meet, make_place, make_resist
from phy124.lattice.surface import Surface
from phy124.lattice.walls import Nodes
from phy124.mpm.model import Model
from phy124.mpm.stage import Named
from phy124.mpm.tracks import Tracks

SAMPLED, MOVED = 1.5, 0.6
"""Distance of sampled points, and relative way after which parts are compared again [cells]."""
FAR, REACH, SIDEWAYS = 3.0, 1.4, 0.75
"""Distance of sampled points, and of points and their distance along the surface, within which they
may meet [cells].
"""
APART, FACING = 3.0, 1.0
"""Distance at rest from which two points belong to different parts; and depth from which each is in
front of the other one at rest, across a gap [cells].
"""
SLID = 0.4
"""Way of a point along the surface of the other part after which pairs are listed again [cells]."""
NEARER = 0.6
"""Largest distance of sampled points that may meet, relative to their distance at rest."""
OPPOSED = -0.2
"""Largest cosine between the normals of parts that meet."""
FLAT = 0.05
"""Least volume ratio with which ways on the surface are taken back to the body at rest."""
FRICTION = 0.5
"""Coefficient of friction, the default of pairs of objects."""


class SelfContact:
    """Contact of a body's surface with itself."""

    def __init__(
        self, surface: Surface, model: Model, nodes: Nodes, tracks: Tracks, restore: float
    ) -> None:
        """Prepare contact without any pair.

        Args:
            surface: Points that may touch.
            model: The constants of the run.
            nodes: Arrays of the nodes.
            tracks: The tracks, which hold the clock.
            restore: Part of their depth by which points come out of each other in a substep.
        """
        self._restore = restore
        self._surface, self._model, self._nodes, self._tracks = surface, model, nodes, tracks
        cube = np.floor(surface.x / (SAMPLED * model.dx)).astype(np.int64)
        _, self._sample = np.unique(cube, axis=0, return_index=True)
        points = surface.x[self._sample]
        self._nearest = KDTree(points).query(surface.x)[1] if len(points) else self._sample
        t, count = types(model.real), surface.count
        self._points: NDArray[np.int64] = np.zeros(0, np.int64)
        """Points that have a partner [K]."""
        self.most = 0
        """Largest number of pairs."""

        def zeros(kind: Any, *shape: int) -> wp.array:
            return wp.zeros(shape, dtype=kind, device=model.device)

        self._pairs = {
            "nodes": zeros(int, count, 2 * NODES),
            "weights": zeros(model.real, count, 2 * NODES),
            "rest": zeros(t.vec3, count),
            "shift": zeros(t.vec3, count),
            "normal": zeros(t.vec3, count),
            "slopes": zeros(t.vec3, count, NODES),
            "back": zeros(t.mat33, count),
            "force": zeros(t.vec3, count),
        }
        """Arguments of `make_meet` for each pair, and the mean force on its point."""
        self._gap, self._yields = zeros(t.vec4, count), zeros(model.real, count)
        self._x = zeros(t.vec3, len(self._sample))
        self._place = model.launch(
            make_place(model.real),
            len(self._sample),
            [
                wp.array(self._sample.astype(np.int32), dtype=int, device=model.device),
                wp.array(surface.nodes, dtype=int, device=model.device),
                model.array(surface.weights, model.real),
                model.array(surface.x, t.vec3),
                nodes.u,
            ],
            [self._x],
        )
        self._seen: NDArray[np.float64] = surface.x[self._sample]
        self._flagged: NDArray[np.bool_] = np.zeros(len(self._sample), bool)
        """Sampled points near which pairs were listed."""

    def record(self) -> list[Named]:
        """Return the stages that apply the previous impulses, and correct them."""
        if not self._surface.count:
            return []
        pairs, nodes, clock = self._pairs, self._nodes, self._tracks.clock
        real, device = self._model.real, self._model.device
        every = wp.array(np.arange(self._surface.count, dtype=np.int32), dtype=int, device=device)
        far = SIDEWAYS * self._model.dx
        read = [pairs[name] for name in ("nodes", "normal", "slopes", "back")]
        changed = [pairs[name] for name in ("weights", "rest", "shift")]
        meet = self._model.launch(
            make_meet(real),
            1,
            [0, far, *read, nodes.movable, nodes.u, clock],
            [*changed, nodes.v, self._gap, self._yields, pairs["force"]],
        )
        tail = [nodes.movable, self._gap, self._yields, clock, self._tracks.rates]
        resist = self._model.launch(
            make_resist("separate", False, real),
            1,
            [every, 0, self._restore, FRICTION, 0, pairs["nodes"], pairs["weights"], *tail],
            [nodes.v, pairs["force"]],
        )

        def repeat(launch: Any, place: int) -> Named:
            def act() -> None:
                if len(self._points):
                    launch.set_param_at_index(place, len(self._points))
                    launch.launch()

            return "self-contact", act

        return [repeat(meet, 0), repeat(resist, 1)]

    def follow(self) -> None:
        """List the pairs again if parts have moved relative to each other."""
        if self._place is None:
            return
        self._place.launch()
        x: NDArray[Any] = self._x.numpy()
        moved = x - self._seen
        moved -= moved.mean(axis=0)
        if np.abs(moved).max() > MOVED * self._model.dx:
            self._look(x.astype(np.float64))

    def _look(self, x: NDArray[np.float64]) -> None:
        """List the pairs.

        Args:
            x: Current positions of the sampled points [K,3], m.
        """
        self._seen = x
        near = KDTree(x).query_pairs(FAR * self._model.dx, output_type="ndarray")
        # Few pairs are nearer than at rest, and only these are compared further.
        now, rest = (_squares(values, near) for values in (x, self._surface.x[self._sample]))
        near = near[now < NEARER**2 * rest]
        near = near[self._may_meet(self._sample[near])]
        flagged: NDArray[np.bool_] = np.zeros(len(self._sample), bool)
        flagged[near] = True
        if not len(near):
            self._points, self._flagged = self._points[:0], flagged
            return
        shift = self._pairs["shift"].numpy()[: len(self._points)]
        slid = np.abs(shift).max(initial=0.0) > SLID * self._model.dx
        if slid or (flagged & ~self._flagged).any():
            self._flagged = flagged
            self._list(*self._partners(np.flatnonzero(flagged[self._nearest])))

    def _may_meet(self, pairs: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return whether pairs [K,2] of points belong to parts that may meet."""
        dx, x, normal = self._model.dx, self._surface.x, self._surface.normal
        square = _squares(x, pairs) / dx**2
        result = square > APART**2
        # Nearer than that, a point must be in front of the other one.
        doubtful = np.flatnonzero(~result & (square > FACING**2))
        a, b = pairs[doubtful].T
        way = x[b] - x[a]
        ahead = np.minimum(_dots(way, normal[a]), -_dots(way, normal[b]))
        result[doubtful] = ahead > FACING * dx
        return result

    def _partners(self, points: NDArray[np.int64]) -> tuple[NDArray[np.int64], dict[str, NDArray]]:
        """Return the points among some points that have a partner, and their pairs."""
        surface, dx, u = self._surface, self._model.dx, self._nodes.u.numpy()
        moved = surface.weights[points][:, None] @ u[surface.nodes[points]]
        x = surface.x[points] + moved[:, 0]
        near = KDTree(x).query_pairs(REACH * dx, output_type="ndarray")
        near = near[self._may_meet(points[near])]
        kept, near = np.unique(near, return_inverse=True)
        points, x, near = points[kept], x[kept], near.reshape(-1, 2)
        nodes, weights, slopes = (
            surface.nodes[points],
            surface.weights[points],
            self._slopes[points],
        )
        F = np.eye(3) + np.swapaxes(u[nodes], 1, 2) @ slopes
        turned = _cofactors(F)
        normal = (turned @ surface.normal[points][:, :, None])[:, :, 0]
        normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-30)
        a, b = np.concatenate([near, near[:, ::-1]]).T
        way = x[a] - x[b]
        distance = np.linalg.norm(way, axis=1)
        out = np.where(normal[b].any(axis=1)[:, None], normal[b], way / distance[:, None])
        gap = _dots(way, out)
        sideways = way - gap[:, None] * out
        fits = (_dots(normal[a], out) < OPPOSED) | ~normal[a].any(axis=1)
        fits &= np.linalg.norm(sideways, axis=1) < SIDEWAYS * dx
        order = np.flatnonzero(fits)
        order = order[np.lexsort((distance[order], a[order]))]
        _, first = np.unique(a[order], return_index=True)
        chosen = order[first]
        a, b = a[chosen], b[chosen]
        J = np.maximum(_dots(F[b, 0], turned[b, 0]), FLAT)
        return points[a], {
            "nodes": np.concatenate([nodes[a], nodes[b]], axis=1),
            "weights": np.concatenate([weights[a], -weights[b]], axis=1),
            "rest": surface.x[points[a]] - surface.x[points[b]],
            "shift": np.zeros((len(a), 3)),
            "normal": out[chosen],
            "slopes": slopes[b],
            "back": np.swapaxes(turned[b], 1, 2) / J[:, None, None],
        }

    @cached_property
    def _slopes(self) -> NDArray[np.float64]:
        """Weights of the nodes in the gradient at each surface point [S,27,3], 1/m."""
        surface = self._surface
        arm = self._nodes.rest.numpy()[surface.nodes] - surface.x[:, None]
        arm *= (surface.weights != 0)[:, :, None]
        weighted = surface.weights[:, :, None] * arm
        moments = np.swapaxes(weighted, 1, 2) @ arm
        slopes: NDArray[np.float64] = weighted @ np.linalg.pinv(moments, rcond=1e-6, hermitian=True)
        return slopes

    def _list(self, points: NDArray[np.int64], pairs: dict[str, NDArray]) -> None:
        """List pairs; points that already had a partner keep their forces."""
        forces = np.zeros((self._surface.count, 3))
        forces[self._points] = self._pairs["force"].numpy()[: len(self._points)]
        self._fill(points, {**pairs, "force": forces[points]})

    def _fill(self, points: NDArray[np.int64], pairs: dict[str, NDArray]) -> None:
        """Copy pairs to the device."""
        self._points, self.most = points, max(self.most, len(points))
        if len(points):
            for name, array in self._pairs.items():
                array[: len(points)].assign(pairs[name])

    def snapshot(self) -> dict[str, Any]:
        """Return the pairs and their forces."""
        count = len(self._points)
        pairs = {name: array.numpy()[:count].copy() for name, array in self._pairs.items()}
        places = {"seen": self._seen.copy(), "flagged": self._flagged.copy()}
        return {"points": self._points.copy(), **places, **pairs}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to a snapshot."""
        self._seen, self._flagged = (np.array(snapshot[name]) for name in ("seen", "flagged"))
        self._fill(np.array(snapshot["points"]), snapshot)


def _squares(x: NDArray, pairs: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the squared distances of pairs [K,2] of points [m^2]."""
    way = x[pairs[:, 0]] - x[pairs[:, 1]]
    return _dots(way, way)


def _dots(a: NDArray, b: NDArray) -> NDArray[np.float64]:
    """Return the scalar products of vectors [K,3] and [K,3]."""
    result: NDArray[np.float64] = np.einsum("ki,ki->k", a, b)
    return result


def _cofactors(F: NDArray) -> NDArray[np.float64]:
    """Return the cofactors of matrices [K,3,3]."""
    rows = [np.cross(F[:, (i + 1) % 3], F[:, (i + 2) % 3]) for i in range(3)]
    return np.stack(rows, axis=1)
