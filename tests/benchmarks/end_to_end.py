"""Measures each stage from picture to MP4s, for the example pictures and presets; a JSON line each.

The first run loads the kernels and is not printed.
"""

import json
import sys
import tempfile
from pathlib import Path

import warp as wp

from phy124 import pipeline

sys.path.insert(0, str(Path(__file__).parent))
from presets import beginning

wp.config.log_level = wp.LOG_WARNING
EXAMPLES = Path(__file__).parents[2] / "demo/examples"
RUNS = [("duck", "press"), ("sunflower", "push_right"), ("teddy", "drop"), ("potted_plant", "sway")]


def run(picture: str, scene: str, accuracy: str) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        chosen = beginning(scene).replaced({"accuracy": accuracy})
        report = pipeline.generate(EXAMPLES / f"{picture}.png", chosen, folder).report
    row = {"picture": picture, "scene": scene, "accuracy": accuracy}
    row |= {key: report[key] for key in ("gaussians", "particles", "substeps", "frames", "device")}
    row["threads"] = report["threads"]
    row["seconds"] = {s["name"]: round(s["seconds"], 2) for s in report["stages"]}
    return row | {"total": round(report["seconds"], 2)}


if __name__ == "__main__":
    run("duck", "press", "draft")
    for accuracy in sys.argv[1:] or ("draft", "standard"):
        for picture, scene in RUNS:
            print(json.dumps(run(picture, scene, accuracy)), flush=True)
