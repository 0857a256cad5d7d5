"""Force of a ball pressed between two plates against Hertz; prints one line per depth.

Hertz (1882) treats both bodies as half-spaces. Tatara (1989) adds what the other contact does to a
ball, F f(a) / (pi E) with the contact's radius a, so that the plates come closer by less.
Run `python tests/benchmarks/hertz.py CELLS [float64]`.
"""

import sys

import numpy as np

from phy124.boundaries import HalfSpace
from phy124.boundaries.motion import Path
from phy124.experiments.bodies import shells
from phy124.experiments.hertz import NU, RADIUS, E, hertz, tatara
from phy124.materials import NeoHookean
from phy124.monitor.wrenches import Wrenches
from phy124.mpm import Model, Solver

DEPTHS = (0.02, 0.035, 0.05)
"""How far each plate presses [m]."""
MOVE, HOLD, FPS = 0.4, 0.4, 50
"""Seconds to go from depth to depth and to stay there, and forces per second."""


def pressed(cells: int, precision: str = "float32") -> dict[float, float]:
    """Mean force on a plate at each depth [N]; `cells` across the ball."""
    dx = 2 * RADIUS / cells
    x, volume = shells(RADIUS, dx / 2)
    order = np.argsort(x[:, 0])
    times = np.cumsum([0.0] + [MOVE, HOLD] * len(DEPTHS))
    depths = np.repeat([0.0, *DEPTHS], 2)[1:]
    plates = [
        HalfSpace(
            point=(0, 0, -side * RADIUS), normal=(0, 0, side), friction=0,
            motion=Path(times=tuple(times), points=tuple((0, 0, side * d) for d in depths)),
        )
        for side in (1.0, -1.0)
    ]  # fmt: skip
    wrenches = Wrenches()
    model = Model.of(
        x[order], volume[order], [NeoHookean(E=E, nu=NU, damping=30.0)], dx=dx, precision=precision,
        origin=(0, 0, -RADIUS - 0.75 * dx),
    )  # fmt: skip
    solver = Solver(model, boundaries=wrenches.boundaries(plates), accumulators=[wrenches])
    found: dict[float, list[float]] = {}
    for frame in range(1, round(times[-1] * FPS) + 1):
        wrenches.begin()
        solver.advance(frame / FPS)
        leg, depth = np.interp(frame / FPS, times, np.arange(len(times))), depths
        forces = [abs(w.force[2]) for w in wrenches.contacts(solver, FPS).values()]
        if int(leg) % 2 == 1 and leg > int(leg):
            found.setdefault(float(depth[int(leg)]), []).append(float(np.mean(forces)))
    return {depth: float(np.mean(some)) for depth, some in found.items()}


def main() -> None:
    """One line per depth."""
    cells, precision = int(sys.argv[1]), (sys.argv[2:] or ["float32"])[0]
    for depth, force in pressed(cells, precision).items():
        print(
            f"{cells} cells, depth {depth:g} m: {force:.1f} N, {force / hertz(depth) - 1:+.1%} of "
            f"Hertz, {force / tatara(depth) - 1:+.1%} of Hertz for a ball between plates"
        )


if __name__ == "__main__":
    main()
