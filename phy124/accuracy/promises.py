"""States the error of a scene or of a run (the "promise"), and formats all messages about errors.

Before a run, the error is predicted (phy124/accuracy/expectation.py). After a run, the error was
estimated (phy124/accuracy/companion.py) or measured for a goal. If an error was measured for a
goal, its bound was correct for 95 % of the objects and scenes in a test.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from phy124.accuracy.expectation import MARGIN, expect
from phy124.accuracy.severity import duration, length, motion_of, unit
from phy124.particles.thickness import Proportions
from phy124.scene import Scene

UNMEASURED = "error not measured"
STUDY = "phy124 accuracy SCENE --image PICTURE"
SPREAD = 3.0
"""Ratio of an error to its estimate from several grids. The ratio was larger for only 5 % of the
measured objects and scenes (docs/lab/accuracy.md#goals).
"""
SMALLEST = 1e-4
"""Smallest error that a message states, relative to the object's size."""


@dataclass(frozen=True)
class Promise:
    """The error bound of a scene, or the reason why there is none."""

    error: float | None
    """Limit of the RMS distance from the exact motion, relative to the object's size, or None.

    The RMS is taken over the clip, or over its first `seconds`.
    """
    why: str
    """Source of the bound, or the reason why there is none."""
    unmeasured: str = ""
    """Kind of the scene if no such scene was measured; otherwise empty."""
    about: float | None = None
    """Error measured on this scene, relative to the object's size, or None."""
    seconds: float | None = None
    """Time up to which the bound holds [s]; None: the whole clip."""
    unestimated: str = ""
    """Reason why a finished run did not estimate its error."""

    @property
    def sentence(self) -> str:
        """Message about the bound and its source."""
        if self.of_scene:
            return f"This run is off by {self.size()}{self._span}. {self.why}"
        if self.error is None:
            return f"Expected error: {self.why}{self._reason}"
        return f"Expected error: {self.size()}{self._span}. {self.why}{self._reason}"

    def with_study(self, command: str) -> str:
        """Return `sentence` with another command for measuring the error."""
        return self.sentence.replace(STUDY, command)

    @property
    def of_scene(self) -> bool:
        """Whether the error was measured on this scene."""
        return self.about is not None

    def size(self, whole: str = "the object's size") -> str:
        """Return the error, such as "about 1.3 % of the object's size, at most 2.4 %"."""
        most = format_percent(self.error or 0.0)
        if self.about is None:
            return f"at most {most} of {whole}"
        return f"about {format_percent(self.about)} of {whole}, at most {most}"

    @property
    def brief(self) -> str:
        """Message without a command that measures the error."""
        if self.unmeasured:
            return f"Expected error: not measured for {self.unmeasured}.{self._reason}"
        return self.sentence

    @property
    def row(self) -> tuple[str, str]:
        """Title and value for a table."""
        title = "Error of this run" if self.of_scene else "Expected error"
        text = self.brief.removeprefix("This run is off by ").removeprefix("Expected error: ")
        return title, text

    @property
    def missing(self) -> str:
        """Short description of an error that was not measured; may be empty."""
        if self.seconds is not None:
            return f"error after {self.seconds:.2f} s not measured"
        return UNMEASURED if self.unmeasured else ""

    def off(self, pixels: float | None) -> str:
        """Describe the bound of a run, also in pixels if known."""
        if self.error is None or pixels is None:
            return UNMEASURED
        return f"off by at most {format_percent(self.error)} ({pixels:.0f} px){self._span}"

    @property
    def _span(self) -> str:
        return "" if self.seconds is None else f" in the first {self.seconds:.2f} s"

    @property
    def _reason(self) -> str:
        if not self.unestimated:
            return ""
        return f" This run did not estimate its error: {self.unestimated.rstrip('.')}."


def _promise_of_run(report: Mapping[str, Any]) -> Promise | None:
    broken = why_broken(report)
    if broken:
        return refuse_promise(broken)
    goal, entry = report.get("goal"), report.get("error") or {}
    if goal is not None and goal["unit"] != "seconds":
        if goal["fraction"] is None:
            return refuse_promise(f"{goal['why_not']}.")
        return promise_measured(goal["fraction"], goal["cells"], goal["levels"])
    return promise_own(entry) if entry.get("about") is not None else None


def promise(
    scene: Scene, proportions: Proportions | None, report: Mapping[str, Any] | None = None
) -> Promise:
    """Return the error bound for a scene.

    If `proportions` is None, the proportions are read from the report of the scene's run. The
    report may also contain the estimated error, the error that was measured for a goal, or a reason
    why no bound holds.
    """
    if report and (settled := _promise_of_run(report)):
        return settled
    expected = expect(scene, proportions or Proportions.of_report(report or {}))
    unestimated = ((report or {}).get("error") or {}).get("why_not", "")
    if expected.error is None:
        what = expected.unmeasured
        why = f"not measured for {what}; `{STUDY}` measures it."
        return Promise(None, why, unmeasured=what, unestimated=unestimated)
    why, seconds = f"Fitted to {expected.objects} measured objects: {expected.such}.", None
    if motion_of(scene) == "landing":  # errors were measured only until the grids' motions diverge
        why += (
            " The bound holds until the motion begins to differ from grid to grid, which may "
            "happen after an impact."
        )
    if length(scene) > MARGIN * expected.length:
        why += f" The rest of the clip, up to {duration(scene):.2f} s, was not measured."
        seconds = expected.length * unit(scene)
    return Promise(expected.error, why, seconds=seconds, unestimated=unestimated)


def refuse_promise(why: str) -> Promise:
    """Return a promise without an error bound."""
    return Promise(None, f"there is no bound: {why}")


def promise_measured(
    error: float, cells: int, grids: Sequence[int], until: float | None = None
) -> Promise:
    """Return the message about an error that was estimated by running the scene on several grids.

    Args:
        error: The estimated error, relative to the object's size.
        cells: Cells across the object on the scene's grid.
        grids: Cells across the object on the measured grids, from coarse to fine.
        until: The error was estimated for the motion up to this time [s]; None: the whole motion.
    """
    if cells > grids[-1]:
        origin = f"Extrapolated to D/{cells} from {_join_names([f'D/{n}' for n in grids])}."
    else:
        nearest = max(n for n in grids if n <= cells)
        all_of_them = _join_names([f"D/{n}" for n in grids])
        origin = f"Measured on {all_of_them if nearest == cells else f'D/{nearest}'}."
    return Promise(SPREAD * error, origin, about=error, seconds=until)


def promise_own(entry: Mapping[str, Any]) -> Promise:
    """Return the error that a run has estimated, from `error` in its report."""
    why = f"Estimated from the same motion on D/{entry['cells']}."
    if entry["until"] is not None:
        why += (
            f" After {entry['until']:.2f} s the motion differs from grid to grid: it is "
            "plausible, but not a prediction."
        )
    return Promise(entry["at_most"], why, about=entry["about"], seconds=entry["until"])


def format_percent(fraction: float, digits: int = 2) -> str:
    """Format a fraction as a percentage of at least 0.01 %: "0.84 %", "12 %"."""
    percent = 100 * max(fraction, SMALLEST)
    places = max(digits - 1 - math.floor(math.log10(percent)), 0)
    return f"{percent:.{places}f} %"


def format_apart(first: float, second: float) -> tuple[str, str]:
    """Format two fractions with enough digits to show their difference."""
    texts = [[format_percent(each, n) for each in (first, second)] for n in range(2, 7)]
    a, b = next((pair for pair in texts if pair[0] != pair[1]), texts[0])
    return a, b


def torn(grids: Sequence[str]) -> str:
    """State that the material may tear on these grids."""
    return f"on {_join_names(grids)} the grid may tear the material"


def off(error: float | None, *, torn: bool = False) -> str:
    """Describe the error on one of a study's grids."""
    if torn:
        return "may be torn"
    return "no error" if error is None else f"off by about {format_percent(error)}"


def check_promise(
    promised: Promise,
    error: float,
    until: float | None = None,
    stated: Mapping[str, Any] | None = None,
) -> str:
    """Describe whether a measured error is within the bound that was stated before.

    Args:
        promised: The error bound.
        error: The measured error, relative to the object's size.
        until: Time up to which the error was measured [s]; None: the whole motion.
        stated: The error in the report of a run, if known.
    """
    states = _describe_stated(stated or {})
    here = f"measured here{'' if until is None else f' up to {until:.2f} s'}"
    if promised.error is None:
        said = f"this kind of scene has no expected error; {here}: {format_percent(error)}"
        return f"{said}{states}"
    bound, measured = format_apart(promised.error, error)
    if promised.seconds is not None:
        only = f"the first {promised.seconds:.2f} s only"
        return f"at most {bound} was expected for {only}; {here}: {measured}{states}"
    if until is not None:
        return f"at most {bound} was expected for the whole motion; {here}: {measured}{states}"
    verdict = "the bound holds" if error <= promised.error else "the bound DOES NOT HOLD"
    return f"at most {bound}, measured {measured}: {verdict}{states}"


def _describe_stated(entry: Mapping[str, Any]) -> str:
    if entry.get("at_most") is None:
        return ""
    span = "" if entry.get("until") is None else f" in the first {entry['until']:.2f} s"
    return f"; the run itself states at most {format_percent(entry['at_most'])}{span}"


def _join_names(names: Sequence[str]) -> str:
    first, last = names[:-1], names[-1]
    return f"{', '.join(first)} and {last}" if first else last


def why_broken(report: Mapping[str, Any]) -> str:
    """Return the reason why no bound holds for a run, or ""."""
    if report.get("balance", {}).get("tearing", {}).get("likely"):
        return "the grid may have torn the material (see the notes)."
    if report.get("complete") is False:
        return "the run stopped early."
    if (report.get("capture") or {}).get("coarse"):
        return "the numbers in its file have too little precision (see the notes)."
    return ""
