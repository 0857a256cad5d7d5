"""Chooses the finest grid that this machine can run live, by a trial of half a second."""

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple

from phy124.accuracy.promises import Promise, promise
from phy124.gaussians import Frame, Gaussians
from phy124.imaging.painted import WHOLE, Crop
from phy124.live.engine import Live
from phy124.live.limits import check_number
from phy124.particles.thickness import Proportions
from phy124.runtime.context import RunContext
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene
from phy124.scene.lattices import choose_solver
from phy124.simulation.bodies import proportions_of

CELLS = (8, 10, 12, 14, 16, 20, 24, 28, 32)
"""Possible numbers of cells across the object."""
TRIED = 12
"""Number of cells across the object in the trial, unless a largest error is requested."""
SPARE = 0.8
"""Largest fraction of the interval between frames that the computation of a frame may take."""
WARM = 2
"""Number of warm-up frames of a trial."""
FRAMES = 6
"""Number of timed frames of a trial."""
SECONDS = 0.2
"""Time limit for the timed frames [s]."""
COST_POWER = 4
"""The time for substeps is proportional to the number of cells across the object, raised to this
power.
"""


class Cost(NamedTuple):
    """Computing time of a frame on the trial's grid, divided into `substeps` and `others` [s]."""

    cells: int
    substeps: float
    others: float
    """Time to compute and show the Gaussians of a frame [s], which does not depend on the grid."""

    def on(self, cells: int) -> float:
        """Estimate the computing time of a frame on another grid [s]."""
        return self.others + self.substeps * (cells / self.cells) ** COST_POWER


class Choice(NamedTuple):
    """A scene on the grid that `held_rate` has chosen."""

    scene: Scene
    factor: float
    """Simulated seconds per second of real time on this machine, estimated from the trial."""
    promise: Promise
    """Error bound of the chosen grid."""

    @property
    def sentence(self) -> str:
        """Description of the choice in one sentence."""
        slow = "" if self.factor >= 1 else "; slower than real time"
        cells = f"{self.scene.resolution.cells} cells across the object"
        return f"{cells}, {self.factor:.1f}x real time{slow}. {self.promise.brief}"


def held_rate(
    gaussians: Gaussians,
    scene: Scene,
    context: RunContext | None = None,
    *,
    rate: float = 1.0,
    max_error: float | None = None,
    shapes: bool = True,
    crop: Crop = WHOLE,
    show: Callable[[Frame], object] = lambda frame: None,
) -> Choice:
    """Find the finest grid on which this machine reaches a given frame rate.

    The Gaussians are bound to a lattice of particles.

    Args:
        gaussians: The object.
        scene: The scene. The scene's number of cells is ignored.
        context: Device, number of threads, and progress function.
        rate: Simulated seconds per real second. A fifth of the time between frames is kept free.
        max_error: Largest error bound, relative to the object's size. The coarsest grid within this
            bound is chosen, even if it is too slow. If None, the error is not limited.
        shapes: Whether frames contain the shapes of the Gaussians, as for `Live`.
        crop: Position of the object in the picture on which the masks of parts were painted.
        show: Function that processes each frame, for example by drawing the frame. The trial
            includes the time that this function takes.

    Raises:
        InputError: The object or the scene cannot be used, or a number is out of bounds.
    """
    rate, context = check_number("rate", rate, 0.01, 100), context or RunContext()
    scene = choose_solver(scene, context.device)
    proportions = proportions_of(gaussians, scene)
    start = partial(Live, gaussians, shapes=shapes, crop=crop)
    if max_error is None:
        cost = _trial(start, _on(scene, TRIED), context, show)
        allowed = SPARE / (scene.time.fps * rate)
        cells = max((n for n in CELLS if cost.on(n) <= allowed), default=CELLS[0])
    else:
        cells = _exact_enough(scene, proportions, check_number("max_error", max_error, 1e-6, 1))
        cost = _trial(start, _on(scene, cells), context, show)
    chosen = _on(scene, cells)
    return Choice(chosen, 1 / (scene.time.fps * cost.on(cells)), promise(chosen, proportions))


def _on(scene: Scene, cells: int) -> Scene:
    accuracy = scene.resolution.model_copy(update={"cells": cells, "precision": "float32"})
    return scene.model_copy(update={"accuracy": accuracy, "binding": "lattice"})


def _exact_enough(scene: Scene, proportions: Proportions | None, error: float) -> int:
    """Return the coarsest grid with an error bound of at most `error`, or else the finest grid."""
    for cells in CELLS:
        promised = promise(_on(scene, cells), proportions).error
        if promised is not None and promised <= error:
            return cells
    return CELLS[-1]


def _trial(
    start: Callable[[Scene, RunContext], Live],
    scene: Scene,
    context: RunContext,
    show: Callable[[Frame], object],
) -> Cost:
    """Measure the time of frames in an expensive motion: a hand swings the object by its top."""
    watch = Stopwatch()
    live = start(scene, replace(context, watch=watch))
    means = live.step().gaussians.means
    x, y, z = means[means[:, 2].argmax()].tolist()
    live.grab((x, y, z))
    sway = 0.3 * live.limits.size
    frames: list[tuple[float, float]] = []
    for count in range(WARM + FRAMES):
        live.move_to((x, y + (sway if count % 2 else -sway), z))
        begun, before = time.perf_counter(), watch.seconds.get("simulate", 0.0)
        show(live.step())
        substeps = watch.seconds.get("simulate", 0.0) - before
        frames.append((time.perf_counter() - begun, substeps))
        # If a frame was too violent, it is computed again without a hand, so nothing is held.
        if not live.holds or sum(whole for whole, _ in frames[WARM:]) > SECONDS:
            break
    counted = sorted(frames[WARM:] or frames[-1:])
    whole, substeps = counted[len(counted) // 2]
    return Cost(scene.resolution.cells, substeps, whole - substeps)
