"""Measures how much a run depends on the order of the threads in each launch."""

from collections.abc import Callable

import numpy as np

from races import gpu_forms
from races.record import Record
from races.watched import Launched, install


class Mixer:
    """Runs the threads of launches in their order, or in a different order for each launch."""

    def __init__(self) -> None:
        self._record = Record()
        self._rng: np.random.Generator | None = None

    def seed(self, seed: int | None) -> None:
        """Choose other orders; None stands for one thread after another."""
        self._rng = None if seed is None else np.random.default_rng(seed)

    def __call__(self, inputs: Launched, launch: Callable[[], None]) -> None:
        """Run a launch."""
        self._record.in_order()
        if self._rng is not None and inputs.threads > 1:
            self._record.shuffled(inputs.threads, self._rng)
        launch()


def apart(group: str, cache: str, seeds: tuple[int, ...] = (1, 2)) -> dict[str, list[float]]:
    """Return, for each run, the largest distance [m] between its clips with threads in order and in
    other orders."""
    mixer = Mixer()
    install(mixer, cache)
    gpu_forms.choose()
    from races.clips import CLIPS

    results: dict[str, list[float]] = {}
    for name, run in CLIPS[group]().items():
        mixer.seed(None)
        means = run().means
        results[name] = []
        for seed in seeds:
            mixer.seed(seed)
            results[name].append(float(np.abs(run().means - means).max()))
    return results
