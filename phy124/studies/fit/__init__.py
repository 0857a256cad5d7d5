"""Fits an object's material and initial motion to an observed motion.

`fit(Fit.from_data(Fit.from_toml("fit.toml")), Path("out/fit"))` returns the fitted scene and the
report of the fit.
"""

from phy124.studies.fit.budget import Outlook
from phy124.studies.fit.declaration import Fit
from phy124.studies.fit.running import Fitted, fit, forecast

__all__ = ["Fit", "Fitted", "Outlook", "fit", "forecast"]
