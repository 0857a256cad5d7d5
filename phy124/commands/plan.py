"""Options for a run's accuracy and time, and the forecast before the run."""

import json
from dataclasses import asdict, dataclass
from typing import Annotated

import tyro

from phy124.accuracy import Forecaster
from phy124.accuracy.choose import Goal, in_time
from phy124.accuracy.companion import AFFORDABLE, ON_LATTICE
from phy124.accuracy.goal import refuse_forecast
from phy124.accuracy.promises import format_percent, promise
from phy124.budget.limits import note_scene
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.options import Effort
from phy124.imaging.painted import Crop
from phy124.runtime.context import RunContext
from phy124.runtime.device import pick_device
from phy124.scene import Scene, summarise
from phy124.scene.lattices import choose_solver

STOOD_IN = "The times of later stages were measured with an object made by relief."


@dataclass(frozen=True)
class PlanOptions:
    """Options for the maximum error or time of a run, and for predictions."""

    forecast: bool = False
    """Predict the time before the run, which takes about a second. The report compares the
    predicted with the actual time. Not possible with --max-error.
    """
    dry_run: bool = False
    """Only print the stages, their predicted times and the error bound; write no files."""
    max_error: str | None = None
    """Use the coarsest grid whose estimated error does not exceed this maximum: 2px, 1% (of the
    object's size) or 3mm.
    """
    max_seconds: float | None = None
    """Use the finest grid whose total time does not exceed this maximum [s]."""
    error: Annotated[
        bool,
        tyro.conf.arg(
            help="Estimate the run's error by a second run on a coarser grid if that takes at most "
            f"{format_percent(AFFORDABLE)} of the time of the dynamics "
            f"({format_percent(ON_LATTICE * AFFORDABLE)} on lattices)."
        ),
    ] = True
    resume: bool = False
    """Continue the interrupted run in the folder of the results."""

    def goal(self) -> Goal | None:
        """Return the requested maximum error or maximum time; None if there is none.

        Raises:
            InputError: Both a maximum error and a maximum time are set, a maximum error and a
                forecast, or a value is out of bounds or has an unknown unit.
        """
        if self.max_error is not None and self.max_seconds is not None:
            limit = "--max-error is also set."
            raise InputError("max_seconds", self.max_seconds, limit, "Give one of the two.")
        if self.max_error is not None:
            goal = Goal.error(self.max_error)
            for name in ("dry_run", "forecast"):
                refuse_forecast(goal, getattr(self, name), name)
            return goal
        return None if self.max_seconds is None else Goal.time(self.max_seconds)

    def forecaster(self, context: RunContext) -> Forecaster | None:
        """Return the forecaster if the report must contain a forecast."""
        return Forecaster(context, self.error) if self.forecast else None


def announce(scene: Scene, goal: Goal | None, device: str, *, as_json: bool) -> None:
    """Print a summary of the scene, and a note if one material makes the run slow.

    Args:
        scene: The scene that will run.
        goal: The goal that determines the grid; None: the scene's grid is used.
        device: Name of the device, as `pick_device` takes it.
        as_json: Print nothing, because the command prints only JSON.
    """
    if as_json:
        return
    cells = "" if goal is None else f"as many cells as {goal.text} needs"
    scene = choose_solver(scene, pick_device(device))
    print(f"scene: {summarise(scene, cells)}", flush=True)
    for note in note_scene(scene):
        print(f"note: {note}", flush=True)


def predict(
    gaussians: Gaussians,
    scene: Scene,
    plan: PlanOptions,
    context: RunContext,
    crop: Crop,
    *,
    study: str,
    as_json: bool,
    effort: Effort | None = None,
) -> int:
    """Print the run's predicted time, the grid chosen for a time goal, and the error bound.

    Args:
        gaussians: The object.
        scene: The scene.
        plan: The options of the command.
        context: Device, threads, and the durations of the finished stages.
        crop: Position of the object in the picture.
        study: The command that measures the error of this scene.
        as_json: Print JSON and nothing else.
        effort: Predicted time of the slow generator that `relief` replaces in the forecast.
    """
    scene = choose_solver(scene, context.device)
    forecaster, goal = Forecaster(context, plan.error), plan.goal()
    spent = dict(context.watch.seconds)
    if effort is not None:
        spent.pop("generate")
    if goal is None:
        forecast = forecaster.forecast(gaussians, scene, crop=crop)
    else:
        elapsed = sum(spent.values()) + (effort.seconds if effort else 0.0)
        scene, forecast = in_time(
            goal, gaussians, scene, context, elapsed=elapsed, crop=crop, forecaster=forecaster
        )
    if effort is not None:
        forecast = forecast.with_predicted("generate", effort.seconds, STOOD_IN)
    for name, seconds in reversed(spent.items()):
        forecast = forecast.with_measured(name, seconds)
    promised = promise(scene, forecast.proportions)
    if as_json:
        more = {
            "scene": scene.data(),
            "promise": asdict(promised),
            "note": " ".join(note_scene(scene)) or None,
        }
        print(json.dumps({**forecast.data(), **more}))
        return 0
    if goal is not None:
        print(f"asked for at most {goal.text}: D/{scene.resolution.cells}")
    print("\n".join([*forecast.lines(), promised.with_study(study)]))
    return 0
