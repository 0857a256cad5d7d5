"""What cannot be told apart: values that what was measured does not depend on, or only together.

The Fisher matrix J^T J of the measurements, with J in units of their errors, tells how sharply each
direction in the space of values is seen. Along a direction of eigenvalue l the standard error is
1 / sqrt(l).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from phy124.errors import InputError
from phy124.studies.fit.table import Values

DEAD = 1e-3
"""A value whose whole range changes what is measured by less than this part is not seen at all."""
ALIKE = 0.12
"""Values whose effects differ in direction by less than this are seen only together: errors of the
model, such as those of a grid, are then taken for their difference. 0 is the same direction, 1 a
right angle; 0.12 is a correlation of 0.986. E and density of a pressed duck without a known force,
which differ by its damping alone, have 0.04 to 0.08 on 16 and 20 cells; E and nu have 0.93."""
SHARE = 0.3
"""Part of a direction from which a value belongs to it."""
VAGUE = 1 / 3
"""Half of an interval of 95 %, as a part of the range, from which a value is not determined: two
thirds of the range are then as good."""
MODULI = ("E", "mu", "lambda", "bulk", "yield_stress", "hardening")
FORCE = "measure the force on a wall, or load it with a known force in newtons"
HOW = (
    " (--forces plate.csv, or a clip of a scene with wrenches = true; "
    '[[forces]] kind = "force" is a load)'
)
"""How the command line is given a force."""
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
"""Path or a part of one -> the experiment that tells it."""


class Undecided(InputError):
    """Values that what was measured does not tell; `limit` says why."""

    def __init__(self, field: str, value: object, limit: str, remedy: str, tell: str) -> None:
        self.tell = tell
        """The experiment that would tell, in words."""
        super().__init__(field, value, limit, remedy)

    def __reduce__(self) -> tuple[type, tuple[object, ...]]:
        """Supports pickle."""
        return type(self), (self.field, self.value, self.limit, self.remedy, self.tell)


class Blind(NamedTuple):
    """Values that cannot be found, and why."""

    names: tuple[str, ...]
    why: str

    def refusal(self) -> Undecided:
        """The refusal, with the experiment that would tell."""
        fixed = self.names[-1]
        tell = experiment(self.names)
        how = HOW if FORCE in tell else ""
        remedy = f"To tell: {tell}{how}; or give {fixed} by --set and find the others."
        return Undecided("find", ", ".join(self.names), self.why, remedy, tell)


def experiment(names: Sequence[str]) -> str:
    """What to do in order to tell values apart, in words."""
    moduli = [name for name in names if name.rpartition(".")[2] in MODULI]
    if moduli and any(name.endswith("density") for name in names):
        return FORCE
    for known, words in EXPERIMENTS.items():
        if any(re.search(rf"(^|\.){re.escape(known)}(\.|$)", name) for name in names):
            return words
    return "measure for longer, from another side, or under another load"


def unseen(names: Sequence[str], jacobian: Values, spread: float) -> Blind | None:
    """Values that no measurement of this kind could tell, however exact it were.

    Args:
        names: Of the values [P].
        jacobian: Derivatives of the weighted prediction [M,P], by parts of the ranges.
        spread: Norm of the weighted measurements.
    """
    effects = np.linalg.norm(jacobian, axis=0)
    for name, effect in zip(names, effects, strict=True):
        if effect < DEAD * spread:
            return Blind((name,), "nothing that was measured depends on it.")
    _, strengths, directions = np.linalg.svd(jacobian / effects, full_matrices=False)
    if strengths[-1] > ALIKE:
        return None
    weak = directions[-1]
    alike = tuple(name for name, part in zip(names, weak, strict=True) if abs(part) > SHARE)
    return Blind(alike, "what was measured changes with them in the same way.")


def undetermined(
    names: Sequence[str], errors: Values, model: Values, directions: Values
) -> Blind | None:
    """Values that these measurements, with their errors and those of the grid, leave open.

    Args:
        names: Of the values [P].
        errors: Half the interval of each value by the measurements, as a part of its range [P].
        model: What the error of the finest grid adds to it [P].
        directions: The covariance of the values [P,P].
    """
    worst = int(np.argmax(errors + model))
    wide = 2 * float(errors[worst] + model[worst])
    if wide < 2 * VAGUE:
        return None
    if model[worst] > errors[worst]:
        why = "the error of the grid moves what is measured as much as this value does: "
        return Blind((names[worst],), f"{why}the interval would be {wide:.1f} times the range.")
    scale = np.sqrt(np.diag(directions))
    alike = np.abs(directions[worst] / (scale * scale[worst])) > 1 - SHARE
    found = tuple(name for name, part in zip(names, alike, strict=True) if part)
    together = "they are only known together: " if len(found) > 1 else ""
    return Blind(found, f"{together}the interval would be {wide:.1f} times the range.")
