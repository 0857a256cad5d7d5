"""Runs experiments in parallel processes."""

import math
import time
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from phy124.progress import Progress
from phy124.runtime.failures import failure
from phy124.runtime.processes import as_done, processes
from phy124.studies.validation.experiments import find_experiment
from phy124.studies.validation.experiments.experiment import Experiment, Outcome, Values, estimate


class Run(NamedTuple):
    """One simulation on one grid, as plain data for another process."""

    experiment: str
    cells: int
    control: bool


class Measured(NamedTuple):
    """The result of one run."""

    run: Run
    values: Values
    """The measured values; empty if the run failed."""
    seconds: float
    """CPU time of the run [s]."""
    failure: str = ""


def list_runs(experiment: Experiment) -> list[Run]:
    """Return the runs of an experiment: one per grid, from fine to coarse, then the control run."""
    coarse, *_ = experiment.grids
    grids = [Run(experiment.name, cells, False) for cells in reversed(experiment.grids)]
    return [*grids, Run(experiment.name, coarse, True)]


def measure_run(run: Run) -> Measured:
    """Execute a run; an exception becomes an error message in the result."""
    experiment, before = find_experiment(run.experiment), time.process_time()
    try:
        values = (experiment.control if run.control else experiment.run)(run.cells)
    except Exception as error:
        what = "control" if run.control else f"{run.cells} cells"
        message = f"{what}: {failure(error).sentence}"
        return Measured(run, (), time.process_time() - before, message)
    return Measured(run, values, time.process_time() - before)


def run_all(
    experiments: Sequence[Experiment], *, jobs: int, progress: Progress
) -> Iterator[Outcome]:
    """Run experiments, and yield the outcome of each completed experiment.

    With one job, all runs are executed in this process. `progress` is called with ("validate",
    finished runs, all runs) and may raise Cancelled.
    """
    longest = sorted(experiments, key=lambda experiment: -experiment.seconds)
    todo = [run for experiment in longest for run in list_runs(experiment)]
    ended: dict[str, list[Measured]] = {experiment.name: [] for experiment in experiments}

    def beat() -> None:
        progress("validate", sum(map(len, ended.values())), len(todo))

    with processes(jobs) as pool:
        for run, result in as_done(pool, measure_run, todo, beat):
            experiment, results = find_experiment(run.experiment), ended[run.experiment]
            results.append(result)
            beat()
            if len(results) == len(list_runs(experiment)):
                yield conclude(experiment, results)


def conclude(experiment: Experiment, measured: Sequence[Measured]) -> Outcome:
    """Return the outcome of an experiment from the results of its runs, in arbitrary order."""
    seconds = sum(result.seconds for result in measured)
    failures = tuple(result.failure for result in measured if result.failure)
    if failures:
        return Outcome(experiment, (), seconds, failures)
    levels = {result.run.cells: result.values for result in measured if not result.run.control}
    control = next(result.values for result in measured if result.run.control)
    each = tuple(
        estimate(
            experiment.grids, quantity, tuple(levels[n][k] for n in experiment.grids), control[k]
        )
        for k, quantity in enumerate(experiment.published())
    )
    lost = tuple(f"{e.quantity.name}: not measured" for e in each if math.isnan(e.value))
    return Outcome(experiment, each, seconds, lost)
