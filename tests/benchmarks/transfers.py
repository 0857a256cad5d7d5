"""What each transfer loses, errs, trembles and costs: the table of docs/results/transfers.md.

python tests/benchmarks/transfers.py [--quick]
"""

import argparse
import math
import platform
import time

import numpy as np

from phy124.accuracy.problems import angular_momentum, block
from phy124.boundaries import Ground
from phy124.experiments.bodies import brick, shells
from phy124.forces import Gravity
from phy124.materials import NeoHookean, Rigid
from phy124.monitor.diagnostics import diagnose
from phy124.mpm import Model, Solver, State
from phy124.mpm.fluctuation import Scheme

SCHEMES = {
    "apic": Scheme(),
    "aflip 0.5": Scheme(1, 0.5),
    "aflip 0.95": Scheme(1, 0.95),
    "aflip 1": Scheme(1, 1.0),
    "xpic2": Scheme(2),
    "xpic3": Scheme(3),
    "xpic5": Scheme(5),
}


def noise(solver):
    """Kinetic energy of what the grid cannot show, as a fraction of all kinetic energy."""
    from phy124.mpm.fluctuation import Fluctuation
    from phy124.mpm.substep import Recorder

    kept = Fluctuation.of(solver.model, solver.state, Scheme(1))
    recorder = Recorder(
        solver.model, solver.state, solver.grids, solver.tracks, solver.outliers, solver.workers,
        solver.slabs, solver.pairs, kept,
    )  # fmt: skip
    for phase in recorder._passes(list(solver.workers[0].parts), 0):
        for _, launch in phase:
            launch()
    m = solver.model.mass.numpy()
    v, all_v = kept.v.numpy(), solver.state.v.numpy()
    return float((m[:, None] * v**2).sum() / (m[:, None] * all_v**2).sum())


def tumble(scheme, cells=4, duration=1.0):
    """A free rigid box about its middle axis: energy and angular momentum lost."""
    edges, (wx, wy, wz) = (0.6, 0.4, 0.2), (1.0, 6.0, 0.0)
    dx = edges[2] / cells
    counts = [round(2 * edge / dx) for edge in edges]
    x = brick(counts, dx / 2, [-n * dx / 4 for n in counts])
    C = np.array([[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]])
    model = Model.of(
        x, np.full(len(x), (dx / 2) ** 3), [Rigid(nu=0.3, speed=2.0, strain=0.02)], dx=dx
    )
    state = State.of(model, x @ C.T, np.broadcast_to(C, (len(x), 3, 3)))
    solver = Solver(model, state, threads=1, scheme=scheme)
    first, spin = diagnose(solver).energy, angular_momentum(solver)
    solver.advance(duration)
    turned = np.linalg.norm(angular_momentum(solver) - spin) / np.linalg.norm(spin)
    return solver, {"lost": 1 - diagnose(solver).energy / first, "error": float(turned)}


def vibration(scheme, cells=24, periods=5):
    """A free bar in its first mode: energy lost, and how late it is [periods]."""
    E, density = 1e4, 1000.0
    dx, wave, speed = 1 / cells, math.pi, math.sqrt(E / density)
    z = (np.arange(cells * 2) + 0.5) * dx / 2
    x, v, C = (np.zeros((len(z), *shape)) for shape in ((3,), (3,), (3, 3)))
    x[:, 2], v[:, 2] = z, 1e-4 * np.cos(wave * z)
    C[:, 2, 2] = -1e-4 * wave * np.sin(wave * z)
    model = Model.of(
        x,
        np.full(len(x), dx**3 / 2),
        [NeoHookean(E=E, nu=0.0, density=density)],
        dx=dx,
        precision="float64",
    )
    solver = Solver(model, State.of(model, v, C), threads=1, scheme=scheme)
    first, period = diagnose(solver).energy, 2 / speed
    solver.advance(periods * period)
    shape = np.cos(wave * z)
    moving = (shape * solver.state.v.numpy()[:, 2]).sum()
    lying = (shape * (solver.state.x.numpy()[:, 2] - z)).sum() * wave * speed
    late = -math.atan2(lying, moving) / (2 * math.pi)
    return solver, {"lost": 1 - diagnose(solver).energy / first, "error": abs(late)}


def bounce(scheme, cells=16, damping=0.0):
    """An elastic ball on a floor: energy lost until it is up again; the height it returns to."""
    radius, dx = 0.5, 1 / cells
    x, volume = shells(radius, dx / 2)
    x = x + [0, 0, radius + 0.02]
    model = Model.of(
        x,
        volume,
        [NeoHookean(E=5e4, density=1000, damping=damping)],
        dx=dx,
        origin=(0, 0, -0.75 * dx),
    )
    v = np.tile([0, 0, -1.0], (len(x), 1))
    solver = Solver(
        model,
        State.of(model, v),
        boundaries=[Ground(contact="separate", friction=0.0)],
        threads=1,
        scheme=scheme,
    )
    first = diagnose(solver).energy
    solver.advance(0.45)
    m = solver.model.mass.numpy().astype(float)
    up = float((m * solver.state.v.numpy()[:, 2]).sum() / m.sum())
    return solver, {"lost": 1 - diagnose(solver).energy / first, "error": 1 - up}


def shaken(scheme):
    """A block whose particles have random velocities: energy after 0.2 s over that at first."""
    rng = np.random.default_rng(0)
    x = block(5, 0.1)
    model = Model.of(x, np.full(len(x), 0.05**3), [NeoHookean(E=2e4)], dx=0.1, cfl=0.9)
    state = State.of(model, rng.normal(scale=0.3, size=x.shape))
    solver = Solver(model, state, threads=1, scheme=scheme)
    first = diagnose(solver).energy
    solver.advance(0.2)
    return solver, {"lost": 1 - diagnose(solver).energy / first, "error": math.nan}


CASES = {"tumble": tumble, "bar": vibration, "bounce": bounce, "shaken": shaken}


def main():
    for case, run in CASES.items():
        for name, scheme in SCHEMES.items():
            begun = time.process_time()
            try:
                solver, found = run(scheme)
            except Exception as e:
                print(case, name, "FAILED", e, flush=True)
                continue
            took = (time.process_time() - begun) / solver.clock.substeps / len(solver.model) * 1e9
            print(
                case,
                name,
                {k: f"{v:.3e}" for k, v in found.items()},
                f"noise {noise(solver):.2e} {took:.0f} ns",
                solver.clock.substeps,
                len(solver.model),
                flush=True,
            )


main()
