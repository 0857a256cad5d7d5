"""Makes clips for many pictures, generators and values of a scene, with parallel workers.

plan = Plan(Sweep.from_toml("sweep.toml"))
run(plan, "out/sweep")
for row, clip in Dataset("out/sweep"): ...
"""

from phy124.studies.sweep.cost import Expected, forecast_sweep, list_refused
from phy124.studies.sweep.dataset import Dataset, Sample
from phy124.studies.sweep.declaration import Sweep
from phy124.studies.sweep.plan import Item, Plan
from phy124.studies.sweep.running import Counts, run

__all__ = [
    "Counts",
    "Dataset",
    "Expected",
    "Item",
    "Plan",
    "Sample",
    "Sweep",
    "forecast_sweep",
    "list_refused",
    "run",
]
