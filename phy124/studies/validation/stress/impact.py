"""Cases 11, 13 and 20: impacts, release from a large strain, a monstrous push."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from phy124.boundaries import Ground
from phy124.forces import ParticleForce
from phy124.materials import Elastic, NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.schema.region import Region
from phy124.studies.validation.bodies import block
from phy124.studies.validation.stress.bodies import (
    assign,
    body,
    deform,
    finite,
    host,
    volume_ratios,
)
from phy124.studies.validation.stress.case import Check, Setting, at_least, at_most, equal


class Impact(NamedTuple):
    """How a cube came off that hit the floor."""

    min_J: float
    max_energy: float
    rebound: float
    """Kinetic energy at the end, relative to the start."""
    substeps: int
    limiters: dict[str, int]


def hit(mach: float, material: Elastic, setting: Setting) -> Impact:
    """A cube thrown flat onto a slippery floor at `mach` times its speed of sound."""
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
        # Both energies at the same instant, as in `Meter`.
        energy = before.elastic + (before.kinetic + after.kinetic) / 2
        max_energy = max(max_energy, energy / first if math.isfinite(energy) else math.inf)
        min_J, before = min(min_J, after.min_J), after

    until = 0.375 * (3 / sound + 1.5 / speed)
    s.advance(until, after=watch)
    rebound = diagnose(s).kinetic / first
    return Impact(min_J, max_energy, rebound, s.clock.substeps, dict(s.clock.limiters))


def impacts(setting: Setting) -> list[Check]:
    """A cube at up to five times the speed of sound rebounds and never turns inside out."""
    checks = []
    for mach in (0.5, 1.0, 2.0, 5.0):
        for nu in (0.3, 0.45) if setting.long else (0.3,):
            found = hit(mach, NeoHookean(E=1e4, nu=nu), setting)
            name = f"Mach {mach:g}" + (f" nu {nu}" if setting.long else "")
            checks += [
                at_least(f"{name}: least J", found.min_J, 1e-9),
                at_most(f"{name}: largest / first energy", found.max_energy, 1.01),
                at_least(f"{name}: rebound", found.rebound, 0.05),
            ]
    return checks


def released(setting: Setting) -> list[Check]:
    """Stretched four times or squeezed to a twentieth, then released, it recovers its shape."""
    checks = []
    for name, F in (("stretch 4", np.diag([1, 1, 4.0])), ("squeeze 0.05", np.diag([1, 1, 0.05]))):
        rest = block(8, 0.25)
        s = body(rest, setting, NeoHookean(E=1e4, nu=0.3), size=0.25)
        assign(s, "x", rest @ F)
        deform(s, F)
        min_J = math.inf
        for k in range(1, 241):
            s.advance(0.01 * k)
            min_J = min(min_J, float(volume_ratios(s).min()))
            # It comes to rest, since its velocities are set to zero again and again.
            s.state.v.zero_()
            s.state.C.zero_()
        size = np.ptp(host(s.state.x), axis=0) / np.ptp(rest, axis=0)
        checks += [
            equal(f"{name}: finite", finite(s)),
            at_least(f"{name}: least J", min_J, 1e-9),
            at_most(f"{name}: shape error", np.abs(size - 1).max(), 0.05),
        ]
    return checks


def monstrous_push(setting: Setting) -> list[Check]:
    """A million times its weight on one particle: momentum equals the impulse, nothing breaks."""
    x = block()
    chosen = x[100]
    weight = 1000 * 0.375**3 / len(x) * 9.81
    region = Region(lower=tuple(chosen - 1e-3), upper=tuple(chosen + 1e-3))
    s = body(x, setting, forces=[ParticleForce(f=(1e6 * weight, 0, 0), region=region)])
    s.advance(1e-3)
    # Velocities are half a substep behind, and have received the impulse up to that time.
    impulse = 1e6 * weight * (s.clock.time - s.clock.last_dt / 2)
    momentum = diagnose(s).momentum
    return [
        equal("finite", finite(s)),
        at_most("momentum / impulse - 1", abs(momentum[0] / impulse - 1), 1e-5),
        at_least("substeps limited by speed, force or gradient", _limited(s.clock.limiters), 1),
    ]


def _limited(limiters: dict[str, int]) -> int:
    return sum(limiters.get(name, 0) for name in ("speed", "gradient", "force"))
