"""Measures energy loss, error, noise and cost of each transfer (table of docs/lab/transfers.md).

python tests/benchmarks/transfers.py
"""

import math
import time
from functools import cache

import numpy as np

from phy124.boundaries import Ground
from phy124.generators.shapes import make_shape
from phy124.materials import NeoHookean, Rigid
from phy124.monitor.diagnostics import diagnose
from phy124.mpm import Model, Scheme, Solver, State
from phy124.runtime.context import RunContext
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.accuracy.problems import angular_momentum
from phy124.studies.validation.bodies import ball_of_shells, block, lattice

SCHEMES = {
    "apic": Scheme(),
    "aflip, blend 0.5": Scheme(1, 0.5),
    "aflip, blend 0.95": Scheme(1, 0.95),
    "aflip, blend 1": Scheme(1, 1.0),
    "xpic2": Scheme(2),
    "xpic3": Scheme(3),
    "xpic5": Scheme(5),
}
ROUNDS = 2
"""Runs of each, of which the fastest counts."""


def noise(solver):
    """Kinetic energy of what the grid does not carry, as a fraction of all kinetic energy."""
    model, state = solver.model, solver.state
    probe = Solver(model, State.of(model), threads=1, scheme=Scheme(1, 0.0))
    probe.state.restore(state.snapshot())
    probe.step(0.0, 0.0)
    m, kept = model.mass.numpy()[:, None], probe.fluctuation
    return float((m * kept.v.numpy() ** 2).sum() / (m * state.v.numpy() ** 2).sum())


def tumble(scheme, cells=4, duration=0.3):
    """A free `rigid` box about its middle axis for 0.3 s; error: change of angular momentum."""
    edges, (wx, wy, wz) = (0.6, 0.4, 0.2), (1.0, 6.0, 0.0)
    dx = edges[2] / cells
    counts = [round(2 * edge / dx) for edge in edges]
    x = lattice(counts, dx / 2, [-n * dx / 4 for n in counts])
    C = np.array([[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]])
    stiff = Rigid(nu=0.3, speed=2.0, strain=0.02)
    model = Model.of(x, np.full(len(x), (dx / 2) ** 3), [stiff], dx=dx)
    state = State.of(model, x @ C.T, np.broadcast_to(C, (len(x), 3, 3)))
    solver = Solver(model, state, threads=1, scheme=scheme)
    first, spin = diagnose(solver).energy, angular_momentum(solver)
    solver.advance(duration)
    turned = np.linalg.norm(angular_momentum(solver) - spin) / np.linalg.norm(spin)
    return solver, 1 - diagnose(solver).energy / first, float(turned)


def bar(scheme, cells=24, periods=5):
    """A free bar of one row of cells in its first mode for five periods; error: phase [periods]."""
    E, density = 1e4, 1000.0
    dx, wave, speed = 1 / cells, math.pi, math.sqrt(E / density)
    z = (np.arange(cells * 2) + 0.5) * dx / 2
    x, v, C = (np.zeros((len(z), *shape)) for shape in ((3,), (3,), (3, 3)))
    x[:, 2], v[:, 2] = z, 1e-4 * np.cos(wave * z)
    C[:, 2, 2] = -1e-4 * wave * np.sin(wave * z)
    soft = NeoHookean(E=E, nu=0.0, density=density)
    model = Model.of(x, np.full(len(x), dx**3 / 2), [soft], dx=dx, precision="float64")
    solver = Solver(model, State.of(model, v, C), threads=1, scheme=scheme)
    first, mode = diagnose(solver).energy, np.cos(wave * z)
    solver.advance(periods * 2 / speed)
    moving = (mode * solver.state.v.numpy()[:, 2]).sum()
    lying = (mode * (solver.state.x.numpy()[:, 2] - z)).sum() * wave * speed
    late = abs(math.atan2(lying, moving)) / (2 * math.pi)
    return solver, 1 - diagnose(solver).energy / first, late


def bounce(scheme, cells=16):
    """An elastic ball without damping on a floor; error: speed that it does not get back."""
    dx, radius = 1 / cells, 0.5
    x, volume = ball_of_shells(radius, dx / 2)
    x = x + [0, 0, radius + 0.02]
    rubber = NeoHookean(E=5e4, density=1000)
    model = Model.of(x, volume, [rubber], dx=dx, origin=(0, 0, -0.75 * dx))
    state = State.of(model, np.tile([0, 0, -1.0], (len(x), 1)))
    floor = Ground(contact="separate", friction=0.0)
    solver = Solver(model, state, boundaries=[floor], threads=1, scheme=scheme)
    first = diagnose(solver).energy
    solver.advance(0.45)
    m = solver.model.mass.numpy().astype(float)
    up = float((m * solver.state.v.numpy()[:, 2]).sum() / m.sum())
    return solver, 1 - diagnose(solver).energy / first, 1 - up


def shaken(scheme):
    """A block whose particles have random velocities, at the boldest cfl, for 0.2 s."""
    rng = np.random.default_rng(0)
    x = block(10, 0.5)
    model = Model.of(x, np.full(len(x), 0.05**3), [NeoHookean(E=2e4)], dx=0.1, cfl=0.9)
    state = State.of(model, rng.normal(scale=0.3, size=x.shape))
    solver = Solver(model, state, threads=1, scheme=scheme)
    first = diagnose(solver).energy
    solver.advance(0.2)
    return solver, 1 - diagnose(solver).energy / first, math.nan


def pressed(cells, **transfer):
    """The preset `press` on a ball."""
    accuracy = {"cells": cells, **transfer}
    scene = Scene.named("press").replaced({"accuracy": accuracy, "time.sleep": False})
    run = Simulation(
        prepare(make_shape("sphere", (1, 1, 1), (0.5, 0.5, 0.5)), scene, RunContext(threads=1))
    )
    return run, run.run()


@cache
def reference():
    """Places of the pressed ball's Gaussians by APIC at 32 cells [T,N,3], m."""
    return pressed(32)[1].means


def press(scheme):
    """The preset `press` on a ball at 16 cells; error: RMS distance from APIC at 32 cells [m]."""
    name = {0: "apic", 1: "aflip"}.get(scheme.passes, f"xpic{scheme.passes}")
    blend = {"blend": scheme.share} if scheme.passes == 1 else {}
    whole = reference()
    run, clip = pressed(16, transfer=name, **blend)
    away = np.sqrt(((clip.means - whole) ** 2).sum(axis=2).mean())
    return run.solver, -clip.report["balance"]["energy_gain"], float(away)


CASES = (tumble, bar, bounce, press, shaken)


def main():
    print("| case | transfer | energy lost | error | noise | ns per particle and substep |")
    print("| --- | --- | --: | --: | --: | --: |")
    for run in CASES:
        run(SCHEMES["apic"])  # loads what all of them need
        for name, scheme in SCHEMES.items():
            seconds = []
            for _ in range(ROUNDS):
                begun = time.process_time()
                solver, lost, error = run(scheme)
                seconds.append(time.process_time() - begun)
            cost = min(seconds) / solver.clock.substeps / len(solver.model) * 1e9
            row = [f"{100 * lost:.2g} %", f"{error:.1e}", f"{noise(solver):.0e}", f"{cost:.0f}"]
            print(f"| {run.__name__} | {name} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
