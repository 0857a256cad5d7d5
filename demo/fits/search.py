"""Search for the stiffness in a separate process, which is killed when the job is cancelled."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phy124.budget.cost import Rates, Work
from phy124.errors import InputError
from phy124.io.files import replacing
from phy124.runtime import isolated
from phy124.runtime.isolated import Deadline, Unfinished
from phy124.scene import Scene
from phy124.scene.files import files_named
from phy124.studies.fit import Fit, Outlook, fit
from phy124.studies.fit.interval import Undecided
from phy124.studies.fit.runs import FOLDER

from ..studies import on_grid
from ..work import Done
from .video import FitOptions, Seen

GRIDS = (16, 24)
"""Number of cells across the object in the search, and in the refinement that follows."""
GAUSSIANS = 4000
"""Number of Gaussians from which the outlines of the object are computed."""
NAME = "material.E"
TIMES = 10.0
"""Largest factor between the stiffnesses of the result and of the filmed object."""
SOFTEST, STIFFEST = 1e3, 1e10
"""Range of stiffnesses on the page's slider [Pa]."""
PLAN, REPORT = "plan.json", "fit.json"
LATE, SLACK = 2.0, 120.0
"""A search is stopped after `LATE` times its time budget plus `SLACK` seconds."""
Search = Callable[[Fit, Path, Deadline], dict[str, Any]]


@dataclass(frozen=True)
class FitResult:
    """The result of a finished fit."""

    folder: Path

    @property
    def report(self) -> dict[str, Any]:
        """The report that `phy124 fit` wrote."""
        return json.loads((self.folder / REPORT).read_text("utf-8"))

    @property
    def material(self) -> dict[str, Any]:
        """The material with the fitted stiffness, as plain data."""
        return Scene.from_toml(self.folder / "fitted.toml").data()["material"]

    @property
    def files(self) -> list[Path]:
        """The files that the page offers for download."""
        return sorted(path for path in self.folder.iterdir() if path.name != PLAN)


def softness(scene: Scene) -> float:
    """Return Young's modulus of a scene's material [Pa].

    Raises:
        InputError: The material has no Young's modulus.
    """
    stiffness = getattr(scene.material, "E", None)
    if stiffness is None:
        limit = f"The material {scene.material.law} has no softness to fit."
        raise InputError("material", scene.material.law, limit, "Choose an elastic material.")
    return float(stiffness)


def outlook(scene: Scene, rates: Rates) -> Outlook:
    """Estimate the time of a fit from the speed that was measured on this machine."""
    works = [Work.of(on_grid(scene, cells), GAUSSIANS) for cells in GRIDS]
    costs = [rates.seconds(work) for work in works]
    each = tuple(cost["simulate"] + cost["deform"] for cost in costs)
    return Outlook(GRIDS, each, values=1, workers=1)


def declare_fit(done: Done, scene: Scene, seen: Seen, asked: FitOptions) -> Fit:
    """Declare a fit that determines the stiffness of a result from a video.

    Args:
        done: The result to fit.
        scene: The scene of the result.
        seen: The decoded video.
        asked: Options of the fit that the visitor chose.

    Raises:
        InputError: The material has no stiffness that could be fitted.
    """
    stiffness = softness(scene)
    view = scene.view.model_dump(mode="json", exclude_none=True, exclude={"picture"})
    low, high = max(stiffness / TIMES, SOFTEST), min(stiffness * TIMES, STIFFEST)
    return Fit.from_data(
        {
            "target": str(seen.folder),
            "object": str(done.clip / "clip.safetensors"),
            "find": {NAME: {"log_uniform": (low, high)}},
            # `fps` refers to real time. The videos of the run may show other sides than this video.
            "set": {"view": {**view, "speed": 1.0, "views": [asked.side]}},
            "fps": seen.fps,
            "side": asked.side,
            "align": True,
            "gaussians": GAUSSIANS,
            "grids": GRIDS,
            "seconds": asked.seconds,
            "seed": scene.seed,
        }
    )


def search_softness(wanted: Fit, out: Path, deadline: Deadline) -> dict[str, Any]:
    """Search for the stiffness in a separate process; reuse runs stored in the folder `out`.

    Raises:
        InputError: The stiffness cannot be determined, or the time budget is exceeded.
    """
    longest = Deadline(LATE * wanted.seconds + SLACK, deadline.beat)
    try:
        return isolated.run(_search, wanted, out, deadline=longest)
    except Unfinished as error:
        limit = f"The search {str(error).partition(' (')[0]}."
        raise InputError("fit", "over", limit, "Try it again.") from None
    except InputError as error:
        raise in_words(error) from None


def _search(wanted: Fit, out: Path) -> dict[str, Any]:
    out.mkdir(parents=True, exist_ok=True)

    def plan(expected: Outlook) -> None:
        with replacing(out / PLAN) as temporary:
            temporary.write_text(json.dumps(expected.data()), "utf-8")

    report = fit(wanted, out, on_forecast=plan).report
    # Paths on the server are removed from the message that the visitor sees.
    names = {"target": "video", "object": Path(wanted.object or "").name}
    report |= {"target": "video", "declared": {**report["declared"], **names}}
    with replacing(out / REPORT) as temporary:
        temporary.write_text(json.dumps(report, indent=2) + "\n", "utf-8")
    shutil.rmtree(out / FOLDER, ignore_errors=True)
    return report


def in_words(error: InputError) -> InputError:
    """Convert an error of `phy124 fit` to a message for visitors of the page."""
    if isinstance(error, Undecided):
        limit = f"The softness cannot be determined from this video, because {error.limit}"
        return InputError("video", "unclear", limit, f"This would determine it: {error.tell}.")
    remedies = {
        "seconds": "Give it more time.",
        "find": "Begin with a result that moves more like the video.",
    }
    remedy = remedies.get(error.field, error.remedy)
    return InputError(error.field, "refused", error.limit, remedy)


def progress(out: Path) -> tuple[int, int, float] | None:
    """Return the number of runs made and expected, and the expected time [s]; None at first."""
    try:
        plan = json.loads((out / PLAN).read_text("utf-8"))
    except FileNotFoundError:
        return None
    made = sum(1 for _ in (out / FOLDER).glob("*.npy"))
    return made, sum(plan["runs"]), float(plan["seconds"])


def newest(done: Done) -> FitResult | None:
    """Return the latest fit of a result, or None if there is none."""
    finished = (done.clip.parents[1] / "fits").glob(f"{done.clip.name}-*/found/{REPORT}")
    latest = max(finished, key=lambda path: path.stat().st_mtime, default=None)
    return FitResult(latest.parent) if latest else None


def scene_of_result(done: Done) -> Scene:
    """Return the scene of a finished result.

    Raises:
        InputError: The scene depends on a picture, whose path is not stored in the clip.
    """
    scene = done.scene
    for field, _ in files_named(scene):
        if not field.startswith("view."):
            limit = f"The scene has a picture ({field}); this page cannot fit such scenes."
            raise InputError(field, "a file", limit, "Remove the picture, and generate again.")
    return scene
