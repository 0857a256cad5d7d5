"""Searches for surface points that may touch, and for the positions opposite to the points."""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.lattice.contact import NODES
from phy124.kernels.lattice.partners import make_expose, make_flag, make_flag_simd, make_partner
from phy124.kernels.lattice.rows import SIMD
from phy124.kernels.launches import put
from phy124.lattice.surface import Surface
from phy124.lattice.walls import Nodes
from phy124.lattice.workers import Division
from phy124.mpm.model import Model

FAR = 3.0
"""If two sampled points are closer than this [cells], the surfaces around the points may touch."""
REACH, NEAR = 1.4, 1.0
"""Largest distance at which two surface points may touch [cells]: on one body, and on two bodies.
"""
LEAST = 0.05
"""Smallest volume ratio J that is used as a divisor."""
AT_ONCE = 16
"""Number of points that are compared at a time (phy124/kernels/native/partners.h)."""
BUCKETS = 32
"""Number of buckets along each axis of the search grid."""
EXPOSED = "nodes", "weights", "slopes", "rest", "normal"
SEARCHED = "evenness", "body", "side", "rest", "normal"
"""Names of the arrays that `make_expose` and `make_partner` read, in the kernels' order."""
FOUND = "partner", "direction", "turned", "J", "x"
"""Names of the arrays with results that `find` reads."""


class Partners:
    """Searches for surface points that may touch."""

    def __init__(self, surface: Surface, model: Model, nodes: Nodes, division: Division) -> None:
        self._surface, self._model, self._nodes = surface, model, nodes
        self._division = division
        self._known = np.zeros(surface.count, bool)
        """Whether each surface point's slopes and evenness are already on the device."""

    def flagger(
        self, sample: NDArray[np.int64], *, between: bool
    ) -> Callable[[NDArray], NDArray[np.bool_]]:
        """Return a function that tells for which samples [K] contact is possible.

        The argument of the function is the current positions of the samples [K,3], m.

        `sample` [K] contains indices of surface points. `between` is true if the other part belongs
        to another body.
        """
        model, arrays, grid, far = self._model, self._arrays, self._grid, FAR * self._model.dx
        vectors, count = self._nodes.rows is SIMD, len(sample)
        x, flagged = self._zeros(types(model.real).vec3, count), self._zeros(int, count)
        places = np.full((6, -(-count // AT_ONCE) * AT_ONCE), np.inf, np.float32)
        places[3:, :count] = self._surface.x[sample].T
        on_device = wp.array(places, device=model.device, copy=False)
        inputs = [on_device if vectors else grid.id, between, far, model.dx]
        inputs += [self._numbers(sample), x]
        inputs += [arrays[name] for name in ("rest", "normal", "body", "side")]
        kernel = make_flag_simd() if vectors else make_flag(model.real)
        run = self._division.record(kernel, count, inputs, [flagged])

        def flag(at: NDArray) -> NDArray[np.bool_]:
            put(x, at)
            if vectors:
                places[:3, :count] = at.T
            else:
                grid.build(x, far)
            run(count)
            return np.asarray(flagged.numpy() > 0)

        return flag

    def find(self, points: NDArray[np.int64], *, between: bool) -> dict[str, NDArray[Any]]:
        """Return the surface points that touch a partner, and their partners.

        The result contains the indices `a` of the points and `b` of the partners [M], the direction
        `normal` from partner to point [M,3], the distance `gap` [M], m, and `back` [M,3,3]. The
        matrices `back` convert displacements of the partner along the surface to displacements on
        the surface at rest. If `between` is true, the points belong to two bodies.
        """
        results, count = self._results, len(points)
        self._learn(points)
        put(results["chosen"], points)
        self._expose(count)
        reach = (NEAR if between else REACH) * self._model.dx
        self._grid.build(results["x"][:count], reach)
        (self._match_bodies if between else self._match_parts)(count)
        values = (results[name].numpy()[:count] for name in FOUND)
        numbers, normals, cofactors, ratios, x = values
        a = np.flatnonzero(numbers >= 0)
        b = numbers[a].astype(np.int64)
        gap = ((x[a] - x[b]) * normals[a]).sum(axis=1).astype(np.float64)
        back = np.swapaxes(cofactors[b], 1, 2) / np.maximum(ratios[b], LEAST)[:, None, None]
        return {"a": points[a], "b": points[b], "gap": gap, "normal": normals[a], "back": back}

    def _learn(self, points: NDArray[np.int64]) -> None:
        new = points[~self._known[points]]
        if len(new):
            put(self._arrays["slopes"], self._surface.slopes[new], new)
            put(self._arrays["evenness"], self._surface.evenness[new], new)
            self._known[new] = True

    @cached_property
    def _results(self) -> dict[str, wp.array]:
        """Results of the search; each array has space for all surface points."""
        vec3, mat33 = types(self._model.real).vec3, types(self._model.real).mat33
        kinds = {"chosen": int, "x": vec3, "normal": vec3, "turned": mat33}
        kinds |= {"J": self._model.real, "partner": int, "direction": vec3}
        return {name: self._zeros(kind, self._surface.count) for name, kind in kinds.items()}

    @cached_property
    def _expose(self) -> Callable[[int], None]:
        results, arrays = self._results, self._arrays
        inputs = [results["chosen"], *(arrays[name] for name in EXPOSED), self._nodes.u]
        outputs = [results[name] for name in ("x", "normal", "turned", "J")]
        kernel = make_expose(self._model.real, self._nodes.rows)
        return self._division.record(kernel, self._surface.count, inputs, outputs)

    @cached_property
    def _match_parts(self) -> Callable[[int], None]:
        return self._match(REACH, between=False)

    @cached_property
    def _match_bodies(self) -> Callable[[int], None]:
        return self._match(NEAR, between=True)

    def _match(self, reach: float, *, between: bool) -> Callable[[int], None]:
        results, dx = self._results, self._model.dx
        inputs = [self._grid.id, between, reach * dx, dx, results["chosen"]]
        inputs += [*(self._arrays[name] for name in SEARCHED), results["x"], results["normal"]]
        outputs = [results["partner"], results["direction"]]
        kernel = make_partner(self._model.real)
        return self._division.record(kernel, self._surface.count, inputs, outputs)

    @cached_property
    def _arrays(self) -> dict[str, wp.array]:
        surface, model = self._surface, self._model
        t = types(model.real)
        return {
            **dict(zip(("nodes", "weights", "rest"), self._nodes.points, strict=True)),
            "normal": model.array(surface.normal, t.vec3),
            "body": self._numbers(surface.body),
            "side": self._numbers(surface.side),
            "slopes": wp.empty((surface.count, NODES), dtype=t.vec3, device=model.device),
            "evenness": self._zeros(int, surface.count),
        }

    @cached_property
    def _grid(self) -> wp.HashGrid:
        real, device = self._model.real, self._model.device
        return wp.HashGrid(BUCKETS, BUCKETS, BUCKETS, device=device, dtype=real)

    def _numbers(self, values: NDArray[Any]) -> wp.array:
        return wp.array(values.astype(np.int32), dtype=int, device=self._model.device)

    def _zeros(self, kind: Any, count: int) -> wp.array:
        return wp.zeros(count, dtype=kind, device=self._model.device)
