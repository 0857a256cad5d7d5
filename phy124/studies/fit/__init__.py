"""Fits an object's material and initial motion to observations of its motion.

fitted = fit(Fit.from_data(Fit.from_toml("fit.toml")), Path("out/fit"))
fitted.scene, fitted.report
"""

from phy124.studies.fit.budget import Outlook
from phy124.studies.fit.declaration import Fit
from phy124.studies.fit.running import Fitted, fit, forecast

__all__ = ["Fit", "Fitted", "Outlook", "fit", "forecast"]
