"""How fine a live run may be on this machine: a trial of half a second tells what grids take."""

from __future__ import annotations

import time
from typing import Any, NamedTuple

from phy124.accuracy.promises import Promise, promise
from phy124.gaussians import Gaussians
from phy124.live.engine import Live
from phy124.live.limits import number
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene

CELLS = (8, 10, 12, 14, 16, 20, 24, 28, 32)
"""Grids that may be chosen."""
TRIED = 12
"""The grid of the trial, unless an error is asked for."""
SPARE = 0.8
"""Fraction of a frame's time that the run may take."""
WARM, FRAMES, SECONDS = 2, 6, 0.2
"""A trial has so many frames before it counts, so many that count, and no more time [s]."""
COST_POWER = 4
"""Substeps cost as this power of the cells: particles fill space, and substeps get shorter."""


class Cost(NamedTuple):
    """What a frame takes on the grid that was tried [s]."""

    cells: int
    substeps: float
    others: float
    """Shapes of the Gaussians and whatever else does not depend on the grid."""

    def on(self, cells: int) -> float:
        """On another grid."""
        return self.others + self.substeps * (cells / self.cells) ** COST_POWER


class Choice(NamedTuple):
    """A scene on a grid that this machine runs fast enough, or as fast as it can."""

    scene: Scene
    factor: float
    """Simulated seconds per second that the machine can do, told from the trial."""
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
        **options: Those of `Live`.

    Raises:
        InputError: The object or the scene cannot be used, or a number is out of bounds.
    """
    rate = number("rate", rate, 0.01, 100)
    if max_error is None:
        cost = _trial(gaussians, _on(scene, TRIED), options)
        allowed = SPARE / (scene.time.fps * rate)
        cells = max((n for n in CELLS if cost.on(n) <= allowed), default=CELLS[0])
    else:
        cells = _exact_enough(scene, number("max_error", max_error, 1e-6, 1))
        cost = _trial(gaussians, _on(scene, cells), options)
    chosen = _on(scene, cells)
    return Choice(chosen, 1 / (scene.time.fps * cost.on(cells)), promise(chosen))


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


def _trial(gaussians: Gaussians, scene: Scene, options: dict[str, Any]) -> Cost:
    """What frames take while a hand swings the object by its top, which costs most."""
    watch = Stopwatch()
    live = Live(gaussians, scene, **options, watch=watch)
    means = live.step().gaussians.means
    x, y, z = means[means[:, 2].argmax()].tolist()
    live.grab((x, y, z))
    sway = 0.3 * live.limits.size
    frames: list[tuple[float, float]] = []
    for count in range(WARM + FRAMES):
        live.to((x, y + (sway if count % 2 else -sway), z))
        begun, before = time.perf_counter(), watch.seconds.get("simulate", 0.0)
        live.step()
        substeps = watch.seconds.get("simulate", 0.0) - before
        frames.append((time.perf_counter() - begun, substeps))
        if sum(whole for whole, _ in frames[WARM:]) > SECONDS:
            break
    counted = sorted(frames[WARM:])
    whole, substeps = counted[len(counted) // 2]
    return Cost(scene.resolution.cells, substeps, whole - substeps)
