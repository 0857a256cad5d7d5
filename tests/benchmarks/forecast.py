"""Compares predicted with measured seconds for the presets at every named accuracy, a line each.

With `--docs` the program updates the table of docs/lab/forecasts.md. Run it on an idle machine,
because a forecast cannot predict the load of other programs. To run only some scenes, pass their
names. The six scenes of the page take one minute; some other presets take minutes at `fine`.

With `--zoo FOLDER` objects of the zoo (zoo.py) are run at `standard` instead of the duck. This
takes about five minutes. The program then also measures the time to estimate a run's error,
relative to the dynamics.

`--solver` selects the solver of elastic objects. With `--cpu` all times are CPU times of a single
thread, which are valid on a busy machine, too.
"""

import argparse
import json
import statistics
import sys
import tempfile
import time
from pathlib import Path

import warp as wp

from phy124 import pipeline
from phy124.accuracy import Forecaster
from phy124.runtime.context import RunContext
from phy124.scene import PRESETS, preset_names

sys.path.insert(0, str(Path(__file__).parent))
from presets import beginning
from tables import DOCS, markdown, renew
from zoo import gaussians_of, objects

ALIKE = ("push_away", "push_right_harder")
"""Scenes that are left out unless named: they differ from push_right by the push alone."""
DUCK = Path(__file__).parents[2] / "demo/examples/duck.png"
ZOO = ("bob", "cat", "koala", "teapot", "duck", "pear", "torus", "table")
MOTIONS = ("press", "drop", "sway", "spin")


def measure(
    gaussians, name: str, accuracy: str, solver: str | None = None, threads: int | None = None
) -> dict:
    """One whole run with its forecast."""
    scene = beginning(name).replaced({"accuracy": accuracy})
    if solver is not None:
        scene = scene.replaced({"accuracy.solver": solver})
    context = RunContext(threads=threads)
    with tempfile.TemporaryDirectory() as folder:
        forecaster = Forecaster(context)
        result = pipeline.simulate(gaussians, scene, folder, context, forecaster=forecaster)
    entry, report = result.report["forecast"], result.report
    simulate = entry["stages"]["simulate"]
    seconds = {stage["name"]: stage["seconds"] for stage in report["stages"]}
    return {
        "scene": name,
        "accuracy": accuracy,
        "particles": report["particles"],
        "substeps predicted": entry["substeps"],
        "substeps": report["substeps"],
        "simulation predicted s": round(simulate["predicted"], 2),
        "simulation s": round(simulate["spent"], 2),
        "predicted s": round(entry["predicted"], 2),
        "spent s": round(entry["spent"], 2),
        "ratio": round(entry["ratio"], 3),
        "certain": entry["caveat"] is None,
        "own error / simulation": round(seconds.get("companion", 0) / seconds["simulate"], 3),
    }


def count_within(rows: list[dict], part: float) -> str:
    """Return how many forecasts without a caveat are met within a part of the time."""
    ratios = [row["ratio"] for row in rows if row["certain"]]
    within = sum(1 - part <= ratio <= 1 + part for ratio in ratios)
    ends = f"between {1 - part:.3g} and {1 + part:.3g}"
    return f"{within} of {len(ratios)} ratios of actual to predicted time are {ends}."


def measure_zoo(folder: Path, names: list[str], solver: str | None, threads: int | None) -> None:
    """Print a line per object and scene, and conclusions about forecasts and the own error."""
    known, rows = objects(folder), []
    for name in names:
        gaussians = gaussians_of(name, known[name])
        for scene in MOTIONS:
            row = measure(gaussians, scene, "standard", solver, threads)
            rows.append({"object": name, **row})
            print(json.dumps(rows[-1]), flush=True)
    costs = sorted(row["own error / simulation"] for row in rows)
    ran = [cost for cost in costs if cost > 0]
    print(count_within(rows, 0.15))
    print(f"{len(ran)} of {len(rows)} runs have an own error, for a median of ", end="")
    print(f"{statistics.median(ran):.0%} and at most {ran[-1]:.0%} of the dynamics.")


def main() -> None:
    """Print a line per run and how many forecasts are met."""
    how = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    how.add_argument("scenes", nargs="*", help="names of presets; default all")
    how.add_argument("--docs", action="store_true", help="renew the table of the page")
    how.add_argument("--zoo", type=Path, metavar="FOLDER", help="folder of the zoo's objects")
    how.add_argument("--objects", nargs="+", default=list(ZOO), help="names of the zoo's objects")
    how.add_argument("--solver", choices=("mpm", "lattice"), help="solver of elastic objects")
    how.add_argument("--cpu", action="store_true", help="measure CPU time of one thread")
    args = how.parse_args()
    if args.cpu:  # All clocks of forecasts and runs are this one.
        time.perf_counter = time.process_time
    kind = args.solver, 1 if args.cpu else None
    wp.config.log_level = wp.LOG_ERROR
    gaussians = pipeline.make_gaussians(DUCK).gaussians
    # The first run of a process compiles and loads kernels.
    for accuracy in ("draft", "fine"):
        measure(gaussians, "push_right", accuracy, *kind)
    if args.zoo:
        measure_zoo(args.zoo, args.objects, *kind)
        return
    rows = []
    for name in args.scenes or [n for n in preset_names() if n not in ALIKE]:
        for accuracy in PRESETS:
            rows.append(measure(gaussians, name, accuracy, *kind))
            print(json.dumps(rows[-1]), flush=True)
    print(count_within(rows, 0.1))
    if args.docs:
        table = markdown(list(rows[0]), [list(row.values()) for row in rows])
        renew(DOCS / "lab/forecasts.md", "forecast", f"{count_within(rows, 0.1)}\n\n{table}")


if __name__ == "__main__":
    main()
