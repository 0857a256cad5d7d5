"""What accuracy costs: predicted time and error bound of `draft`, `standard` and `fine`.

Install with `.venv/bin/pip install --editable '.[plots]'`.
"""

from pathlib import Path

from matplotlib import pyplot as plt

import phy124
from phy124.accuracy import Forecaster
from phy124.pipeline import make_gaussians

duck = make_gaussians("demo/examples/duck.png").gaussians
stops = Forecaster().stops(duck, phy124.Scene.named("press"))
for name, stop in stops.items():
    error = "unknown" if stop.error is None else f"{100 * stop.error:.1f} % of the size"
    print(f"{name}: {stop.seconds:.1f} s, error {error}")

known = {name: stop for name, stop in stops.items() if stop.error is not None}
figure, axes = plt.subplots(figsize=(5, 3.4), layout="constrained")
axes.plot([s.seconds for s in known.values()], [100 * s.error for s in known.values()], "o-")
for name, stop in known.items():
    axes.annotate(name, (stop.seconds, 100 * stop.error), (6, 6), textcoords="offset points")
axes.margins(0.15)
axes.set(xscale="log", xlabel="time [s]", ylabel="error [% of the size]", title="duck, press")
Path("out/cost").mkdir(parents=True, exist_ok=True)
figure.savefig("out/cost/cost.png", dpi=120)
