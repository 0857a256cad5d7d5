"""Fits: a visitor's video goes back to the softness of a finished result.

    upload -> video.py (decoded in a process)
           -> search.py (`phy124.studies.fit`, in a process) -> shown.py

`jobs.py` is who may: one fit of each visitor, and a total for the server.
"""

from .asked import Asked, asked_of
from .jobs import Fits
from .search import Found, newest

__all__ = ["Asked", "Fits", "Found", "asked_of", "newest"]
