"""The jobs that the page's buttons start, and their limits. A job outlives its connection.

All slow work is done by jobs in two queues (demo.line): one for the device, and one for cutting out
pictures.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any

from phy124.accuracy.probe import seconds_to_compile
from phy124.budget.cost import GAUSSIANS, USUAL, Work
from phy124.errors import InputError
from phy124.imaging.objects import Point
from phy124.io.formats import is_file_of_gaussians
from phy124.particles.thickness import Proportions
from phy124.runtime.context import RunContext
from phy124.runtime.device import pick_device
from phy124.runtime.isolated import Deadline
from phy124.scene import Scene
from phy124.scene.files import files_named

from .catalogue import check_limits, check_time, scene_of
from .course import Course
from .extras import ExtraInputs, extras_of
from .fits import Fits
from .forecast import Estimate, Estimator, probe_estimate, promise_of
from .line import Job, Line, run_guarded
from .pictures import Stroke, bytes_of_cutout, check_picture, cut_by, cut_once, viewable
from .progress import MEASURING, READING, STAGES, close_now
from .room import renew
from .settings import Settings
from .source import EACH, Choice, Cutout, Source, check_file, is_there, missing, open_gaussians
from .studies import grids, on_grid, read_study
from .touch import Table
from .visitors import Visitor, Visitors
from .work import (
    DEVICE,
    Done,
    Order,
    bytes_to_write,
    gaussians_of,
    made_by,
    made_gaussians,
    stages_done,
    steps,
    study_file,
    trial_key,
)
from .work.order import count_of, order_of
from .work.others import with_crops

CUTTERS = 2
"""Number of pictures that are cut out in parallel."""


@dataclass
class Studio:
    """The state shared by all visitors: limits, folders, forecasts and queues."""

    settings: Settings
    visitors: Visitors
    forecaster: Estimator = field(default_factory=lambda: Estimator(DEVICE.locked))
    work: Callable[[Order], Iterator[Any]] = steps
    """Function that executes an `Order` (the request for a run); demo.zerogpu has another one."""
    searches: deque[float] = field(default_factory=lambda: deque(maxlen=5))
    """Durations of the latest segmentations [s]."""
    warm: threading.Event = field(default_factory=threading.Event)
    """Event that is set once all kernels are loaded."""

    def __post_init__(self) -> None:
        most = self.settings.max_queue
        if self.forks:
            self.forecaster.learned.assume(USUAL["cuda"], Work.of(Scene.named("press"), GAUSSIANS))
        self.runs = Line("device", workers=1, most=most)
        self.cuts = Line("cut-out", workers=CUTTERS, most=4 * most)
        self.touches = Table(self.settings.max_touch)
        self.fits = Fits(self.visitors, self.settings, self.forecaster, self._submit)

    @property
    def busy(self) -> bool:
        """Whether a job is running."""
        lines = (self.runs, self.cuts, self.fits.line)
        return DEVICE.locked() or any(line.running for line in lines)

    @property
    def forks(self) -> bool:
        """Whether jobs run in a forked process. If so, Warp must not start in this process."""
        return self.work is not steps

    @property
    def search_seconds(self) -> float | None:
        """Median duration of a segmentation [s]; None before the first segmentation."""
        return median(self.searches) if self.searches else None

    def take(self, name: str, sent: Any, pick: Point | None = None) -> Job:
        """Start a job that cuts the object out of an uploaded picture or reads a file of Gaussians.

        Args:
            name: The visitor's name.
            sent: The path of the uploaded file, as the request states it.
            pick: A point on the object, if the picture shows several objects.

        Raises:
            InputError: The path is not an upload of this visitor, or the queue is full.
        """
        upload = self._upload(name, sent)
        if not is_file_of_gaussians(upload):
            return self.cut_out(name, sent, pick=pick)
        if pick is not None:
            limit = "A file of Gaussians contains only one object."
            raise InputError("pick", pick, limit, "Remove the point.")
        check_file(upload, self.settings)
        visitor = self.visitors.expect(name)

        def work(job: Job) -> None:
            deadline = Deadline(self.settings.max_cut_seconds, job.check)
            out, most = visitor.folder / "objects" / upload.stem, self.settings.gaussians
            with self.visitors.writing(visitor, EACH * most, (upload,), self.visitors.room.all):
                result = open_gaussians(upload, out, most, deadline)
            visitor.trim(self.visitors.room)
            job.end("done", result=result)

        job = Job("read", visitor.new_stop_file(), subject=str(upload))
        return self._submit(visitor, job, self.cuts, work)

    def _upload(self, name: str, sent: Any) -> Path:
        if not sent:
            raise missing(None)
        return self.visitors.find_upload(name, sent)

    def cut_out(
        self,
        name: str,
        picture: Any,
        strokes: Sequence[Stroke] = (),
        pick: Point | None = None,
        kind: str = "cut",
    ) -> Job:
        """Start a job that cuts the object out of an uploaded picture.

        Args:
            name: The visitor's name.
            picture: The path of the uploaded picture, as the request states it.
            strokes: Brush strokes that correct the cut-out.
            pick: A point on the object, if the picture shows several objects.
            kind: "cut" for the front picture, "view" for other pictures.

        Raises:
            InputError: The path is not an upload of this visitor, or the queue is full.
        """
        upload = self._upload(name, picture)
        check_picture(upload, self.settings)
        visitor = self.visitors.expect(name)

        def work(job: Job) -> None:
            deadline = Deadline(self.settings.max_cut_seconds, job.check)
            shown = viewable(upload, deadline)
            job.subject = str(shown)
            start = time.monotonic()
            try:
                size, most = bytes_of_cutout(shown), self.visitors.room.all
                with self.visitors.writing(visitor, size, (upload, shown), most):
                    path, doubts, searched = cut_once(visitor, shown, strokes, pick, deadline)
                visitor.trim(self.visitors.room)
            except InputError as error:
                if error.field == "image":
                    job.subject = ""  # a picture that cannot be opened cannot be shown
                raise
            if searched:
                self.searches.append(time.monotonic() - start)
            job.end("done", result=Cutout(str(path), str(shown), doubts, cut_by(path), pick))

        job = Job(kind, visitor.new_stop_file(), subject=str(upload))
        return self._submit(visitor, job, self.cuts, work)

    def forecast(self, choice: Choice) -> Estimate:
        """Return the predicted time and error of a run.

        Raises:
            InputError: The run would be refused.
        """
        scene = self._scene(self.visitors.find(choice.name), choice)
        self._check_time(choice.source, scene)
        order = self._order(choice, scene)
        return self._complete(self._predict(choice.source, scene, order), choice, scene, order)

    def refine(self, choice: Choice) -> Estimate | None:
        """Return a forecast from a trial run; None if the device is busy or Gaussians are missing.

        Raises:
            InputError: The run would be refused.
        """
        visitor = self.visitors.find(choice.name)
        if self.forks or visitor is None or not is_there(choice.source):
            return None
        scene = self._scene(visitor, choice)
        self._check_time(choice.source, scene)
        if not DEVICE.acquire(blocking=False):
            return None
        try:
            order = self._order(choice, scene)
            if order is None:
                return None
            ready = stages_done(order)
            device = pick_device(self.settings.device)
            if not ready["generated"] or ready["simulated"] or seconds_to_compile(scene, device):
                return None
            if not all(other.cutout.exists() for other in order.others):
                return None
            gaussians = gaussians_of(order, made_gaussians(order))
            rates = self.forecaster.rates
            rest = rates.rest + rates.pixel * ready["composed"]
            context = RunContext(device=device, threads=order.threads)
            placed = with_crops(order.scene, order.others)
            estimate = probe_estimate(gaussians, placed, context, rest, order.crop)
            visitor.forecasts[trial_key(order)] = estimate.seconds
            visitor.proportions[str(made_gaussians(order))] = estimate.proportions
        finally:
            DEVICE.release()
        return self._complete(estimate, choice, scene, order)

    def _predict(self, source: Source | None, scene: Scene, order: Order | None) -> Estimate:
        ready = stages_done(order) if order else {}
        count, compiling = self.count(source), self._compiling(scene)
        return self.forecaster(scene, gaussians=count, compiling=compiling, **ready)

    def _complete(
        self, estimate: Estimate, choice: Choice, scene: Scene, order: Order | None
    ) -> Estimate:
        """Add the error, measured on this object or else on similar objects, to the estimate."""
        visitor, study, proportions, seconds = self.visitors.find(choice.name), None, None, None
        if order is not None and visitor is not None:
            study = read_study(study_file(order))
            proportions = visitor.proportions.get(str(made_gaussians(order)))
            seconds = visitor.forecasts.get(trial_key(order))
        stops = self.forecaster.stops(
            scene,
            gaussians=self.count(choice.source),
            proportions=proportions,
            seconds=seconds,
            study=study,
        )
        promise = promise_of(scene, proportions, study)
        course = Course.of(scene, estimate.seconds, estimate.after, self.settings.max_seconds)
        estimate = replace(estimate, promise=promise, accuracy=scene.accuracy, stops=stops)
        estimate = replace(estimate, course=course)
        if promise.missing and not promise.of_scene:
            with suppress(InputError):  # if the study would be refused, it is not offered
                self._check_study(choice.source, scene)
                seconds = self._study_seconds(choice.source, scene, order)
                estimate = replace(estimate, study_seconds=seconds)
        return replace(estimate, study=study)

    def check_extras(self, name: str, extras: Any) -> ExtraInputs:
        """Validate a visitor's optional inputs; raise InputError if one is invalid."""
        return extras_of(self.visitors, self.settings, name, extras)

    def run(self, choice: Choice) -> Job:
        """Start a run, which generates the Gaussians, simulates their motion and renders videos.

        Raises:
            InputError: The source, the scene or an input is invalid.
        """
        visitor, source, scene = self.resolve(choice)
        self._check_time(source, scene)
        order = self.order((visitor, source, scene), self.check_extras(choice.name, choice.extras))
        usual = self._predict(source, scene, order)
        trial = None if stages_done(order)["simulated"] else visitor.forecasts.get(trial_key(order))
        expected = usual.seconds if trial is None else trial
        stages = STAGES if isinstance(source, Cutout) else STAGES | READING
        job = Job("run", visitor.new_stop_file(), expected, stages=stages)
        job.progress.unloaded = usual.unloaded
        if usual.seconds > usual.after:
            limit = self.settings.max_seconds
            job.progress.course = Course.of(scene, expected, usual.after, limit)
        order = replace(order, stop=job.stop, expected=expected)
        job.choice = choice
        return self._submit(visitor, job, self.runs, lambda job: self._run(visitor, order, job))

    def measure(self, choice: Choice) -> Job:
        """Start to measure the error of a scene.

        Raises:
            InputError: The source, the scene or an input is invalid.
        """
        visitor, source, scene = self.resolve(choice)
        self._check_study(source, scene)
        order = self.order((visitor, source, scene), self.check_extras(choice.name, choice.extras))
        expected = self._study_seconds(source, scene, order)
        stages = MEASURING if isinstance(source, Cutout) else MEASURING | READING
        job = Job("measure", visitor.new_stop_file(), expected, stages=stages)
        order = replace(order, stop=job.stop, expected=expected, levels=grids(scene))
        return self._submit(visitor, job, self.runs, lambda job: self._run(visitor, order, job))

    def _check_study(self, source: Source | None, scene: Scene) -> None:
        levels, count = grids(scene), self.count(source)
        for cells in levels:
            check_limits(on_grid(scene, cells), self.settings)
        check_time(self.forecaster.min_study(scene, levels, gaussians=count), self.settings)

    def _study_seconds(self, source: Source | None, scene: Scene, order: Order | None) -> float:
        return self.forecaster.study(
            scene,
            grids(scene),
            gaussians=self.count(source),
            generated=order is not None and stages_done(order)["generated"],
            compiling=self._compiling(on_grid(scene, grids(scene)[0])),
        )

    def resolve(self, choice: Choice) -> tuple[Visitor, Source, Scene]:
        """Return the visitor, the object's source and the scene that the visitor has chosen.

        Raises:
            InputError: The source no longer exists, or the scene is invalid.
        """
        visitor, source = self.visitors.find(choice.name), choice.source
        if visitor is None or source is None or not is_there(source):
            raise missing(source)
        return visitor, source, self._scene(visitor, choice)

    def _scene(self, visitor: Visitor | None, choice: Choice) -> Scene:
        """Validate a scene, which may name the visitor's uploads but no other files."""
        uploads = visitor and visitor.folder / "uploads"
        scene = scene_of(choice.data, choice.limits or self.settings, uploads)
        for _, path in files_named(scene):
            renew(path)
        return scene

    def _order(self, choice: Choice, scene: Scene) -> Order | None:
        visitor, source = self.visitors.find(choice.name), choice.source
        if visitor is None or source is None or not is_there(source):
            return None
        return self.order((visitor, source, scene), self.check_extras(choice.name, choice.extras))

    def _compiling(self, scene: Scene) -> float:
        """Predict the time to compile the kernels [s]; 0 if a running job may be compiling them."""
        if self.forks or not DEVICE.acquire(blocking=False):
            return 0.0
        try:
            return seconds_to_compile(scene, pick_device(self.settings.device))
        finally:
            DEVICE.release()

    def count(self, source: Source | None) -> int:
        """Return the number of Gaussians of an object."""
        return count_of(source, self.settings)

    def _check_time(self, source: Source | None, scene: Scene) -> None:
        count = self.count(source)
        check_time(self.forecaster.minimum(scene, gaussians=count), self.settings)

    def order(self, asked: tuple[Visitor, Source, Scene], extras: ExtraInputs) -> Order:
        """Create the `Order` of a run; raise InputError for unsuitable inputs."""
        order = order_of(*asked, extras, self.settings)
        cutouts = (*order.extras.views.pictures.values(), *(other.cutout for other in order.others))
        for path in (*asked[1].stored, *cutouts):
            renew(path)
        return order

    def _submit(self, visitor: Visitor, job: Job, line: Line, work: Callable[[Job], None]) -> Job:
        self.visitors.check_work(visitor, line.most)
        line.submit(job, lambda job: run_guarded(job, work))
        visitor.remember(job)
        return job

    def _run(self, visitor: Visitor, order: Order, job: Job) -> None:
        load, events, done = self.forecaster.load(), self.work(order), None
        with self.visitors.writing(visitor, bytes_to_write(order), made_by(order)):
            try:
                order.cut_views(Deadline(self.settings.max_cut_seconds, job.check))
                for event in events:
                    done = event if isinstance(event, Done) else job.tell(event)
            finally:
                close_now(events)
                visitor.trim(self.visitors.room)
        if done is not None:
            # The visitor learns of the end only after `writing`, because the visitor may then
            # request several files at the same time.
            job.tell(done)
            visitor.proportions[str(made_gaussians(order))] = Proportions.of_report(done.report)
            if "simulate" not in job.progress.reused:
                self.forecaster.learn(done.report, order.scene, load)

    def warm_up(self) -> None:
        """Load all kernels, and calibrate the forecast by small runs; this runs in a thread."""
        from .warm import example_run, search_seconds, tiny_run, warm_up

        if self.settings.warm_up:
            self.searches.append(search_seconds())
        if self.settings.warm_up and not self.forks:
            with DEVICE:
                device = pick_device(self.settings.device)
                context = RunContext(device=device, threads=self.settings.threads or None)
                warm_up(context)
                self.forecaster.calibrate(partial(tiny_run, context), partial(example_run, context))
        self.warm.set()
