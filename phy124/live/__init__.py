"""A live run: inputs act during the computation and are recorded as a scene.

`Live(gaussians, Scene.named("drop"))` is a live run of a preset. `frames(24)` computes frames.
Calls such as `grab((0, 0, 1))` and `move_to((0, 0.5, 1.2))` between two frames are inputs, which
act from the next frame on. `session()` returns a scene that contains the inputs. This scene repeats
the run bit for bit at the same accuracy, and can also be run at a finer accuracy.
"""

from phy124.live.choose import Choice, held_rate
from phy124.live.engine import Live
from phy124.live.real_time import RealTime

__all__ = ["Choice", "Live", "RealTime", "held_rate"]
