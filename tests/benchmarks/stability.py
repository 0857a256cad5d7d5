"""Measures the figures of docs/lab/stability.md and draws its plot.

`python tests/benchmarks/stability.py OUT` takes about two minutes on one core.
"""

import json
import math
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from phy124.materials import FixedCorotated, Material, NeoHookean
from phy124.mpm import Unstable
from phy124.studies.validation.stress import CASES, Setting, examine
from phy124.studies.validation.stress.bodies import DX, Array, body, host, steps
from phy124.studies.validation.stress.impact import throw_at_floor
from phy124.studies.validation.stress.limits import heavy_on_light

sys.path.insert(0, str(Path(__file__).parents[1]))
from phy124.studies.validation.bodies import block, lattice, make_solver

SETTING = Setting()
POISSON = (0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.49)


def layouts() -> dict[str, Array]:
    """Particle layouts whose limits are measured."""
    rng = np.random.default_rng(0)
    return {
        "one particle": np.array([[0.013, 0.021, 0.017]]),
        "a hundred in one point": np.tile([[0.013, 0.021, 0.017]], (100, 1)),
        "1 per cell": block(4, 0.5),
        "8 per cell": block(8, 0.5),
        "8 per cell, random": rng.uniform(-0.25, 0.25, (512, 3)),
        "27 per cell": block(9, 0.375),
    }


def diverges(x: Array, material: Material, dt: float) -> bool:
    """Return whether small noise grows without bound in 400 substeps."""
    rng = np.random.default_rng(1)
    v = 1e-5 * DX / dt * rng.normal(size=x.shape)
    C = np.tile(1e-5 / dt * np.eye(3), (len(x), 1, 1))
    if len(x) == 100:
        v[:] = v[0]
    s = body(x, SETTING, material, size=0.5, v=v, C=C)
    for _ in range(20):
        try:
            steps(s, 20, dt)
        except Unstable:
            return True
        F = host(s.state.F)
        if not np.abs(F.transpose(0, 2, 1) @ F - np.eye(3)).max() < 0.1:
            return True
    return False


def limit(x: Array, material: Material) -> float:
    """Longest stable substep, in units of dx / sqrt(A / rho), to half a per cent."""
    unit = DX / material.wave_speed()
    low, high = 0.5, 2.5
    while high - low > 0.005:
        middle = (low + high) / 2
        low, high = (low, middle) if diverges(x, material, middle * unit) else (middle, high)
    return low


def measure_limits() -> dict[str, list[float]]:
    """The limit of each layout over Poisson's ratio."""
    return {
        name: [limit(x, NeoHookean(E=1e4, nu=nu)) for nu in POISSON]
        for name, x in layouts().items()
    }


def measure_impacts() -> list[dict[str, Any]]:
    """Cubes against a slippery floor at Mach 0.1 to 5."""
    rows = []
    for law in (NeoHookean, FixedCorotated):
        for nu in (0.3, 0.45):
            for mach in (0.1, 0.5, 1.0, 2.0, 5.0):
                try:
                    result = throw_at_floor(mach, law(E=1e4, nu=nu), SETTING)._asdict()
                except RuntimeError as error:
                    result = {"error": str(error)}
                rows.append({"law": law.__name__, "nu": nu, "mach": mach, **result})
    return rows


def measure_long() -> list[dict[str, Any]]:
    """The cases at full length whose figures the page quotes."""
    rows = []
    for number in (5, 8, 9, 10, 19, 25):
        start = time.process_time()
        row, checks = examine(CASES[number - 1], SETTING._replace(long=True))
        results = {check.what: check.measured for check in checks}
        seconds = time.process_time() - start
        rows.append({"case": row.case, "verdict": row.verdict, "seconds": seconds, **results})
    return rows


def measure_tears() -> list[dict[str, Any]]:
    """A bar pulled ever harder: the largest stretch it came back from, and the least it did not.

    The stretch is that of its middle half; it parted if a gap wider than three cells opened.
    """
    rows = []
    for per_axis in (2, 3, 4):
        held, parted = 1.0, math.inf
        for speed in np.arange(2.0, 12.0, 0.5):
            stretch, gap = pull(per_axis, float(speed))
            if gap < 3:
                held = max(held, stretch)
            else:
                parted = min(parted, stretch)
                break
        rows.append(
            {"per_axis": per_axis, "held": held, "parted": parted, "cells": held / per_axis}
        )
    return rows


def pull(per_axis: int, speed: float, cells: int = 16) -> tuple[float, float]:
    """A bar of 1 m whose ends fly apart at `speed` m/s: largest stretch, widest gap in cells."""
    h = 1 / cells / per_axis
    x = lattice([round(side / h) for side in (0.375, 0.375, 1.0)], h)
    rate = np.zeros((len(x), 3, 3))
    rate[:, 2, 2] = 2 * speed
    v = np.einsum("pij,pj->pi", rate, x - 0.5)
    s = make_solver(
        x, np.full(len(x), h**3), [NeoHookean(E=1e4)], dx=1 / cells, v=v, C=rate, threads=1
    )
    middle, stretch, gap = np.abs(x[:, 2] - 0.5) < 0.25, 1.0, 0.0
    for frame in range(60):
        s.advance((frame + 1) * 0.015)
        stretch = max(stretch, float(s.state.F.numpy()[middle, 2, 2].mean()))
        gap = max(gap, float(np.diff(np.sort(s.state.x.numpy()[middle, 2])).max() / s.model.dx))
    return stretch, gap


def draw(limits: dict[str, list[float]], path: Path) -> None:
    """Measured against used limit."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(7, 4.2), dpi=110)
    for name, values in limits.items():
        axes.plot(POISSON, values, marker="o", markersize=4, label=name)
    axes.axhline(1, color="black", linewidth=1, linestyle="--", label="derived, isolated particle")
    axes.axhline(0.6, color="black", linewidth=2, label="used (accuracy.cfl = 0.6)")
    usual = [math.sqrt((3 * nu / (1 - 2 * nu) + 1) / (nu / (1 - 2 * nu) + 1)) for nu in POISSON]
    axes.plot(POISSON, usual, color="grey", linestyle=":", label="dx / p-wave speed, as is usual")
    axes.set(xlabel="Poisson's ratio", ylabel="substep / (dx / sqrt(A / rho))", ylim=(0, 2))
    axes.legend(fontsize=8, ncols=2, loc="lower left")
    axes.set_title("Longest stable substep: measured and used")
    figure.tight_layout()
    figure.savefig(path)


def main(out: Path) -> None:
    """Measure and draw."""
    out.mkdir(parents=True, exist_ok=True)
    limits = measure_limits()
    draw(limits, out / "stability.png")
    stacks = {r: heavy_on_light(r, SETTING, 0.4)._asdict() for r in (1.0, 1e2, 1e4)}
    results = {"limits": limits, "impacts": measure_impacts(), "stacks": stacks}
    results["tears"] = measure_tears()
    results["long"] = measure_long()
    (out / "stability.json").write_text(json.dumps(results, indent=1))
    print(json.dumps(results, indent=1))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
