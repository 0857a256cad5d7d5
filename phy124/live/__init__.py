"""A live run: inputs act while the run is computed, and are recorded as a scene.

    live = Live(gaussians, Scene.named("drop"))
    live.grab((0, 0, 1))
    for frame in live.frames(24):
        live.move_to((0, frame.time, 1.2))

Inputs act from the next frame on. `session()` returns a scene that contains the inputs. It repeats
the run bit for bit at the same accuracy, and can also be run at a finer accuracy.
"""

from phy124.live.choose import Choice, held_rate
from phy124.live.engine import Live
from phy124.live.real_time import RealTime

__all__ = ["Choice", "Live", "RealTime", "held_rate"]
