"""Force of a ball pressed between two plates against Hertz; prints one line per depth.

Hertz (1882) treats both bodies as half-spaces. Tatara (1989) adds what the other contact does to a
ball, F f(a) / (pi E) with the contact's radius a, so that the plates come closer by less.
Run `python tests/benchmarks/hertz.py CELLS [float64]`.
"""

import sys

import numpy as np
from scipy.optimize import brentq

from phy124.boundaries import HalfSpace
from phy124.boundaries.motion import Path
from phy124.harmonics import spread_directions
from phy124.materials import NeoHookean
from phy124.monitor.wrenches import Wrenches
from phy124.mpm import Model, Solver

RADIUS, E, NU = 0.5, 1e5, 0.3
DEPTHS = (0.02, 0.035, 0.05)
"""How far each plate presses [m]."""
MOVE, HOLD, FPS = 0.4, 0.4, 50
"""Seconds to go from depth to depth and to stay there, and forces per second."""


def shells(spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Particles of a ball in shells, so that its surface is smooth, and their volumes."""
    count, rng = round(RADIUS / spacing), np.random.default_rng(0)
    step, x, volume = RADIUS / count, [], []
    for k in range(count):
        radius = (k + 0.5) * step
        many = max(4, round(4 * np.pi * (radius / step) ** 2))
        turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        x.append(radius * spread_directions(many) @ turn)
        shell = 4 / 3 * np.pi * ((k + 1) ** 3 - k**3) * step**3
        volume.append(np.full(many, shell / many))
    return np.concatenate(x), np.concatenate(volume)


def pressed(cells: int, precision: str = "float32") -> dict[float, float]:
    """Mean force on a plate at each depth [N]; `cells` across the ball."""
    dx = 2 * RADIUS / cells
    x, volume = shells(dx / 2)
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
        forces = [abs(w.force[2]) for w in wrenches.contacts(model, solver.state, FPS).values()]
        if int(leg) % 2 == 1 and leg > int(leg):
            found.setdefault(float(depth[int(leg)]), []).append(float(np.mean(forces)))
    return {depth: float(np.mean(some)) for depth, some in found.items()}


def hertz(depth: float) -> float:
    """4/3 E / (1 - nu^2) sqrt(R) d^(3/2) [N]."""
    return 4 / 3 * E / (1 - NU**2) * np.sqrt(RADIUS) * depth**1.5


def tatara(depth: float) -> float:
    """Hertz for a ball between two plates [N]."""

    def force(a: float) -> float:
        return 4 * E / (1 - NU**2) * a**3 / (3 * RADIUS)

    def missing(a: float) -> float:
        reach = a * a + 4 * RADIUS**2
        f = 2 * (1 + NU) * RADIUS**2 / reach**1.5 + (1 - NU**2) / np.sqrt(reach)
        return a * a / RADIUS - force(a) * f / (np.pi * E) - depth

    return force(brentq(missing, 1e-9, RADIUS))


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
