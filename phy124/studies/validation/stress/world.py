"""Cases 15, 26 to 29 and 31: grid window, order, orientation, threads and walls."""

from typing import Any

import numpy as np

from phy124.boundaries import Boundary, Container, Ground, Press, Sphere
from phy124.forces import Gravity
from phy124.materials import Fluid, Material, NeoHookean, Sand, Snow
from phy124.monitor.diagnostics import diagnose
from phy124.mpm import Solver
from phy124.schema.region import Region
from phy124.studies.validation.bodies import block
from phy124.studies.validation.stress.bodies import DX, Array, alike, body, finite, host, relative
from phy124.studies.validation.stress.case import Check, Setting, at_most, equal


def far_away(setting: Setting) -> list[Check]:
    """Check that very distant and fast particles move freely and are counted as outliers."""
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


def permute(setting: Setting) -> list[Check]:
    """Check that the motion depends neither on the particles' order nor on the orientation."""
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
        at_most("difference / size after a change of the particles' order", shuffled, 1e-4),
        at_most("difference / size after a rotation by 90 degrees", turned, 1e-4),
    ]


def window(setting: Setting) -> list[Check]:
    """Check that a moving grid window gives the result of one large grid."""
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
    """Check that repeated runs are equal, and hardly depend on the number of threads."""
    x = block(8, 0.5, middle=(0, 0, 0.4))
    v = np.random.default_rng(0).normal(size=x.shape)

    def run(threads: int) -> Array:
        world = {"forces": [Gravity()], "boundaries": [Ground()]}
        s = body(x, setting, NeoHookean(E=1e5), size=0.5, v=v, threads=threads, **world)
        s.advance(0.1)
        return host(s.state.x)

    single = run(1)
    checks = [alike("with one thread", run(1), single, setting)]
    if setting.device == "cpu":
        for threads, name in ((2, "two"), (5, "five")):
            several = run(threads)
            checks += [
                equal(f"{name} threads: bitwise equal", np.array_equal(several, run(threads))),
                at_most(f"{name} threads against one", relative(several, single), 1e-5),
            ]
    return checks


def floor(setting: Setting) -> list[Check]:
    """Check that a body rests on the floor, does not penetrate it, and slides without friction."""
    origin = (0, 0, -0.75 * DX)
    world: dict[str, Any] = {"forces": [Gravity()], "boundaries": [Ground()], "origin": origin}
    x = block(8, 0.5, (0, 0, 0.29))
    resting = body(x, setting, NeoHookean(E=1e6), size=0.5, **world)
    for _ in range(40):
        resting.advance(resting.clock.time + 0.02)
        resting.state.v.zero_()
        resting.state.C.zero_()
    gap = host(resting.state.x)[:, 2].min() - 0.5 / 16
    x, v = block(middle=(0, 0, 0.3)), np.tile([0, 0, -3.0], (216, 1))
    falling = body(x, setting, NeoHookean(E=1e5), v=v, **world)
    lowest = []
    falling.advance(0.3, after=lambda: lowest.append(host(falling.state.x)[:, 2].min()))
    x, v = block(middle=(0, 0, 0.1875)), np.tile([1.0, 0, 0], (216, 1))
    slippery = {**world, "boundaries": [Ground(contact="slip")]}
    sliding = body(x, setting, v=v, **slippery)
    mass = sliding.model.mass.numpy().sum()
    sliding.advance(0.2)
    kept = diagnose(sliding).momentum[0]
    return [
        at_most("gap at rest [cells]", abs(gap) / DX, 0.2),
        at_most("largest depth below the floor [cells]", -np.min(lowest) / DX, 0.5),
        at_most("loss of tangential velocity on a slip wall", abs(kept / mass - 1), 1e-5),
    ]


SIZE = 0.5
"""Edge of the collapsing cube [m]."""
BALL = Sphere(centre=(0.0, 0.0, 0.25), radius=0.25)
PRESS = Press(depth=0.6, down=0.2)


def flow(setting: Setting) -> list[Check]:
    """Check that heaps, puddles and pressed material do not penetrate walls."""
    checks = []
    for material in (Sand(E=2e5), Snow(), Fluid()):
        heap = host(_drop(setting, material, 0.1, [Ground()]).state.x)[:, 2]
        around = host(_drop(setting, material, 0.6, [Ground(), BALL]).state.x)
        pressed = host(_drop(setting, material, 0.0, [Ground(), PRESS], 0.25).state.x)[:, 2]
        outside = np.linalg.norm(around - BALL.centre, axis=1) - BALL.radius
        for where, distance in (
            ("the floor", heap),
            ("a ball", outside),
            ("the floor under a press", pressed),
        ):
            inside = -float(np.quantile(distance, 0.005)) / DX
            checks.append(at_most(f"{material.law}: inside {where} [cells]", inside, 0.2))
    return [*checks, *_pack(setting)]


def _drop(
    setting: Setting, material: Material, lift: float, walls: list[Boundary], time: float = 0.8
) -> Solver:
    """Drop a cube from the height `lift` [m], and simulate `time` seconds."""
    x = block(8, SIZE, (0.0, 0.0, SIZE / 2 + lift))
    origin = (0.0, 0.0, -0.75 * DX)
    s = body(x, setting, material, size=SIZE, forces=[Gravity()], boundaries=walls, origin=origin)
    s.advance(time)
    return s


def _pack(setting: Setting) -> list[Check]:
    side = Region(lower=(-SIZE / 2, -SIZE / 2, 0.0), upper=(SIZE / 2, SIZE / 2, 1e9))
    stiff = Sand(E=1e7)
    s = _drop(setting, stiff, 0.1, [Container(inside=side, friction=0.0)])
    z: Array = host(s.state.x)[:, 2]
    return [
        at_most(
            "error of the centre of mass of sand in a bin [cells]",
            abs(z.mean() - SIZE / 2) / DX,
            0.3,
        ),
        at_most(
            "error of the height of sand in a bin [cells]",
            abs(np.ptp(z) / SIZE - 7 / 8) * SIZE / DX,
            0.3,
        ),
    ]
