"""Measure the error of a scene by comparing its motion on a few coarse grids."""

from __future__ import annotations

from pathlib import Path

from phy124.errors import InputError
from phy124.io.files import replacing
from phy124.runtime.context import RunContext
from phy124.studies.validation.accuracy.study import Study

from ..course import SIMULATING, easier
from ..progress import Measured, Reused, Step
from ..studies import Measurement, on_grid
from .limits import Limits
from .motion import gaussians_of
from .order import Order, made_gaussians, study_file
from .others import with_crops


def measure(order: Order, limits: Limits) -> Measured:
    """Simulate a visitor's scene on several grids, and store the errors.

    Raises:
        InputError: Too few grids were finished within the time limit.
    """
    path = study_file(order)
    if path.exists():
        limits.tell(Reused("generate"))
        limits.tell(Reused("measure"))
        return Measured(path)
    gaussians = gaussians_of(order, made_gaussians(order), limits.tell)

    def progress(stage: str, done: int, total: int) -> None:
        if stage != "study":
            return
        note = f"D/{order.levels[done]}" if done < total else ""
        event = Step("measure", done, total, note)
        limits.tell_simulating(event) if done < total else limits.tell(event)

    scene = on_grid(with_crops(order.scene, order.others), order.levels[0])
    context = RunContext(device=order.device, threads=order.threads, progress=progress)
    study = Study(gaussians, scene, context, order.levels, order.crop, thorough=False)
    measurement = Measurement.of(study.run())
    if limits.spent > SIMULATING and len(measurement.levels) < len(order.levels):
        limit = (
            f"The time limit of {order.seconds:.0f} s was nearly over before all grids were run."
        )
        remedy = easier(order.scene.model_copy(update={"accuracy": "draft"}))
        raise InputError("time", "over", limit, remedy)
    with replacing(path) as temporary:
        Path(temporary).write_text(measurement.model_dump_json(), "utf-8")
    return Measured(path)
