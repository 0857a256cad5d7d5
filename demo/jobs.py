"""What happens behind the page's buttons: generators that can be cancelled, and their limits.

Nothing here knows the layout. Functions that take long are generators: Gradio stops a generator
at its next yield, and one that is closed asks its work to stop.
"""

from __future__ import annotations

import base64
import json
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from demo.catalogue import check_time, scene_of
from demo.forecast import Forecaster, measured
from demo.pictures import check_picture, cut_out
from demo.settings import Settings
from demo.visitors import Visitor, Visitors, key
from demo.work import (
    BEAT,
    DEVICE,
    Done,
    Glimpse,
    Order,
    Reused,
    Step,
    device_named,
    made_already,
    made_gaussians,
    steps,
)
from phy124.clip import Clip
from phy124.errors import Cancelled, InputError
from phy124.isolated import Deadline
from phy124.scene import Scene

STAGES = {"generate": "Picture to 3D", "simulate": "Physics", "render": "Videos", "save": "Files"}
FAILED = "Something went wrong here, not with you; it is in the log. Try again or change the scene."
LOG = logging.getLogger("phy124.web")
CUTTERS = 2
"""Pictures cut out at once."""


def sentence(error: InputError) -> str:
    """An error for the visitor: no server paths in it."""
    text = f"{error.limit} {error.remedy}"
    return text[:1].upper() + text[1:]


class Cutting:
    """Turns at cutting out: a few pictures at once."""

    def __init__(self) -> None:
        self.at_work = 0
        self._slots = threading.BoundedSemaphore(CUTTERS)
        self._lock = threading.Lock()

    @contextmanager
    def turn(self, check: Callable[[], None]) -> Iterator[None]:
        """Wait for a turn, then hold it; what `check` raises ends the wait."""
        while not self._slots.acquire(timeout=BEAT):
            check()
        self._count(1)
        try:
            yield
        finally:
            self._count(-1)
            self._slots.release()

    def _count(self, more: int) -> None:
        with self._lock:
            self.at_work += more


@dataclass
class Studio:
    """Everything visitors share: limits, folders, forecasts."""

    settings: Settings
    visitors: Visitors
    forecaster: Forecaster = field(default_factory=Forecaster)
    work: Callable[[Order], Iterator[Any]] = steps
    """What runs an order; on ZeroGPU it is wrapped by `spaces.GPU`."""
    warm: threading.Event = field(default_factory=threading.Event)
    """Set once all kernels are loaded."""

    cutting: Cutting = field(default_factory=Cutting)

    @property
    def busy(self) -> bool:
        """Whether anybody's work is in hand."""
        return DEVICE.locked() or self.cutting.at_work > 0

    @property
    def forks(self) -> bool:
        """Whether the work runs in a forked process: Warp must not be started in this one."""
        return self.work is not steps

    def cut(self, session: str, picture: str | None, strokes: Image.Image | None = None) -> Cutout:
        """Cut the object out of an uploaded picture; raises InputError, Cancelled."""
        if picture is None:
            raise InputError("picture", "none", "There is no picture yet.", "Choose one first.")
        check_picture(Path(picture), self.settings)
        visitor = self.visitors.get(session)
        marks = b"" if strokes is None else np.asarray(strokes).tobytes()
        path = visitor.folder / "cutouts" / f"{key(Path(picture).read_bytes(), marks)}.png"
        doubts: tuple[str, ...] = ()
        if not path.exists():
            with visitor.cutting() as check, self.cutting.turn(check):
                deadline = Deadline(self.settings.max_cut_seconds, check)
                doubts = cut_out(picture, strokes, path, deadline)
        return Cutout(str(path), picture, doubts)

    def forecast(self, session: str, cutout: str | None, data: Any) -> str:
        """What a run would take; a complaint if it is not allowed."""
        try:
            scene = scene_of(data, self.settings)
            ready = self._ready(session, cutout, scene)
            forecast = self.forecaster(scene, gaussians=self.settings.gaussians, **ready)
            self._check_time(scene)
        except InputError as error:
            return f"{error.field}: {sentence(error)}"
        return forecast.sentence

    def refine(self, session: str, cutout: str | None, data: Any) -> str | None:
        """The same from a probe, if the Gaussians are there and the device is free, else None."""
        if self.forks or not cutout or not Path(cutout).exists():
            return None
        if not DEVICE.acquire(blocking=False):
            return None
        try:
            scene = scene_of(data, self.settings)
            visitor = self.visitors.get(session)
            order = self._order(visitor, Path(cutout), scene, visitor.folder / "never")
            ready = made_already(order)
            if not ready["generated"] or ready["simulated"]:
                return None
            gaussians = Clip.load(made_gaussians(order)).frame(0).gaussians
            device = device_named(self.settings.device)
            forecast = measured(gaussians, scene, device, self.forecaster.rates.rest)
            visitor.forecasts[key(scene.data())] = forecast.seconds
        except InputError as error:
            return f"{error.field}: {sentence(error)}"
        finally:
            DEVICE.release()
        return forecast.sentence

    def announce(self, session: str) -> str | None:
        """A ticket for a run that is about to be queued, so that it can be called off there."""
        try:
            return self.visitors.get(session).begin().name
        except InputError:
            return None

    def run(
        self, session: str, cutout: str | None, data: Any, ticket: str | None = None
    ) -> Iterator[Progress]:
        """Do the whole chain; yields often, the last one carries the result or what is wrong.

        Yields nothing for a ticket that was called off while it waited in the queue.
        """
        try:
            if not cutout or not Path(cutout).exists():
                raise InputError("picture", "none", "There is no picture yet.", "Choose one first.")
            scene = scene_of(data, self.settings)
            forecast = self.forecaster(scene, gaussians=self.settings.gaussians)
            self._check_time(scene)
            visitor = self.visitors.get(session)
        except InputError as error:
            yield Progress(message=sentence(error), state="refused")
            return
        flag = visitor.folder / ticket if ticket else visitor.begin()
        if not visitor.start(flag):
            return
        self.visitors.sweep(self.settings.keep_hours * 3600, self.settings.max_visitors)
        expected = visitor.forecasts.get(key(scene.data()), forecast.seconds)
        yield from self._work(visitor, self._order(visitor, Path(cutout), scene, flag), expected)

    def _ready(self, session: str, cutout: str | None, scene: Scene) -> dict[str, bool]:
        """Which stages need not be run again for this visitor."""
        if not cutout or not Path(cutout).exists():
            return {}
        visitor = self.visitors.get(session)
        return made_already(self._order(visitor, Path(cutout), scene, visitor.folder / "never"))

    def _check_time(self, scene: Scene) -> None:
        count = self.settings.gaussians
        check_time(self.forecaster.least(scene, gaussians=count), self.settings)

    def _order(self, visitor: Visitor, cutout: Path, scene: Scene, stop: Path) -> Order:
        limits = self.settings
        return Order(
            visitor.folder, cutout, scene, stop, limits.max_seconds, limits.max_particles,
            device=limits.device, gaussians=limits.gaussians, about=(("generator", "relief"),),
        )  # fmt: skip

    def _work(self, visitor: Visitor, order: Order, expected: float) -> Iterator[Progress]:
        progress, events = Progress(expected=expected), self.work(order)
        try:
            for event in events:
                progress.take(event)
                if progress.due():
                    yield progress
        except Cancelled:
            progress.message, progress.state = "Stopped. Nothing was changed.", "stopped"
            yield progress
        except InputError as error:
            progress.message, progress.state = sentence(error), "refused"
            yield progress
        except GeneratorExit:
            order.stop.touch()
            raise
        except Exception:
            LOG.exception("the work failed")
            progress.message, progress.state = FAILED, "failed"
            yield progress
        finally:
            stop_at_close(events)
            visitor.end(order.stop)
        if progress.done is not None:
            if "simulate" not in progress.reused:
                self.forecaster.learn(read_report(progress.done), order.scene)
            visitor.trim(self.settings.max_clips)

    def warm_up(self) -> None:
        """Load all kernels and measure this machine with a small run; at the start, in a thread."""
        from demo.warm import example_run, tiny_run, warm_up

        if not self.forks:
            with DEVICE:
                warm_up(self.settings.device)
                device = self.settings.device
                self.forecaster.learned.calibrate(tiny_run(device), example_run(device))
        self.warm.set()


@dataclass
class Cutout:
    """A picture with its object cut out."""

    path: str
    picture: str
    """What was uploaded."""
    doubts: tuple[str, ...] = ()
    """What makes it likely that another object was meant; told once."""


@dataclass
class Progress:
    """What the progress panel shows."""

    state: str = "running"
    message: str = ""
    expected: float = 0.0
    start: float = field(default_factory=time.monotonic)
    stages: dict[str, Step] = field(default_factory=dict)
    reused: list[str] = field(default_factory=list)
    glimpses: list[bytes] = field(default_factory=list)
    """Pictures since the page was last told."""
    done: Done | None = None
    told: float = 0.0

    def take(self, event: Any) -> None:
        """Take an event of the work into account; None only lets time pass."""
        if isinstance(event, Step):
            self.stages[event.stage] = event
        elif isinstance(event, Reused):
            self.reused.append(event.stage)
        elif isinstance(event, Glimpse):
            self.glimpses.append(event.picture)
        elif isinstance(event, Done):
            self.done, self.state = event, "done"

    def due(self) -> bool:
        """Whether the page should be told now: not for every substep, a browser cannot follow."""
        now = time.monotonic()
        if self.done is None and now - self.told < BEAT:
            return False
        self.told = now
        return True

    def data(self) -> dict[str, Any]:
        """Plain data for the page, the new pictures handed over once."""
        rows = []
        for name, label in STAGES.items():
            step = self.stages.get(name)
            rows.append(
                {
                    "name": label,
                    "done": step.done if step else 0,
                    "total": step.total if step else 0,
                    "note": "as before" if name in self.reused else step.note if step else "",
                    "reused": name in self.reused,
                }
            )
        pictures = [base64.b64encode(picture).decode() for picture in self.glimpses]
        self.glimpses.clear()
        return {
            "state": self.state,
            "message": self.message,
            "elapsed": time.monotonic() - self.start,
            "expected": self.expected,
            "stages": rows,
            "glimpses": pictures,
        }


def stop_at_close(events: Iterator[Any]) -> None:
    """Close the work's generator now, not when it is collected."""
    close = getattr(events, "close", None)
    if close is not None:
        close()


def read_report(done: Done) -> dict[str, Any]:
    """The report of a finished run."""
    return json.loads((done.films / "report.json").read_text("utf-8"))
