"""Outliers: where particles meet the grid. Those that fly beyond are kept on their parabolas.

The window grows with the particles, but a single one that leaves at speed must not make it grow
without bound. Once the particles spread over more than `LARGEST` nodes, or `GROWTH` times the
first window, a box around their middle is the domain: what is outside is counted, feels the
uniform acceleration and nothing else, and is part of the body again if it comes back.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.ballistic import make_fly, make_hide
from phy124.kernels.transfer import types
from phy124.mpm.grid import MARGIN

if TYPE_CHECKING:
    from phy124.mpm.solver import Solver
    from phy124.mpm.workers import Recorded, Worker

LARGEST = 2**25
"""Nodes a window may have at most."""
LEAST = 2**20
"""Nodes a window may always have."""
GROWTH = 16
"""How many times larger than at first a window may become."""
EVERYWHERE = 1e30
"""Beyond any position [m], and a number in float32."""


class Outliers:
    """A box, or all of space as long as the particles stay together."""

    def __init__(self, solver: Solver) -> None:
        self._solver, self._half = solver, np.zeros(3)
        corners = np.array([[-EVERYWHERE] * 3, [EVERYWHERE] * 3])
        self.corners = solver.array(corners, types(solver.real).vec3)
        """Lowest and highest corner on the device [m]."""
        self.bounded = False
        self.outside = wp.zeros(0, dtype=int, device=solver.device)
        """Indices of the particles that are ballistic at the moment."""
        # The bulk at rest; single particles far away do not count.
        first = self._nodes(*np.quantile(solver.rest, (0.05, 0.95), axis=0))
        self._allowed = min(LARGEST, max(LEAST, GROWTH * min(first, LARGEST)))
        self.most, self.changed = 0, False
        """The greatest number so far, and whether the last measurement changed the list."""

    @property
    def count(self) -> int:
        """Particles that are ballistic at the moment."""
        return len(self.outside)

    def memory(self) -> dict[str, Any]:
        """What `recall` needs, as plain data."""
        half = self._half.tolist() if self.bounded else None
        return {"corners": self.corners.numpy().tolist(), "half": half, "most": self.most}

    def recall(self, memory: dict[str, Any]) -> None:
        """Go on as when `memory` was taken, with the particles where they were then."""
        self.corners.assign(np.array(memory["corners"], self.corners.numpy().dtype))
        self.bounded, self.most, self.changed = memory["half"] is not None, memory["most"], False
        if self.bounded:
            self._half = np.array(memory["half"])
        out = self._beyond() if self.bounded else []
        self.outside = wp.array(out, dtype=int, device=self._solver.device)

    def confine(self, lower: NDArray, upper: NDArray) -> bool:
        """Follow the particles between two corners [m]; True if they must be measured again."""
        if self.bounded and np.isfinite(lower).all():
            measured = self._beyond()
            self._centre((lower + upper) / 2)
            return self.changed or not np.array_equal(measured, self.outside.numpy())
        if not self.bounded and self._nodes(lower, upper) <= self._allowed:
            return False
        x = self._solver.state.x.numpy().astype(np.float64)
        side = self._solver.dx * (self._allowed ** (1 / 3) - 3 * MARGIN)
        self._half, self.bounded = np.full(3, side / 2), True
        # Around a particle, so that at least one is inside.
        self._centre(x[np.abs(x - np.median(x, axis=0)).max(axis=1).argmin()])
        return True

    def around(self, worker: Worker, gather: list[Recorded]) -> list[Recorded]:
        """The gather of a worker, between hiding and moving its ballistic particles, if any."""
        out = self.outside.numpy()
        mine = [out[(out >= start) & (out < stop)] for start, stop in worker.runs]
        s, state, count = self._solver, self._solver.state, sum(map(len, mine))
        if not count:
            return gather
        chosen = wp.array(np.concatenate(mine), dtype=int, device=s.device)
        kept = wp.empty(count, dtype=state.x.dtype, device=s.device)
        away = wp.empty(count, dtype=int, device=s.device)
        inputs = [chosen, s.grid.lattice, worker.nodes.window, s.grid.window]
        hide = s.record(make_hide(s.real), count, inputs, [state.x, kept, away])
        inputs = [chosen, s.clock, s.tracks.values, kept, away]
        fly = s.record(make_fly(s.real), count, inputs, [state.x, state.residue, state.v])
        return [("ballistic", hide), *gather, ("ballistic", fly)]

    def _centre(self, middle: NDArray) -> None:
        low, high = middle - self._half, middle + self._half
        self.corners.assign(np.stack([low, high]).astype(self.corners.numpy().dtype))
        out = self._beyond()
        self.changed = not np.array_equal(out, self.outside.numpy())
        self.outside = wp.array(out, dtype=int, device=self._solver.device)
        self.most = max(self.most, len(out))

    def _beyond(self) -> NDArray[np.int32]:
        """Indices of the particles beyond the corners, by the same comparison as on the device."""
        (low, high), x = self.corners.numpy(), self._solver.state.x.numpy()
        return np.flatnonzero(~np.all((x >= low) & (x <= high), axis=1)).astype(np.int32)

    def _nodes(self, lower: NDArray, upper: NDArray) -> float:
        """Nodes of a window over a box; in floating point, for boxes beyond all integers."""
        return float(np.prod((upper - lower) / self._solver.dx + 3 + 2 * MARGIN))
