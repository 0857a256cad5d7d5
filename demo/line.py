"""Runs jobs in the order of their arrival, and describes how each job ended.

A job continues when its visitor disconnects. Each job has a name that cannot be guessed.
"""

from __future__ import annotations

import contextvars
import logging
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from phy124.errors import Cancelled, InputError
from phy124.runtime.failures import Kind, failure

from .progress import STAGES, Progress

if TYPE_CHECKING:
    from .source import Choice

LOG = logging.getLogger("phy124.web")
RECENT = 5
"""Number of latest finished jobs that are used to correct the predicted waiting time."""
STOPPED = "Stopped. Nothing was changed."
FAILED = "The server failed to do this; its log has the reason. Try again, or change the scene."
SERVER = {
    Kind.MEMORY: "This server has too little memory for this. Choose a coarser accuracy.",
    Kind.DISK: "The disk of this server is full. Try again later.",
}
"""Messages for the visitor by kind of failure; the message of all other kinds is `FAILED`."""


SUBJECTS = {"image": "The file", "mesh": "The file", "video": "The video", "depth": "The depth map"}
"""Names by which messages to visitors refer to the field of an error."""


class Job:
    """A visitor's job: its progress, its result, and a request to stop."""

    def __init__(
        self,
        kind: str,
        stop: Path,
        expected: float = 0.0,
        subject: str = "",
        stages: Mapping[str, str] = STAGES,
    ) -> None:
        self.kind = kind
        self.subject = subject
        """Path of the file that the job works on, such as a picture or a clip."""
        self.name = secrets.token_urlsafe(18)
        self.stop = stop
        """File whose existence tells the job to stop."""
        self.progress = Progress(expected=expected, names=stages)
        self.line: Line | None = None
        self.choice: Choice | None = None
        """The visitor's choices for a run; a finer run uses these choices again."""
        self._changed = threading.Condition()

    @property
    def over(self) -> bool:
        """Whether the job has ended, successfully or not."""
        return self.progress.state not in ("waiting", "running")

    def tell(self, event: object) -> None:
        """Update the job's progress from an event."""
        with self._changed:
            self.progress.take(event)
            self._changed.notify_all()

    def end(self, state: str, message: str = "", result: object = None) -> None:
        """End the job; later calls of this method have no effect.

        Args:
            state: done, stopped, refused, full or failed.
            message: A sentence that the visitor reads.
            result: Result of the job.
        """
        with self._changed:
            if not self.over:
                self.progress.state, self.progress.message = state, message
                self.progress.result = result
            self._changed.notify_all()

    def wait(self, seconds: float) -> bool:
        """Wait up to `seconds` for the job to end; return whether it has ended."""
        with self._changed:
            self._changed.wait_for(lambda: self.over, seconds)
            return self.over

    def cancel(self) -> None:
        """Remove the job from the queue; if it is running, request it to stop."""
        if self.line is not None and self.line.drop(self):
            self.end("stopped", STOPPED)
        elif not self.over and self.stop.parent.is_dir():
            self.stop.touch()

    def check(self) -> None:
        """Raise Cancelled if the job has been requested to stop."""
        if self.stop.exists():
            raise Cancelled

    @property
    def place(self) -> int:
        """Number of jobs queued before this job; 0 if this job has started."""
        return 0 if self.line is None else self.line.place(self)

    @property
    def seconds_to_start(self) -> float:
        """Predicted time until this job starts [s]; 0 if it has started."""
        return 0.0 if self.line is None else self.line.seconds_to_start(self)


class Line:
    """A queue of jobs, and the threads that run the jobs."""

    def __init__(self, name: str, *, workers: int, most: int) -> None:
        self.name, self.workers, self.most = name, workers, most
        self._waiting: deque[tuple[Job, Callable[[], None]]] = deque()
        self._running: set[Job] = set()
        self._slowdowns: deque[float] = deque(maxlen=RECENT)
        """Durations of the latest jobs, each divided by the duration predicted without other load.
        """
        self._changed = threading.Condition()
        self._threads: list[threading.Thread] = []

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def running(self) -> int:
        """Number of running jobs."""
        return len(self._running)

    def submit(self, job: Job, work: Callable[[Job], None]) -> Job:
        """Append a job to the queue.

        Raises:
            InputError: Too many jobs are waiting.
        """
        context = contextvars.copy_context()
        with self._changed:
            if len(self._waiting) >= self.most:
                raise InputError(
                    "queue", "full", "Too many visitors are waiting.", "Try again soon."
                )
            job.line = self
            self._waiting.append((job, lambda: context.run(work, job)))
            self._start()
            self._changed.notify()
        return job

    def place(self, job: Job) -> int:
        """Return the number of jobs queued before a job; 0 if the job has started."""
        with self._changed:
            names = [waiting.name for waiting, _ in self._waiting]
        return names.index(job.name) + self.running if job.name in names else 0

    def seconds_to_start(self, job: Job) -> float:
        """Predict the time until a job starts [s]; 0 if it has started.

        Predictions are for an idle machine, so they are multiplied by the slowdown of recent jobs.
        """
        with self._changed:
            jobs = [waiting for waiting, _ in self._waiting]
            if job not in jobs:
                return 0.0
            before = jobs[: jobs.index(job)]
            waiting = sum(each.progress.duration(self._slowdowns) for each in before)
            running = sum(each.progress.seconds_left(self._slowdowns) for each in self._running)
        return (running + waiting) / self.workers

    def drop(self, job: Job) -> bool:
        """Remove a job from the queue; return False if the job has already started."""
        with self._changed:
            entry = next((entry for entry in self._waiting if entry[0] is job), None)
            if entry is None:
                return False
            self._waiting.remove(entry)
            return True

    def _start(self) -> None:
        while len(self._threads) < self.workers:
            thread = threading.Thread(target=self._serve, name=f"line {self.name}", daemon=True)
            self._threads.append(thread)
            thread.start()

    def _serve(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting)
                job, work = self._waiting.popleft()
                self._running.add(job)
            start = time.monotonic()
            try:
                work()
            except BaseException as problem:
                # No exception may end the thread, because it runs the following jobs.
                end(job, problem)
            job.end("failed", FAILED)
            with self._changed:
                self._running.discard(job)
                if job.progress.whole and job.progress.unloaded > 0:
                    self._slowdowns.append((time.monotonic() - start) / job.progress.unloaded)


def run_guarded(job: Job, work: Callable[[Job], None]) -> None:
    """Run a job; if the job raises an exception, end it with a message."""
    job.progress.begin()
    try:
        job.check()
        work(job)
    except BaseException as problem:
        end(job, problem)
    finally:
        job.stop.unlink(missing_ok=True)


def end(job: Job, problem: BaseException) -> None:
    """End a job that raised an exception; log the exception if the server is at fault."""
    state, message = describe_failure(problem)
    if state == "failed":
        LOG.error("a job failed", exc_info=problem)
    job.end(state, message)


def describe_failure(problem: BaseException) -> tuple[str, str]:
    """Return the final state of a job that raised an exception, and the message to the visitor."""
    kind = failure(problem).kind
    if kind is Kind.STOPPED:
        return "stopped", STOPPED
    if isinstance(problem, InputError):
        return "refused", user_message(problem)
    return "failed", SERVER.get(kind, FAILED)


def user_message(error: InputError) -> str:
    """Return an error's message for the visitor, without the paths of files on the server."""
    text = _text(error)
    subject = "The file" if error.field.endswith(" file") else SUBJECTS.get(error.field)
    return f"{subject} {text[3:]}" if subject and text.startswith("It ") else text


def api_message(error: InputError) -> str:
    """Return an error's message for a program; the message begins with the field."""
    return f"{error.field}: {_text(error)}"


def _text(error: InputError) -> str:
    text = f"{error.limit} {error.remedy}"
    return text[:1].upper() + text[1:]
