"""Dissipation: computes how much energy is lost to the material, to walls and to the grid.

Viscous materials dissipate the work of the rate-dependent part of their stress. Plastic and fluid
materials also dissipate the work of the remaining stress, minus the elastic energy that they store.
Walls dissipate energy by friction. All other losses are numerical.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

import warp as wp
from numpy.typing import NDArray

from phy124.kernels.reduction import shared_out
from phy124.kernels.work import LOST, RUBBED, STRAINED, make_dissipation
from phy124.monitor.observer import Effect, Observer, Subject
from phy124.mpm import Model, State
from phy124.mpm.model import part_of
from phy124.mpm.stage import Recorded
from phy124.mpm.tracks import Tracks
from phy124.mpm.workers import Part

STAGE = "dissipation"
STRIDE = 16
"""Length of each worker's row of sums, chosen so that no two workers write to one cache line."""


class Loss(NamedTuple):
    """Energy [J] lost since the start, by cause."""

    material: float
    """Energy lost to viscosity, plastic flow and fluid flow."""
    contact: float
    """Energy lost to friction at walls."""
    numerical: float
    """Energy lost by numerical errors of grid and substeps; negative if energy was gained."""

    @property
    def total(self) -> float:
        """Total lost energy [J]."""
        return sum(self)


class Dissipation(Observer):
    """Sums the work of the stress."""

    in_gathers = True
    kept = ("_sums", "_stress")

    def __init__(self) -> None:
        self._sums: wp.array | None = None

    @classmethod
    def called_for(cls, subject: Subject) -> bool:
        """Return whether the scene requests the lost energy by cause."""
        return subject.scene.checks.energy and not subject.scene.projects

    @classmethod
    def kernels(cls, subject: Subject, real: Any) -> Iterator[Any]:
        """Yield the kernels that sum the work of the scene's laws."""
        yield from (make_dissipation(law, real) for law in subject.laws)

    @classmethod
    def effect(cls, subject: Subject) -> Effect | None:
        """Return the entry in the report's list of effects."""
        why = "checks.energy is off: the causes of energy loss are not distinguished"
        return Effect("work of the stress", cls.called_for(subject), why)

    def allocate(self, model: Model, workers: int) -> None:
        """Allocate a row of sums for each worker."""
        shape = (workers, STRIDE)
        self._sums = wp.zeros(shape, dtype=wp.float64, device=model.device)
        self._stress = wp.zeros(len(model), dtype=wp.mat33d, device=model.device)
        solid = (group for group in model.groups if group.body not in model.wet)
        self._plastic = any(group.law.project is not None for group in solid)

    def record(
        self, part: Part, worker: int, model: Model, state: State, tracks: Tracks
    ) -> Recorded:
        """Record the kernel launch that sums the work of the stress on a worker's particles of one
        law.

        Args:
            part: A worker's particles of one law.
            worker: Index of the worker.
            model: The particles' constants.
            state: The state after the gather.
            tracks: Quantities that change over time.
        """
        assert self._sums is not None
        run, group = part.particles, part.group
        threads, *fraction = shared_out(part.count, model.device)
        inputs = [*fraction, part.count, part.chosen, group.rows(run), model.volume[run]]
        inputs += [tracks.clock, state.C[run], state.F[run], part_of(state.history, run)]
        outputs = [self._stress[run], cast("wp.array", self._sums[worker])]
        kernel = make_dissipation(group.law, model.real)
        return STAGE, model.launch(kernel, threads, inputs, outputs)

    def loss(self, gained: float, rubbed: float, stored: float) -> Loss:
        """Return the energy [J] lost to the material, to the walls and to the grid.

        Args:
            gained: Current energy minus initial energy and external work [J].
            rubbed: Energy lost to friction at walls [J].
            stored: Current elastic energy minus the initial elastic energy [J].
        """
        assert self._sums is not None
        rows: NDArray[Any] = self._sums.numpy()
        total = rows[:, :LOST].sum(axis=0)
        material = float(total[RUBBED])
        if self._plastic:
            material += float(total[STRAINED]) - stored
        return Loss(material, rubbed, -gained - material)

    def details(self, loss: Loss, change: float, stored: float) -> dict[str, Any]:
        """Return further terms of the energy balance [J].

        `change` is the change of the energy, and `stored` the change of the elastic energy.
        """
        return {}

    def false_gain(self) -> float:
        """Return the energy [J], never negative, that the coupling of liquid and bodies has
        created.
        """
        return 0.0

    def open(self) -> None:
        """Sum the work of the stress from now on."""


def split_seconds(timings: Mapping[str, Sequence[float]]) -> float:
    """Return the time [s] for computing the lost energy, from the times of stages."""
    return timings.get(STAGE, (0.0, 0))[0]
