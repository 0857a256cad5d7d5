"""Jobs that fit a result to a video; the number of jobs per visitor and in total is limited."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from phy124.accuracy.forecast import GUESS
from phy124.accuracy.load import format_span
from phy124.errors import InputError
from phy124.runtime.isolated import Deadline
from phy124.studies.fit.budget import FEWEST, USUAL

from ..forecast import Estimator
from ..line import Job, Line
from ..progress import FITTING, Step
from ..settings import Settings
from ..visitors import Visitor, Visitors, key
from ..work import Done
from .search import (
    FitResult,
    Search,
    declare_fit,
    outlook,
    progress,
    scene_of_result,
    search_softness,
    softness,
)
from .video import FitOptions, check_video, fit_options_of, read_video

Submit = Callable[[Visitor, Job, Line, Callable[[Job], None]], Job]
STARTING = 6.0
"""Time to read a video and to start the search [s]."""
ROOM = 1.5
"""Suggested time budget, as a multiple of the usual duration of a search."""
NO_RESULT = "There is no result yet that could be fitted to the video."


class Fits:
    """All fits that run on the server."""

    def __init__(
        self,
        visitors: Visitors,
        settings: Settings,
        forecaster: Estimator,
        submit: Submit,
        search: Search = search_softness,
    ) -> None:
        self.visitors, self.settings, self.forecaster = visitors, settings, forecaster
        self.search = search
        self._submit = submit
        self.line = Line("fit", workers=settings.max_fits, most=settings.max_queue)

    def offer(self, done: Done | None) -> dict[str, Any]:
        """Predict the time of a fit; return a sentence, and the range of time budgets [s].

        Raises:
            InputError: The result cannot be fitted on this page.
        """
        if done is None or not done.is_stored:
            raise InputError("run", "none", NO_RESULT, "Generate one first.")
        if find_spec("cma") is None:
            limit = "This server cannot search for a softness: the package cma is not installed."
            raise InputError("fit", "none", limit, "Ask the operator of the page to install it.")
        scene = scene_of_result(done)
        softness(scene)
        expected, load = outlook(scene, self.forecaster.rates), self.forecaster.load().thread
        least, usual = (STARTING + load * expected.wall(runs) for runs in (FEWEST, USUAL))
        most = self.settings.max_fit_seconds
        if least > most:
            limit = f"A fit of this scene takes at least {least:.0f} s; the limit is {most:g} s."
            raise InputError("seconds", "over", limit, "Choose a shorter length.")
        budget = {"least": round(least), "most": most, "value": round(min(ROOM * usual, most))}
        low, high = self.forecaster.load().span(usual, unsure=GUESS)
        span = format_span((min(low, budget["value"]), min(high, budget["value"])))
        return {"sentence": f"A fit takes {span}.", "seconds": usual, "budget": budget}

    def begin(self, name: str, done: Done | None, video: Any, options: dict[str, Any]) -> Job:
        """Start a fit of a visitor's result to a video.

        Args:
            name: The visitor's name.
            done: The result to fit.
            video: The path of the uploaded video, as the request states it.
            options: Values of `FitOptions`.

        Raises:
            InputError: The request is invalid, or another fit of the visitor is running.
        """
        asked, expected = fit_options_of(options, self.settings), self.offer(done)["seconds"]
        visitor = self.visitors.find(name)
        if visitor is None or done is None or done.clip.parents[1] != visitor.folder:
            raise InputError("run", "none", NO_RESULT, "Generate one first.")
        upload = self._upload(name, video)
        check_video(upload, self.settings)
        if any(job.kind == "fit" and not job.over for job in list(visitor.jobs.values())):
            limit = "Your previous fit is still running."
            raise InputError("fit", "yours", limit, "Let it end or cancel it.")
        job = Job("fit", visitor.new_stop_file(), expected, str(done.clip), FITTING)
        work = partial(self._run, visitor, done, upload, asked)
        return self._submit(visitor, job, self.line, work)

    def _upload(self, name: str, video: Any) -> Path:
        if not video:
            raise InputError("video", "none", "There is no video yet.", "Choose one first.")
        try:
            return self.visitors.find_upload(name, video)
        except InputError as error:
            if error.field == "room":
                raise
            limit = "The server does not have this video."
            raise InputError("video", error.value, limit, error.remedy) from None

    def _run(self, visitor: Visitor, done: Done, upload: Path, asked: FitOptions, job: Job) -> None:
        scene = scene_of_result(done)
        out = _folder(visitor, done, upload, asked)
        length = (scene.time.frames - 1) / scene.time.fps
        job.tell(Step("read", 0, 1))
        reading = Deadline(self.settings.max_cut_seconds, job.check)
        seen = read_video(upload, out / "video", length, asked.speed, reading)
        left_out = f", {seen.whole - seen.count} come later" if seen.whole > seen.count else ""
        job.tell(Step("read", 1, 1, f"{seen.count} pictures{left_out}"))
        folder = out / "found"
        watching = Deadline(asked.seconds, lambda: _watch(job, folder))
        self.search(declare_fit(done, scene, seen, asked), folder, watching)
        visitor.trim(self.visitors.room)
        job.end("done", result=FitResult(folder))


def _watch(job: Job, out: Path) -> None:
    job.check()
    state = progress(out)
    if state is None:
        return
    made, runs, seconds = state
    job.progress.expected = STARTING + seconds
    # The number of finished runs may exceed the estimated number of runs.
    job.tell(Step("fit", min(made, runs - 1), runs, f"{made} runs, about {runs} expected"))


def _folder(visitor: Visitor, done: Done, upload: Path, asked: FitOptions) -> Path:
    """Return the folder of a fit; an equal fit to the same video continues in this folder."""
    options, view = asked.model_dump(exclude={"seconds"}), done.view.model_dump(mode="json")
    return visitor.folder / "fits" / f"{done.clip.name}-{key(upload.read_bytes(), options, view)}"
