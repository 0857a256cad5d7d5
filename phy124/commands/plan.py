"""Options of a run that say how accurate or how fast it shall be, and what is said before it."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import Any

from phy124.accuracy import Forecaster
from phy124.accuracy.choose import Goal, in_time
from phy124.accuracy.promises import promise
from phy124.errors import InputError
from phy124.gaussians import Gaussians
from phy124.imaging.painted import Crop
from phy124.limits import stiffest_part
from phy124.runtime.stopwatch import Stopwatch
from phy124.scene import Scene, summary


@dataclass(frozen=True)
class PlanOptions:
    """What a run shall achieve, and whether it is only predicted."""

    forecast: bool = False
    """Foretell the seconds first and compare them in the report; takes about a second."""
    dry_run: bool = False
    """Write nothing: only say what would run, for how long, and what error is promised."""
    max_error: str | None = None
    """Choose the accuracy so that the error is at most this: 2px, 1% (of the size) or 3mm."""
    max_seconds: float | None = None
    """Choose the finest accuracy that takes at most so many seconds in all."""
    resume: bool = False
    """Go on with the run that was interrupted in the folder of the results, bit for bit."""

    def goal(self) -> Goal | None:
        """What is asked for, if anything; raises InputError."""
        if self.max_error is not None and self.max_seconds is not None:
            limit = "an error is asked for as well."
            raise InputError("max_seconds", self.max_seconds, limit, "Give one of the two.")
        if self.max_error is not None and self.dry_run:
            limit = "which grid it takes shows only once coarse ones have run."
            remedy = "Leave --dry-run out, or name an accuracy instead of the error."
            raise InputError("dry_run", f"with --max-error {self.max_error}", limit, remedy)
        if self.max_error is not None:
            return Goal.error(self.max_error)
        return None if self.max_seconds is None else Goal.time(self.max_seconds)

    def forecaster(self, device: str) -> Forecaster | None:
        """What predicts the run, if it is to be compared in the report."""
        return Forecaster(device) if self.forecast else None


def announce(scene: Scene, *, as_json: bool) -> None:
    """Say what will run, before it does, and what makes it slow."""
    if as_json:
        return
    print(f"scene: {summary(scene)}", flush=True)
    stiff = stiffest_part(scene)
    if stiff:
        print(f"note: {stiff}", flush=True)


def predict(
    gaussians: Gaussians, scene: Scene, plan: PlanOptions, device: str, crop: Crop,
    watch: Stopwatch, *, as_json: bool,
) -> int:  # fmt: skip
    """Print how long a run would take, the grid a time leads to, and what is promised."""
    forecaster, goal = Forecaster(device), plan.goal()
    if goal is None:
        forecast = forecaster.forecast(gaussians, scene, crop=crop)
    else:
        options: dict[str, Any] = {"device": device, "forecaster": forecaster, "crop": crop}
        scene, forecast = in_time(goal, gaussians, scene, elapsed=watch.total, **options)
    for name, seconds in reversed(watch.seconds.items()):
        forecast = forecast.with_measured(name, seconds)
    promised = promise(scene)
    if as_json:
        more = {"scene": scene.data(), "promise": asdict(promised), "note": stiffest_part(scene)}
        print(json.dumps({**forecast.data(), **more}))
        return 0
    if goal is not None:
        print(f"asked for at most {goal.text}: D/{scene.resolution.cells}")
    print("\n".join([*forecast.lines(), promised.sentence]))
    return 0
