"""From a cut-out to the error of its scene, by the same motion on a few coarse grids."""

from __future__ import annotations

from pathlib import Path

from phy124.errors import InputError
from phy124.io.files import replacing
from phy124.simulation.parts import crop_of
from phy124.studies.validation.accuracy.study import Study

from ..events import Measured, Reused, Step
from ..studies import Measurement, on_grid
from .limits import SIMULATING, Limits, easier
from .motion import gaussians_of
from .order import Order, made_gaussians, study_file
from .others import cropped


def measure(order: Order, limits: Limits) -> Measured:
    """Run a scene on the grids of an order.

    Raises:
        InputError: Too few grids were finished in time.
    """
    path = study_file(order)
    if path.exists():
        limits.tell(Reused("generate"))
        limits.tell(Reused("measure"))
        return Measured(path)
    gaussians = gaussians_of(order, made_gaussians(order), limits.tell)
    with order.picture() as cutout:
        crop = crop_of(cutout)

    def progress(stage: str, done: int, total: int) -> None:
        if stage != "study":
            return
        note = f"D/{order.levels[done]}" if done < total else ""
        event = Step("measure", done, total, note)
        limits.simulated(event) if done < total else limits.tell(event)

    scene = on_grid(cropped(order.scene, order.others), order.levels[0])
    study = Study(
        gaussians, scene, order.device, order.levels, crop, progress=progress, thorough=False
    )
    found = Measurement.of(study.run())
    if limits.spent > SIMULATING and len(found.levels) < len(order.levels):
        raise _too_late(order)
    _keep(found, path)
    return Measured(path)


def _keep(found: Measurement, path: Path) -> None:
    with replacing(path) as temporary:
        Path(temporary).write_text(found.model_dump_json(), "utf-8")


def _too_late(order: Order) -> InputError:
    return InputError(
        "time",
        "over",
        f"The {order.seconds:.0f} s of one run were nearly over before enough grids had been run.",
        easier(order.scene.model_copy(update={"accuracy": "draft"})),
    )
