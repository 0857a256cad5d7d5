"""What a scene with a rigid solid that moves freely may hold."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from phy124.boundaries import Container, Ground, HalfSpace, Press
from phy124.scene.objects import SceneObject
from phy124.scene.sections import Object

FLAT = Ground | HalfSpace | Press | Container
"""Walls that it meets."""


def check_free(objects: Sequence[Object], boundaries: Sequence[Any]) -> None:
    """Check that a free solid meets nothing that it would pass through.

    Raises:
        ValueError: It would.
    """
    free = [one.name for one in objects if isinstance(one, SceneObject) and one.free]
    if not free:
        return
    if len(free) > 1:
        raise ValueError(
            f"{free[0]} and {free[1]} are both free solids, which would pass through each other; "
            "leave the motion of one of them out, so that it is made of particles"
        )
    for one in objects:
        led = isinstance(one, SceneObject) and one.path is not None
        if one.held or led:
            how = "follows a path" if led else "is held"
            raise ValueError(
                f"{one.name} {how}, and the free solid {free[0]} would pass through it; leave one "
                "of them out, or use flat boundaries"
            )
    for wall in boundaries:
        if not (isinstance(wall, FLAT) or wall.holds):
            raise ValueError(
                f"the free solid {free[0]} would pass through the boundary {wall.kind}; use "
                "ground, half_space, press or container"
            )
