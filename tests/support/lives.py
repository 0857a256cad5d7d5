"""Live runs of a small ball."""

import numpy as np

from phy124.gaussians import Gaussians
from phy124.generators.shapes import ball
from phy124.live import Live
from phy124.runtime.context import RunContext
from phy124.scene import Scene

GROUND = [{"kind": "ground"}, {"kind": "sphere", "centre": [0, 0.8, 0.2], "radius": 0.25}]


def thing() -> Gaussians:
    return ball(400)


def scene(**changes: object) -> Scene:
    base = Scene.named("drop").replaced({"accuracy": {"cells": 8}, "binding": "lattice"})
    return base.replaced({"object.lift": 0.1, "boundaries": GROUND, "time.fps": 24.0, **changes})


def live(**changes: object) -> Live:
    return Live(thing(), scene(**changes), RunContext(threads=1))


def middle(frame) -> np.ndarray:
    return frame.gaussians.means.astype(np.float64).mean(axis=0)
