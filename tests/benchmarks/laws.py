"""Measures the cost of each law: CPU nanoseconds per particle and substep, a JSON line each.

There are 132,651 particles, eight per cell, as in a grid of 64^3. The laws are run in turn, and the
smallest time of each counts. `limits` is the time to measure the limits of the substep once, which
a run does in every fourth substep. In `rest` the strains are 0.1 %, and hardly any particle yields.
In `flow` they are 5 %, and every particle yields.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
import warp as wp

from phy124.kernels import hencky
from phy124.kernels.transfer import Law
from phy124.materials import (
    Elastic,
    FixedCorotated,
    Fluid,
    Foam,
    Hencky,
    Material,
    Metal,
    NeoHookean,
    Plasticine,
    Sand,
    Snow,
)
from phy124.mpm import Solver

sys.path.insert(0, str(Path(__file__).parents[1]))
from phy124.studies.validation.bodies import lattice, make_solver

SIDE = 51
DX = 1 / 64


@wp.func
def no_stress(F: wp.mat33, C: wp.mat33, h: wp.vec2, theta: wp.vec2):
    """Zero: the cost of the transfers alone."""
    return wp.mat33()


class Nothing(Elastic):
    """Transfers only."""

    device_law = Law("nothing", no_stress, hencky.hencky_modulus, 2)


LAWS: dict[str, Material] = {
    "transfers only": Nothing(),
    "neo_hookean": NeoHookean(),
    "neo_hookean, damped": NeoHookean(damping=50.0),
    "fixed_corotated": FixedCorotated(),
    "hencky": Hencky(),
    "metal": Metal(yield_stress=2e3),
    "plasticine": Plasticine(yield_stress=2e3),
    "foam": Foam(),
    "sand": Sand(),
    "snow": Snow(),
    "fluid": Fluid(viscosity=1.0),
}


def solver(material: Material, strain: float, *, simd: bool = True) -> Solver:
    """A cube of particles with a random strain each."""
    rng = np.random.default_rng(0)
    x = lattice((SIDE,) * 3, DX / 2, (0.3, 0.3, 0.3))
    made = make_solver(x, np.full(len(x), (DX / 2) ** 3), [material], dx=DX, threads=1, simd=simd)
    F = np.eye(3) + strain * rng.standard_normal((len(x), 3, 3))
    if isinstance(material, Fluid):
        F = np.eye(3) * (1 + strain * rng.standard_normal((len(x), 1, 1)))
    made.state.F.assign(F.astype(np.float32))
    made.step(1e-9, 1e-9)
    return made


def look(made: Solver) -> float:
    """CPU nanoseconds per particle of measuring what limits the substep."""
    begin = time.thread_time()
    made.workers[0].measure()
    return (time.thread_time() - begin) / len(made.model.rest) * 1e9


def cost(made: Solver, start: dict[str, wp.array]) -> tuple[float, float]:
    """CPU nanoseconds per particle of scatter and gather, from the same state each time."""
    made.state.restore(start)
    spent = []
    for name, work in (stage for phase in made.workers[0].phases for stage in phase):
        begin = time.thread_time()
        work()
        if name.startswith(("p2g", "g2p")):
            spent.append((time.thread_time() - begin) / len(made.model.rest) * 1e9)
    return spent[0], spent[1]


def main(repeats: int) -> None:
    """Print a line per law and state."""
    cases = {}
    for state, strain in (("rest", 1e-3), ("flow", 0.05)):
        for name, material in LAWS.items():
            made = solver(material, strain)
            F = made.state.F.numpy().copy()
            rng = np.random.default_rng(1)
            if not isinstance(material, Fluid):
                F = (np.eye(3) + strain * rng.standard_normal(F.shape)).astype(np.float32)
            made.state.F.assign(F)
            cases[name, state] = made, made.state.snapshot(), []
    for _ in range(repeats):
        for made, start, spent in cases.values():
            spent.append((*cost(made, start), look(made)))
    for (name, state), (_, _, spent) in cases.items():
        p2g, g2p, limits = np.min(spent, axis=0)
        line = {"law": name, "state": state, "p2g": p2g, "g2p": g2p, "sum": p2g + g2p}
        line["limits"] = limits
        print(json.dumps({k: round(v, 1) if isinstance(v, float) else v for k, v in line.items()}))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 8)
