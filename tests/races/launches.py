"""Which threads of which launches race, over a group of runs."""

from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any

from races import controls, gpu_forms
from races.conflicts import conflicts
from races.record import Record
from races.watched import Launched, install

FIRST, THEN = 3, 10
"""Launches of a kernel in a run that are looked at: the first ones, then one in so many."""


class Detective:
    """Looks at launches and keeps what their threads raced for."""

    def __init__(self) -> None:
        self._record = Record()
        self._run = ""
        self._turns: Counter[str] = Counter()
        self.seen: Counter[str] = Counter()
        """Kernel -> launches looked at."""
        self.raced: dict[str, dict[str, Counter[str]]] = defaultdict(dict)
        """Kernel -> what raced, such as "read-write grid_out" -> run -> number of words."""

    def begin(self, run: str) -> None:
        """Launches that follow belong to this run."""
        self._run = run
        self._turns.clear()

    def __call__(self, inputs: Launched, launch: Callable[[], None]) -> None:
        """Run a launch and look at it, if its turn has come."""
        turn = self._turns[inputs.name]
        self._turns[inputs.name] += 1
        if turn >= FIRST and turn % THEN:
            launch()
            return
        self.seen[inputs.name] += 1
        if inputs.threads == 1:  # Nothing races with it.
            launch()
            return
        with self._record.noting():
            launch()
        for what, words in conflicts(self._record.entries(), inputs.arrays()).items():
            self.raced[inputs.name].setdefault(what, Counter())[self._run] += words


def races(group: str, cache: str) -> dict[str, Any]:
    """Kernels that were seen in a group of runs, and what they raced for."""
    detective = Detective()
    install(detective, cache)
    for name, run in _runs(group).items():
        detective.begin(name)
        run()
    return {"seen": detective.seen, "raced": detective.raced}


def _runs(group: str) -> dict[str, Callable[[], object]]:
    if group == "controls":
        return {name: lambda name=name: controls.run(name) for name in controls.NAMES}
    gpu_forms.choose()
    from races import lattices, runs

    return {**runs.GROUPS, **lattices.GROUPS}[group]()
