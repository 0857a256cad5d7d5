"""Estimate the stiffness of the material in a finished result from a visitor's video.

    upload -> video.py (decodes the video in a separate process) -> search.py (runs
    `phy124.studies.fit` in another process)

`jobs.py` allows one fit per visitor at a time, and limits the number of fits on the server.
"""

from .jobs import Fits
from .search import FitResult, newest
from .video import FitOptions, fit_options_of

__all__ = ["FitOptions", "FitResult", "Fits", "fit_options_of", "newest"]
