"""Compares the solver with experiments and theories from the literature.

Each experiment runs on three grids. For each quantity, the experiment declares a band of permitted
values. A control run with a deliberate mistake must move at least one quantity out of its band.
"""

from phy124.errors import InputError
from phy124.studies.validation.experiments import (
    beam,
    dam_break,
    hertz,
    incline,
    liquids,
    middle_axis,
    pressed_block,
    restitution,
    sand_column,
    sinking,
    taylor_bar,
    terminal_speed,
    turning,
)
from phy124.studies.validation.experiments.experiment import Estimate, Experiment, Outcome, Quantity

EXPERIMENTS: tuple[Experiment, ...] = (
    beam.ELASTICA,
    beam.MPM_ELASTICA,
    beam.SPLINE_ELASTICA,
    beam.HEAVY_ELASTICA,
    beam.MPM_HEAVY_ELASTICA,
    pressed_block.EXPERIMENT,
    pressed_block.MPM,
    hertz.EXPERIMENT,
    hertz.MPM,
    restitution.EXPERIMENT,
    restitution.MPM,
    incline.EXPERIMENT,
    incline.MPM,
    middle_axis.EXPERIMENT,
    middle_axis.MPM,
    turning.EXPERIMENT,
    terminal_speed.EXPERIMENT,
    taylor_bar.EXPERIMENT,
    sand_column.EXPERIMENT,
    dam_break.EXPERIMENT,
    liquids.SLOSHING,
    liquids.CHANNEL,
    liquids.SPREADING,
    sinking.EXPERIMENT,
)

__all__ = ["EXPERIMENTS", "Estimate", "Experiment", "Outcome", "Quantity", "find_experiment"]


def find_experiment(name: str) -> Experiment:
    """Return the experiment with this name.

    Raises:
        InputError: There is no experiment with this name.
    """
    for experiment in EXPERIMENTS:
        if experiment.name == name:
            return experiment
    names = ", ".join(experiment.name for experiment in EXPERIMENTS)
    raise InputError("name", name, "there is no experiment of this name.", f"Use one of: {names}.")
