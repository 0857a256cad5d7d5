"""Runs a scene on different grids, and records which runs stopped early or tore the material."""

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from phy124.errors import InputError
from phy124.gaussians import Frame, Gaussians
from phy124.imaging.painted import Crop
from phy124.io.clip import Clip
from phy124.monitor.tearing import Tearing
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.simulation.bodies import Placed

DENSEST = 4.0
"""Largest number of particles per cell and axis."""


@dataclass
class Runs:
    """The runs of a scene on different grids; the runs differ only in accuracy."""

    gaussians: Gaussians
    scene: Scene
    context: RunContext
    crop: Crop
    begin: Callable[[Simulation], object] = lambda run: None
    see: Callable[[Simulation], object] = lambda run: None
    done: dict[int, tuple[Simulation, Clip]] = field(default_factory=dict)
    spent: dict[int, float] = field(default_factory=dict)
    """Duration of the run on each grid [s]."""
    placed: Placed | None = None
    """The object in its position; None before the first simulation."""
    denser: bool = False
    """Whether further runs use one more particle per cell and axis, because the material tore."""

    def simulation(self, cells: int) -> Simulation:
        """Return a simulation on the grid with this number of cells, without starting it."""
        base = self.scene.resolution
        per_axis = self.scene.particles_per_axis + self.denser
        accuracy = base.model_copy(update={"cells": cells, "particles_per_axis": per_axis})
        changed = self.scene.model_copy(update={"accuracy": accuracy})
        options: dict[str, Any] = {"crop": self.crop, "placed": self.placed}
        setup = prepare(self.gaussians, changed, self.context, **options)
        self.placed = setup.placed
        return Simulation(setup)

    def clip(self, cells: int) -> Clip:
        """Return the clip on the grid with this number of cells; run the simulation if
        necessary.
        """
        if cells not in self.done:
            start = time.perf_counter()
            self._make(cells)
            if cells in self.torn and not self.denser:
                self._make_denser(cells)
            self.spent[cells] = time.perf_counter() - start
        return self.done[cells][1]

    def _make(self, cells: int) -> None:
        simulation = self.simulation(cells)
        self.done[cells] = simulation, self.run(simulation)

    def run(self, simulation: Simulation, each: Callable[[Frame], object] | None = None) -> Clip:
        """Run a simulation and return its clip."""
        self.begin(simulation)
        return simulation.run(each, record=self.see)

    def _make_denser(self, cells: int) -> None:
        """Repeat a run in which the material tore; use more particles per cell, or give up at the
        limit.
        """
        self.denser = self.scene.particles_per_axis + 1 <= DENSEST
        if self.denser:
            with suppress(InputError):
                self._make(cells)

    @property
    def stopped(self) -> list[int]:
        """Grids on which the run stopped before its last frame; estimates ignore such grids."""
        return sorted(n for n, (_, clip) in self.done.items() if not clip.report["complete"])

    @property
    def torn(self) -> list[int]:
        """Grids on which the material may have torn; estimates of the error ignore such grids."""
        tearing = {level: run.find(Tearing) for level, (run, _) in self.done.items()}
        return sorted(level for level, search in tearing.items() if search and search.likely)

    @property
    def whole(self) -> list[int]:
        """Numbers of cells across the object on the grids on which the run was completed, and the
        material did not tear.
        """
        return sorted(set(self.done) - set(self.torn) - set(self.stopped))
