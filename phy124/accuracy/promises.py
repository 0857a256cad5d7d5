"""The error that may be promised for a scene: only one that was measured for such scenes.

`make accuracy` runs each law in each kind of motion on a series of grids and writes to
measured.json the error of each grid, and how violent and how long the scenes were. A scene is
promised the error of its law and kind of motion, on a grid as coarse as its own or coarser, if it
is no more violent; one that lasts longer is promised it for as long as was measured. Otherwise
nothing is promised: the error is "not measured", and a study of the scene itself
(`phy124 accuracy`) measures it.

All sentences about errors, of the command line and of the page, are in this module.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any, Literal

from phy124.accuracy.severity import damping, poisson, unlike, violence, yielding
from phy124.scene import Scene

Motion = Literal["squeezed", "landing", "standing", "held", "free"]
WORDS: dict[Motion, str] = {
    "squeezed": "pressed or gripped",
    "landing": "falling or thrown onto something",
    "standing": "standing on something",
    "held": "held at a part of it",
    "free": "touching nothing",
}
"""Kinds of motion, in words."""
MARGIN = 1.25
"""How much longer or more violent a scene may be than those measured; errors grow by as much."""
NEARBY = 0.02
"""How much larger than measured Poisson's ratio may be."""
UNMEASURED = "error not measured"
STUDY = "phy124 accuracy SCENE --image PICTURE"
"""The command that measures a user's own scene."""


@dataclass(frozen=True)
class Promise:
    """The error that a scene may be promised before it runs, or why there is none."""

    error: float | None
    """RMS distance of the Gaussians from the exact motion over the clip, in object sizes; over its
    first `seconds` if these are given."""
    why: str
    """A sentence: where the number comes from, or why there is none."""
    unmeasured: str = ""
    """The kind of scene that was not measured, if that is why there is none."""
    own: bool = False
    """Whether it was measured on this scene itself."""
    seconds: float | None = None
    """How much of the clip was measured, from its start [s]; None: all of it."""

    @property
    def sentence(self) -> str:
        """For people."""
        if self.own and self.error is not None:
            return f"Error of this scene: about {self.error:.1%} of its size. {self.why}"
        if self.error is None:
            return f"Expected error: {self.why}"
        return (
            f"Expected error: at most {self.error:.1%} of the object's size{self._span}. {self.why}"
        )

    @property
    def brief(self) -> str:
        """The promise in words, for people without a command line."""
        if self.unmeasured:
            return f"Expected error: not measured for {self.unmeasured}."
        return self.sentence

    @property
    def row(self) -> tuple[str, str]:
        """The promise as a row of a table: title and value."""
        return "Error measured" if self.own else "Error promised", self.brief.partition(": ")[2]

    @property
    def missing(self) -> str:
        """What was not measured, in a few words; "" if all was, or if no error can be measured."""
        if self.seconds is not None:
            return f"error after {self.seconds:.2f} s not measured"
        return UNMEASURED if self.unmeasured else ""

    @property
    def measured(self) -> str:
        """The error measured on this scene, in a few words."""
        off = "no error can be promised" if self.error is None else f"about {self.error:.1%} off"
        return f"Measured: {off}."

    def off(self, pixels: float | None) -> str:
        """The error of a run in a few words; `pixels` is the same error in the video."""
        if self.error is None or pixels is None:
            return UNMEASURED
        how = "about" if self.own else "at most"
        return f"off by {how} {self.error:.1%} ({pixels:.0f} px){self._span}"

    @property
    def _span(self) -> str:
        """The part of the clip that was measured, if it is not all of it."""
        return "" if self.seconds is None else f" in the first {self.seconds:.2f} s"


def _beyond(scene: Scene, laws: Sequence[str]) -> str:
    """What a scene has that was never measured; empty: nothing."""
    if scene.objects:
        return "scenes of several objects"
    if len(laws) > 1:
        return "scenes of several materials"
    if scene.stiffness is not None or scene.properties is not None:
        return "materials that vary from point to point"
    if scene.resolution.gradient != "affine":
        return f"accuracy.gradient = {scene.resolution.gradient}"
    if scene.resolution.rpic_damping > 0:
        return "motion that accuracy.rpic_damping damps"
    return unlike(scene)


def _harder(scene: Scene, found: Mapping[str, Any]) -> str:
    """In what a scene is harder than those measured; empty: in nothing."""
    if violence(scene) > MARGIN * found["violence"]:
        return "so violent, or so soft"
    if yielding(scene) > MARGIN * found["yielding"]:
        return "that yields so much"
    if damping(scene) * MARGIN < found["damping"]:
        return "with so little damping"
    if poisson(scene) > found["nu"] + NEARBY:
        return f"so nearly incompressible (nu above {found['nu']:g})"
    return ""


def promise(scene: Scene, report: Mapping[str, Any] | None = None) -> Promise:
    """The error that may be promised for a scene.

    The report of its run may rule it out; or it has measured the error itself, since it had a goal.
    """
    report = report or {}
    broken = why_broken(report)
    if broken:
        return none(broken)
    goal = report.get("goal")
    if goal is not None and goal["unit"] != "seconds":
        if goal["fraction"] is None:
            return none(f"{goal['why_not']}.")
        return measured(goal["fraction"], goal["cells"], goal["levels"])
    laws, motion = sorted({section.law for section in scene.materials}), motion_of(scene)
    beyond = _beyond(scene, laws)
    if beyond:
        return _unknown(beyond)
    found = table()["scenes"].get(f"{laws[0]} {motion}")
    such = f"{laws[0]} {WORDS[motion]}"
    if found is None:
        return _unknown(such)
    if scene.particles_per_axis < found["particles_per_axis"]:
        return _unknown(
            f"{such} with fewer than {found['particles_per_axis']:g} particles per cell and axis"
        )
    harder = _harder(scene, found)
    if harder:
        return _unknown(f"{such} {harder}")
    grids = {int(cells): error for cells, error in found["errors"].items() if error is not None}
    within = [cells for cells in grids if cells <= scene.resolution.cells]
    if not within:
        return _unknown(f"{such} on so coarse a grid")
    about = ", ".join(found["from"])
    why = f"Measured at D/{max(within)} for {such} ({about}; {table()['object']})."
    longer = length(scene) > MARGIN * found["length"]
    if not longer:
        return Promise(grids[max(within)], why)
    why += f" What follows, up to {_until(scene):.2f} s, was not measured."
    return Promise(grids[max(within)], why, seconds=found["length"] * _unit(scene))


def motion_of(scene: Scene) -> Motion:
    """The kind of motion of a scene, from what it touches and how it starts."""
    walls = [b for b in scene.boundaries if not b.holds]
    if any(b.moves for b in scene.boundaries):
        return "squeezed"
    if len(walls) < len(scene.boundaries):
        return "held"
    if not walls:
        return "free"
    moves = scene.object.lift > 0 or any(scene.object.velocity)
    return "landing" if moves else "standing"


def length(scene: Scene) -> float:
    """Duration of a scene in units of sqrt(size / 9.81 m/s^2)."""
    return _until(scene) / _unit(scene)


def _until(scene: Scene) -> float:
    """The instant of the last frame [s]."""
    return (scene.time.frames - 1) / scene.time.fps


def _unit(scene: Scene) -> float:
    """The unit of length of a scene's motion [s]."""
    return math.sqrt(scene.object.size / 9.81)


@cache
def table() -> dict[str, Any]:
    """The measured errors, with machine and date."""
    file = resources.files("phy124") / "accuracy" / "measured.json"
    return json.loads(file.read_text("utf-8"))


def none(why: str) -> Promise:
    """No promise, for a reason."""
    return Promise(None, f"none can be promised: {why}")


def measured(error: float, cells: int, grids: Sequence[int]) -> Promise:
    """The error that was measured on a scene itself.

    Args:
        error: The error in object sizes.
        cells: Cells across the object of its grid.
        grids: Cells of the grids that were measured, from coarse to fine.
    """
    if cells > grids[-1]:
        origin = f"Extrapolated to D/{cells} from {_listed([f'D/{n}' for n in grids])}."
    else:
        nearest = max(n for n in grids if n <= cells)
        all_of_them = _listed([f"D/{n}" for n in grids])
        origin = f"Measured on {all_of_them if nearest == cells else f'D/{nearest}'}."
    return Promise(error, origin, own=True)


def torn(grids: Sequence[str]) -> str:
    """Why nothing is promised if a study's grids may be torn; `grids` are names such as D/16."""
    return f"on {_listed(grids)} the grid may tear the material"


def off(error: float | None, *, torn: bool = False) -> str:
    """The error of a grid of a study, in a few words."""
    if torn:
        return "may be torn"
    return "no error" if error is None else f"off by about {error:.1%}"


def kept(promised: Promise, error: float) -> str:
    """Whether the promised error holds in this scene, where it was measured."""
    if promised.error is None:
        return f"none was made for such a scene; measured here: {error:.1%}"
    if promised.seconds is not None:
        only = f"the first {promised.seconds:.2f} s only"
        return f"at most {promised.error:.1%} was made for {only}; measured here: {error:.1%}"
    verdict = "holds" if error <= promised.error else "DOES NOT HOLD"
    return f"{verdict}: {error:.1%} of at most {promised.error:.1%}"


def _listed(names: Sequence[str]) -> str:
    first, last = names[:-1], names[-1]
    return f"{', '.join(first)} and {last}" if first else last


def _unknown(what: str) -> Promise:
    return Promise(None, f"not measured for {what}; `{STUDY}` measures it.", unmeasured=what)


def why_broken(report: Mapping[str, Any]) -> str:
    """Why the promise does not hold for a run, whatever was measured elsewhere; "" if it holds."""
    if report.get("balance", {}).get("tearing", {}).get("likely"):
        return "the grid may have torn the material (see the notes)."
    if report.get("complete") is False:
        return "the run stopped early."
    if (report.get("capture") or {}).get("coarse"):
        return "the numbers of its file are too coarse (see the notes)."
    return ""
