"""Stress tests: extreme inputs and motions, for which the results must stay within bounds.

docs/lab/stability.md lists the bounds with their reasons.
"""

from collections.abc import Iterator, Sequence

import warp as wp

from phy124.errors import InputError
from phy124.studies.validation.stress import (
    advice,
    conserve,
    impact,
    inputs,
    laws,
    limits,
    liquids,
    tips,
    world,
)
from phy124.studies.validation.stress.case import Case, Check, Row, Setting, examine

CASES = (
    Case(1, "at rest nothing moves", conserve.rest),
    Case(2, "units by powers of two", conserve.units),
    Case(3, "free fall", conserve.free_fall),
    Case(4, "eight turns", conserve.spin),
    Case(5, "endurance near the limit", conserve.endurance),
    Case(6, "one particle, at the limit and beyond", limits.check_isolated),
    Case(7, "a hundred particles in one point", limits.check_coincident),
    Case(8, "stiffness 1e2 to 1e13", limits.stiff),
    Case(9, "Poisson's ratio 0 to 0.4999", limits.poisson),
    Case(10, "a user's substep far beyond the limit", limits.user_substep),
    Case(11, "impacts at Mach 0.5 to 5", impact.check_impacts),
    Case(12, "impossible deformations", laws.impossible),
    Case(13, "stretched and squeezed, then released", impact.release),
    Case(14, "NaN and infinity in a file", inputs.broken_numbers),
    Case(15, "particles far away", world.far_away),
    Case(16, "negative grid coordinates", inputs.below_zero),
    Case(17, "needles, sheets, nanometres, kilometres", inputs.sizes),
    Case(18, "opacity 0 and 1, no volume, no mass", inputs.odd_gaussians),
    Case(19, "mass ratio 10,000", limits.mass_ratio),
    Case(20, "a million times its weight on one particle", impact.push_hard),
    Case(21, "sand in tension, in heaps, under pressure", laws.sand),
    Case(22, "Hencky stress without an SVD", laws.series_strain),
    Case(23, "covariances over a long motion", conserve.covariances),
    Case(24, "quaternions go on", conserve.continuity),
    Case(25, "a drift slower than rounding", conserve.slow_drift),
    Case(26, "order and orientation", world.permute),
    Case(27, "the window moves", world.window),
    Case(28, "repeats and threads", world.repeats),
    Case(29, "the floor", world.floor),
    Case(30, "following the advice helps", advice.advice, precise=False),
    Case(31, "fluids and grains at walls", world.flow),
    Case(32, "free solids, light and heavy", impact.free),
    Case(33, "tips, edges, legs and hairs", tips.tips),
    Case(34, "tips, edges and hairs on another body", tips.tips_on_body),
    Case(35, "liquids in tanks that move, blow and shrink", liquids.tanks),
    Case(36, "light, soft and heavy bodies in a liquid", liquids.bodies),
    Case(37, "such bodies on lattices in a liquid", liquids.bodies_on_lattices),
)

__all__ = ["CASES", "Case", "Check", "Row", "Setting", "examine", "find_cases", "run", "settings"]


def settings(device: str | None = None, *, long: bool = False) -> list[Setting]:
    """Return a setting for each precision on a device. If `device` is None, return settings for the
    CPU and for each GPU.
    """
    devices = [device] if device else ["cpu", *map(str, wp.get_cuda_devices())]
    return [Setting(d, p, long) for d in devices for p in ("float32", "float64")]


def find_cases(names: Sequence[str]) -> list[Case]:
    """Return the cases whose numbers or names match; `names` may contain words of a name.

    Without names, return all cases.

    Raises:
        InputError: A name fits no case.
    """
    for name in names:
        if not any(_is_called(case, name) for case in CASES):
            known = "; ".join(f"{case.number} {case.name}" for case in CASES)
            raise InputError("cases", name, "no case has this number or name.", f"Use: {known}.")
    return [case for case in CASES if not names or any(_is_called(case, name) for name in names)]


def run(settings: Sequence[Setting], cases: Sequence[Case] = CASES) -> Iterator[Row]:
    """Run cases in each setting, and yield the rows of the table of results."""
    for case in cases:
        for setting in settings:
            yield examine(case, setting)[0]


def _is_called(case: Case, name: str) -> bool:
    return str(case.number) == name if name.isdigit() else name.lower() in case.name.lower()
