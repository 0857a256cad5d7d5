"""The error of a run: a ball is pressed on three grids, and the results are extrapolated.

Install with `.venv/bin/pip install --editable '.[plots]'`.
"""

from pathlib import Path

import phy124
from phy124.generators.shapes import ball
from phy124.studies.validation.accuracy.plots import save_picture
from phy124.studies.validation.accuracy.study import Study

scene = phy124.Scene.named("press").replaced({"time.frames": 8})
report = Study(ball(), scene, levels=(12, 16, 24)).run()
for row in report.rows:
    error = "unknown" if row.error is None else f"{100 * row.error:.2f} % of the size"
    print(f"{row.name}: {row.particles} particles, {row.seconds:.1f} s, error {error}")
print(*report.sentences, sep="\n")
Path("out/error").mkdir(parents=True, exist_ok=True)
save_picture(report, "out/error/error.png", title="a ball under a plate")
