"""Intervals of fitted values, and values that the measurements do not determine.

The Fisher matrix J^T J of the measurements, with J in units of their errors, shows how precisely
each direction in the space of values is determined: along an eigenvector with eigenvalue l, the
standard error is 1 / sqrt(l). Intervals are a bootstrap over groups of measurements, plus the
effect of the grid's error.

Each draw takes as many groups as there are, with repetition, and makes one Gauss-Newton step from
the fitted place, so that none needs a run. Errors that a group shares (a badly tracked point, a
limb that the grid bends wrongly) widen the interval as they must.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from phy124.errors import InputError
from phy124.studies.fit.observation import Groups, Kind, Values

DRAWS = 1000
PROBABILITY = 0.95


class Spread(NamedTuple):
    """Errors of the values."""

    errors: Values
    """Half of each interval, as a part of the range [P]."""
    covariance: Values
    """[P,P]."""


def bootstrap(
    jacobian: Values, residual: Values, groups: Groups, kinds: Sequence[Kind], seed: int
) -> Spread:
    """Spread of the fitted values under repetition of the measurements.

    Args:
        jacobian: Derivatives of the weighted prediction [M,P].
        residual: Weighted differences at the fitted place [M].
        groups: Which measurements err together [M].
        kinds: Kinds of measurements; each is drawn by itself.
        seed: Seed of the draws.
    """
    from scipy.special import stdtrit

    count, width = int(groups.max()) + 1, jacobian.shape[1]
    squares, slopes = np.zeros((count, width, width)), np.zeros((count, width))
    np.add.at(squares, groups, jacobian[:, :, None] * jacobian[:, None, :])
    np.add.at(slopes, groups, jacobian * residual[:, None])
    slopes -= slopes.mean(0)
    taken = _draw(groups, kinds, count, np.random.default_rng(seed))
    matrices = np.einsum("bg,gij->bij", taken, squares)
    matrices += 1e-9 * np.trace(squares.sum(0)) * np.eye(width)
    steps = -np.linalg.solve(matrices, (taken @ slopes)[..., None])[..., 0]
    free = max(count - width, 1)
    covariance = np.atleast_2d(np.cov(steps.T)) * count / free
    factor = float(stdtrit(free, 0.5 + PROBABILITY / 2))
    return Spread(factor * np.sqrt(np.diag(covariance)), covariance)


def _draw(groups: Groups, kinds: Sequence[Kind], count: int, random: np.random.Generator) -> Values:
    """Return the number of times that each group is in each draw [DRAWS,G]."""
    taken = np.zeros((DRAWS, count))
    for kind in kinds:
        members = np.unique(groups[kind.place])
        chances = np.full(len(members), 1 / len(members))
        taken[:, members] = random.multinomial(len(members), chances, DRAWS)
    return taken


def extrapolate(
    grids: Sequence[int], places: Sequence[Values], cells: float
) -> tuple[Values, Values]:
    """Extrapolate to another grid; return the place, and its distance from the finest grid's.

    The position of a body's surface has an error of a fraction of a cell, so first order in the
    spacing is assumed (Richardson). With one grid, the place is that of this grid.

    Args:
        grids: Cells across the object, from coarse to fine.
        places: The fitted place on each grid.
        cells: Cells of the other grid; infinity for a grid without error.
    """
    finest = places[-1]
    if len(places) < 2:
        return finest, np.zeros_like(finest)
    coarse, fine, other = 1 / grids[-2], 1 / grids[-1], 1 / cells
    shift = (finest - places[-2]) * (fine - other) / (coarse - fine)
    return finest + shift, np.abs(shift)


def find_unexplained(
    grids: Sequence[int], coarse: Sequence[float], fine: Sequence[float]
) -> Values:
    """Estimate the finest grid's error in each kind of measurement, as a fraction of its misfit.

    A misfit m consists of the measurements' errors, equal on all grids, and the grid's error, which
    decreases with the spacing h: m^2 = a^2 + (c h)^2. Two grids determine c.

    Args:
        grids: Cells across the object, from coarse to fine.
        coarse: Root mean square misfit of each kind on the last grid but one.
        fine: Root mean square misfit of each kind on the last grid.
    """
    more = (np.asarray(coarse) / np.maximum(fine, 1e-12)) ** 2 - 1
    return np.sqrt(np.maximum(more, 0) / ((grids[-1] / grids[-2]) ** 2 - 1))


def shift_values(
    jacobian: Values, parts: Values, groups: Groups, kinds: Sequence[Kind]
) -> NDArray[np.float64]:
    """Return the largest shift of each value by model errors of known size but unknown shape [P].

    Errors of a grid have few degrees of freedom (two to four singular values in synthetic tests),
    so the worst case is assumed: they resemble the effect of a value. The largest shift by errors
    of norm e is e sqrt((J^T J)^-1) (least squares).

    Args:
        jacobian: Derivatives of the weighted prediction [M,P], in units of the misfit.
        parts: Size of the errors in each kind of measurement, as a part of its misfit.
        groups: Which measurements err together [M].
        kinds: Kinds of measurements.
    """
    counts = [len(np.unique(groups[kind.place])) for kind in kinds]
    size = float(np.sqrt(np.dot(counts, np.square(parts))))
    square = jacobian.T @ jacobian
    inverse = np.linalg.inv(square + 1e-12 * np.trace(square) * np.eye(len(square)))
    return size * np.sqrt(np.diag(inverse))


DEAD = 1e-3
"""A value is not determined if its whole range changes the measurements by a smaller fraction."""
ALIKE = 0.12
"""Values whose effects differ in direction by less than this are determined only together, since
errors of the model, such as those of a grid, resemble their difference. 0 is the same direction, 1
a right angle; 0.12 is a correlation of 0.986. For E and density of a pressed duck without a known
force, which differ only by damping, the value is 0.04 to 0.08 on 16 and 20 cells; for E and nu, it
is 0.93."""
SHARE = 0.3
"""Smallest component of a direction for which a value belongs to it."""
VAGUE = 1 / 3
"""Half of a 95 % interval, as a fraction of the range, from which a value is not determined: the
interval then covers two thirds of the range."""
MODULI = ("E", "mu", "lambda", "bulk", "yield_stress", "hardening")
FORCE = "measure the force on a wall, or load it with a known force in newtons"
HOW = (
    " (--forces plate.csv, or a clip of a scene with wrenches = true; "
    '[[forces]] kind = "force" is a load)'
)
"""Ways to give a force on the command line."""
EXPERIMENTS = {
    "material.density": f"weigh it, or {FORCE}",
    "material.E": f"let it wobble freely after the load, or {FORCE}",
    "material.nu": "squeeze a block of it between slippery plates and watch how far its "
    "sides come out",
    "material.damping": "watch it swing freely for several periods without touching anything",
    "friction": "let it slide, on a slope that it just does not stay on",
    "object.velocity": "watch it fly for some frames before it touches anything",
    "object.spin": "watch it fly for some frames before it touches anything",
    "stiffness": "load the stiff and the soft end one after the other",
}
"""A path or part of a path -> the experiment that determines it."""


class Undecided(InputError):
    """Values that the measurements do not determine; `limit` says why."""

    def __init__(self, field: str, value: object, limit: str, remedy: str, tell: str) -> None:
        self.tell = tell
        """The experiment that would determine them, in words."""
        super().__init__(field, value, limit, remedy)

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        """Supports pickle."""
        return type(self), (self.field, self.value, self.limit, self.remedy, self.tell)


class Blind(NamedTuple):
    """Values that cannot be determined, and the reason."""

    names: tuple[str, ...]
    why: str

    def refusal(self) -> Undecided:
        """Return the error, with the experiment that would determine the values."""
        fixed = self.names[-1]
        tell = suggest_experiment(self.names)
        how = HOW if FORCE in tell else ""
        remedy = f"To determine them: {tell}{how}; or fix {fixed} by --set and find the others."
        return Undecided("find", ", ".join(self.names), self.why, remedy, tell)


def suggest_experiment(names: Sequence[str]) -> str:
    """Suggest an experiment that determines the values, in words."""
    moduli = [name for name in names if name.rpartition(".")[2] in MODULI]
    if moduli and any(name.endswith("density") for name in names):
        return FORCE
    for known, words in EXPERIMENTS.items():
        if any(re.search(rf"(^|\.){re.escape(known)}(\.|$)", name) for name in names):
            return words
    return "measure for longer, from another side, or under another load"


def find_unseen(names: Sequence[str], jacobian: Values, spread: float) -> Blind | None:
    """Return values that no measurement of this kind can determine, however exact; None: all can.

    Args:
        names: Names of the values [P].
        jacobian: Derivatives of the weighted prediction by fractions of the ranges [M,P].
        spread: Norm of the weighted measurements.
    """
    effects = np.linalg.norm(jacobian, axis=0)
    for name, effect in zip(names, effects, strict=True):
        if effect < DEAD * spread:
            return Blind((name,), "no measurement depends on it.")
    _, strengths, directions = np.linalg.svd(jacobian / effects, full_matrices=False)
    if strengths[-1] > ALIKE:
        return None
    weak = directions[-1]
    alike = tuple(name for name, part in zip(names, weak, strict=True) if abs(part) > SHARE)
    return Blind(alike, "the measurements change with them in the same way.")


def find_undetermined(
    names: Sequence[str], errors: Values, model: Values, directions: Values
) -> Blind | None:
    """Return values that errors of measurements and grid leave undetermined; None: there are none.

    Args:
        names: Names of the values [P].
        errors: Half the interval by the measurements, as a fraction of the range [P].
        model: Half the interval by the error of the finest grid [P].
        directions: Covariance of the values [P,P].
    """
    worst = int(np.argmax(errors + model))
    wide = 2 * float(errors[worst] + model[worst])
    if wide < 2 * VAGUE:
        return None
    if model[worst] > errors[worst]:
        why = "the grid's error changes the measurements as much as this value does: "
        return Blind((names[worst],), f"{why}the interval would be {wide:.1f} times the range.")
    scale = np.sqrt(np.diag(directions))
    alike = np.abs(directions[worst] / (scale * scale[worst])) > 1 - SHARE
    linked = tuple(name for name, part in zip(names, alike, strict=True) if part)
    together = "they are only known together: " if len(linked) > 1 else ""
    return Blind(linked, f"{together}the interval would be {wide:.1f} times the range.")
