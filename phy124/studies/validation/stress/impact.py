"""Cases 11, 13, 20 and 32: impacts, release from a large strain, a huge force, free solids."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from phy124.boundaries import Ground
from phy124.forces import ParticleForce
from phy124.materials import Elastic, NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.mpm import FreeBody, Solver
from phy124.schema.region import Region
from phy124.studies.validation.bodies import block
from phy124.studies.validation.stress.bodies import (
    Array,
    assign,
    body,
    deform,
    finite,
    host,
    volume_ratios,
)
from phy124.studies.validation.stress.case import Check, Setting, at_least, at_most, equal, lower


class Impact(NamedTuple):
    """Measurements of a cube's impact on the floor."""

    min_J: float
    max_energy: float
    rebound: float
    """Final kinetic energy divided by the initial kinetic energy."""
    substeps: int
    limiters: dict[str, int]


def throw_at_floor(mach: float, material: Elastic, setting: Setting) -> Impact:
    """Simulate the impact of a cube, face-on, on a frictionless floor.

    `mach` is the speed divided by the speed of sound in the cube.
    """
    mu, lam = material.lame
    sound = math.sqrt((lam + 2 * mu) / material.density)
    x = block(middle=(0, 0, 0.21))
    speed = mach * sound
    s = body(
        x,
        setting,
        material,
        v=np.tile([0.0, 0, -speed], (len(x), 1)),
        boundaries=[Ground(contact="slip")],
        dx=0.0625,
    )
    first = diagnose(s).kinetic
    min_J, max_energy, before = 1.0, 1.0, diagnose(s)

    def watch() -> None:
        nonlocal min_J, max_energy, before
        after = diagnose(s)
        # Measure elastic and kinetic energy at the same instant, as in `Meter`.
        energy = before.elastic + (before.kinetic + after.kinetic) / 2
        max_energy = max(max_energy, energy / first if math.isfinite(energy) else math.inf)
        min_J, before = lower(min_J, after.min_J), after

    until = 0.375 * (3 / sound + 1.5 / speed)
    s.advance(until, after=watch)
    rebound = diagnose(s).kinetic / first
    return Impact(min_J, max_energy, rebound, s.clock.substeps, dict(s.clock.limiters))


def check_impacts(setting: Setting) -> list[Check]:
    """Check that a cube rebounds at up to Mach 5, without inverted particles."""
    checks = []
    for mach in (0.5, 1.0, 2.0, 5.0):
        for nu in (0.3, 0.45) if setting.long else (0.3,):
            impact = throw_at_floor(mach, NeoHookean(E=1e4, nu=nu), setting)
            name = f"Mach {mach:g}" + (f" nu {nu}" if setting.long else "")
            checks += [
                at_least(f"{name}: least J", impact.min_J, 1e-9),
                at_most(f"{name}: largest / first energy", impact.max_energy, 1.01),
                at_least(f"{name}: rebound", impact.rebound, 0.05),
            ]
    return checks


def release(setting: Setting) -> list[Check]:
    """Check that a body recovers its shape after axial stretches of 4 and 0.05."""
    checks = []
    for name, F in (("stretch 4", np.diag([1, 1, 4.0])), ("squeeze 0.05", np.diag([1, 1, 0.05]))):
        rest = block(8, 0.25)
        s = body(rest, setting, NeoHookean(E=1e4, nu=0.3), size=0.25)
        assign(s, "x", rest @ F)
        deform(s, F)
        min_J = math.inf
        for k in range(1, 241):
            s.advance(0.01 * k)
            min_J = lower(min_J, volume_ratios(s).min())
            # Repeatedly setting the velocities to zero brings the body to rest.
            s.state.v.zero_()
            s.state.C.zero_()
        size = np.ptp(host(s.state.x), axis=0) / np.ptp(rest, axis=0)
        checks += [
            equal(f"{name}: finite", finite(s)),
            at_least(f"{name}: least J", min_J, 1e-9),
            at_most(f"{name}: shape error", np.abs(size - 1).max(), 0.05),
        ]
    return checks


def push_hard(setting: Setting) -> list[Check]:
    """Check that momentum equals impulse for a force of 1e6 times the weight of one particle."""
    x = block()
    chosen = x[100]
    weight = 1000 * 0.375**3 / len(x) * 9.81
    region = Region(lower=tuple(chosen - 1e-3), upper=tuple(chosen + 1e-3))
    s = body(x, setting, forces=[ParticleForce(f=(1e6 * weight, 0, 0), region=region)])
    s.advance(1e-3)
    # Velocities are half a substep behind positions, so the impulse of the last half substep is
    # missing.
    impulse = 1e6 * weight * (s.clock.time - s.clock.last_dt / 2)
    momentum = diagnose(s).momentum
    limited = sum(s.clock.limiters.get(name, 0) for name in ("speed", "gradient", "force"))
    return [
        equal("finite", finite(s)),
        at_most("momentum / impulse - 1", abs(momentum[0] / impulse - 1), 1e-5),
        at_least("substeps limited by speed, force or gradient", limited, 1),
    ]


LOST = {"float32": 1e-5, "float64": 1e-11}
"""Largest relative change due to rounding in a short run."""
SHAPES = {"sphere": (0.2, 0.2, 0.2), "box": (0.25, 0.2, 0.15), "capsule": (0.15, 0.3, 0.15)}


def free(setting: Setting) -> list[Check]:
    """Check momenta and energy when a spinning free solid hits a block off-centre."""
    checks = []
    for shape, half in SHAPES.items():
        for ratio in (1e-2, 1.0, 1e2):
            solid = FreeBody(
                "body",
                shape,
                half,
                (0.04, 0.03, 0.45),
                density=1000 * ratio,
                velocity=(0.3, 0.1, -1.0),
                spin=(1.0, 2.0, 3.0),
            )
            s = body(block(), setting, free=[solid])
            before = _whole(s)
            s.advance(0.3)
            after, name = _whole(s), f"{shape}, {ratio:g} times as dense"
            lost = LOST[setting.precision]
            checks += [
                at_most(f"{name}: momentum lost", _change(after.momentum, before.momentum), lost),
                at_most(
                    f"{name}: angular momentum lost", _change(after.angular, before.angular), lost
                ),
                at_most(f"{name}: energy", after.energy / before.energy, 1.0),
            ]
    return checks


@dataclass(frozen=True, eq=False)
class _Sums:
    momentum: Array
    angular: Array
    energy: float


def _whole(s: Solver) -> _Sums:
    (solid,), (pose,), (motion,) = s.free.all, s.free.poses(), s.free.motions()
    axes = solid._replace(turn=tuple(pose[3:].tolist())).axes
    block, momentum = diagnose(s), solid.mass * motion[:3]
    spin = axes @ (solid.moments * (axes.T @ motion[3:]))
    return _Sums(
        block.momentum + momentum,
        block.angular + np.cross(pose[:3], momentum) + spin,
        block.energy + float(momentum @ motion[:3] + spin @ motion[3:]) / 2,
    )


def _change(after: Array, before: Array) -> float:
    return float(np.abs(after - before).max() / np.abs(before).max())
