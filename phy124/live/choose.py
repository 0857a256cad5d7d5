"""How fine a live run may be on this machine: a short trial, and the finest grid that keeps up."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

from phy124.accuracy.promises import Promise, promise
from phy124.gaussians import Gaussians
from phy124.live.limits import number
from phy124.scene import Scene
from phy124.simulation import Simulation, Stopped

CELLS = (8, 10, 12, 14, 16, 20, 24, 28, 32)
"""Grids that may be chosen."""
FIRST = 12
"""The grid that is tried first."""
SPARE = 0.8
"""Fraction of a frame's time that the run may take."""
FRAMES, SECONDS = 4, 0.2
"""A trial has as many frames, and ends after so much time [s]."""
COST_POWER = 4
"""The cost of a frame grows with this power of the cells: particles in space, and substeps."""


class Choice(NamedTuple):
    """A scene on a grid that this machine runs fast enough, or as fast as it can."""

    scene: Scene
    factor: float
    """Simulated seconds per second that the trial reached."""
    promise: Promise
    """What error it is promised."""

    @property
    def sentence(self) -> str:
        """For people."""
        slow = "" if self.factor >= 1 else "; time runs slower than in reality"
        cells = f"{self.scene.resolution.cells} cells across the object"
        return f"{cells}, {self.factor:.1f}x real time{slow}. {self.promise.brief}"


def held_rate(
    gaussians: Gaussians,
    scene: Scene,
    *,
    rate: float = 1.0,
    max_error: float | None = None,
    **options: Any,
) -> Choice:
    """The finest grid on which a scene runs at a rate here, its Gaussians riding on a lattice.

    Args:
        gaussians: The object.
        scene: The scene; its own cells are ignored.
        rate: Simulated seconds per second, with a fifth of the time to spare.
        max_error: Largest error promised, in sizes of the object; the coarsest grid that has it
            is taken, fast enough or not. None: whatever the rate allows.
        **options: Those of `Simulation`.

    Raises:
        InputError: The object or the scene cannot be used, or a number is out of bounds.
    """
    rate = number("rate", rate, 0.01, 100)
    allowed = SPARE / (scene.time.fps * rate)
    cells = (
        FIRST
        if max_error is None
        else _exact_enough(scene, number("max_error", max_error, 1e-6, 1))
    )
    spent = _trial(gaussians, _on(scene, cells), options)
    if max_error is None:
        cells, spent = _finest(gaussians, scene, cells, spent, allowed, options)
    chosen = _on(scene, cells)
    return Choice(chosen, 1 / (scene.time.fps * spent), promise(chosen))


def _on(scene: Scene, cells: int) -> Scene:
    """The scene on another grid, its Gaussians riding on a lattice."""
    accuracy = scene.resolution.model_copy(update={"cells": cells, "precision": "float32"})
    return scene.model_copy(update={"accuracy": accuracy, "binding": "lattice"})


def _exact_enough(scene: Scene, error: float) -> int:
    """The coarsest grid of which such an error is promised; the finest if none is."""
    for cells in CELLS:
        promised = promise(_on(scene, cells)).error
        if promised is not None and promised <= error:
            return cells
    return CELLS[-1]


def _finest(
    gaussians: Gaussians, scene: Scene, tried: int, spent: float, allowed: float,
    options: dict[str, Any],
) -> tuple[int, float]:  # fmt: skip
    """The finest grid that takes no longer per frame than allowed [s], and its seconds."""
    known = {tried: spent}
    fits = [n for n in CELLS if spent * (n / tried) ** COST_POWER <= allowed]
    index = CELLS.index(fits[-1]) if fits else 0
    while CELLS[index] not in known:
        known[CELLS[index]] = _trial(gaussians, _on(scene, CELLS[index]), options)
        if known[CELLS[index]] > allowed and index > 0:
            index -= 1
    return CELLS[index], known[CELLS[index]]


def _trial(gaussians: Gaussians, scene: Scene, options: dict[str, Any]) -> float:
    """Seconds per frame of the first frames, without the very first, which may compile."""
    timing = scene.time.model_copy(update={"sleep": False, "budget": 1e8})
    run = Simulation(
        gaussians, scene.model_copy(update={"time": timing}), keep=False, **options
    )  # fmt: skip
    spent: list[float] = []
    try:
        run.step()
        run.step()
        while len(spent) < FRAMES and sum(spent) < SECONDS:
            begun = time.perf_counter()
            run.step()
            spent.append(time.perf_counter() - begun)
    except Stopped:
        return max(spent, default=1.0)
    return sorted(spent)[len(spent) // 2]
