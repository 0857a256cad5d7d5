"""The error that may be promised for a scene: only one that was measured for such scenes.

`make accuracy` runs each law in each kind of motion on many objects and a series of grids, and
writes to measured.json the error of each object and grid, how thick the objects are, and how
violent and how long the scenes were. A scene is promised the largest error of its law and kind of
motion among the objects that are about as thick as its own or thicker, on a grid as coarse as its
own or coarser, times a safety factor, if it is no more violent; one that lasts longer is promised
it for as long as was measured. Otherwise nothing is promised: the error is "not measured", and a
study of the scene itself (`phy124 accuracy`) measures it.

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

from phy124.accuracy.severity import damping, find_difference, poisson, violence, yielding
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
NEARLY = 0.8
"""Smallest thickness, relative to that of an object, of those that count as thick as it."""
FEWEST = 6
"""Smallest number of objects whose largest error is promised: the thickest ones, if need be."""
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
            return (
                f"Error of this scene: about {self.error:.1%} of its size{self._span}. {self.why}"
            )
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
    return find_difference(scene)


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


def _outside(scene: Scene, such: str, kind: Mapping[str, Any]) -> str:
    """In what a scene is outside those measured of its kind, in words; empty: in nothing."""
    harder = _harder(scene, kind)
    if harder:
        return f"{such} {harder}"
    if scene.particles_per_axis < kind["particles_per_axis"]:
        return f"{such} with fewer than {kind['particles_per_axis']:g} particles per cell and axis"
    if scene.resolution.cells < min(kind["levels"]):
        return f"{such} on so coarse a grid"
    return ""


def _promise_of_run(report: Mapping[str, Any]) -> Promise | None:
    """The promise that a run's own report makes or rules out; None: it does neither."""
    broken = why_broken(report)
    if broken:
        return none(broken)
    goal = report.get("goal")
    if goal is None or goal["unit"] == "seconds":
        return None
    if goal["fraction"] is None:
        return none(f"{goal['why_not']}.")
    return measured(goal["fraction"], goal["cells"], goal["levels"])


def promise(
    scene: Scene, thickness: float | None, report: Mapping[str, Any] | None = None
) -> Promise:
    """Return the error that may be promised for a scene.

    Args:
        scene: The scene.
        thickness: Local thickness of its object relative to its size
            (`phy124.particles.thickness`); None: the object is not known yet.
        report: The report of its run, which may rule a promise out; or it contains the error
            itself, which was measured because the run had a goal.
    """
    if report and (settled := _promise_of_run(report)):
        return settled
    laws, motion = sorted({section.law for section in scene.materials}), motion_of(scene)
    such = f"{laws[0]} {WORDS[motion]}"
    kind = table()["scenes"].get(f"{laws[0]} {motion}")
    unknown = _beyond(scene, laws) or (_outside(scene, such, kind) if kind else such)
    if unknown:
        return _unknown(unknown)
    if thickness is None:
        return _unknown("an object whose thickness is not known yet")
    level = max(cells for cells in kind["levels"] if cells <= scene.resolution.cells)
    error, count = largest_error(kind, table()["objects"], thickness, level)
    if error is None:
        cells = thickness * scene.resolution.cells
        return _unknown(f"{such} that is so thin ({cells:.1f} cells of this grid)")
    error *= table()["safety"]
    why = (
        f"Measured at D/{level} for {such} ({', '.join(kind['from'])}; objects about as thick or "
        f"thicker: {count})."
    )
    if length(scene) <= MARGIN * kind["length"]:
        return Promise(error, why)
    why += f" What follows, up to {_until(scene):.2f} s, was not measured."
    return Promise(error, why, seconds=kind["length"] * _unit(scene))


def largest_error(
    kind: Mapping[str, Any], thick: Mapping[str, float], thickness: float, cells: int
) -> tuple[float | None, int]:
    """Return the largest error of the objects about as thick as another, and their number.

    An object's error on a grid is at least that on the finer grids; if it has none on this grid or
    finer ones, it is that on the coarser grids. There is no error if the object is thinner than
    all of them.

    Args:
        kind: The errors of a kind of scene: `levels`, and the `errors` of each object on them.
        thick: Name of an object -> its thickness relative to its size.
        thickness: Thickness of the object, relative to its size.
        cells: One of the levels.
    """
    errors = {}
    for name, each in kind["errors"].items():
        pairs = zip(kind["levels"], each, strict=True)
        known = [(level, error) for level, error in pairs if error is not None]
        finer = (error for level, error in known if level >= cells)
        errors[name] = max(finer, default=known[-1][1])
    widths = sorted((thick[name] for name in errors), reverse=True)
    if not widths or thickness < widths[-1]:
        return None, 0
    least = min(NEARLY * thickness, widths[min(FEWEST, len(widths)) - 1])
    near = [error for name, error in errors.items() if thick[name] >= least]
    return max(near), len(near)


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
    """Return the measured errors, with the machine and the commit that measured them."""
    file = resources.files("phy124") / "accuracy" / "measured.json"
    return json.loads(file.read_text("utf-8"))


def none(why: str) -> Promise:
    """No promise, for a reason."""
    return Promise(None, f"none can be promised: {why}")


def measured(error: float, cells: int, grids: Sequence[int], until: float | None = None) -> Promise:
    """The error that was measured on a scene itself.

    Args:
        error: The error in object sizes.
        cells: Cells across the object of its grid.
        grids: Cells of the grids that were measured, from coarse to fine.
        until: Time up to which the error holds [s]; None: the whole motion.
    """
    if cells > grids[-1]:
        origin = f"Extrapolated to D/{cells} from {_listed([f'D/{n}' for n in grids])}."
    else:
        nearest = max(n for n in grids if n <= cells)
        all_of_them = _listed([f"D/{n}" for n in grids])
        origin = f"Measured on {all_of_them if nearest == cells else f'D/{nearest}'}."
    return Promise(error, origin, own=True, seconds=until)


def torn(grids: Sequence[str]) -> str:
    """Why nothing is promised if a study's grids may be torn; `grids` are names such as D/16."""
    return f"on {_listed(grids)} the grid may tear the material"


def off(error: float | None, *, torn: bool = False) -> str:
    """The error of a grid of a study, in a few words."""
    if torn:
        return "may be torn"
    return "no error" if error is None else f"off by about {error:.1%}"


def kept(promised: Promise, error: float, until: float | None = None) -> str:
    """Whether the promised error holds in this scene, where it was measured up to a time [s]."""
    here = f"measured here{'' if until is None else f' up to {until:.2f} s'}: {error:.1%}"
    if promised.error is None:
        return f"none was made for such a scene; {here}"
    if promised.seconds is not None:
        only = f"the first {promised.seconds:.2f} s only"
        return f"at most {promised.error:.1%} was made for {only}; {here}"
    if until is not None:
        return f"at most {promised.error:.1%} was made for the whole motion; {here}"
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
