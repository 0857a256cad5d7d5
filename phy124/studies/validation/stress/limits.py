"""Cases 6 to 10 and 19: the stability limit for a wide range of parameters."""

import math
from typing import NamedTuple

import numpy as np
from pydantic import ValidationError

from phy124.boundaries import Ground
from phy124.forces import Gravity
from phy124.materials import NeoHookean
from phy124.mpm import Unstable
from phy124.mpm.timestep import CFL
from phy124.studies.validation.bodies import block, make_solver
from phy124.studies.validation.stress.bodies import (
    DX,
    Array,
    Meter,
    body,
    finite,
    host,
    relative,
    stable_dt,
    steps,
    vibrating,
    volume_ratios,
)
from phy124.studies.validation.stress.case import (
    Check,
    Setting,
    at_least,
    at_most,
    equal,
    higher,
    lower,
)

POISSON = (0.0, 0.3, 0.45, 0.49)


def check_isolated(setting: Setting) -> list[Check]:
    """Check the stability limit dx / sqrt(A / rho) of a single particle.

    Substeps of 0.95 times the limit must be stable, and substeps of 1.10 times the limit must not.
    """
    checks = []
    for nu in POISSON:
        points = np.array([[0.013, 0.021, 0.017]])
        checks += _around_the_limit(f"nu {nu}", points, nu, setting)
    return checks


def check_coincident(setting: Setting) -> list[Check]:
    """Check that the limit of a single particle also holds for 100 particles at one point."""
    points = np.tile([[0.013, 0.021, 0.017]], (100, 1))
    return _around_the_limit("100 in one point", points, 0.3, setting)


def _around_the_limit(name: str, x: Array, nu: float, setting: Setting) -> list[Check]:
    count = 20_000 if setting.long else 2000
    _, growth = disturb(x, nu, 0.95, setting, count)
    lasted, _ = disturb(x, nu, 1.10, setting, count)
    return [
        at_most(
            f"{name}: growth of the motion in {count} substeps of 0.95 times the limit",
            growth,
            1.05,
        ),
        at_most(f"{name}: substeps of 1.10 times the limit until instability", lasted, 100),
    ]


def disturb(
    x: Array, nu: float, fraction: float, setting: Setting, count: int
) -> tuple[int, float]:
    """Disturb a body at rest, and measure whether the strain grows.

    The volumetric mode, which is stiffest, is disturbed most strongly.

    Args:
        x: Positions [P,3], m.
        nu: Poisson's ratio.
        fraction: The substep as a fraction of the limit of an isolated particle.
        setting: Device and precision.
        count: Number of substeps.

    Returns: The number of substeps with finite values, and the growth of the strain. The growth is
    the maximum strain in the second half divided by the maximum in the first half; if the body is
    unstable, the growth is infinite.
    """
    material = NeoHookean(E=1e4, nu=nu)
    # The limit at rest is computed independently of the solver: A = 2 mu + 3 lambda.
    A = material.E / (1 + nu) + 3 * material.E * nu / ((1 + nu) * (1 - 2 * nu))
    dt = fraction * DX * math.sqrt(material.density / A)
    mixed = np.random.default_rng(1).normal(size=(3, 3))
    C = 1e-4 / dt * (np.eye(3) + 0.1 * (mixed + mixed.T))
    v = (x - x.mean(axis=0)) @ C.T
    s = body(x, setting, material, size=DX, v=v, C=np.tile(C, (len(x), 1, 1)))
    strains: list[float] = []
    while len(strains) < count:
        try:
            steps(s, 1, dt)
        except Unstable:
            return len(strains), math.inf
        strains.append(float(np.abs(host(s.state.F) - np.eye(3)).max()))
        if not math.isfinite(strains[-1]):
            return len(strains), math.inf
    half = count // 2
    return count, max(strains[half:]) / max(strains[:half])


def stiff(setting: Setting) -> list[Check]:
    """Check finite values and the number of substeps for E from 1e2 to 1e13 Pa."""
    checks = []
    for E in (1e2, 1e7, 1e9, 1e12, 1e13):
        x = block(4, 0.25)
        material = NeoHookean(E=E)
        dt = CFL * stable_dt(body(x, setting, material))
        s = body(x, setting, material, size=0.25, **vibrating(x, 1e-3 / dt))
        until = 200.5 * dt
        s.advance(until)
        checks += [
            equal(f"E {E:.0e}: finite", finite(s)),
            equal(f"E {E:.0e}: substeps = T / dt", s.clock.substeps == math.ceil(until / dt)),
        ]
    return checks


def poisson(setting: Setting) -> list[Check]:
    """Check that nearly incompressible bodies are stable, and that invalid Poisson's ratios are
    refused.
    """
    checks = []
    for nu in (0.0, 0.3, 0.49, 0.4999):
        x = block(4, 0.25)
        s = body(x, setting, NeoHookean(E=1e4, nu=nu), size=0.25, **vibrating(x, 1.0))
        meter = Meter(s)
        for _ in range(10):
            steps(s, 19, 0.6 * stable_dt(s))
            meter.read(0.6 * stable_dt(s))
        checks += [
            at_most(f"nu {nu}: largest / first energy", meter.max_energy, 1.001),
            at_least(f"nu {nu}: least J", meter.min_J, 0.5),
        ]
    for nu in (0.5, 0.6, -0.1, -0.99, math.nan):
        checks.append(equal(f"nu {nu} is refused", _is_refused(nu)))
    return checks


def _is_refused(nu: float) -> bool:
    try:
        NeoHookean(nu=nu)
    except ValidationError:
        return True
    return False


def user_substep(setting: Setting) -> list[Check]:
    """Check that a maximum substep above the stability limit has no effect."""

    def run(ceiling: float) -> tuple[Array, dict[str, int]]:
        x = block(middle=(0, 0, 0.2))
        v = np.tile([0.5, 0, -1.0], (len(x), 1))
        world = {"forces": [Gravity()], "boundaries": [Ground()]}
        s = body(x, setting, v=v, ceiling=ceiling, **world)
        s.advance(0.2)
        return host(s.state.x), s.clock.limiters

    usual, _ = run(math.inf)
    limit = 0.6 * stable_dt(body(block(), setting))
    checks = []
    for factor in (10, 1000):
        path, limiters = run(factor * limit)
        checks += [
            at_most(f"{factor} times the limit: difference", relative(path, usual), 1e-3),
            equal(f"{factor} times the limit: never in force", "user" not in limiters),
        ]
    return checks


class Stack(NamedTuple):
    """Results for a block that rests on another block."""

    min_J: float
    max_J: float
    substeps: int


def heavy_on_light(ratio: float, setting: Setting, until: float) -> Stack:
    """Simulate a block on a lighter block until a time [s]; `ratio` is the ratio of the masses."""
    low, high = block(4, 0.25, (0, 0, 0.125)), block(4, 0.25, (0, 0, 0.375))
    x = np.concatenate([low, high])
    materials = [NeoHookean(E=5e7, density=d) for d in (1e5 / ratio, 1e5)]
    s = make_solver(
        x,
        0.25**3 / len(low),
        materials,
        **setting.options,
        dx=DX,
        material=np.repeat([0, 1], len(low)),
        forces=[Gravity()],
        boundaries=[Ground(contact="sticky")],
        origin=(0, 0, -0.75 * DX),
    )
    min_J, max_J = 1.0, 1.0
    for k in range(1, 11):
        s.advance(until * k / 10)
        J = volume_ratios(s)
        min_J, max_J = lower(min_J, J.min()), higher(max_J, J.max())
    return Stack(min_J, max_J, s.clock.substeps)


def mass_ratio(setting: Setting) -> list[Check]:
    """Check that a block can rest on another one with 1, 1/100 or 1/10,000 of its mass."""
    checks = []
    for ratio in (1.0, 1e2, 1e4):
        stack = heavy_on_light(ratio, setting, 0.4 if setting.long else 0.02)
        checks += [
            at_least(f"ratio {ratio:.0e}: smallest J", stack.min_J, 0.9),
            at_most(f"ratio {ratio:.0e}: largest J", stack.max_J, 1.1),
        ]
    return checks
