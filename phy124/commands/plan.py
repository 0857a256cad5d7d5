"""Options that say how accurate or how fast a run is to be, and what is printed before it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass

from phy124.accuracy import Forecaster
from phy124.accuracy.choose import Goal, in_time
from phy124.accuracy.promises import promise
from phy124.budget.limits import note_stiffest_part
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.generators.options import Effort
from phy124.imaging.painted import Crop
from phy124.runtime.context import RunContext
from phy124.scene import Scene, summarise

STOOD_IN = "The seconds after the generator are those of an object that relief made in its place."


@dataclass(frozen=True)
class PlanOptions:
    """What a run is to achieve, and whether it is only predicted."""

    forecast: bool = False
    """Predict the seconds first and compare them in the report; takes about a second."""
    dry_run: bool = False
    """Write nothing: only print what would run, for how long, and what error is promised."""
    max_error: str | None = None
    """Choose the accuracy so that the error is at most this: 2px, 1% (of the size) or 3mm."""
    max_seconds: float | None = None
    """Choose the finest accuracy that takes at most so many seconds in all."""
    resume: bool = False
    """Continue the run that was interrupted in the folder of the results."""

    def goal(self) -> Goal | None:
        """The error or time asked for, if any.

        Raises:
            InputError: Both are given, or one that cannot be used.
        """
        if self.max_error is not None and self.max_seconds is not None:
            limit = "an error is given as well."
            raise InputError("max_seconds", self.max_seconds, limit, "Give one of the two.")
        if self.max_error is not None and self.dry_run:
            limit = "the grid it needs is known only after coarser ones have run."
            remedy = "Leave --dry-run out, or name an accuracy instead of the error."
            raise InputError("dry_run", f"with --max-error {self.max_error}", limit, remedy)
        if self.max_error is not None:
            return Goal.error(self.max_error)
        return None if self.max_seconds is None else Goal.time(self.max_seconds)

    def forecaster(self, context: RunContext) -> Forecaster | None:
        """Return the forecaster, if the report is to compare its prediction."""
        return Forecaster(context) if self.forecast else None


def announce(scene: Scene, *, as_json: bool) -> None:
    """Print what is about to run and what makes it slow."""
    if as_json:
        return
    print(f"scene: {summarise(scene)}", flush=True)
    stiff = note_stiffest_part(scene)
    if stiff:
        print(f"note: {stiff}", flush=True)


def predict(
    gaussians: Gaussians,
    scene: Scene,
    plan: PlanOptions,
    context: RunContext,
    crop: Crop,
    *,
    as_json: bool,
    effort: Effort | None = None,
) -> int:
    """Print how long a run would take, the grid chosen for a given time, and the promised error.

    Args:
        gaussians: The object.
        scene: The scene.
        plan: The options of the command.
        context: Device, threads, and the durations of the stages so far.
        crop: Where the object is in the picture that the masks of parts were painted on.
        as_json: Print JSON and nothing else.
        effort: What a generator for which `relief` stood in will take.
    """
    forecaster, goal, spent = Forecaster(context), plan.goal(), dict(context.watch.seconds)
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
    promised = promise(scene, forecast.thickness)
    if as_json:
        more = {
            "scene": scene.data(),
            "promise": asdict(promised),
            "note": note_stiffest_part(scene),
        }
        print(json.dumps({**forecast.data(), **more}))
        return 0
    if goal is not None:
        print(f"asked for at most {goal.text}: D/{scene.resolution.cells}")
    print("\n".join([*forecast.lines(), promised.sentence]))
    return 0
