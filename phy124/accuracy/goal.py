"""Goal: what a run is to achieve, an error or a time, and why a time cannot be met."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

from phy124.accuracy.forecast import Forecast, pixels_per_size
from phy124.budget.remedies import change_field
from phy124.errors import InputError, Remedy
from phy124.scene import Scene

Kind = Literal["pixels", "fraction", "metres", "seconds"]
UNIT: dict[Kind, Callable[[Scene], float]] = {
    "pixels": pixels_per_size,
    "fraction": lambda scene: 1.0,
    "metres": lambda scene: scene.object.size,
}
"""Kind of goal -> the object's size in its unit."""
MARGIN = 0.95
"""Largest fraction of the target time for a forecast, since forecasts err by a few per cent."""


@dataclass(frozen=True)
class Goal:
    """What a run is to achieve: a largest error, or a longest time."""

    kind: Kind
    value: float
    """Pixels of the first view, fraction of the object's size, metres, or seconds."""
    text: str

    @classmethod
    def error(cls, text: str) -> Goal:
        """A goal from a text such as "2px", "1%" or "3mm".

        Raises:
            InputError: It is not an error.
        """
        found = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)\s*(px|%|mm|cm|m)\s*", text)
        units: dict[str, tuple[Kind, float]] = {
            "px": ("pixels", 1.0), "%": ("fraction", 0.01),
            "mm": ("metres", 1e-3), "cm": ("metres", 1e-2), "m": ("metres", 1.0),
        }  # fmt: skip
        if not found or float(found[1]) <= 0:
            remedy = "Write 2px, 1% or 3mm, for example."
            raise InputError("max_error", text, "it is not an error.", remedy)
        kind, scale = units[found[2]]
        return cls(kind, float(found[1]) * scale, text.strip())

    @classmethod
    def time(cls, seconds: float) -> Goal:
        """The goal of at most so many seconds in all.

        Raises:
            InputError: It is not a positive number.
        """
        if not (math.isfinite(seconds) and seconds > 0):
            limit = "the time must be a positive number of seconds."
            raise InputError("max_seconds", seconds, limit, "Write 20, say.")
        return cls("seconds", float(seconds), f"{seconds:g} s")


def said(kind: Kind, value: float) -> str:
    """A value in the unit of a goal."""
    if kind == "pixels":
        return f"{value:.1f}px"
    return f"{value:.1%}" if kind == "fraction" else f"{value * 1000:.2g}mm"


def too_long(goal: Goal, scene: Scene, cells: int, forecast: Forecast, ready: float) -> InputError:
    """The refusal of a time that even the coarsest grid exceeds, with what takes most of it.

    Args:
        goal: The time.
        scene: The scene.
        cells: Cells of the coarsest grid.
        forecast: Its forecast.
        ready: Time that has been used already [s].
    """
    minimum = math.ceil((forecast.seconds + ready) / MARGIN)
    stages = {"preparing": ready, **forecast.stages}
    most = max(stages, key=stages.__getitem__)
    limit = (
        f"the coarsest grid, D/{cells}, takes about {minimum} s, most of it ({stages[most]:.0f} s) "
        f"for {STAGES[most]}."
    )
    remedies = list(_less(scene, most))
    less = f"; {' or '.join(remedy.words for remedy in remedies)} takes less" if remedies else ""
    advice = f"Ask for --max-seconds {minimum}{less}."
    return InputError("max_seconds", goal.text, limit, advice, remedies)


def _less(scene: Scene, stage: str) -> Iterator[Remedy]:
    """Changes to the scene with which a stage takes less time."""
    if stage in ("render", "encode", "save") and len(scene.view.sides) > 1:
        yield Remedy(
            "view.views = front", {"view.views": ["front"], "view.azimuths": [], "view.cameras": []}
        )
    if stage != "preparing" and scene.time.frames > 2:
        yield change_field("time.frames", max(2, scene.time.frames // 2))


STAGES = {
    "preparing": "the particles and the forecast of each grid",
    "simulate": "the simulation",
    "deform": "the shapes of the Gaussians",
    "render": "the pictures",
    "encode": "the videos",
    "save": "saving",
}
"""Stage -> its name in words."""
