"""A stage as the player reads it: plain data, and its shadow maps (phy124/io/viewer/stage.js)."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from phy124.io.clip import Clip
from phy124.rendering.stage.build import Stage

LARGEST = 1280
"""Longest side of the picture that goes with a player [pixels]."""


def packed(stage: Stage | None, clip: Clip) -> tuple[dict[str, Any], NDArray[np.uint8]] | None:
    """Plain data of a clip's stage and its shadow maps [T,cells,cells], 255 is no light at all."""
    if stage is None:
        return None
    floors = [stage.at(frame).floor for frame in clip.frames()]
    shades = [floor.shade for floor in floors if floor is not None]
    behind, first = stage.backdrop, floors[0]
    data: dict[str, Any] = {"top": list(behind.top), "bottom": list(behind.bottom)}
    data["picture"] = None if behind.picture is None else _address(behind.picture)
    data["floor"] = first and {
        "heights": stage.heights.tolist(),
        "middle": list(first.middle),
        "reach": first.reach,
        "cells": len(first.shade),
    }
    data["solids"] = [
        {
            "centres": (solid.centre + moved).tolist(),
            "present": there.tolist(),
            "half": solid.half.tolist(),
            "axes": solid.axes.tolist(),
            "radius": solid.radius,
        }
        for solid, moved, there in stage.walls
    ]
    maps = np.stack(shades) if shades else np.zeros((len(clip), 0, 0))
    return data, np.rint(maps * 255).astype(np.uint8)


def _address(picture: NDArray[np.uint8]) -> str:
    """The picture as an address that holds it, smaller if it is large."""
    image = Image.fromarray(picture)
    image.thumbnail((LARGEST, LARGEST))
    with io.BytesIO() as file:
        image.save(file, "JPEG", quality=88)
        return f"data:image/jpeg;base64,{base64.b64encode(file.getvalue()).decode()}"
