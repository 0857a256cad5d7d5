"""The search for the softness, in a process of its own: it is killed when it is cancelled."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from phy124.budget.cost import Rates, Work
from phy124.errors import InputError
from phy124.io.clip import read_scene
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
from .asked import Asked
from .video import Seen

GRIDS = (16, 24)
"""Cells across the object: searched on the first, refined on the second."""
GAUSSIANS = 4000
"""What outlines are drawn of."""
NAME = "material.E"
TIMES = 10.0
"""How many times softer or stiffer than the result what was filmed may be."""
SOFTEST, STIFFEST = 1e3, 1e10
"""Ends of the page's slider [Pa]."""
PLAN, REPORT = "plan.json", "fit.json"
LATE, SLACK = 2.0, 120.0
"""A search is given up after so many times its budget and so many seconds more."""
Search = Callable[[Fit, Path, Deadline], dict[str, Any]]


@dataclass(frozen=True)
class Found:
    """A finished fit."""

    folder: Path

    @property
    def report(self) -> dict[str, Any]:
        """What `phy124 fit` says of itself."""
        return json.loads((self.folder / REPORT).read_text("utf-8"))

    @property
    def material(self) -> dict[str, Any]:
        """The material with the softness that was found, as plain data."""
        return Scene.from_toml(self.folder / "fitted.toml").data()["material"]

    @property
    def files(self) -> list[Path]:
        """What can be taken away."""
        return sorted(path for path in self.folder.iterdir() if path.name != PLAN)


def softness(scene: Scene) -> float:
    """The stiffness of a scene's material [Pa].

    Raises:
        InputError: It has none.
    """
    found = getattr(scene.material, "E", None)
    if found is None:
        limit = f"The material {scene.material.law} has no softness that could be found."
        raise InputError("material", scene.material.law, limit, "Choose an elastic one.")
    return float(found)


def outlook(scene: Scene, rates: Rates) -> Outlook:
    """What a fit will take with the usual costs of this machine; nothing is run."""
    works = [Work.of(on_grid(scene, cells), GAUSSIANS) for cells in GRIDS]
    costs = [rates.seconds(work) for work in works]
    each = tuple(cost["simulate"] + cost["deform"] for cost in costs)
    return Outlook(GRIDS, each, values=1, workers=1)


def declared(done: Done, scene: Scene, seen: Seen, asked: Asked) -> Fit:
    """The fit of a result's softness to a video.

    Args:
        done: The result.
        scene: Its scene.
        seen: The video.
        asked: What is said of it.

    Raises:
        InputError: Its material has no softness.
    """
    stiffness = softness(scene)
    low, high = max(stiffness / TIMES, SOFTEST), min(stiffness * TIMES, STIFFEST)
    return Fit.from_data({
        "target": str(seen.folder),
        "object": str(done.clip / "clip.safetensors"),
        "find": {NAME: {"log_uniform": (low, high)}},
        # The rate is that of what was filmed, at its own speed; the run may have had other sides.
        "set": {"view.speed": 1.0, "view.views": [asked.side]},
        "fps": seen.fps, "side": asked.side, "align": True, "gaussians": GAUSSIANS,
        "grids": GRIDS, "seconds": asked.seconds, "seed": scene.seed,
    })  # fmt: skip


def searched(wanted: Fit, out: Path, deadline: Deadline) -> dict[str, Any]:
    """Fit in a process of its own; runs that were made stay, and the same call goes on from them.

    Raises:
        InputError: It cannot be told, or takes longer than it may; in the page's words.
    """
    longest = Deadline(LATE * wanted.seconds + SLACK, deadline.beat)
    try:
        return isolated.run(_searched, wanted, out, deadline=longest)
    except Unfinished as error:
        limit = f"The search {str(error).partition(' (')[0]}."
        raise InputError("fit", "over", limit, "Try it once more.") from None
    except InputError as error:
        raise in_words(error) from None


def _searched(wanted: Fit, out: Path) -> dict[str, Any]:
    """What `searched` does, in this process."""
    out.mkdir(parents=True, exist_ok=True)

    def plan(expected: Outlook) -> None:
        with replacing(out / PLAN) as temporary:
            temporary.write_text(json.dumps(expected.data()), "utf-8")

    found = fit(wanted, out, on_forecast=plan).report
    # A visitor need not know where files of this server are.
    found |= {"target": "video", "declared": {**found["declared"], **_named(wanted)}}
    with replacing(out / REPORT) as temporary:
        temporary.write_text(json.dumps(found, indent=2) + "\n", "utf-8")
    shutil.rmtree(out / FOLDER, ignore_errors=True)
    return found


def _named(wanted: Fit) -> dict[str, str]:
    return {"target": "video", "object": Path(wanted.object or "").name}


def in_words(error: InputError) -> InputError:
    """A refusal of `phy124 fit` for somebody who has no command line."""
    if isinstance(error, Undecided):
        limit = f"The softness cannot be told apart from this video, because {error.limit}"
        return InputError("video", "unclear", limit, f"What would tell it: {error.tell}.")
    remedies = {
        "seconds": "Give it more time.",
        "find": "Begin with a result that moves more like the video.",
    }
    remedy = remedies.get(error.field, error.remedy)
    return InputError(error.field, "refused", error.limit, remedy)


def progress(out: Path) -> tuple[int, int, float] | None:
    """Runs made, runs expected, and seconds expected of a search; None before it has begun."""
    try:
        plan = json.loads((out / PLAN).read_text("utf-8"))
    except FileNotFoundError:
        return None
    made = sum(1 for _ in (out / FOLDER).glob("*.npy"))
    return made, sum(plan["runs"]), float(plan["seconds"])


def newest(done: Done) -> Found | None:
    """The newest fit of a result, if there is one."""
    finished = (done.clip.parents[1] / "fits").glob(f"{done.clip.name}-*/found/{REPORT}")
    latest = max(finished, key=lambda path: path.stat().st_mtime, default=None)
    return Found(latest.parent) if latest else None


def scene_of_result(done: Done) -> Scene:
    """The scene of a result.

    Raises:
        InputError: Its motion depends on a picture, of which a clip does not say where it lies.
    """
    scene = Scene.from_data(read_scene(done.clip / "clip.safetensors"))
    for field, _ in files_named(scene):
        if not field.startswith("view."):
            limit = f"The scene has a picture ({field}), and such a one is not fitted here."
            raise InputError(field, "a file", limit, "Leave it out and generate it again.")
    return scene
