"""Shortens presets to the frames for which the figures of docs/ were measured.

Most presets last longer (phy124/presets). `settling.py` measures their whole length.
"""

from phy124.scene import Scene

OTHERS = {
    **dict.fromkeys(("drop", "spin", "sway"), (14, 20.0)),
    "wind": (24, 20.0),
    **dict.fromkeys(("foam", "sand", "collide"), (20, 24.0)),
    "snow": (16, 24.0),
    "water": (16, 24.0),
    **dict.fromkeys(("jelly", "bury", "land_on_cushion", "stack"), (24, 24.0)),
}
"""Preset -> frames and frames per second; the others 14 at 24."""


def beginning(name: str) -> Scene:
    """The beginning of a preset."""
    frames, fps = OTHERS.get(name, (14, 24.0))
    return Scene.named(name).replaced({"time.frames": frames, "time.fps": fps})
