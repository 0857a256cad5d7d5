"""Runs experiments in processes side by side: each grid and each control is a run of its own."""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from typing import NamedTuple

from phy124.progress import Progress
from phy124.runtime.failures import failure
from phy124.runtime.processes import as_done, processes
from phy124.studies.validation.experiments import named
from phy124.studies.validation.experiments.experiment import Experiment, Values
from phy124.studies.validation.experiments.outcome import Outcome, found


class Run(NamedTuple):
    """One simulation of an experiment; plain data, so that another process can do it."""

    experiment: str
    cells: int
    control: bool


class Measured(NamedTuple):
    """What a run found."""

    run: Run
    values: Values
    """Empty if it failed."""
    seconds: float
    """Processor time [s]."""
    failure: str = ""


def runs(experiment: Experiment) -> list[Run]:
    """Its runs, the longest first."""
    coarse, *_ = experiment.grids
    grids = [Run(experiment.name, cells, False) for cells in reversed(experiment.grids)]
    return [*grids, Run(experiment.name, coarse, True)]


def measure(run: Run) -> Measured:
    """Do one run; whatever goes wrong is told in words, so that it does not stop the others."""
    experiment, before = named(run.experiment), time.process_time()
    try:
        values = (experiment.control if run.control else experiment.run)(run.cells)
    except Exception as error:
        what = "control" if run.control else f"{run.cells} cells"
        said = f"{what}: {failure(error).sentence}"
        return Measured(run, (), time.process_time() - before, said)
    return Measured(run, values, time.process_time() - before)


def outcomes(
    experiments: Sequence[Experiment], *, jobs: int, progress: Progress
) -> Iterator[Outcome]:
    """What each experiment found, as soon as its last run has ended.

    Args:
        experiments: Those to run.
        jobs: Processes at once; 1: this process does all runs.
        progress: Told how many runs have ended; may raise Cancelled.
    """
    longest = sorted(experiments, key=lambda experiment: -experiment.seconds)
    todo = [run for experiment in longest for run in runs(experiment)]
    ended: dict[str, list[Measured]] = {}
    with closing(_measured(todo, jobs, progress)) as measured:
        for number, one in enumerate(measured, start=1):
            progress("validate", number, len(todo))
            mine = ended.setdefault(one.run.experiment, [])
            mine.append(one)
            experiment = named(one.run.experiment)
            if len(mine) == len(runs(experiment)):
                yield outcome(experiment, mine)


def outcome(experiment: Experiment, measured: Sequence[Measured]) -> Outcome:
    """What its runs say together.

    Args:
        experiment: The experiment.
        measured: All its runs, in any order.
    """
    seconds = sum(one.seconds for one in measured)
    failures = tuple(one.failure for one in measured if one.failure)
    if failures:
        return Outcome(experiment, (), seconds, failures)
    levels = {one.run.cells: one.values for one in measured if not one.run.control}
    control = next(one.values for one in measured if one.run.control)
    each = tuple(
        found(experiment.grids, quantity, tuple(levels[n][k] for n in experiment.grids), control[k])
        for k, quantity in enumerate(experiment.published())
    )
    lost = tuple(f"{one.quantity.name}: not measured" for one in each if math.isnan(one.value))
    return Outcome(experiment, each, seconds, lost)


def _measured(
    todo: Sequence[Run], jobs: int, progress: Progress
) -> Generator[Measured, None, None]:
    """The runs as they end; processes that are still at work afterwards are stopped."""
    if jobs == 1:
        yield from map(measure, todo)
        return
    ended: list[Run] = []

    def beat() -> None:
        progress("validate", len(ended), len(todo))

    with processes(jobs) as pool:
        for run, one in as_done(pool, measure, todo, beat):
            ended.append(run)
            yield one
