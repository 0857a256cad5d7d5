"""Determines an error bound for a scene ("promise") from measured errors of similar scenes.

`make accuracy` simulates each material law in each kind of motion, for many objects and several
grids. It writes the errors, the objects' thickness, and the severity and duration of the scenes to
measured.json. The severity (`violence`) of a scene is its energy relative to the material's
stiffness.

The bound is the largest measured error, times a safety factor, for the scene's law and kind of
motion. Only objects about as thick as the scene's object, or thicker, are considered. The error is
that on the finest measured grid that is not finer than the scene's grid. The scene must not be more
severe than the measured scenes. If it lasts longer, the bound holds only for the measured duration.
If no measured scene is similar, there is no bound: the error is "not measured". A study of the
scene itself (`phy124 accuracy`) can measure it.

This module contains all messages about errors, for the command line and the page.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from phy124.accuracy.severity import (
    Motion,
    damping,
    duration,
    find_difference,
    length,
    motion_of,
    poisson,
    unit,
    violence,
    yielding,
)
from phy124.scene import Scene

WORDS: dict[Motion, str] = {
    "squeezed": "pressed or gripped",
    "landing": "falling or thrown onto something",
    "standing": "standing on something",
    "held": "held at a part of it",
    "free": "touching nothing",
}
"""Kind of motion -> its description in messages."""
MARGIN = 1.25
"""Maximum ratio of a scene's duration, severity or `yielding` to the measured value.

It is also the maximum ratio of the measured damping to the scene's damping.
"""
NEARBY = 0.02
"""Maximum excess of Poisson's ratio over the measured value."""
NEARLY = 0.8
"""Minimum thickness of measured objects that count as equally thick.

It is relative to the thickness of the scene's object.
"""
FEWEST = 6
"""Minimum number of measured objects for a bound; if too few are thick enough, the thickest are
used."""
UNMEASURED = "error not measured"
STUDY = "phy124 accuracy SCENE --image PICTURE"
"""The command that measures a user's own scene."""


@dataclass(frozen=True)
class Promise:
    """The error bound of a scene, or the reason why there is none."""

    error: float | None
    """Bound on the RMS distance of the Gaussians from the exact motion, in object sizes; or None.

    The RMS is taken over the clip, or over its first `seconds`.
    """
    why: str
    """A sentence about the source of the bound, or the reason why there is none."""
    unmeasured: str = ""
    """The kind of scene that was not measured, if this is the reason."""
    about: float | None = None
    """Error measured on this scene itself, in object sizes; None: `error` is from other scenes."""
    seconds: float | None = None
    """Duration from the start for which the bound holds [s]; None: the whole clip."""

    @property
    def sentence(self) -> str:
        """The bound and its source as a message."""
        if self.of_scene:
            return f"This run is off by {self.size()}{self._span}. {self.why}"
        if self.error is None:
            return f"Expected error: {self.why}"
        return (
            f"Expected error: at most {self.error:.1%} of the object's size{self._span}. {self.why}"
        )

    def with_study(self, command: str) -> str:
        """Return `sentence`, but recommend `command` for measuring the error of the scene."""
        return self.sentence.replace(STUDY, command)

    @property
    def of_scene(self) -> bool:
        """Whether the error was measured on this scene itself."""
        return self.about is not None

    def size(self, whole: str = "the object's size") -> str:
        """Return the error in words: "about 1.3 % of the object's size, at most 2.4 %"."""
        about, most = format_percent(self.about or 0.0), format_percent(self.error or 0.0)
        if not self.of_scene:
            return f"at most {most} of {whole}"
        more = "" if about == most else f", at most {most}"
        return f"about {about} of {whole}{more}"

    @property
    def brief(self) -> str:
        """The bound as a message that names no command."""
        if self.unmeasured:
            return f"Expected error: not measured for {self.unmeasured}."
        return self.sentence

    @property
    def row(self) -> tuple[str, str]:
        """The bound as a row of a table (title, value)."""
        return "Error measured" if self.of_scene else "Error promised", self.brief.partition(": ")[
            2
        ]

    @property
    def missing(self) -> str:
        """The missing measurement in a few words; empty if none is missing."""
        if self.seconds is not None:
            return f"error after {self.seconds:.2f} s not measured"
        return UNMEASURED if self.unmeasured else ""

    @property
    def measured(self) -> str:
        """The error measured on this scene itself, in a few words."""
        off = "no error can be promised" if self.error is None else f"about {self.error:.1%} off"
        return f"Measured: {off}."

    def off(self, pixels: float | None) -> str:
        """Describe the error of a run in a few words.

        Args:
            pixels: The error in the video [pixels]; None if unknown.
        """
        if self.error is None or pixels is None:
            return UNMEASURED
        how = "about" if self.about == self.error else "at most"
        return f"off by {how} {self.error:.1%} ({pixels:.0f} px){self._span}"

    @property
    def _span(self) -> str:
        """The part of the clip for which the bound holds, as text; empty for the whole clip."""
        return "" if self.seconds is None else f" in the first {self.seconds:.2f} s"


def _describe_beyond(scene: Scene, laws: Sequence[str]) -> str:
    """Describe a feature of the scene that no measured scene has; empty if there is none."""
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


def _describe_harder(scene: Scene, kind: Mapping[str, Any]) -> str:
    """Describe a property by which a scene is harder to simulate than the measured scenes.

    The result is empty if there is no such property.
    """
    if violence(scene) > MARGIN * kind["violence"]:
        return "with so fast a motion or so soft a material"
    if yielding(scene) > MARGIN * kind["yielding"]:
        return "with so large a plastic deformation"
    if damping(scene) * MARGIN < kind["damping"]:
        return "with so little damping"
    if poisson(scene) > kind["nu"] + NEARBY:
        return f"with Poisson's ratio above {kind['nu']:g}"
    return ""


def _describe_outside(scene: Scene, such: str, kind: Mapping[str, Any]) -> str:
    """Describe a property of the scene outside the range of the measured scenes of its kind.

    The result is empty if there is no such property.
    """
    harder = _describe_harder(scene, kind)
    if harder:
        return f"{such} {harder}"
    if scene.particles_per_axis < kind["particles_per_axis"]:
        return f"{such} with fewer than {kind['particles_per_axis']:g} particles per cell and axis"
    if scene.resolution.cells < min(kind["levels"]):
        return f"{such} on so coarse a grid"
    return ""


def _promise_of_run(report: Mapping[str, Any]) -> Promise | None:
    """Return the error or the reason for none in a run's report; None if the report has neither."""
    broken = why_broken(report)
    if broken:
        return refuse_promise(broken)
    entry = report.get("error") or {}
    if entry.get("about") is not None:
        return promise_own(entry)
    goal = report.get("goal")
    if goal is None or goal["unit"] == "seconds":
        return None
    if goal["fraction"] is None:
        return refuse_promise(f"{goal['why_not']}.")
    return promise_measured(goal["fraction"], goal["cells"], goal["levels"])


def promise(
    scene: Scene, thickness: float | None, report: Mapping[str, Any] | None = None
) -> Promise:
    """Return the error bound for a scene.

    Args:
        scene: The scene.
        thickness: Local thickness of the object relative to its size
            (`phy124.particles.thickness`); None: the object is not known yet.
        report: The report of the scene's run. It may exclude a bound, or contain the error that was
            measured for a goal.
    """
    if report and (settled := _promise_of_run(report)):
        return settled
    laws, motion = sorted({section.law for section in scene.materials}), motion_of(scene)
    such = f"{laws[0]} {WORDS[motion]}"
    kind = table()["scenes"].get(f"{laws[0]} {motion}")
    unknown = _describe_beyond(scene, laws) or (
        _describe_outside(scene, such, kind) if kind else such
    )
    if unknown:
        return _unknown(unknown)
    if thickness is None:
        return _unknown("an object whose thickness is not known yet")
    level = max(cells for cells in kind["levels"] if cells <= scene.resolution.cells)
    error, count = largest_error(kind, table()["objects"], thickness, level)
    if error is None:
        cells = thickness * scene.resolution.cells
        return _unknown(f"{such} that is so thin ({cells:.1f} cells of this grid)")
    known, cells = _measured_level(kind, error, level), scene.resolution.cells
    stays = known < level or level == kind["levels"][-1] < cells
    finer = f" (D/{cells} has no smaller expected error yet)" if stays else ""
    error *= table()["safety"]
    why = (
        f"Measured at D/{known}{finer} for {such} ({', '.join(kind['from'])}; objects about as "
        f"thick or thicker: {count})."
    )
    if length(scene) <= MARGIN * kind["length"]:
        return Promise(error, why)
    why += f" What follows, up to {duration(scene):.2f} s, was not measured."
    return Promise(error, why, seconds=kind["length"] * unit(scene))


def largest_error(
    kind: Mapping[str, Any], thick: Mapping[str, float], thickness: float, cells: int
) -> tuple[float | None, int]:
    """Return the largest error of measured objects that are thick enough, and their number.

    The error of a measured object is its largest error on the grid with `cells` and on finer grids.
    If it was measured on neither, its error on the finest measured grid is used.

    Args:
        kind: The measurements of a kind of scene: `levels`, and `errors` of each object per level.
        thick: Name of a measured object -> its thickness relative to its size.
        thickness: Thickness of the scene's object relative to its size.
        cells: One of the levels.

    Returns:
        The error, None if the scene's object is thinner than all measured objects; and the number
        of measured objects considered.
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


def _measured_level(kind: Mapping[str, Any], error: float, cells: int) -> int:
    """Return the finest level, up to `cells`, of the objects whose errors contain `error`."""
    return max(
        level
        for each in kind["errors"].values()
        if error in each
        for level, measured in zip(kind["levels"], each, strict=True)
        if measured is not None and level <= cells
    )


@cache
def table() -> dict[str, Any]:
    """Return the data of measured.json: errors, with the machine and commits that measured them."""
    file = resources.files("phy124") / "accuracy" / "measured.json"
    return json.loads(file.read_text("utf-8"))


def refuse_promise(why: str) -> Promise:
    """Return a promise without an error bound, with the reason."""
    return Promise(None, f"none can be promised: {why}")


def promise_measured(
    error: float, cells: int, grids: Sequence[int], until: float | None = None
) -> Promise:
    """Return the promise for an error that was measured on the scene itself.

    Args:
        error: The error in object sizes.
        cells: Cells across the object on the scene's grid.
        grids: Cells across the object on the measured grids, from coarse to fine.
        until: Time up to which the error holds [s]; None: the whole motion.
    """
    if cells > grids[-1]:
        origin = f"Extrapolated to D/{cells} from {_join_names([f'D/{n}' for n in grids])}."
    else:
        nearest = max(n for n in grids if n <= cells)
        all_of_them = _join_names([f"D/{n}" for n in grids])
        origin = f"Measured on {all_of_them if nearest == cells else f'D/{nearest}'}."
    return Promise(error, origin, about=error, seconds=until)


def promise_own(entry: Mapping[str, Any]) -> Promise:
    """Return the promise for a run's own error, from the entry `error` of its report."""
    why = f"Estimated from the same motion on D/{entry['cells']}."
    if entry["until"] is not None:
        why += (
            f" After {entry['until']:.2f} s other grids move otherwise: plausible, not predicted."
        )
    return Promise(entry["at_most"], why, about=entry["about"], seconds=entry["until"])


def format_percent(fraction: float) -> str:
    """Format a fraction as a percentage of at least 0.01 %: "0.8 %", "12 %"."""
    fraction = max(fraction, 1e-4)
    return f"{100 * fraction:.1g} %" if fraction < 0.01 else f"{100 * fraction:.2g} %"


def torn(grids: Sequence[str]) -> str:
    """Return a message that some grids of a study, named such as D/16, may tear the material."""
    return f"on {_join_names(grids)} the grid may tear the material"


def off(error: float | None, *, torn: bool = False) -> str:
    """Describe the error on one of a study's grids in a few words."""
    if torn:
        return "may be torn"
    return "no error" if error is None else f"off by about {error:.1%}"


def check_promise(promised: Promise, error: float, until: float | None = None) -> str:
    """Describe whether an error bound holds in a scene.

    Args:
        promised: The error bound.
        error: The error measured in this scene, in object sizes.
        until: Time up to which the error was measured [s]; None: the whole motion.
    """
    here = f"measured here{'' if until is None else f' up to {until:.2f} s'}: {error:.1%}"
    if promised.error is None:
        return f"this kind of scene has no expected error; {here}"
    if promised.seconds is not None:
        only = f"the first {promised.seconds:.2f} s only"
        return f"at most {promised.error:.1%} was expected for {only}; {here}"
    if until is not None:
        return f"at most {promised.error:.1%} was expected for the whole motion; {here}"
    verdict = "holds" if error <= promised.error else "DOES NOT HOLD"
    return f"at most {promised.error:.1%}, measured {error:.1%}: {verdict}"


def _join_names(names: Sequence[str]) -> str:
    first, last = names[:-1], names[-1]
    return f"{', '.join(first)} and {last}" if first else last


def _unknown(what: str) -> Promise:
    return Promise(None, f"not measured for {what}; `{STUDY}` measures it.", unmeasured=what)


def why_broken(report: Mapping[str, Any]) -> str:
    """Return the reason why no error bound holds for a run; empty if one may hold."""
    if report.get("balance", {}).get("tearing", {}).get("likely"):
        return "the grid may have torn the material (see the notes)."
    if report.get("complete") is False:
        return "the run stopped early."
    if (report.get("capture") or {}).get("coarse"):
        return "the numbers in its file have too little precision (see the notes)."
    return ""
