"""Runs the hard cases with which PhysGaussian's solver was tested (docs/lab/stability.md).

`python tests/benchmarks/abuse.py` prints one line per case, and takes a minute. The bodies are
those of the table: a cube of 512 particles (1,728 in impacts) with E = 1e5 Pa.
"""

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from phy124.boundaries import Ground
from phy124.forces import Gravity
from phy124.materials import FixedCorotated, Material, NeoHookean, Sand, Snow
from phy124.monitor.diagnostics import diagnose
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.watchdog import Watchdog
from phy124.mpm import Solver
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.stress import Setting
from phy124.studies.validation.stress.bodies import (
    Array,
    assign,
    finite,
    host,
    volume_ratios,
)
from phy124.studies.validation.stress.inputs import quick

sys.path.insert(0, str(Path(__file__).parents[1]))
from phy124.studies.validation.bodies import block, make_solver, turning
from support.shapes import ball, watch_run

SIZE = 0.5
"""Edge of the cubes [m]; 512 particles are two per cell and axis."""
JELLY = NeoHookean(E=1e5, nu=0.3)
LAWS = (NeoHookean, FixedCorotated)


def cube(per_axis: int = 8, height: float = 0.3) -> Array:
    """Return a cube whose centre is `height` above the floor."""
    return block(per_axis, SIZE, (0, 0, height))


def watched(x: Array, material: Material = JELLY, **options: Any) -> tuple[Solver, Watchdog]:
    """Return a solver with its watchdog, as in a simulation."""
    external, count = ExternalWork(), options.pop("filled", len(x))
    walls = options.pop("boundaries", ())
    s = make_solver(
        x,
        np.full(len(x), SIZE**3 / count),
        [material],
        dx=2 * SIZE / round(count ** (1 / 3)),
        forces=external.wrap_forces(options.pop("forces", ())),
        boundaries=external.wrap_walls(walls, walls),
        accumulators=[external],
        **options,
    )
    return s, watch_run(s, external)


def go(s: Solver, watch: Watchdog, seconds: float, frames: int = 1) -> str:
    """Run frames as a simulation does; return the violation, or the smallest J and the number of
    resets."""
    for k in range(1, frames + 1):
        s.repair.begin(s.clock)
        watch.before_attempt()
        s.advance(seconds * k / frames, after=watch.after_substep)
        problem = watch.after_attempt()
        if problem or not finite(s):
            return problem.what if problem else "not finite"
        s.repair.end()
    resets = f", {s.repair.count} reset" if s.repair.count else ""
    return f"sound, J >= {min(watch.min_J, 1.0):.2g}{resets}"


def dropped(material: Material) -> str:
    """A cube hits the floor at 1 m/s."""
    x = cube(height=0.26)
    v = np.tile([0, 0, -1.0], (len(x), 1))
    s, watch = watched(x, material, v=v, forces=[Gravity()], boundaries=[Ground()])
    steps = 2000 * 0.6 * s.model.dx / material.wave_speed()
    return (
        go(s, watch, min(0.2, steps), 4) + f", {s.clock.substeps} substeps in {s.clock.time:.2g} s"
    )


def long_substep() -> str:
    """A substep that is ten times too long, compared with the automatic substep."""
    results = []
    for ceiling in (math.inf, 10 * 0.6 * 0.125 / JELLY.wave_speed()):
        x = cube()
        s, watch = watched(
            x, v=np.tile([0, 0, -1.0], (len(x), 1)), boundaries=[Ground()], ceiling=ceiling
        )
        go(s, watch, 0.1)
        results.append(host(s.state.x))
    return f"largest difference {np.abs(results[1] - results[0]).max():.1e} m"


def nan_position() -> str:
    """One position in the object's file is NaN."""
    gaussians = ball(512)
    means = gaussians.means.copy()
    means[7] = np.nan
    report = Simulation(prepare(replace(gaussians, means=means), quick(Setting()))).run().report
    return f"complete: {report['complete']}; {report['cleaning']}"


def far(place: float) -> str:
    """One particle far from the body."""
    x = np.concatenate([cube(), [[place, 0, 0.3]]])
    s, watch = watched(x, forces=[Gravity()], filled=512)
    said = go(s, watch, 0.1)
    error = np.abs(host(s.state.x) - x + [0, 0, 9.81 * 0.1**2 / 2]).max()
    return f"{said}, {s.outliers.count} ballistic, off its parabola by {error:.1e} m"


def leaving() -> str:
    """The body at 30 m/s for half a second."""
    x = cube()
    s, watch = watched(x, v=np.tile([30.0, 0, 0], (len(x), 1)))
    return (
        go(s, watch, 0.5, 5)
        + f", shape off by {np.abs(host(s.state.x) - x - [15, 0, 0]).max():.1e} m"
    )


def impact(mach: float, law: type[NeoHookean] | type[FixedCorotated]) -> str:
    """A cube of 1,728 particles on a slippery floor."""
    material, x = law(E=1e5, nu=0.3), cube(12, 0.27)
    speed = mach * material.sound_speed()
    s, watch = watched(
        x, material, v=np.tile([0, 0, -speed], (len(x), 1)), boundaries=[Ground(contact="slip")]
    )
    first = diagnose(s).kinetic
    said = go(s, watch, SIZE * (3 / material.sound_speed() + 1.5 / speed), 10)
    notes = "; noted" if watch.notes() else ""
    return f"{said}, rebound {diagnose(s).kinetic / first:.2%}{notes}"


def broken(F: Array, material: Material = JELLY) -> str:
    """One element with an impossible deformation."""
    s, watch = watched(cube(), material)
    deformations = host(s.state.F)
    deformations[100] = F
    assign(s, "F", deformations)
    return go(s, watch, 0.05) + f", J = {volume_ratios(s)[100]:.3g} at the end"


def fast() -> str:
    """One particle at 20 km/s."""
    x = cube()
    v = np.zeros_like(x)
    v[100] = [2e4, 0, 0]
    s, watch = watched(x, v=v)
    return go(s, watch, 0.01, 2)


def slippery() -> str:
    """Tangential speed lost on a slippery floor in 0.1 s."""
    x = cube(height=SIZE / 2)
    s, watch = watched(
        x,
        v=np.tile([1.0, 0, 0], (len(x), 1)),
        forces=[Gravity()],
        boundaries=[Ground(contact="slip")],
        origin=(0, 0, -0.75 * 0.125),
    )
    said = go(s, watch, 0.1)
    kept = diagnose(s).momentum[0] / s.model.mass.numpy().sum()
    return f"{said}, {1 - kept:.1e} of the speed lost"


def tiny() -> str:
    """An object of 10 micrometres falls for a millisecond."""
    x = cube() * (1e-5 / SIZE)
    s = make_solver(x, np.full(512, 1e-15 / 512), [JELLY], dx=2.5e-6, forces=[Gravity()])
    s.advance(1e-4)
    fallen = (x - host(s.state.x))[:, 2].mean()
    return f"fell {fallen / (9.81 * 1e-8 / 2):.6f} of what it should, {s.clock.substeps} substeps"


def spinning() -> str:
    """Energy lost at once, and in eight turns."""
    x = cube()
    s, watch = watched(x, **turning(x, (0, 0, 2 * math.pi)))
    first = diagnose(s).energy
    s.step(1e-4, 1e-4)
    at_once = 1 - diagnose(s).energy / first
    s.clock.last_dt = 1e-4
    go(s, watch, 8.0)
    return f"{at_once:.1e} at once, {1 - diagnose(s).energy / first:.2%} in eight turns"


def falling() -> str:
    """Free fall of 0.1 s."""
    x = cube()
    s, _ = watched(x, forces=[Gravity()])
    s.advance(0.1)
    return f"{np.abs(host(s.state.x) - x + [0, 0, 9.81 * 0.1**2 / 2]).max():.1e} m off"


def snow() -> str:
    """Snow dropped from 5 cm."""
    x = cube()
    s, watch = watched(x, Snow(), forces=[Gravity()], boundaries=[Ground()])
    said = go(s, watch, 0.5, 12)
    return f"{said}, {np.ptp(host(s.state.x)[:, 2]) / np.ptp(x[:, 2]):.0%} of its height"


def no_volume() -> str:
    """One particle without volume."""
    volume = np.full(512, SIZE**3 / 512)
    volume[3] = 0
    try:
        make_solver(cube(), volume, [JELLY], dx=0.125)
    except ValueError as error:
        return f"refused: {error}"
    return "accepted"


def near_zero() -> str:
    """A body across x = 0, compared with a body at large x."""
    results = []
    for cells in (16, 0):
        x = cube() + [cells * 0.125, 0, 0]
        s, _ = watched(x, **turning(x, (0, 0, 3.0)), boundaries=[Ground()])
        s.advance(0.2)
        results.append(host(s.state.x) - [cells * 0.125, 0, 0])
    return f"largest difference {np.abs(results[1] - results[0]).max():.1e} m"


ABUSE: dict[str, Callable[[], str]] = {
    "E = 2e9 Pa": lambda: dropped(NeoHookean(E=2e9, nu=0.3)),
    "nu = 0.4999": lambda: dropped(NeoHookean(E=1e5, nu=0.4999)),
    "substep ten times too long": long_substep,
    "one position NaN": nan_position,
    "one particle at 5 m": lambda: far(5.0),
    "one particle at 1000 km": lambda: far(1e6),
    "body at 30 m/s": leaving,
    **{
        f"Mach {m}, {law.__name__}": lambda m=m, law=law: impact(m, law)
        for m in (2.0, 5.0)
        for law in LAWS
    },
    "one element inside out": lambda: broken(np.diag([1, 1, -0.5])),
    "one element flat": lambda: broken(np.diag([1, 1, 0.0])),
    "sand, one element inside out": lambda: broken(np.diag([1, 1, -0.5]), Sand(E=1e5)),
    "one particle at 20 km/s": fast,
    "slippery floor": slippery,
    "object of 10 micrometres": tiny,
    "spinning body": spinning,
    "free fall of 0.1 s": falling,
    "snow, dropped": snow,
    "one particle without volume": no_volume,
    "body near x = 0": near_zero,
}


if __name__ == "__main__":
    for name, abuse in ABUSE.items():
        print(f"{name}: {abuse()}", flush=True)
