"""Experiments from the literature, repeated by the solver: does it describe the world?

`phy124 accuracy --verify` shows that the equations are solved; `phy124 validate` compares with what
was measured, or proved, elsewhere. Each experiment has three grids, a band, and a control with a
deliberate mistake, which must leave that band. docs/lab/experiments.md is made by it.
"""

from __future__ import annotations

from phy124.errors import InputError
from phy124.studies.validation.experiments import (
    dam_break,
    elastica,
    elastica_spline,
    heavy_elastica,
    hertz,
    incline,
    middle_axis,
    pressed_block,
    restitution,
    sand_column,
    taylor_bar,
    terminal_speed,
)
from phy124.studies.validation.experiments.experiment import Experiment, Quantity
from phy124.studies.validation.experiments.outcome import Found, Outcome

EXPERIMENTS: tuple[Experiment, ...] = tuple(
    module.EXPERIMENT
    for module in (
        elastica, elastica_spline, heavy_elastica, pressed_block, hertz, restitution, incline,
        middle_axis, terminal_speed, taylor_bar, sand_column, dam_break,
    )
)  # fmt: skip
"""All experiments, in the order in which they are shown."""

__all__ = ["EXPERIMENTS", "Experiment", "Found", "Outcome", "Quantity", "named"]


def named(name: str) -> Experiment:
    """The experiment of a name.

    Raises:
        InputError: There is none.
    """
    for experiment in EXPERIMENTS:
        if experiment.name == name:
            return experiment
    names = ", ".join(experiment.name for experiment in EXPERIMENTS)
    raise InputError("name", name, "there is no such experiment.", f"Use one of: {names}.")
