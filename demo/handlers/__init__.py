"""The event handlers of the page, which connect Gradio's events to the jobs (demo.jobs)."""

from .event import Handler
from .fit import on_fit_begin, on_fit_end, on_fit_stop, on_result_shown
from .picture import (
    on_choose,
    on_choose_object,
    on_choose_view,
    on_correct,
    on_cut_end,
    on_view_cut,
)
from .results import on_job_end, on_load, on_prepare
from .run import (
    on_cancel,
    on_finer,
    on_generate,
    on_measure,
    on_refine,
    on_save,
    on_scene_changed,
    on_touch,
)

__all__ = [
    "Handler",
    "on_cancel",
    "on_choose",
    "on_choose_object",
    "on_choose_view",
    "on_correct",
    "on_cut_end",
    "on_finer",
    "on_fit_begin",
    "on_fit_end",
    "on_fit_stop",
    "on_generate",
    "on_job_end",
    "on_load",
    "on_measure",
    "on_prepare",
    "on_refine",
    "on_result_shown",
    "on_save",
    "on_scene_changed",
    "on_touch",
    "on_view_cut",
]
