"""Searches for surface points that may touch, and for the positions opposite to the points."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.arguments import types
from phy124.kernels.lattice.partners import make_expose, make_flag, make_partner
from phy124.kernels.launches import put
from phy124.lattice.surface import Surface
from phy124.lattice.walls import Nodes
from phy124.mpm.model import Model

FAR = 3.0
"""If two sampled points are closer than this [cells], the surfaces around the points may touch."""
REACH, NEAR = 1.4, 1.0
"""Largest distance between points that may touch [cells], within one body and between two
bodies.
"""
LEAST = 0.05
"""Smallest volume ratio for mapping displacements on the surface to the body at rest."""
BUCKETS = 32
"""Number of buckets along each axis of the search grid."""
SEARCHED = "body", "side", "rest", "normal"
"""Names of the arrays that the search for partners reads, in the kernel's order."""


class Partners:
    """Searches for points that may touch among the surface points of all bodies."""

    def __init__(self, surface: Surface, model: Model, nodes: Nodes) -> None:
        """Prepare the search.

        Args:
            surface: Points that may touch.
            model: The constants of the run.
            nodes: Arrays of the nodes.
        """
        self._surface, self._model, self._nodes = surface, model, nodes

    def flagger(
        self, sample: NDArray[np.int64], *, between: bool
    ) -> Callable[[NDArray], NDArray[np.bool_]]:
        """Return a function that flags the sampled points that may touch another part or body [K],
        from their current positions [K,3], m.

        Args:
            sample: Indices of the sampled points [K].
            between: Whether the other part is a different body.
        """
        model, arrays, grid, far = self._model, self._arrays, self._grid, FAR * self._model.dx
        x, flagged = self._zeros(types(model.real).vec3, len(sample)), self._zeros(int, len(sample))
        inputs = [grid.id, between, far, model.dx, self._numbers(sample), x]
        inputs += [arrays[name] for name in ("rest", "normal", "body", "side")]
        launch = model.launch(make_flag(model.real), len(sample), inputs, [flagged])

        def flag(at: NDArray) -> NDArray[np.bool_]:
            if launch is not None:
                put(x, at)
                grid.build(x, far)
                launch.launch()
            return np.asarray(flagged.numpy() > 0)

        return flag

    def find(self, points: NDArray[np.int64], *, between: bool) -> dict[str, NDArray[Any]]:
        """Return the points that have a partner, and the partners.

        Args:
            points: Indices of the points among which to search [K].
            between: Whether the points belong to two bodies.

        Returns:
            `a` and `b`, the indices of the points and of their partners [M]; `normal`, the
            direction from the partner to the point [M,3]; and `back`, which maps displacements
            along the surface at the partner to the body at rest [M,3,3].
        """
        model, arrays, count = self._model, self._arrays, len(points)
        t, reach = types(model.real), NEAR if between else REACH
        chosen = self._numbers(points)
        x, normal, direction = (self._zeros(t.vec3, count) for _ in range(3))
        turned, J, partner = (self._zeros(kind, count) for kind in (t.mat33, model.real, int))
        slopes, flat = self._surface.slopes[points], self._surface.flat[points]
        inputs = [chosen, arrays["nodes"], arrays["weights"], model.array(slopes, t.vec3)]
        inputs += [arrays["rest"], arrays["normal"], self._nodes.u]
        expose = make_expose(model.real, self._nodes.rows)
        self._launch(expose, count, inputs, [x, normal, turned, J])
        inputs = [self._bucket(x, reach), between, reach * model.dx, model.dx, chosen]
        inputs += [self._numbers(flat), *(arrays[name] for name in SEARCHED), x, normal]
        self._launch(make_partner(model.real), count, inputs, [partner, direction])
        results = partner.numpy(), direction.numpy(), turned.numpy(), J.numpy()
        numbers, normals, cofactors, ratios = (np.asarray(values) for values in results)
        a = np.flatnonzero(numbers >= 0)
        b = numbers[a].astype(np.int64)
        back = np.swapaxes(cofactors[b], 1, 2) / np.maximum(ratios[b], LEAST)[:, None, None]
        return {"a": points[a], "b": points[b], "normal": normals[a], "back": back}

    @cached_property
    def _arrays(self) -> dict[str, wp.array]:
        """Arrays of the surface on the device."""
        surface, model = self._surface, self._model
        t = types(model.real)
        return {
            "nodes": wp.array(surface.nodes, dtype=int, device=model.device),
            "weights": model.array(surface.weights, model.real),
            "rest": model.array(surface.x, t.vec3),
            "normal": model.array(surface.normal, t.vec3),
            "body": self._numbers(surface.body),
            "side": self._numbers(surface.side),
        }

    @cached_property
    def _grid(self) -> wp.HashGrid:
        real, device = self._model.real, self._model.device
        return wp.HashGrid(BUCKETS, BUCKETS, BUCKETS, device=device, dtype=real)

    def _bucket(self, x: wp.array, reach: float) -> Any:
        """Sort points into the grid, and return the grid's identifier."""
        self._grid.build(x, reach * self._model.dx)
        return self._grid.id

    def _numbers(self, values: NDArray[Any]) -> wp.array:
        return wp.array(values.astype(np.int32), dtype=int, device=self._model.device)

    def _zeros(self, kind: Any, count: int) -> wp.array:
        return wp.zeros(count, dtype=kind, device=self._model.device)

    def _launch(self, kernel: Any, count: int, inputs: list[Any], outputs: list[Any]) -> None:
        wp.launch(kernel, count, inputs=inputs, outputs=outputs, device=self._model.device)
