"""A solver of particles, in one call."""

from collections.abc import Sequence
from inspect import signature
from typing import Any

from numpy.typing import NDArray

from phy124.materials import Material
from phy124.monitor.observer import Observer
from phy124.monitor.watchdog import Watchdog
from phy124.mpm import Model, Solver, State

OF_MODEL = set(signature(Model.of).parameters)


def make_solver(
    x: NDArray,
    volume: NDArray,
    materials: Sequence[Material],
    *,
    v: NDArray | None = None,
    C: NDArray | None = None,
    **options: Any,
) -> Solver:
    """Particles that move with v [P,3] and C [P,3,3]; options of `Model.of` and of `Solver`."""
    own = {name: options.pop(name) for name in OF_MODEL & options.keys()}
    model = Model.of(x, volume, materials, **own)
    return Solver(model, State.of(model, v, C), **options)


def watch_run(solver: Solver, *observers: Observer) -> Watchdog:
    """Return a watchdog of a solver and of what else observes it."""
    watchdog = Watchdog()
    watchdog.bind(solver, observers)
    return watchdog
