"""Cases 15 and 26 to 29: the grid, its window, order and orientation, threads, and the floor."""

from __future__ import annotations

from typing import Any

import numpy as np

from phy124.boundaries import Ground
from phy124.forces import Gravity
from phy124.materials import NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.studies.validation.bodies import block
from phy124.studies.validation.stress.bodies import DX, Array, alike, body, finite, host, relative
from phy124.studies.validation.stress.case import Check, Setting, at_most, equal


def astray(setting: Setting) -> list[Check]:
    """Particles a thousand kilometres away, or leaving at high speed, fly on and are counted."""
    x = block()
    far = np.array([[1e6, 0, 0], [0, -1e6, 0], [3e5, 2e5, 1e6]])
    x, v = np.concatenate([x, far]), np.zeros((len(x) + 3, 3))
    v[-1] = [3000.0, 0, 0]
    v[7] = [0, 0, 2000.0]
    s = body(x, setting, v=v, volume=np.full(len(x), 2e-4), forces=[Gravity()])
    s.advance(0.2)
    moved = host(s.state.x) - x
    fall = 9.81 * 0.2**2 / 2
    wanted = np.array([[0, 0, -fall], [0, 0, -fall], [600.0, 0, -fall]])
    return [
        equal("finite", finite(s)),
        equal("all far particles counted", s.outliers.count >= 3),
        at_most("window in cells", float(s.grid.count), 5e6),
        at_most("off their parabolas [m]", np.abs(moved[-3:] - wanted).max(), 0.13),
        at_most("centre of the rest [m]", np.abs(moved[:-3].mean(axis=0)[:2]).max(), 0.5),
    ]


def permuted(setting: Setting) -> list[Check]:
    """The order of the particles and the scene's orientation do not matter."""
    x = block(middle=(0, 0, 0.3))
    v = np.tile([0.5, 0.2, -2.0], (len(x), 1))
    order = np.random.default_rng(0).permutation(len(x))
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])

    def run(x: Array, v: Array) -> Array:
        world = {"forces": [Gravity()], "boundaries": [Ground()]}
        s = body(x, setting, NeoHookean(E=1e5), v=v, **world)
        s.advance(500 * 0.6 * DX / s.model.materials[0].wave_speed())
        return host(s.state.x)

    usual = run(x, v)
    shuffled = relative(run(x[order], v[order]), usual[order])
    turned = relative(run(x @ turn.T, v @ turn.T) @ turn, usual)
    return [
        at_most("shuffled: difference / size", shuffled, 1e-4),
        at_most("turned by 90 degrees: difference / size", turned, 1e-4),
    ]


def window(setting: Setting) -> list[Check]:
    """A window that follows the particles gives the result of one fixed grid around everything."""
    x = block()
    C = 1.0 * np.eye(3) + np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 0]])
    motion: dict[str, Any] = {
        "v": x @ C.T + [6.0, 0, -1.0],
        "C": np.broadcast_to(C, (len(x), 3, 3)),
    }
    moving, fixed = body(x, setting, **motion), body(x, setting, **motion)
    wide = [np.full(3, -16), np.array([48, 32, 32])]

    def fit(lower: Array, upper: Array) -> bool:
        first = fixed.grid.count == 0
        if first:
            fixed.grid.rebase(*wide)
        return first

    fixed.grid.fit = fit
    for s in (moving, fixed):
        s.advance(0.5)
    return [
        at_most("difference / size", relative(host(moving.state.x), host(fixed.state.x)), 1e-6),
        equal("the window moved", bool((moving.grid.low > [0, -90, -90]).all())),
    ]


def repeats(setting: Setting) -> list[Check]:
    """Repeated runs are equal for each number of threads; they agree with each other."""
    x = block(8, 0.5, middle=(0, 0, 0.4))
    v = np.random.default_rng(0).normal(size=x.shape)

    def run(threads: int) -> Array:
        world = {"forces": [Gravity()], "boundaries": [Ground()]}
        s = body(x, setting, NeoHookean(E=1e5), size=0.5, v=v, threads=threads, **world)
        s.advance(0.1)
        return host(s.state.x)

    one = run(1)
    checks = [alike("with one thread", run(1), one, setting)]
    if setting.device == "cpu":
        for threads, name in ((2, "two"), (5, "five")):
            several = run(threads)
            checks += [
                equal(f"{name} threads: bitwise equal", np.array_equal(several, run(threads))),
                at_most(f"{name} threads against one", relative(several, one), 1e-5),
            ]
    return checks


def floor(setting: Setting) -> list[Check]:
    """A body rests on its floor, does not sink in on landing, and slides where it may."""
    origin = (0, 0, -0.75 * DX)
    resting = body(
        block(8, 0.5, (0, 0, 0.29)), setting, NeoHookean(E=1e6), size=0.5, forces=[Gravity()],
        boundaries=[Ground()], origin=origin,
    )  # fmt: skip
    for _ in range(40):
        resting.advance(resting.clock.time + 0.02)
        resting.state.v.zero_()
        resting.state.C.zero_()
    gap = host(resting.state.x)[:, 2].min() - 0.5 / 16
    falling = body(
        block(middle=(0, 0, 0.3)), setting, NeoHookean(E=1e5), v=np.tile([0, 0, -3.0], (216, 1)),
        forces=[Gravity()], boundaries=[Ground()], origin=origin,
    )  # fmt: skip
    lowest = []
    falling.advance(0.3, after=lambda: lowest.append(host(falling.state.x)[:, 2].min()))
    sliding = body(
        block(middle=(0, 0, 0.1875)), setting, v=np.tile([1.0, 0, 0], (216, 1)),
        forces=[Gravity()], boundaries=[Ground(contact="slip")], origin=origin,
    )  # fmt: skip
    mass = sliding.model.mass.numpy().sum()
    sliding.advance(0.2)
    kept = diagnose(sliding).momentum[0]
    return [
        at_most("resting gap in cells", abs(gap) / DX, 0.2),
        at_most("deepest below the floor in cells", -min(lowest) / DX, 0.5),
        at_most("slip: tangential velocity lost", abs(kept / mass - 1), 1e-5),
    ]
