"""The job that Generate starts: cut-out -> Gaussians -> clip -> videos; skips finished stages.

An `Order` is the request for a run. If the order has grids, the job computes the error of the scene
instead: cut-out -> Gaussians -> error. A job that is requested to stop raises `Cancelled` within a
substep or a rendered frame. Orders and events can be pickled, because on ZeroGPU the job runs in a
forked process.
"""

from __future__ import annotations

import queue
import shutil
import threading
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from phy124.runtime.device import pick_device
from phy124.runtime.memory import trim
from phy124.runtime.stopwatch import Stopwatch

from ..progress import Done, Event, Measured, Reused
from ..visitor import STAGES
from .films import film
from .limits import BEAT, DEVICE, Limits, hold_device
from .motion import gaussians_of, simulate
from .order import (
    Order,
    bytes_to_write,
    folders,
    made_by,
    made_gaussians,
    stages_done,
    study_file,
    trial_key,
)
from .study import measure

__all__ = [
    "BEAT",
    "DEVICE",
    "Done",
    "Order",
    "bytes_to_write",
    "gaussians_of",
    "made_by",
    "made_gaussians",
    "stages_done",
    "steps",
    "study_file",
    "trial_key",
]


def steps(order: Order) -> Iterator[Event | None]:
    """Execute an order (the request for a run), and yield the events of its progress.

    None is yielded if `BEAT` seconds pass without an event.

    Raises:
        Cancelled: The stop file exists.
        InputError: An input is invalid, or the time limit is exceeded.
    """
    events: queue.SimpleQueue[Event | BaseException] = queue.SimpleQueue()
    thread = threading.Thread(target=_run, args=(order, events), name="work", daemon=True)
    thread.start()
    try:
        while True:
            try:
                event = events.get(timeout=BEAT)
            except queue.Empty:
                yield None
                continue
            if isinstance(event, BaseException):
                raise event
            yield event
            if isinstance(event, Done | Measured):
                return
    except GeneratorExit:
        order.stop.touch()
        raise


def _run(order: Order, events: queue.SimpleQueue[Any]) -> None:
    try:
        order = replace(order, device=pick_device(order.device))
        with hold_device(order):
            produce = measure if order.levels else _produce
            last = produce(order, Limits(order, events.put))
    except BaseException as error:
        last = error
    order.stop.unlink(missing_ok=True)
    if not (order.folder / STAGES[0]).exists():
        # The visitor's folder has been removed in the meantime.
        shutil.rmtree(order.folder, ignore_errors=True)
    trim()
    events.put(last)


def _produce(order: Order, limits: Limits) -> Done:
    tell = limits.tell
    source = made_gaussians(order)
    clips, films = folders(order)
    if (clips / "report.json").exists():
        tell(Reused("generate"))
        tell(Reused("simulate"))
    else:
        watch = Stopwatch()
        with watch.stage("generate"):
            gaussians = gaussians_of(order, source, tell)
        simulate(gaussians, order, clips, limits, watch)
    if (films / "report.json").exists():
        tell(Reused("render"))
    else:
        film(order, clips, films, limits)
    clips.touch()
    films.touch()
    return Done(clips, films, study_file(order))
