"""Effects left out: mechanisms that a scene does not need take no time.

Install with `.venv/bin/pip install --editable '.[plots]'`.
"""

from pathlib import Path

from matplotlib import pyplot as plt

import phy124
from phy124.pipeline import make_gaussians

scene = phy124.Scene.named("drop").replaced({"accuracy": "draft", "time.frames": 12})
duck = make_gaussians("demo/examples/duck.png").gaussians
effects = phy124.Simulation(phy124.prepare(duck, scene)).run().report["effects"]
print("computed:", *effects["ran"], sep="\n  ")
print("left out:", *(row["effect"] for row in effects["left_out"]), sep="\n  ")

saved = {row["effect"]: row.get("saved_seconds", 0.0) for row in effects["left_out"]}
saved = dict(sorted(saved.items(), key=lambda item: item[1])[-8:])
figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
axes.barh(list(saved), list(saved.values()))
axes.set(xlabel="time saved [s]", title="duck, drop: effects left out")
Path("out/effects").mkdir(parents=True, exist_ok=True)
figure.savefig("out/effects/effects.png", dpi=120)
