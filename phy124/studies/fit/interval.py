"""Computes intervals of the fitted values, and finds values that remain undetermined.

J is the Jacobian of the measurements in units of their errors. The Fisher matrix J^T J shows how
precisely each direction in the space of values is determined: along an eigenvector with eigenvalue
l, the standard error is 1 / sqrt(l). The half-width of an interval is the sum of two parts: the
error from a bootstrap over groups of measurements, and the effect of the grid's error.

Each bootstrap draw selects G of the G groups, with replacement, and makes one Gauss-Newton step
from the fitted point. A Gauss-Newton step from the fitted point needs no simulation. Errors that
are common to a group, such as those of a badly tracked point, widen the interval because each group
is drawn as a whole.
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
    """Uncertainty of the values due to the errors of the measurements."""

    errors: Values
    """Half-width of each 95 % interval, as a fraction of the range [P]."""
    covariance: Values
    """Covariance of the values, as fractions of the ranges [P,P]."""


def bootstrap(
    jacobian: Values, residual: Values, groups: Groups, kinds: Sequence[Kind], seed: int
) -> Spread:
    """Estimate the uncertainty of the fitted values by a bootstrap over groups of measurements.

    Args:
        jacobian: Derivatives of the weighted prediction [M,P].
        residual: Weighted differences at the fitted point [M].
        groups: Group of each measurement, from 0 [M]; errors in a group are correlated.
        kinds: Kinds of measurements; each kind's groups are drawn separately.
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
    """Return how often each bootstrap sample contains each group [DRAWS,G]."""
    taken = np.zeros((DRAWS, count))
    for kind in kinds:
        members = np.unique(groups[kind.place])
        chances = np.full(len(members), 1 / len(members))
        taken[:, members] = random.multinomial(len(members), chances, DRAWS)
    return taken


def extrapolate(
    grids: Sequence[int], places: Sequence[Values], cells: float
) -> tuple[Values, Values]:
    """Extrapolate the fitted values to another grid (Richardson).

    The error of a surface's position is a fraction of a cell. The extrapolation therefore assumes
    first order in the spacing. With only one grid, the result is the point on this grid.

    Args:
        grids: Cells across the object, from coarse to fine.
        places: The fitted point on each grid [P].
        cells: Cells across the object on the other grid; infinity: no grid error.

    Returns:
        The extrapolated point [P], and the absolute shift of each value from the finest grid [P].
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
    """Return the finest grid's error in each kind of measurement, as a fraction of the misfit.

    A misfit m is modelled as m^2 = a^2 + (c h)^2. The errors of the measurements, a, are equal on
    all grids. The grid's error c h is proportional to the spacing h. Two grids determine c.

    Args:
        grids: Cells across the object, from coarse to fine.
        coarse: RMS misfit of each kind on the second-finest grid.
        fine: RMS misfit of each kind on the finest grid.
    """
    more = (np.asarray(coarse) / np.maximum(fine, 1e-12)) ** 2 - 1
    return np.sqrt(np.maximum(more, 0) / ((grids[-1] / grids[-2]) ** 2 - 1))


def shift_values(
    jacobian: Values, parts: Values, groups: Groups, kinds: Sequence[Kind]
) -> NDArray[np.float64]:
    """Return the largest shift of each value due to grid errors of known size [P].

    The pattern of a grid's errors over the measurements is unknown, but has few degrees of freedom
    (two to four singular values in synthetic tests). A grid's errors may therefore resemble the
    effect of a value; the worst case is assumed. In a least-squares fit, errors of norm e then
    shift value i by at most e sqrt(((J^T J)^-1)_ii).

    Args:
        jacobian: Derivatives of the weighted prediction [M,P], in units of the misfit.
        parts: Size of the grid errors in each kind of measurement, as a fraction of its misfit.
        groups: Group of each measurement, from 0 [M]; errors in a group are correlated.
        kinds: Kinds of measurements.
    """
    counts = [len(np.unique(groups[kind.place])) for kind in kinds]
    size = float(np.sqrt(np.dot(counts, np.square(parts))))
    square = jacobian.T @ jacobian
    inverse = np.linalg.inv(square + 1e-12 * np.trace(square) * np.eye(len(square)))
    return size * np.sqrt(np.diag(inverse))


DEAD = 1e-3
"""Relative effect on the measurements below which a value is undetermined.

It is the change of the measurements over the value's range, divided by the measurements' norm.
"""
ALIKE = 0.12
"""Minimum singular value of the values' normalised effects on the measurements.

The singular value is 0 if the effects of two values have the same direction, and 1 if they are
orthogonal; 0.12 means a correlation of 0.986. Below this limit, errors of the model, such as grid
errors, resemble the difference between the effects, so the values cannot be separated.

For example, the effects of E and density on a pressed duck differ only by damping if no force is
known. The singular value is then 0.04 to 0.08 on grids of 16 and 20 cells. For E and nu, it is
0.93.
"""
SHARE = 0.3
"""Minimum component in the weakest direction from which a value counts as undetermined."""
VAGUE = 1 / 3
"""Half-width of a 95 % interval, as a fraction of the range, from which a value is undetermined.

The interval then covers two thirds of the range.
"""
MODULI = ("E", "mu", "lambda", "bulk", "yield_stress", "hardening")
FORCE = "measure the force on a wall, or load it with a known force in newtons"
HOW = (
    " (--forces plate.csv, or a clip of a scene with wrenches = true; "
    '[[forces]] kind = "force" is a load)'
)
"""Part of a message that explains how to provide a force on the command line."""
EXPERIMENTS = {
    "material.density": f"weigh it, or {FORCE}",
    "material.E": f"let it oscillate freely after the load, or {FORCE}",
    "material.nu": "squeeze a block of it between slippery plates and "
    "measure how far its sides bulge",
    "material.damping": "watch it swing freely for several periods without touching anything",
    "friction": "let it slide down a slope that is just steep enough",
    "object.velocity": "watch it fly for some frames before it touches anything",
    "object.spin": "watch it fly for some frames before it touches anything",
    "stiffness": "load the stiff and the soft end one after the other",
}
"""Path of a value, or part of a path -> an experiment that determines the value."""


class Undecided(InputError):
    """Error: the measurements do not determine some values; `limit` gives the reason."""

    def __init__(self, field: str, value: object, limit: str, remedy: str, tell: str) -> None:
        self.tell = tell
        """Description of an experiment that would determine the values."""
        super().__init__(field, value, limit, remedy)

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        """Return the class and its arguments, so that pickle can restore the error."""
        return type(self), (self.field, self.value, self.limit, self.remedy, self.tell)


class Blind(NamedTuple):
    """Values that the measurements do not determine, and the reason."""

    names: tuple[str, ...]
    why: str

    def refusal(self) -> Undecided:
        """Return the error for these values, with an experiment that would determine them."""
        fixed = self.names[-1]
        tell = suggest_experiment(self.names)
        how = HOW if FORCE in tell else ""
        remedy = f"To determine them: {tell}{how}; or fix {fixed} by --set and find the others."
        return Undecided("find", ", ".join(self.names), self.why, remedy, tell)


def suggest_experiment(names: Sequence[str]) -> str:
    """Describe an experiment that determines the values."""
    moduli = [name for name in names if name.rpartition(".")[2] in MODULI]
    if moduli and any(name.endswith("density") for name in names):
        return FORCE
    for known, words in EXPERIMENTS.items():
        if any(re.search(rf"(^|\.){re.escape(known)}(\.|$)", name) for name in names):
            return words
    return "measure for longer, from another side, or under another load"


def find_unseen(names: Sequence[str], jacobian: Values, spread: float) -> Blind | None:
    """Return the values that cannot be determined even from exact measurements.

    The result is None if exact measurements determine all values.

    Args:
        names: Names of the values [P].
        jacobian: Derivatives of the weighted prediction with respect to the values, as fractions of
            their ranges [M,P].
        spread: Norm of the weighted measurements.
    """
    effects = np.linalg.norm(jacobian, axis=0)
    for name, effect in zip(names, effects, strict=True):
        if effect < DEAD * spread:
            return Blind((name,), "no measurement depends on this value.")
    _, strengths, directions = np.linalg.svd(jacobian / effects, full_matrices=False)
    if strengths[-1] > ALIKE:
        return None
    weak = directions[-1]
    alike = tuple(name for name, part in zip(names, weak, strict=True) if abs(part) > SHARE)
    return Blind(alike, "the measurements depend on the named values in the same way.")


def find_undetermined(
    names: Sequence[str], errors: Values, model: Values, directions: Values
) -> Blind | None:
    """Return values whose intervals are too wide; None if all intervals are narrow enough.

    Args:
        names: Names of the values [P].
        errors: Half-width of the interval due to the measurements' errors, as a fraction of the
            range [P].
        model: Half-width of the interval due to the finest grid's error, as a fraction of the
            range [P].
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
    together = "only a combination of these values can be determined: " if len(linked) > 1 else ""
    return Blind(linked, f"{together}the interval would be {wide:.1f} times the range.")
