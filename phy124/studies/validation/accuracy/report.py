"""Reports a study: the time and the error of each setting, and the recommended setting."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from phy124.accuracy.convergence import TRUSTED, Convergence
from phy124.accuracy.difference import Difference
from phy124.accuracy.promises import check_promise, format_percent, promise, torn
from phy124.particles.thickness import Proportions
from phy124.scene import PRESETS, Scene
from phy124.scene.lattices import keep_lattice

COARSEST = 8
"""Smallest number of cells across the object of a recommended setting."""
KNOWN = 0.5
"""A setting is recommended only if the errors of at least this fraction of the frames are known."""
MOVING = 2
"""A setting is recommended only if the errors of at least this many later frames are known."""
GOOD = 0.04
"""Largest error of a recommended setting, as a fraction of the object's size."""


@dataclass(frozen=True)
class Row:
    """The time and the error of one setting."""

    name: str
    cells: int
    precision: str
    cfl: float
    binding: str
    particles: int
    particles_per_axis: float
    """Median number of particles per cell and axis, over the cells that contain particles."""
    substeps: int
    predicted: float | None
    """Predicted time to simulate and to deform the Gaussians [s]."""
    seconds: float
    """Measured time [s], without the time to split the energy loss by cause."""
    limiters: dict[str, float]
    """Fraction of the substeps that each limit determines."""
    energy_lost: float
    """Lost energy, as a fraction of the supplied energy."""
    lost_to: dict[str, float] | None
    """Energy lost to each cause (material, contact, numerical); None if unknown."""
    angular_momentum_lost: float | None
    """Relative change of the angular momentum; None if forces or walls may change it."""
    from_finest: Difference | None = None
    """Difference from the motion on the finest grid; None for the finest grid."""
    error: float | None = None
    """Estimated error, as a fraction of the object's size; None if the grids do not converge."""
    pixels: float | None = None
    """Estimated error in the video [pixels]."""
    torn: str = ""
    """Reason why the grid may have torn the material, or empty. With such a reason, the setting has
    no error estimate.
    """
    stated: dict[str, Any] | None = None
    """The entry `error` in the report of a run; None unless the study is thorough and this is a
    level.
    """

    @property
    def level(self) -> bool:
        """Whether the setting is a level, which differs from the scene only in its grid spacing."""
        return self.name.startswith("D/")


@dataclass(frozen=True)
class Report:
    """The result of a study of accuracy."""

    rows: tuple[Row, ...]
    skipped: tuple[str, ...]
    """Sentences about settings that were skipped, or with which the material may have torn."""
    convergence: Convergence
    object_size: float
    """Longest side of the object at rest [m]."""
    recommendation: str
    promises: dict[str, str]
    """A sentence for each preset that says whether its error bound holds in this scene."""
    until: float | None = None
    """Time up to which the errors are valid [s]; None: for the whole motion."""
    closest: float | None = None
    """Distance between the motions on the two finest grids, in object sizes."""
    interrupted: bool = False
    """Whether the study ended before all settings had been run."""

    @property
    def sentences(self) -> tuple[str, ...]:
        """Sentences about the result, without duplicates."""
        sentences = (*self.skipped, self._extent, self.convergence.why_not, self.recommendation)
        return tuple(sentence for sentence in dict.fromkeys(sentences) if sentence)

    @property
    def _extent(self) -> str:
        if self.until is not None:
            return (
                f"The motions on different levels diverge after {self.until:.3g} s. "
                "All errors are for the motion up to that time."
            )
        if self.convergence.error is None and self.closest is not None:
            return (
                "The error is unknown; the two finest levels differ by "
                f"{format_percent(self.closest)} of the object's size."
            )
        return ""

    def data(self) -> dict[str, Any]:
        """Return plain data for accuracy.json; infinity and NaN become None."""
        return _plain(asdict(self))


def error_on(cells: int, errors: Mapping[int, float], order: float | None) -> float | None:
    """Return the error with `cells` cells across the object, from the errors of the levels.

    Between two levels, the error of the coarser level is assumed. Beyond the finest level, the
    error decreases with the observed order (clamped to `TRUSTED`). If no order was observed, the
    error is assumed to be constant. Below the coarsest level, the error is unknown.
    """
    within = [level for level in errors if level <= cells]
    if not within:
        return None
    nearest = max(within)
    if order is None or nearest < max(errors):
        return errors[nearest]
    return errors[nearest] * (nearest / cells) ** min(max(order, TRUSTED[0]), TRUSTED[1])


def recommend(rows: tuple[Row, ...], convergence: Convergence, known: tuple[int, int]) -> str:
    """Return a sentence that recommends a grid spacing.

    `known` contains the number of frames with known errors, and the number of all frames. The first
    frame is not counted.
    """
    levels = [row for row in rows if row.level and not row.torn and row.cells >= COARSEST]
    no = "No setting can be recommended by its error"
    if convergence.error is None:
        return f"{no}: {convergence.why_not}."
    if known[0] < max(MOVING, KNOWN * known[1]):
        return f"{no}, which is known for only {known[0]} of {known[1]} frames after the first."
    if not levels:
        return f"{no}, because every level is coarser than D/{COARSEST}."
    good = [row for row in levels if row.error is not None and row.error <= GOOD]
    best = min(good or levels[-1:], key=lambda row: row.seconds)
    reached = (
        f"with an error of about {format_percent(best.error or 0)} of the object's size in "
        f"{best.seconds:.1f} s"
    )
    advice = f"Recommended: {best.name}, {reached}"
    finer = [row for row in levels if row.cells > best.cells]
    if not good:
        return (
            f"Most accurate: {best.name}, {reached}. No grid is recommended, since none has an "
            f"error of at most {format_percent(GOOD)}; a finer grid is needed."
        )
    if not finer:
        return f"{advice}; it is the finest grid that was run."
    ratio = finer[0].seconds / best.seconds
    better = f"with an error of about {format_percent(finer[0].error or 0)}"
    return f"{advice}; {finer[0].name} would take {ratio:.1f} times as long, {better}."


def kept_promises(
    scene: Scene,
    proportions: Proportions | None,
    rows: tuple[Row, ...],
    convergence: Convergence,
    until: float | None = None,
) -> dict[str, str]:
    """Describe for each preset whether its error bound holds in this scene.

    Args:
        scene: The scene of the study.
        proportions: Proportions of the object; None if unknown.
        rows: The settings that were run.
        convergence: The convergence of the levels.
        until: Time up to which the errors are valid [s]; None: for the whole motion.
    """
    sentences = {}
    for name, accuracy in PRESETS.items():
        row = next((row for row in rows if row.level and row.cells == accuracy.cells), None)
        if row is None:
            sentences[name] = "not tried"
        elif row.torn:
            sentences[name] = f"none: {torn([row.name])}"
        elif convergence.error is None or row.error is None:
            sentences[name] = f"cannot be judged: {convergence.why_not}"
        else:
            stated = keep_lattice(scene.model_copy(update={"accuracy": name}), scene)
            promised = promise(stated, proportions)
            sentences[name] = check_promise(promised, row.error, until, row.stated)
    return sentences


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value.item() if isinstance(value, np.generic) else value
