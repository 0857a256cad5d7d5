"""Runs a scene with different values in several processes, and stores each result."""

import hashlib
import json
import pickle
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from phy124.gaussians import Gaussians
from phy124.imaging.painted import Crop
from phy124.io.clip import Clip
from phy124.io.files import replacing
from phy124.progress import Progress, silent
from phy124.runtime.context import RunContext
from phy124.runtime.processes import as_done, processes
from phy124.scene import Scene
from phy124.simulation import Simulation, prepare
from phy124.studies.fit.budget import Budget
from phy124.studies.fit.observation import Observations, Values
from phy124.studies.fit.problem import Distance, Places
from phy124.studies.fit.target import Target
from phy124.studies.sweep.keys import code

FOLDER = "runs"
DIGITS = 6

Played = tuple[Values | None, float]
"""Predicted measurements (None if the run stopped early), and CPU time [s]."""


class Tried(NamedTuple):
    """A run with trial values."""

    level: int
    """Index of the grid."""
    values: dict[str, float]
    misfits: list[float] | None
    """RMS misfit of each kind; None if the run stopped early."""


@dataclass(frozen=True)
class Player:
    """Simulates a scene and predicts the measurements."""

    gaussians: Gaussians
    crop: Crop
    observations: Observations

    def __call__(self, scene: dict[str, Any]) -> Played:
        """Return the predicted measurements and the CPU time [s]."""
        begun = time.process_time()
        clip = self.clip(scene)
        predicted = self.observations.predict(clip) if clip.report["complete"] else None
        return predicted, time.process_time() - begun

    def clip(self, scene: dict[str, Any]) -> Clip:
        """Simulate a scene with a single thread, so that the clip is deterministic."""
        run = Simulation(
            prepare(self.gaussians, Scene.from_data(scene), RunContext(threads=1), crop=self.crop)
        )
        return run.run().surface


class Runs:
    """The `Problem` that a fit solves by simulations."""

    def __init__(
        self, target: Target, folder: Path, budget: Budget, progress: Progress = silent
    ) -> None:
        """Store predictions in the subfolder `FOLDER`.

        `progress` is called with ("fit", runs made, runs expected) and may raise Cancelled.

        Raises:
            InputError: A path does not exist in the scene, or a range exceeds the allowed values.
        """
        declared, seen = target.declared, target.observations
        self.names, self._ranges = tuple(declared.find), tuple(declared.find.values())
        self.measured, self.groups, self.kinds = seen.measured, seen.groups, seen.kinds
        self.grids = declared.grids
        self.scene, self._budget, self._progress = target.played, budget, progress
        self.player = Player(target.gaussians, target.crop, seen)
        self.made, self.kept, self.seconds = [0] * len(self.grids), 0, 0.0
        """Number of runs on each grid, number of reused results, and CPU time [s]."""
        self.tried: list[Tried] = []
        self._folder, self._pool = folder / FOLDER, None
        for end in (0.0, 1.0):
            self.scene_at(np.full(len(self.names), end), 0)
        self._known = _digest(self.player)

    def values(self, place: Values) -> dict[str, float]:
        """Return the values at `place`, which contains fractions of their ranges.

        Outside of 0..1, the values are extrapolated beyond their ranges.
        """
        pairs = zip(self.names, self._ranges, place, strict=True)
        return {name: float(f"{axis.draw(float(part)):.{DIGITS}g}") for name, axis, part in pairs}

    def scene_at(self, place: Values, level: int) -> Scene:
        """Return the scene with the values at `place`, on the grid with index `level`."""
        return self.scene.replaced({**self.values(place), "accuracy.cells": self.grids[level]})

    def predict(self, places: Places, level: int) -> list[Values | None]:
        """Predict the measurements [M] at each point on grid `level`; None for a failed run."""
        scenes = [self.scene_at(place, level).data() for place in places]
        files = [self._folder / f"{self._key(scene)}.npy" for scene in scenes]
        missing = {f: s for f, s in zip(files, scenes, strict=True) if not f.is_file()}
        self.kept += len(files) - len(missing)
        work = partial(_play, self.player)
        for (file, _), (predicted, seconds) in as_done(
            self._pool, work, missing.items(), self._beat
        ):
            self.made[level] += 1
            self.seconds += seconds
            file.parent.mkdir(parents=True, exist_ok=True)
            with replacing(file) as temporary, open(temporary, "wb") as out:
                np.save(out, np.empty(0) if predicted is None else predicted.astype(np.float32))
        stored = [np.load(file).astype(np.float64) for file in files]
        predictions = [values if len(values) else None for values in stored]
        for place, values in zip(places, predictions, strict=True):
            misfits = None if values is None else Distance(self).misfits(values)
            self.tried.append(Tried(level, self.values(place), misfits))
        return predictions

    def late(self, part: float) -> bool:
        """Return whether more than the fraction `part` of the time budget has been used."""
        return self._budget.late(part)

    @contextmanager
    def workers(self, count: int) -> Iterator[None]:
        """Within this context, simulate in `count` processes; with 0 or 1, in this process."""
        try:
            with processes(count) as self._pool:
                yield
        finally:
            self._pool = None

    def _beat(self) -> None:
        made = sum(self.made)
        self._progress("fit", made, max(made + 1, self._budget.expected))

    def _key(self, scene: dict[str, Any]) -> str:
        text = self._known + json.dumps(scene, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:24]


def _digest(player: Player) -> str:
    """Return a digest of all inputs of a prediction except the scene."""
    return hashlib.sha256(code().encode() + pickle.dumps(player)).hexdigest()


def _play(player: Player, kept: tuple[Path, dict[str, Any]]) -> Played:
    return player(kept[1])
