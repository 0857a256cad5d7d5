"""The error that is promised for a scene, from measurements of similar scenes.

`make accuracy` runs each law in each kind of motion on many objects and a series of grids. It
writes to measured.json the errors, the thickness of the objects, and the violence and duration of
the scenes. The promise is the largest error for the scene's law and kind of motion, of objects that
are about as thick or thicker, on a grid that is as coarse or coarser, times a safety factor. The
scene must not be more violent than the measured ones. If it lasts longer, the promise holds for the
measured duration. Otherwise there is no promise: the error is "not measured", and a study of the
scene itself (`phy124 accuracy`) measures it.

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

from phy124.boundaries import Press
from phy124.materials import AnyMaterial
from phy124.materials.base import Elastic
from phy124.scene import Scene

MEASURED_FORCES = ("gravity", "acceleration")
"""Kinds of forces in the scenes that were measured, on the whole object and constant."""
COMPARED = {"law", "density", "E", "bulk_modulus", "nu", "damping", "yield_stress"}
"""Fields of a law that these numbers cover; others must be as in the measured scenes."""
LOOKS = {"tint"}
"""Fields of a law that do not affect the motion."""


def violence(scene: Scene) -> float:
    """Return the energy relative to the stiffness that absorbs it: (v^2 + |a| L) / c^2 + e^2.

    v is the largest speed at which the object starts, lands or is pressed, a the acceleration by
    forces, L its size, c the speed of waves in a bar of its softest material, and e the fraction of
    its height by which it is pressed.
    """
    slowest = min(bar_speed(section) for section in scene.materials)
    return energy(scene) / max(slowest, 1e-9) ** 2 + _squeeze(scene) ** 2


def yielding(scene: Scene) -> float:
    """Return the energy relative to the smallest yield stress, rho (v^2 + |a| L) / sigma.

    It is 0 if no material yields.
    """
    yields = [getattr(section, "yield_stress", math.inf) for section in scene.materials]
    pairs = zip(scene.materials, yields, strict=True)
    return energy(scene) * max(section.density / max(stress, 1e-9) for section, stress in pairs)


def damping(scene: Scene) -> float:
    """Return the damping of vibrations, eta / (rho c L), of the least damped material."""
    return min(
        getattr(section, "damping", 0.0)
        / (section.density * max(bar_speed(section), 1e-9) * scene.object.size)
        for section in scene.materials
    )


def poisson(scene: Scene) -> float:
    """Return the largest Poisson's ratio; 0 for materials without one."""
    return max(getattr(section, "nu", 0.0) for section in scene.materials)


def energy(scene: Scene) -> float:
    """Return twice the energy per mass that a scene may convert to strain [m^2/s^2]."""
    body = scene.object
    pull = sum(math.hypot(*_vector(force)) for force in scene.forces)
    speed = math.hypot(*body.velocity) + math.hypot(*body.spin) * body.size / 2
    plates = sum(_plate_speed(wall, body.size) for wall in scene.boundaries)
    return speed**2 + 2 * pull * body.lift + pull * body.size + plates**2


def bar_speed(section: AnyMaterial) -> float:
    """Return the speed of waves along a bar [m/s], sqrt(E / rho) for elastic materials.

    Unlike that of pressure waves it remains finite as Poisson's ratio approaches 0.5.
    """
    if isinstance(section, Elastic):
        return math.sqrt(section.E / section.density)
    return section.wave_speed()


def find_difference(scene: Scene) -> str:
    """Return a feature that no measured scene had; empty if there is none."""
    for force in scene.acting:
        if force.kind not in MEASURED_FORCES:
            return f"a force of the kind {force.kind}"
        if force.region is not None:
            return f"{force.kind} on a region"
        if force.profile.kind != "constant":
            return f"a force that follows a {force.profile.kind}"
    for wall in scene.boundaries:
        if wall.moves and not isinstance(wall, Press):
            return f"a {wall.kind} that moves"
    for section in scene.materials:
        for name, field in type(section).model_fields.items():
            usual = field.get_default(call_default_factory=True)
            if name not in COMPARED | LOOKS and getattr(section, name) != usual:
                return f"{section.law} with another {name}"
    return ""


def _plate_speed(wall: Any, size: float) -> float:
    """Return the largest speed of a press on an object of this size [m/s]; it moves as a cosine."""
    if not isinstance(wall, Press):
        return 0.0
    return math.pi / 2 * wall.depth * size / min(wall.down, wall.up)


def _squeeze(scene: Scene) -> float:
    """Return the fraction of its height by which an object is pressed."""
    return max((wall.depth for wall in scene.boundaries if isinstance(wall, Press)), default=0.0)


def _vector(force: Any) -> tuple[float, ...]:
    """Return the acceleration of a force [m/s^2]; zero for other forces."""
    value = next((getattr(force, name) for name in ("g", "a") if hasattr(force, name)), 0.0)
    return tuple(value) if isinstance(value, tuple) else (float(value),)


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
"""Largest ratio of a scene's duration or violence to the measured ones."""
NEARBY = 0.02
"""Largest difference of Poisson's ratio from the measured ones."""
NEARLY = 0.8
"""Smallest relative thickness of measured objects that count as equally thick."""
FEWEST = 6
"""Smallest number of objects for a promise; the thickest objects are included if necessary."""
UNMEASURED = "error not measured"
STUDY = "phy124 accuracy SCENE --image PICTURE"
"""The command that measures a user's own scene."""


@dataclass(frozen=True)
class Promise:
    """The error that is promised for a scene before it runs, or the reason why there is none."""

    error: float | None
    """RMS distance of the Gaussians from the exact motion over the clip, or over its first
    `seconds`, in object sizes."""
    why: str
    """A sentence about the source of the error, or the reason why there is none."""
    unmeasured: str = ""
    """The kind of scene that was not measured, if that is the reason."""
    of_scene: bool = False
    """Whether the error was measured on this scene itself."""
    seconds: float | None = None
    """Duration from the start for which the error holds [s]; None: the whole clip."""

    @property
    def sentence(self) -> str:
        """The promise with its source, in words."""
        if self.of_scene and self.error is not None:
            return (
                f"Error of this scene: about {self.error:.1%} of its size{self._span}. {self.why}"
            )
        if self.error is None:
            return f"Expected error: {self.why}"
        return (
            f"Expected error: at most {self.error:.1%} of the object's size{self._span}. {self.why}"
        )

    def with_study(self, command: str) -> str:
        """Return the sentence; where it names the command of a study, it names this one."""
        return self.sentence.replace(STUDY, command)

    @property
    def brief(self) -> str:
        """The promise in words, without a command."""
        if self.unmeasured:
            return f"Expected error: not measured for {self.unmeasured}."
        return self.sentence

    @property
    def row(self) -> tuple[str, str]:
        """The promise as a row of a table: title and value."""
        return "Error measured" if self.of_scene else "Error promised", self.brief.partition(": ")[
            2
        ]

    @property
    def missing(self) -> str:
        """The missing measurement in a few words; "" if none is missing or possible."""
        if self.seconds is not None:
            return f"error after {self.seconds:.2f} s not measured"
        return UNMEASURED if self.unmeasured else ""

    @property
    def measured(self) -> str:
        """The error measured on this scene, in a few words."""
        off = "no error can be promised" if self.error is None else f"about {self.error:.1%} off"
        return f"Measured: {off}."

    def off(self, pixels: float | None) -> str:
        """Describe the error of a run in a few words; `pixels` is the error in the video."""
        if self.error is None or pixels is None:
            return UNMEASURED
        how = "about" if self.of_scene else "at most"
        return f"off by {how} {self.error:.1%} ({pixels:.0f} px){self._span}"

    @property
    def _span(self) -> str:
        """The part of the clip that was measured, if it is not all of it."""
        return "" if self.seconds is None else f" in the first {self.seconds:.2f} s"


def _describe_beyond(scene: Scene, laws: Sequence[str]) -> str:
    """Return a feature of a scene that was never measured; empty if there is none."""
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
    """Describe in what a scene exceeds the measured ones; empty if in nothing."""
    if violence(scene) > MARGIN * kind["violence"]:
        return "so violent, or so soft"
    if yielding(scene) > MARGIN * kind["yielding"]:
        return "with so large a plastic deformation"
    if damping(scene) * MARGIN < kind["damping"]:
        return "with so little damping"
    if poisson(scene) > kind["nu"] + NEARBY:
        return f"so nearly incompressible (nu above {kind['nu']:g})"
    return ""


def _describe_outside(scene: Scene, such: str, kind: Mapping[str, Any]) -> str:
    """Describe in what a scene exceeds the measured ones of its kind; empty if in nothing."""
    harder = _describe_harder(scene, kind)
    if harder:
        return f"{such} {harder}"
    if scene.particles_per_axis < kind["particles_per_axis"]:
        return f"{such} with fewer than {kind['particles_per_axis']:g} particles per cell and axis"
    if scene.resolution.cells < min(kind["levels"]):
        return f"{such} on so coarse a grid"
    return ""


def _promise_of_run(report: Mapping[str, Any]) -> Promise | None:
    """Return the promise that a run's report determines; None: it determines none."""
    broken = why_broken(report)
    if broken:
        return refuse_promise(broken)
    goal = report.get("goal")
    if goal is None or goal["unit"] == "seconds":
        return None
    if goal["fraction"] is None:
        return refuse_promise(f"{goal['why_not']}.")
    return promise_measured(goal["fraction"], goal["cells"], goal["levels"])


def promise(
    scene: Scene, thickness: float | None, report: Mapping[str, Any] | None = None
) -> Promise:
    """Return the promise for a scene.

    Args:
        scene: The scene.
        thickness: Local thickness of its object relative to its size
            (`phy124.particles.thickness`); None: the object is not known yet.
        report: The report of its run, which may exclude a promise, or contain the measured error
            of a run with a goal.
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


def _measured_level(kind: Mapping[str, Any], error: float, cells: int) -> int:
    """Return the finest level up to `cells` of the objects with this largest error."""
    return max(
        level
        for each in kind["errors"].values()
        if error in each
        for level, measured in zip(kind["levels"], each, strict=True)
        if measured is not None and level <= cells
    )


def motion_of(scene: Scene) -> Motion:
    """Return the kind of motion of a scene, from its walls and its initial state."""
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
    """Return the duration of a scene in units of sqrt(size / 9.81 m/s^2)."""
    return _until(scene) / _unit(scene)


def _until(scene: Scene) -> float:
    """Return the time of the last frame [s]."""
    return (scene.time.frames - 1) / scene.time.fps


def _unit(scene: Scene) -> float:
    """Return the unit of a scene's duration [s]."""
    return math.sqrt(scene.object.size / 9.81)


@cache
def table() -> dict[str, Any]:
    """Return the measured errors, with the machine and the commit that measured them."""
    file = resources.files("phy124") / "accuracy" / "measured.json"
    return json.loads(file.read_text("utf-8"))


def refuse_promise(why: str) -> Promise:
    """Return the absence of a promise, with a reason."""
    return Promise(None, f"none can be promised: {why}")


def promise_measured(
    error: float, cells: int, grids: Sequence[int], until: float | None = None
) -> Promise:
    """Return the promise of the error that was measured on a scene itself.

    Args:
        error: The error in object sizes.
        cells: Cells across the object of its grid.
        grids: Cells of the grids that were measured, from coarse to fine.
        until: Time up to which the error holds [s]; None: the whole motion.
    """
    if cells > grids[-1]:
        origin = f"Extrapolated to D/{cells} from {_join_names([f'D/{n}' for n in grids])}."
    else:
        nearest = max(n for n in grids if n <= cells)
        all_of_them = _join_names([f"D/{n}" for n in grids])
        origin = f"Measured on {all_of_them if nearest == cells else f'D/{nearest}'}."
    return Promise(error, origin, of_scene=True, seconds=until)


def torn(grids: Sequence[str]) -> str:
    """Describe that a study's grids, with names such as D/16, may tear the material."""
    return f"on {_join_names(grids)} the grid may tear the material"


def off(error: float | None, *, torn: bool = False) -> str:
    """Describe the error of a study's grid in a few words."""
    if torn:
        return "may be torn"
    return "no error" if error is None else f"off by about {error:.1%}"


def check_promise(promised: Promise, error: float, until: float | None = None) -> str:
    """Say whether the promised error holds in this scene, whose error was measured up to a time."""
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


def _join_names(names: Sequence[str]) -> str:
    first, last = names[:-1], names[-1]
    return f"{', '.join(first)} and {last}" if first else last


def _unknown(what: str) -> Promise:
    return Promise(None, f"not measured for {what}; `{STUDY}` measures it.", unmeasured=what)


def why_broken(report: Mapping[str, Any]) -> str:
    """Return the reason why no promise holds for a run; "" if a promise may hold."""
    if report.get("balance", {}).get("tearing", {}).get("likely"):
        return "the grid may have torn the material (see the notes)."
    if report.get("complete") is False:
        return "the run stopped early."
    if (report.get("capture") or {}).get("coarse"):
        return "the numbers of its file are too coarse (see the notes)."
    return ""
