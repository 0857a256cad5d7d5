"""Fitting: from what was seen of an object back to its material and its start.

found = fit(Fit.from_data(Fit.from_toml("fit.toml")), Path("out/fit"))
found.scene, found.report
"""

from phy124.studies.fit.budget import Outlook
from phy124.studies.fit.declaration import Fit
from phy124.studies.fit.running import Fitted, fit, forecast

__all__ = ["Fit", "Fitted", "Outlook", "fit", "forecast"]
