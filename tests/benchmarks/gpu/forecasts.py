"""Compares forecasts of a device with runs: predicted and actual seconds, and their ratio.

The object is a ball of `--count` Gaussians on 24 cells (8 in a trial on the CPU). The actual time
is that of the second of two runs, since the first run compiles the kernels.
"""

import json
import sys
from pathlib import Path

from arguments import device_asked
from laws import CELLS, FEW, PRESETS, clip_and_seconds

sys.path.insert(0, str(Path(__file__).parents[1]))
from presets import beginning

from phy124.accuracy.forecast import Forecaster
from phy124.runtime.context import RunContext
from phy124.simulation import Simulation, prepare
from phy124.studies.validation.bodies import surface_of_ball


def main(count: int, device: str) -> None:
    """A row per preset."""
    cells, context = CELLS if count > 5000 else FEW, RunContext(device=device)
    for name in PRESETS:
        scene = beginning(name).replaced({"accuracy": {"cells": cells}})
        clip, spent = clip_and_seconds(scene, count, device)
        simulation = Simulation(prepare(surface_of_ball(count), scene, context))
        estimated = simulation.setup.estimate.seconds
        forecast = Forecaster(context).of(simulation, filming=False)
        row = {"what": "forecasts", "preset": name, "gaussians": count}
        row |= {"substeps": clip.report["substeps"], "predicted_substeps": forecast.substeps}
        for stage in ("simulate", "deform"):
            predicted = forecast.stages[stage]
            row |= {f"{stage}_s": round(spent[stage], 4)}
            row |= {f"{stage}_ratio": round(spent[stage] / predicted, 2)}
        row |= {"closed_form_ratio": round(spent["simulate"] / estimated, 2)}
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    asked = device_asked(__doc__, 20_000)
    main(asked.count, asked.device)
