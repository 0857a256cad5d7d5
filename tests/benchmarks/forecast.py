"""Forecast against measured seconds: the preset scenes at every named accuracy, a line each.

With `--docs` the table of docs/lab/forecasts.md is renewed. Run it when nothing else runs: a
forecast cannot know what others will do. About four minutes; names of scenes do only these.
"""

import json
import sys
import tempfile
from pathlib import Path

import warp as wp

from phy124 import pipeline
from phy124.accuracy import Forecaster
from phy124.scene import PRESETS, preset_names

sys.path.insert(0, str(Path(__file__).parent))
from presets import beginning
from tables import DOCS, markdown, renew

ALIKE = ("push_away", "push_right_harder")
"""Scenes that are left out unless named: they differ from push_right by the push alone."""
DUCK = Path(__file__).parents[2] / "demo/examples/duck.png"


def measure(gaussians, name: str, accuracy: str) -> dict:
    """One whole run with its forecast."""
    scene = beginning(name).replaced({"accuracy": accuracy})
    with tempfile.TemporaryDirectory() as folder:
        result = pipeline.simulate(gaussians, scene, folder, forecaster=Forecaster())
    told, report = result.report["forecast"], result.report
    simulate = told["stages"]["simulate"]
    return {
        "scene": name,
        "accuracy": accuracy,
        "particles": report["particles"],
        "substeps predicted": told["substeps"],
        "substeps": report["substeps"],
        "simulation predicted s": round(simulate["predicted"], 2),
        "simulation s": round(simulate["spent"], 2),
        "predicted s": round(told["predicted"], 2),
        "spent s": round(told["spent"], 2),
        "ratio": round(told["ratio"], 3),
        "promised": told["caveat"] is None,
    }


def main(scenes: list[str], *, docs: bool) -> None:
    """Print a line per run and how many ratios are between 0.9 and 1.1."""
    wp.config.log_level = wp.LOG_ERROR
    gaussians = pipeline.make_gaussians(DUCK).gaussians
    # The first run of a process compiles and loads kernels.
    for accuracy in ("draft", "fine"):
        measure(gaussians, "push_right", accuracy)
    rows = []
    for name in scenes or [n for n in preset_names() if n not in ALIKE]:
        for accuracy in PRESETS:
            rows.append(measure(gaussians, name, accuracy))
            print(json.dumps(rows[-1]), flush=True)
    promised = [row for row in rows if row["promised"]]
    within = sum(0.9 <= row["ratio"] <= 1.1 for row in promised)
    said = f"{within} of {len(promised)} ratios of spent to predicted are between 0.9 and 1.1."
    print(said)
    if docs:
        table = markdown(list(rows[0]), [list(row.values()) for row in rows])
        renew(DOCS / "lab/forecasts.md", "forecast", f"{said}\n\n{table}")


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--docs"]
    main(words, docs="--docs" in sys.argv)
