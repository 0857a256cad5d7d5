"""Case 12: impossible deformations, and how the watchdog handles them."""

from __future__ import annotations

import numpy as np

from phy124.materials import Fluid, Hencky, Material, Metal, NeoHookean, Sand
from phy124.monitor.external_work import ExternalWork
from phy124.monitor.watchdog import Watchdog
from phy124.studies.validation.bodies import block
from phy124.studies.validation.stress.bodies import assign, body, finite, host, volume_ratios
from phy124.studies.validation.stress.case import Check, Setting, at_least, at_most, equal
from phy124.studies.validation.stress.laws import IMPOSSIBLE, every_deformation

FRAMES = (NeoHookean(E=1e4), Hencky(E=1e4), Metal(E=1e4), Sand(), Fluid(bulk_modulus=1e4))
"""Laws whose bodies are given an impossible particle."""


def impossible(setting: Setting) -> list[Check]:
    """Every law has a finite stress for every F; in a body such a particle is reset and counted."""
    checks = every_deformation(setting)
    for material in FRAMES:
        min_J, moved, sound = np.inf, 0.0, True
        for F in IMPOSSIBLE.values():
            found = _one_bad_particle(material, F, setting)
            min_J, moved = min(min_J, found[0]), max(moved, found[1])
            sound &= found[2]
        name = material.device_law.name
        checks += [
            equal(f"{name}: finite and within its balance", sound),
            at_least(f"{name}: smallest J after a frame", min_J, 1e-5),
            at_most(f"{name}: largest displacement of a neighbour / size", moved, 0.5),
        ]
    return checks


def _one_bad_particle(
    material: Material, F: np.ndarray, setting: Setting
) -> tuple[float, float, bool]:
    """After a frame: smallest J, largest displacement in sizes, and whether all is sound."""
    x = block(4, 0.25)
    external = ExternalWork()
    s = body(x, setting, material, size=0.25, accumulators=[external])
    deformations = host(s.state.F)
    deformations[21] = F
    assign(s, "F", deformations)
    watch = Watchdog()
    watch.bind(s, [external])
    s.repair.begin(s.clock)
    watch.before_attempt()
    s.advance(1 / 24, after=watch.after_substep)
    problem = watch.after_attempt()
    way = np.abs(host(s.state.x) - x).max() / 0.25
    return float(volume_ratios(s).min()), float(way), finite(s) and problem is None
