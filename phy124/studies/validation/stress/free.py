"""Case 32: free rigid solids that are much lighter or heavier than what they hit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from phy124.monitor.diagnostics import diagnose
from phy124.mpm import FreeBody, Solver
from phy124.studies.validation.bodies import block
from phy124.studies.validation.stress.bodies import Array, body
from phy124.studies.validation.stress.case import Check, Setting, at_most

LOST = {"float32": 1e-5, "float64": 1e-11}
"""Fraction of momentum and angular momentum that rounding may take in this short run."""
SHAPES = {"sphere": (0.2, 0.2, 0.2), "box": (0.25, 0.2, 0.15), "capsule": (0.15, 0.3, 0.15)}


def free(setting: Setting) -> list[Check]:
    """A body hits a block off its middle, spinning, and gives it what it loses."""
    checks = []
    for shape, half in SHAPES.items():
        for ratio in (1e-2, 1.0, 1e2):
            one = FreeBody(
                "body", shape, half, (0.04, 0.03, 0.45), density=1000 * ratio,
                velocity=(0.3, 0.1, -1.0), spin=(1.0, 2.0, 3.0),
            )  # fmt: skip
            s = body(block(), setting, free=[one])
            before = _whole(s)
            s.advance(0.3)
            after, name = _whole(s), f"{shape}, {ratio:g} times as dense"
            lost = LOST[setting.precision]
            checks += [
                at_most(f"{name}: momentum lost", _change(after.momentum, before.momentum), lost),
                at_most(
                    f"{name}: angular momentum lost", _change(after.angular, before.angular), lost
                ),
                at_most(f"{name}: energy", after.energy / before.energy, 1.0),
            ]
    return checks


@dataclass(frozen=True, eq=False)
class _Sums:
    """Of a body and what it hits."""

    momentum: Array
    angular: Array
    energy: float


def _whole(s: Solver) -> _Sums:
    (one,), (pose,), (motion,) = s.free.all, s.free.poses(), s.free.motions()
    axes = one._replace(turn=tuple(pose[3:].tolist())).axes
    found, momentum = diagnose(s), one.mass * motion[:3]
    spin = axes @ (one.moments * (axes.T @ motion[3:]))
    return _Sums(
        found.momentum + momentum,
        found.angular + np.cross(pose[:3], momentum) + spin,
        found.energy + float(momentum @ motion[:3] + spin @ motion[3:]) / 2,
    )


def _change(after: Array, before: Array) -> float:
    return float(np.abs(after - before).max() / np.abs(before).max())
