"""The event handlers of the page, between Gradio and the jobs.

Handlers know the session and Gradio's types; the work itself is in demo.jobs.
"""

from .event import Handler
from .fit import fit_offerer, fit_shower, fit_starter, fit_stopper
from .known import object_chooser, view_chooser, view_shower
from .picture import chooser, corrector, cut_shower
from .results import finisher, greeter, preparer
from .run import forecaster, measurer, refiner, starter, stopper
from .touch import saver, toucher

__all__ = [
    "Handler",
    "chooser",
    "corrector",
    "cut_shower",
    "finisher",
    "fit_offerer",
    "fit_shower",
    "fit_starter",
    "fit_stopper",
    "forecaster",
    "greeter",
    "measurer",
    "object_chooser",
    "preparer",
    "refiner",
    "saver",
    "starter",
    "stopper",
    "toucher",
    "view_chooser",
    "view_shower",
]
