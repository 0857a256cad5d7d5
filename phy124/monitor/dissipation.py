"""Dissipation: where the energy of a run has gone: into the material, into walls, into the grid.

Friction in the material takes the work of that part of its stress which depends on the rate. What
flows takes the work of the rest, less the elastic energy stored. Walls take what they rub off. All
else is the numerical loss: of transfers, and of the layer of cells that a wall stops.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124.kernels.dissipation import LOST, RUBBED, STRAINED, make_dissipation
from phy124.kernels.reduction import shared_out
from phy124.kernels.transfer import Law
from phy124.mpm import Model, State
from phy124.mpm.stage import Recorded
from phy124.mpm.state import part_of
from phy124.mpm.tracks import Tracks
from phy124.mpm.workers import Part

STAGE = "dissipation"
"""Name of its stages."""
ROOM = 16
"""Numbers kept for the sums of one worker, so that no two workers write to one line of cache."""


class Loss(NamedTuple):
    """Energy lost since the start, by where it went [J]; they add up to all that is gone."""

    material: float
    """To friction inside and to flow."""
    contact: float
    """To friction at walls."""
    numerical: float
    """To the grid and the substep; below zero if energy was gained."""

    @property
    def total(self) -> float:
        """All of it [J]."""
        return sum(self)


class Dissipation:
    """The work of the stress, summed in every substep."""

    def __init__(self) -> None:
        self._sums: wp.array | None = None

    def begin(self, model: Model, workers: int) -> None:
        """Count from now on, in one row for each worker."""
        shape = (workers, ROOM)
        self._sums = wp.zeros(shape, dtype=wp.float64, device=model.device)
        self._stress = wp.zeros(len(model), dtype=wp.mat33d, device=model.device)
        self._plastic = any(group.law.project is not None for group in model.groups)

    def record(
        self, part: Part, worker: int, model: Model, state: State, tracks: Tracks
    ) -> Recorded:
        """The launch for a worker's part, right after it has gathered.

        Args:
            part: Particles of one law that a worker steps.
            worker: Number of the worker.
            model: The particles' constants.
            state: What is stepped.
            tracks: What changes with time.
        """
        assert self._sums is not None
        run, group = part.particles, part.group
        threads, *fraction = shared_out(part.count, model.device)
        inputs = [*fraction, part.count, part.chosen, group.rows(run), model.volume[run]]
        inputs += [tracks.clock, state.C[run], state.F[run], part_of(state.history, run)]
        own = cast("wp.array", self._sums[worker])
        kernel = make_dissipation(group.law, model.real)
        outputs = [self._stress[run], own]
        return STAGE, model.launch(kernel, threads, inputs, outputs)

    def loss(self, gained: float, rubbed: float, stored: float) -> Loss:
        """Where the energy went.

        Args:
            gained: Energy of the body now less that at first and less the work of all forces and
                walls [J].
            rubbed: What walls took by friction [J].
            stored: Elastic energy now less that at first [J].
        """
        total = self._total()
        material = float(total[RUBBED])
        if self._plastic:
            material += float(total[STRAINED]) - stored
        return Loss(material, rubbed, -gained - material)

    def snapshot(self) -> dict[str, Any]:
        """The sums so far, and the stress that the next substep begins with."""
        assert self._sums is not None
        return {"sums": self._sums.numpy().tolist(), "stress": wp.clone(self._stress)}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Set the sums back; those of another number of workers go to the first."""
        assert self._sums is not None
        rows = np.array(snapshot["sums"])
        if rows.shape != self._sums.shape:
            whole = np.zeros(self._sums.shape)
            whole[0] = rows.sum(axis=0)
            rows = whole
        self._sums.assign(rows)
        self._stress.assign(snapshot["stress"])

    def _total(self) -> NDArray[np.float64]:
        assert self._sums is not None
        rows: NDArray[Any] = self._sums.numpy()
        return rows[:, :LOST].sum(axis=0)


def split_seconds(timings: Mapping[str, Sequence[float]]) -> float:
    """How much of a run's time was spent on the split [s], by the times of its stages."""
    return timings.get(STAGE, (0.0, 0))[0]


def kernels(laws: Iterable[Law], real: Any) -> Iterator[Any]:
    """What sums up the work of these laws."""
    yield from (make_dissipation(law, real) for law in laws)
