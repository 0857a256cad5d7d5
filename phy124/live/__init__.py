"""A live run: it is pushed while it runs, and what was done to it becomes a scene.

    live = Live(gaussians, Scene.named("drop"))
    live.grab((0, 0, 1))
    for frame in live.frames(24):
        live.to((0, frame.time, 1.2))

Inputs act from one frame to the next. `session()` is the scene that does the same again, at the
same accuracy bit for bit, or at a finer one.
"""

from phy124.live.choose import Choice, held_rate
from phy124.live.engine import Live
from phy124.live.real_time import RealTime

__all__ = ["Choice", "Live", "RealTime", "held_rate"]
