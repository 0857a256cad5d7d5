"""Start: the executables of `ros2 run`, and how all of them import what takes long.

Only what is light may be imported here: until `importing` has begun, Python itself answers Ctrl-C
with a traceback.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


def player() -> None:
    """`ros2 run phy124_bridge player --ros-args -p clip:=/path/to/clip.safetensors`."""
    with importing(0):
        from . import node
    node.main()


def live() -> None:
    """`ros2 run phy124_bridge live --ros-args -p source:=photo.png -p scene:=drop`."""
    with importing(0):
        from . import node
    node.live()


@contextmanager
def importing(status: int, said: str = "") -> Iterator[None]:
    """Within it Ctrl-C and SIGTERM end the process at once: nothing is open that must be closed.

    A KeyboardInterrupt would not always come through: some of what runs during an import only
    prints it.
    """
    try:
        from phy124.runtime.signals import ending, handled

        with handled(ending(status, said)):
            yield
    except KeyboardInterrupt:
        sys.stderr.write(said)
        raise SystemExit(status) from None
