"""A small run that is steered: a ball of 400 Gaussians on a coarse grid, on one thread."""

from types import SimpleNamespace

from bridge.options import Options
from bridge.steering.run import SteeredRun
from phy124.generators.shapes import ball
from phy124.live import Live
from phy124.runtime.context import RunContext
from phy124.scene import Scene

EPOCH = 1_700_000_000.0
OPTIONS = Options(epoch=EPOCH, profile="full")
WEIGHTLESS = {"forces": [], "boundaries": []}


def scene(**changes):
    base = Scene.named("drop").replaced({"accuracy": {"cells": 8}, "binding": "lattice"})
    return base.replaced({"object.lift": 0.1, "time.fps": 24.0, **changes})


def steered(options=OPTIONS, *, paused=True, changes=None, **how):
    live = Live(ball(400), scene(**(changes or {})), RunContext(threads=1))
    return SteeredRun(live, options, paused=paused, **how)


def triple(values):
    return SimpleNamespace(**dict(zip("xyz", values, strict=True)))


def header(frame):
    return SimpleNamespace(frame_id=frame, stamp=SimpleNamespace(sec=0, nanosec=0))


def wrench(force, torque=(0, 0, 0), frame="phy124"):
    parts = SimpleNamespace(force=triple(force), torque=triple(torque))
    return SimpleNamespace(header=header(frame), wrench=parts)


def point(place, frame="phy124"):
    return SimpleNamespace(header=header(frame), point=triple(place))


def transform(parent, child, place, quaternion=(0, 0, 0, 1)):
    rotation = SimpleNamespace(**dict(zip("xyzw", quaternion, strict=True)))
    link = SimpleNamespace(translation=triple(place), rotation=rotation)
    first = SimpleNamespace(header=header(parent), child_frame_id=child, transform=link)
    return SimpleNamespace(transforms=[first])
