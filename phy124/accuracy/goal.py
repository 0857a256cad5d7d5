"""The goal of a run: a maximum error or a maximum time."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from phy124.accuracy.forecast import Forecast, pixels_per_size
from phy124.accuracy.promises import format_percent
from phy124.budget.remedies import change_field
from phy124.errors import InputError, Remedy
from phy124.scene import Scene

Kind = Literal["pixels", "fraction", "metres", "seconds"]
UNIT: dict[Kind, Callable[[Scene], float]] = {
    "pixels": pixels_per_size,
    "fraction": lambda scene: 1.0,
    "metres": lambda scene: scene.object.size,
}
"""Functions that return the size of a scene's object in the goal's unit."""
MARGIN = 0.95
"""Largest predicted time, relative to the goal's time; forecasts err by a few %."""


@dataclass(frozen=True)
class Goal:
    """The maximum error or the maximum time of a run."""

    kind: Kind
    value: float
    """Maximum, in the unit of `kind`: pixels of the first view, fractions of the size, m, or s."""
    text: str

    @classmethod
    def error(cls, text: str) -> Goal:
        """Parse a maximum error such as "2px", "1%" or "3mm".

        Raises:
            InputError: The text is not a positive, finite number with a unit.
        """
        match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+(?:[eE][+-]?[0-9]+)?)\s*(px|%|mm|cm|m)\s*", text)
        units: dict[str, tuple[Kind, float]] = {
            "px": ("pixels", 1.0),
            "%": ("fraction", 0.01),
            "mm": ("metres", 1e-3),
            "cm": ("metres", 1e-2),
            "m": ("metres", 1.0),
        }
        if not match or not 0 < float(match[1]) < math.inf:
            limit = "it is not a positive, finite number with a unit."
            raise InputError("max_error", text, limit, "Write 2px, 1% or 3mm, for example.")
        kind, scale = units[match[2]]
        return cls(kind, float(match[1]) * scale, text.strip())

    @classmethod
    def time(cls, seconds: float) -> Goal:
        """Return the goal that a run takes at most `seconds` in total.

        Raises:
            InputError: The time is not a positive number.
        """
        if not (math.isfinite(seconds) and seconds > 0):
            limit = "the time must be a positive number of seconds."
            raise InputError("max_seconds", seconds, limit, "Write 20, for example.")
        return cls("seconds", float(seconds), f"{seconds:g} s")


def refuse_forecast(goal: Goal | None, wanted: bool, field: str) -> None:
    """Refuse a forecast (`wanted`) if the run's goal is an error; `field` is the option for a
    forecast.

    Raises:
        InputError: A forecast is wanted, and the goal is an error.
    """
    if wanted and goal is not None and goal.kind != "seconds":
        limit = "the grid that meets this error is known only after coarser grids have run."
        option = f"--{field.replace('_', '-')}"
        remedy = f"Remove {option}, or set --accuracy instead of --max-error."
        raise InputError(field, f"with --max-error {goal.text}", limit, remedy)


def format_error(kind: Kind, value: float) -> str:
    """Format an error: "1.8 px", "0.84 %", "3.4 mm"."""
    if kind == "pixels":
        return f"{value:.1f} px"
    return format_percent(value) if kind == "fraction" else f"{value * 1000:.2g} mm"


def describe_goal(goal: Mapping[str, Any], seconds: float) -> str:
    """Describe how a run of `seconds` met its goal, from the entry `goal` of the report."""
    target, grid = goal["target"], f"D/{goal['cells']}"
    if goal["unit"] == "seconds":
        return f"asked for at most {target}: {grid} takes {seconds:.1f} s"
    errors = dict(zip(goal["levels"], goal["errors"], strict=False))
    tried = [f"D/{n} {format_error(goal['unit'], error)}" for n, error in errors.items()]
    tried = f"; estimated errors: {', '.join(tried)}" if tried else ""
    left_out = " and ".join(f"D/{n}" for n in goal.get("stopped", ()))
    if left_out:
        tried += f"; {left_out} left out, because the simulation stops early on so coarse a grid"
    how = "meets it" if goal["met"] else f"is used, which does NOT meet it: {goal['why_not']}"
    return f"asked for an error of at most {target}: {grid} {how.rstrip(': ')}{tried}"


def explain_time(
    goal: Goal, scene: Scene, cells: int, forecast: Forecast, ready: float
) -> InputError:
    """Return an exception: the time is too short even for the coarsest grid.

    Args:
        goal: The maximum time.
        scene: The scene.
        cells: Cells across the object on the coarsest grid.
        forecast: Forecast of the run on the coarsest grid.
        ready: Time that is already used [s].
    """
    minimum = math.ceil((forecast.seconds + ready) / MARGIN)
    stages = {"preparing": ready, **forecast.stages}
    most = max(stages, key=stages.__getitem__)
    limit = (
        f"the coarsest grid, D/{cells}, takes about {minimum} s, most of it ({stages[most]:.0f} s) "
        f"for {STAGES[most]}."
    )
    remedies = list(_find_remedies(scene, most))
    less = f"; {' or '.join(remedy.words for remedy in remedies)} takes less" if remedies else ""
    advice = f"Use --max-seconds {minimum}{less}."
    return InputError("max_seconds", goal.text, limit, advice, remedies)


def _find_remedies(scene: Scene, stage: str) -> Iterator[Remedy]:
    if stage in PER_VIEW and len(scene.view.sides) > 1:
        yield Remedy(
            "view.views = front", {"view.views": ["front"], "view.azimuths": [], "view.cameras": []}
        )
    if stage != "preparing" and scene.time.frames > 2:
        yield change_field("time.frames", max(2, scene.time.frames // 2))


PER_VIEW = ("render", "shine", "encode", "outputs")
"""Stages whose time is proportional to the number of views."""
STAGES = {
    "preparing": "the particles and the forecast of each grid",
    "simulate": "the simulation",
    "deform": "the shapes of the Gaussians",
    "companion": "the estimate of the error",
    "observe": "contacts, forces and torn material in each frame",
    "render": "the pictures",
    "shine": "highlights and reflections",
    "encode": "the videos",
    "outputs": "the outputs of the view",
    "export": "files of the whole clip",
    "save": "saving",
}
