"""Makes clips for many pictures, generators and values of a scene, with parallel workers.

`run(Plan(Sweep.from_toml("sweep.toml")), "out/sweep")` makes the clips. `Dataset("out/sweep")` then
yields each clip together with its row of the manifest.
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
