"""Finds the launches whose threads race in a group of runs."""

from collections import Counter, defaultdict
from collections.abc import Callable
from typing import Any

from races import controls, gpu_forms
from races.conflicts import conflicts
from races.record import Record
from races.watched import Launched, install

FIRST, THEN = 3, 10
"""Which launches of a kernel in a run are examined: the first ones, then one in this many."""


class Detective:
    """Examines launches, and stores the words for which their threads race."""

    def __init__(self) -> None:
        self._record = Record()
        self._run = ""
        self._turns: Counter[str] = Counter()
        self.seen: Counter[str] = Counter()
        """Kernel -> number of examined launches, each of several threads."""
        self.raced: dict[str, dict[str, Counter[str]]] = defaultdict(dict)
        """Kernel -> kind and array of a race, such as "read-write grid_out" -> run -> number of
        words."""

    def begin(self, run: str) -> None:
        """Assign the following launches to this run."""
        self._run = run
        self._turns.clear()

    def __call__(self, inputs: Launched, launch: Callable[[], None]) -> None:
        """Run a launch, and examine it if it is one of the chosen launches."""
        turn = self._turns[inputs.name]
        self._turns[inputs.name] += 1
        if turn >= FIRST and turn % THEN:
            launch()
            return
        if inputs.threads == 1:  # Nothing races with it, which says nothing about its kernel.
            launch()
            return
        self.seen[inputs.name] += 1
        with self._record.noting():
            launch()
        for what, words in conflicts(self._record.entries(), inputs.arrays()).items():
            self.raced[inputs.name].setdefault(what, Counter())[self._run] += words


def races(group: str, cache: str) -> dict[str, Any]:
    """Return the kernels that a group of runs launched, and their races."""
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
