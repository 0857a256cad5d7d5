"""Work that waits for its turn: first come, first served, whatever becomes of one piece."""

from pathlib import Path

import pytest

from demo.line import Job, Line
from phy124.errors import InputError
from support.processes import until


def _line() -> tuple[Line, Job, list[str]]:
    """A line whose only worker is held by a job."""
    line, done = Line("test", workers=1, most=2), []
    holding = Job("run", Path("/nowhere/stop"))

    def hold(job: Job) -> None:
        job.progress.begin()
        until(lambda: "let go" in done)
        job.end("done")

    line.submit(holding, hold)
    until(lambda: line.running == 1 and not len(line))
    return line, holding, done


def test_jobs_are_done_in_turn_and_know_their_place():
    line, holding, done = _line()

    def work(job: Job) -> None:
        done.append(job.kind)
        job.end("done")

    single, two = (line.submit(Job(kind, Path("/nowhere/stop")), work) for kind in ("one", "two"))
    assert (holding.place, single.place, two.place) == (0, 1, 2)
    with pytest.raises(InputError, match="Too many visitors"):
        line.submit(Job("three", Path("/nowhere/stop")), work)
    done.append("let go")
    assert two.wait(60) and done == ["let go", "one", "two"]


def test_a_job_that_is_called_off_while_it_waits_never_starts():
    line, holding, done = _line()
    late = line.submit(Job("late", Path("/nowhere/stop")), lambda job: done.append("late"))
    late.cancel()
    assert late.over and late.progress.state == "stopped" and len(line) == 0
    done.append("let go")
    assert holding.wait(60) and "late" not in done


def test_a_line_survives_work_that_breaks():
    line = Line("test", workers=1, most=2)
    broken = line.submit(Job("run", Path("/nowhere/stop")), lambda job: 1 / 0)
    assert broken.wait(60) and broken.progress.state == "failed"
    fine = line.submit(Job("run", Path("/nowhere/stop")), lambda job: job.end("done"))
    assert fine.wait(60) and fine.progress.state == "done"


def test_waiting_time_follows_the_durations_of_the_last_jobs():
    """Jobs that take four times their time without load lengthen the waits behind them."""
    line, holding, done = _line()
    waiting = [Job(kind, Path("/nowhere/stop"), expected=10) for kind in ("one", "two")]
    holding.progress.expected = 20
    for job in waiting:
        line.submit(job, lambda job: job.end("done"))
    single, two = (job.seconds_to_start for job in waiting)
    assert (
        holding.seconds_to_start == 0
        and 19 < single <= 20
        and two == pytest.approx(single + 10, abs=1)
    )
    for job in (holding, *waiting):
        job.progress.unloaded = job.progress.expected / 2  # the machine is forecast to be busy
    line._slowdowns.append(4.0)
    assert two + 25 < waiting[1].seconds_to_start <= 60
    done.append("let go")
    assert waiting[1].wait(60) and waiting[1].seconds_to_start == 0
