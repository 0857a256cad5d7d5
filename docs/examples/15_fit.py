"""Fit: estimate the stiffness of an object from its motion.

Install with `.venv/bin/pip install --editable '.[fit]'`.
"""

from pathlib import Path

import phy124
from phy124.studies.fit import Fit, fit

scene = phy124.Scene.named("press").replaced(
    {"accuracy": "draft", "material.E": 6e4, "time.frames": 10, "view.views": ["front"]}
)
phy124.generate("demo/examples/duck.png", scene, "out/fit/target", count=2000)

declared = Fit.from_data(
    {
        "target": "out/fit/target",  # a clip; a video or a table of tracked points is also possible
        "find": {"material.E": "1e4..2e5"},
        "gaussians": 500,
        "grids": [8, 12],
    }
)
fitted = fit(declared, Path("out/fit/found"))
print(fitted.report["found"])
