"""Case 31: flowing material ends at the surface of its walls."""

from __future__ import annotations

import numpy as np

from phy124.boundaries import Boundary, Container, Ground, Press, Sphere
from phy124.forces import Gravity
from phy124.materials import Fluid, Material, Sand, Snow
from phy124.mpm import Solver
from phy124.schema.region import Region
from phy124.studies.validation.bodies import block
from phy124.studies.validation.stress.bodies import DX, Array, body, host
from phy124.studies.validation.stress.case import Check, Setting, at_most

SIZE = 0.5
"""Side of the cube that falls apart [m]."""
BALL = Sphere(centre=(0.0, 0.0, 0.25), radius=0.25)
PRESS = Press(depth=0.6, down=0.2)


def flow(setting: Setting) -> list[Check]:
    """Heaps, puddles and pressed material neither sink into a wall nor float above it."""
    checks = []
    for material in (Sand(E=2e5), Snow(), Fluid()):
        heap = host(_dropped(setting, material, 0.1, [Ground()]).state.x)[:, 2]
        around = host(_dropped(setting, material, 0.6, [Ground(), BALL]).state.x)
        pressed = host(_dropped(setting, material, 0.0, [Ground(), PRESS], 0.25).state.x)[:, 2]
        outside = np.linalg.norm(around - BALL.centre, axis=1) - BALL.radius
        for where, distance in (
            ("the floor", heap),
            ("a ball", outside),
            ("the floor under a press", pressed),
        ):
            inside = -float(np.quantile(distance, 0.005)) / DX
            checks.append(at_most(f"{material.law}: inside {where} [cells]", inside, 0.2))
    return [*checks, *_packed(setting)]


def _dropped(
    setting: Setting, material: Material, lift: float, walls: list[Boundary], time: float = 0.8
) -> Solver:
    """A cube of a material, `time` [s] after it was released at the height `lift` [m]."""
    x = block(8, SIZE, (0.0, 0.0, SIZE / 2 + lift))
    origin = (0.0, 0.0, -0.75 * DX)
    s = body(x, setting, material, size=SIZE, forces=[Gravity()], boundaries=walls, origin=origin)
    s.advance(time)
    return s


def _packed(setting: Setting) -> list[Check]:
    """Sand that falls into a bin of its own width keeps its volume."""
    side = Region(lower=(-SIZE / 2, -SIZE / 2, 0.0), upper=(SIZE / 2, SIZE / 2, 1e9))
    stiff = Sand(E=1e7)
    s = _dropped(setting, stiff, 0.1, [Container(inside=side, friction=0.0)])
    z: Array = host(s.state.x)[:, 2]
    return [
        at_most("sand in a bin: mass centre off [cells]", abs(z.mean() - SIZE / 2) / DX, 0.3),
        at_most(
            "sand in a bin: height off [cells]", abs(np.ptp(z) / SIZE - 7 / 8) * SIZE / DX, 0.3
        ),
    ]
