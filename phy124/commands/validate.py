"""`phy124 validate`: compare the solver with published experiments and theory."""

import json
import os
import platform
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from phy124.commands.bars import Bars
from phy124.commands.options import Device
from phy124.errors import InputError
from phy124.io.files import staging, write_whole
from phy124.runtime.cores import cores, refuse_threads
from phy124.runtime.device import pick_device
from phy124.studies.validation import stress
from phy124.studies.validation.experiments import EXPERIMENTS, Experiment, Outcome, find_experiment
from phy124.studies.validation.experiments.page import (
    data,
    details,
    refuse_missing_plots,
    save_page,
    summary,
)
from phy124.studies.validation.experiments.running import run_all

DOCS = Path("docs/lab/experiments.md"), Path("docs/images/experiments")


@dataclass(frozen=True)
class Validate:
    """Repeat each published experiment on three grids, and once with a deliberate error that must
    be detected.

    The status is 0 if three conditions hold: all experiments ran, every run with a deliberate error
    left its acceptance band, and every other value outside its band is a known deviation.
    """

    name: tyro.conf.Positional[str | None] = None
    """Name of the experiment to repeat; by default, all are repeated. --list prints the names."""
    quick: bool = False
    """Repeat only the experiments that take seconds. These are about half of all experiments, and
    take a minute in total.
    """
    list: bool = False
    """Print the names of the experiments and the measured quantities; run no experiment."""
    jobs: int | None = None
    """Number of parallel processes; by default, one per core."""
    out: Path | None = None
    """Folder for experiments.md, experiments.json and a plot of each experiment."""
    docs: bool = False
    """Update docs/lab/experiments.md and its plots; works only in a clone of the repository."""
    json: bool = False
    """Print only JSON."""

    def run(self) -> int:
        """Run the experiments; return status 1 if a run fails, if a deliberate error is not
        detected, or if a deviation is new.

        Raises:
            InputError: The experiment is unknown, or the results cannot be written.
        """
        chosen = self._chosen()
        if self.list:
            print(json.dumps(_list(chosen)) if self.json else "\n".join(_lines(chosen)))
            return 0
        refuse_threads(self.jobs)
        self._refuse_docs()
        self._refuse_out()
        return self._validate(chosen)

    def _validate(self, chosen: Sequence[Experiment]) -> int:
        done: list[Outcome] = []
        with Bars(quiet=self.json, keeps=True) as bars, bars.keeping():
            for outcome in run_all(chosen, jobs=self.jobs or cores(), progress=bars):
                done.append(outcome)
                if not self.json:
                    print("\n".join([summary(outcome), *details(outcome)]), flush=True)
        done.sort(key=lambda outcome: chosen.index(outcome.experiment))
        good = len(done) == len(chosen) and all(outcome.good for outcome in done)
        if self.json:
            print(json.dumps({"good": good, "experiments": [data(each) for each in done]}))
        elif bars.ended is None:
            print(_summary(done))
        self._write(done, whole=bars.ended is None)
        return bars.status(f"{len(done)} experiments were made") or (0 if good else 1)

    def _chosen(self) -> Sequence[Experiment]:
        if self.name is None:
            return [each for each in EXPERIMENTS if each.quick or not self.quick]
        return [find_experiment(self.name)]

    def _refuse_docs(self) -> None:
        if not self.docs:
            return
        if self.name or self.quick:
            raise InputError(
                "docs",
                "a part",
                "the page shows all experiments, not a selection.",
                "Remove NAME and --quick, or write the selection with --out FOLDER.",
            )
        if not DOCS[0].parent.is_dir():
            raise InputError(
                "docs",
                Path.cwd(),
                "there is no docs/lab here.",
                "Run the command in the root of a clone, or choose a folder with --out FOLDER.",
            )

    def _refuse_out(self) -> None:
        """Refuse an unusable folder before the experiments, which take hours."""
        if self.docs or self.out is not None:
            refuse_missing_plots()
        if self.out is not None:
            with staging(self.out):
                pass

    def _write(self, done: Sequence[Outcome], *, whole: bool) -> None:
        if self.docs and whole:
            save_page(done, *DOCS, machine=_machine())
        if self.out is not None and done:
            with staging(self.out, keeps=True) as folder:
                rows = [data(each) for each in done]
                write_whole(folder / "experiments.json", json.dumps(rows, indent=1))
                page = folder / "experiments.md"
                save_page(done, page, folder / "plots", machine=_machine())


def _list(chosen: Sequence[Experiment]) -> list[dict[str, Any]]:
    names = ("name", "title", "measured", "quick")
    return [{name: getattr(each, name) for name in names} for each in chosen]


def _lines(chosen: Sequence[Experiment]) -> list[str]:
    return [f"{e.name:<20}{e.title}{' (quick)' if e.quick else ''}" for e in chosen]


def _summary(done: Sequence[Outcome]) -> str:
    inside, total = (sum(map(f, done)) for f in (lambda o: o.inside, lambda o: len(o.estimates)))
    held = sum(outcome.control_holds for outcome in done)
    seconds = sum(outcome.seconds for outcome in done)
    narrow = sum(each.by_its_error for outcome in done for each in outcome.estimates)
    return (
        f"{inside} of {total} values are in their bands, {narrow} of these only because of the "
        f"value's own error; {held} of {len(done)} control runs are outside the bands, as "
        f"required; {seconds:.0f} s of CPU time"
    )


def _machine() -> str:
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else 0.0
    busy = f", while other programs were running (load {load:.0f})" if load > 1.5 * cores() else ""
    return (
        f"Seconds are CPU time, summed over all runs of an experiment, on {cores()} cores "
        f"of {_processor()}, Python {platform.python_version()}{busy}.\n"
    )


def _processor() -> str:
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text("utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.machine()


@dataclass(frozen=True)
class Stress:
    """Run the hard cases; print the bound, the measured value and the verdict of each case."""

    cases: tyro.conf.Positional[tuple[str, ...]] = ()
    """Numbers of the cases to run, or words from their names; by default, all cases are run."""
    all: bool = False
    """Run the cases at full length, which takes minutes instead of seconds."""
    device: Device | None = None
    """Device on which the cases run; default: the CPU and then each CUDA device."""
    json: bool = False
    """Print only JSON."""

    def run(self) -> int:
        """Run the cases and print the table; return status 1 if a case fails.

        Raises:
            InputError: No case has this name, or this machine does not have the requested device.
        """
        cases = stress.find_cases(self.cases)
        device = None if self.device is None else pick_device(self.device)
        settings, rows = stress.settings(device, long=self.all), []
        total = len(cases) * len(settings)
        with Bars(quiet=self.json, keeps=True) as bars, bars.keeping():
            for row in stress.run(settings, cases):
                rows.append(row)
                bars("stress", len(rows), total)
        if self.json:
            print(json.dumps([row._asdict() for row in rows]))
        else:
            for row in rows:
                print(f"{row.verdict:<5}{row.case}")
                for bound, measured in zip(
                    row.bound.split("; "), row.measured.split("; "), strict=False
                ):
                    print(f"       {measured:>10}  {bound}")
        good = all(row.verdict == "pass" for row in rows)
        return bars.status(f"{len(rows)} of {total} cases were run") or (0 if good else 1)
