"""Computes intervals of the fitted values, and finds values that remain undetermined.

J is the Jacobian of the measurements in units of their errors. Along an eigenvector of the Fisher
matrix J^T J with eigenvalue l, the standard error is 1 / sqrt(l). The half-width of an interval is
the error from a bootstrap over groups of measurements plus the effect of the grid's error.

Each bootstrap draw selects G of the G groups with replacement, and makes one Gauss-Newton step from
the fitted point. This step needs no simulation. Groups are drawn as a whole, because a badly
tracked point shifts all its measurements.
"""

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
    """Uncertainty of the values that is due to the errors of the measurements."""

    errors: Values
    """Half-width of each 95 % interval [P], as a fraction of the value's range."""
    covariance: Values
    """Covariance of the fitted values [P,P], as fractions of their ranges."""


def bootstrap(
    jacobian: Values, residual: Values, groups: Groups, kinds: Sequence[Kind], seed: int
) -> Spread:
    """Estimate the uncertainty of the values by a bootstrap over groups of measurements.

    Args:
        jacobian: Derivatives of the weighted prediction with respect to the values [M,P].
        residual: Weighted differences between prediction and measurement at the fitted point [M].
        groups: Index of each measurement's group [M], from 0; errors in a group are correlated.
        kinds: Kinds of measurements; the groups of each kind are drawn separately.
        seed: Seed of the random draws.
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
    """Return the number of times that each bootstrap sample contains each group [DRAWS,G]."""
    taken = np.zeros((DRAWS, count))
    for kind in kinds:
        members = np.unique(groups[kind.place])
        chances = np.full(len(members), 1 / len(members))
        taken[:, members] = random.multinomial(len(members), chances, DRAWS)
    return taken


def extrapolate(
    grids: Sequence[int], places: Sequence[Values], cells: float
) -> tuple[Values, Values]:
    """Extrapolate the fitted values to another grid by Richardson's method.

    The error is assumed to be proportional to the grid spacing, because a surface's position is off
    by a fraction of a cell.

    Args:
        grids: Numbers of cells across the object, from coarse to fine.
        places: The fitted point on each grid [P].
        cells: Number of cells across the object on the new grid; infinity means no error.

    Returns the extrapolated point [P] and its distance from the finest grid's point [P].
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
    """Return the error that the finest grid causes in each kind of measurement, relative to the
    misfit.

    The model of a misfit m is `m^2 = a^2 + (c h)^2` with the error of the measurements `a`, the
    grid spacing `h` and an unknown `c`. `coarse` and `fine` are the RMS misfits of each kind on the
    two finest `grids`.
    """
    more = (np.asarray(coarse) / np.maximum(fine, 1e-12)) ** 2 - 1
    return np.sqrt(np.maximum(more, 0) / ((grids[-1] / grids[-2]) ** 2 - 1))


def shift_values(
    jacobian: Values, parts: Values, groups: Groups, kinds: Sequence[Kind]
) -> NDArray[np.float64]:
    """Return the largest shift of each value [P] that grid errors of known size can cause.

    Grid errors have few degrees of freedom (two to four singular values in synthetic tests). The
    worst case is therefore assumed: grid errors look like a change of a value. Errors of norm e
    then shift value i of a least-squares fit by `e sqrt(((J^T J)^-1)_ii)`.

    Args:
        jacobian: Derivatives of the weighted prediction [M,P], in units of the misfit.
        parts: Size of the grid errors for each kind, as a fraction of the misfit.
        groups: Index of each measurement's group [M], from 0; errors in a group are correlated.
        kinds: Kinds of measurements.
    """
    counts = [len(np.unique(groups[kind.place])) for kind in kinds]
    size = float(np.sqrt(np.dot(counts, np.square(parts))))
    square = jacobian.T @ jacobian
    inverse = np.linalg.inv(square + 1e-12 * np.trace(square) * np.eye(len(square)))
    return size * np.sqrt(np.diag(inverse))


DEAD = 1e-3
"""Smallest effect of a value that can be determined. The effect of a value is the change of the
measurements over the value's range, divided by the norm of the measurements.
"""
ALIKE = 0.12
"""Smallest singular value at which two values can be separated; 0.12 means a correlation of 0.986.

Each column of the matrix is the effect of one value on the measurements, normalised to length 1.
Below this limit, the effects of two values differ by no more than grid errors. For a pressed duck
without known forces, the singular value of E and density is 0.04 to 0.08 (with 16 and 20 cells),
and that of E and nu is 0.93.
"""
SHARE = 0.3
"""A value is undetermined if its component in the least determined direction is at least this
large.
"""
VAGUE = 1 / 3
"""Smallest half-width of an undetermined value's 95 % interval, as a fraction of the range."""
MODULI = ("E", "mu", "lambda", "bulk", "yield_stress", "hardening")
FORCE = "measure the force on a wall, or load the object with a known force in newtons"
HOW = (
    " (--forces plate.csv, or a clip of a scene with wrenches = true; "
    '[[forces]] kind = "force" is a load)'
)
EXPERIMENTS = {
    "material.density": f"weigh it, or {FORCE}",
    "material.E": f"let it oscillate freely after the load, or {FORCE}",
    "material.nu": "squeeze a block of the material between slippery plates and measure how far "
    "its sides bulge",
    "material.damping": "watch it swing freely for several periods without touching anything",
    "friction": "let it slide down a slope that is just steep enough",
    "object.velocity": "watch it fly for some frames before it touches anything",
    "object.spin": "watch it fly for some frames before it touches anything",
    "stiffness": "load the stiff and the soft end one after the other",
}
"""Experiments that determine a value, by the value's path or a part of the path."""


class Undecided(InputError):
    """The measurements do not determine some values; `limit` states the reason."""

    def __init__(self, names: Sequence[str], why: str) -> None:
        self.names, self.tell = tuple(names), suggest_experiment(names)
        """Names of the undetermined values, and an experiment that would determine them."""
        how = HOW if FORCE in self.tell else ""
        other = f"or fix {names[-1]} by --set and fit the others."
        remedy = f"To determine them: {self.tell}{how}; {other}"
        super().__init__("find", ", ".join(names), why, remedy)

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        return type(self), (self.names, self.limit)


def suggest_experiment(names: Sequence[str]) -> str:
    """Describe an experiment that determines the values."""
    moduli = [name for name in names if name.rpartition(".")[2] in MODULI]
    if moduli and any(name.endswith("density") for name in names):
        return FORCE
    for known, words in EXPERIMENTS.items():
        if any(re.search(rf"(^|\.){re.escape(known)}(\.|$)", name) for name in names):
            return words
    return "measure for a longer time, from another side, or under another load"


def find_unseen(names: Sequence[str], jacobian: Values, spread: float) -> Undecided | None:
    """Return an error if exact measurements cannot determine all values, otherwise None.

    In the weighted Jacobian [M,P], values are fractions of their ranges. `spread` is the norm of
    the weighted measurements.
    """
    effects = np.linalg.norm(jacobian, axis=0)
    for name, effect in zip(names, effects, strict=True):
        if effect < DEAD * spread:
            return Undecided((name,), "no measurement depends on this value.")
    _, strengths, directions = np.linalg.svd(jacobian / effects, full_matrices=False)
    if strengths[-1] > ALIKE:
        return None
    weak = directions[-1]
    alike = tuple(name for name, part in zip(names, weak, strict=True) if abs(part) > SHARE)
    return Undecided(alike, "the measurements depend on the named values in the same way.")


def find_undetermined(
    names: Sequence[str], errors: Values, model: Values, directions: Values
) -> Undecided | None:
    """Return an error if the interval of a value is too wide, otherwise None.

    Args:
        names: Names of the values [P].
        errors: Half-widths of the intervals due to measurement errors, as fractions of the ranges
            [P].
        model: Half-widths of the intervals due to the finest grid's error [P].
        directions: Covariance matrix of the values [P,P].
    """
    worst = int(np.argmax(errors + model))
    wide = 2 * float(errors[worst] + model[worst])
    if wide < 2 * VAGUE:
        return None
    if model[worst] > errors[worst]:
        why = "the grid's error changes the measurements as much as this value does: "
        return Undecided((names[worst],), f"{why}the interval would be {wide:.1f} times the range.")
    scale = np.sqrt(np.diag(directions))
    alike = np.abs(directions[worst] / (scale * scale[worst])) > 1 - SHARE
    linked = tuple(name for name, part in zip(names, alike, strict=True) if part)
    together = "only a combination of these values can be determined: " if len(linked) > 1 else ""
    return Undecided(linked, f"{together}the interval would be {wide:.1f} times the range.")
