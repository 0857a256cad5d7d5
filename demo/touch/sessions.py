"""Sessions: how much of a live run can be saved as a clip."""

from __future__ import annotations

from phy124.budget.cost import BYTES_PER_GAUSSIAN
from phy124.scene import Scene

from ..settings import Settings

FPS = 24.0
"""Frames per second of a live run."""
ROOM, TIME = 0.5, 0.1
"""What its clip may take of a visitor's room, and its length of the time of one run."""
FORCES = 64
"""Forces and boundaries: each hold is one, and each change of gravity."""


def limits_of(settings: Settings, gaussians: int) -> Settings:
    """The page's limits for a live run that is saved: it may last while there is room and time.

    Args:
        settings: The page's limits.
        gaussians: Number of Gaussians of the object.
    """
    room = ROOM * 1e6 * settings.max_visitor_mb / (BYTES_PER_GAUSSIAN * max(gaussians, 1))
    frames = int(min(room, TIME * FPS * settings.max_seconds))
    most = {"max_frames": max(settings.max_frames, frames)}
    most["max_forces"] = max(settings.max_forces, FORCES)
    return settings.model_copy(update=most)


def shortened(scene: Scene, most: Settings) -> Scene:
    """A session within limits, without the forces that begin after it.

    Args:
        scene: The session.
        most: Its limits.
    """
    begun = sorted(_start(force) for force in scene.forces)
    spare = most.max_forces - len(scene.boundaries)
    frames = min(scene.time.frames, most.max_frames)
    if len(begun) > spare:
        # It ends before the first force that is too many.
        frames = min(frames, max(round(begun[spare] * scene.time.fps) + 1, 2))
    if frames == scene.time.frames:
        return scene
    end = (frames - 1) / scene.time.fps
    forces = tuple(force for force in scene.forces if _start(force) < end)
    timing = scene.time.model_copy(update={"frames": frames})
    return scene.model_copy(update={"forces": forces, "time": timing})


def _start(force: object) -> float:
    return getattr(force, "start", 0.0)
