"""Work in spawned processes: results as they come, what is killed, and what is still at work."""

import multiprocessing
import os
import signal
import sys
import time
from types import SimpleNamespace

import pytest

from phy124.errors import Cancelled
from phy124.runtime.processes import _exit_codes, as_done, explain_end, processes
from support.processes import run_program, until


def test_tasks_return_results_and_running_ones_stop():
    with processes(2) as pool:
        assert dict(as_done(pool, abs, [-1, -2, 3], lambda: None)) == {-1: 1, -2: 2, 3: 3}

        def cancel() -> None:
            raise Cancelled

        with pytest.raises(Cancelled):
            list(as_done(pool, time.sleep, [600.0], cancel))
        workers = [worker.pid for worker in multiprocessing.active_children()]
    # Not `worker.join`: the pool's own thread may have taken their exit status already.
    assert len(workers) == 2
    until(lambda: not any(map(exists, workers)))


def test_without_a_pool_tasks_run_here_and_can_be_cancelled_between():
    beats = iter([None, None])

    def cancel_third() -> None:
        if next(beats, "ended"):
            raise Cancelled

    with processes(1) as pool:
        assert pool is None
        done = as_done(pool, lambda task: (task, os.getpid()), [1, 2, 3], cancel_third)
        assert [next(done), next(done)] == [(n, (n, os.getpid())) for n in (1, 2)]
        with pytest.raises(Cancelled):
            next(done)


def exists(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


ENDS = [
    ({-signal.SIGTERM, -signal.SIGKILL, 0}, OSError, "killed (SIGKILL), most likely because the m"),
    ({-signal.SIGTERM, -signal.SIGSEGV}, RuntimeError, "crashed in native code (SIGSEGV)"),
    ({-signal.SIGTERM, -signal.SIGABRT}, RuntimeError, "crashed in native code (SIGABRT)"),
    ({-signal.SIGTERM}, OSError, "ended from outside (SIGTERM)"),
    ({-signal.SIGTERM, 9}, OSError, "ended with status 9"),
]


@pytest.mark.parametrize(("codes", "kind", "words"), ENDS)
def test_the_end_of_a_worker_is_explained_by_its_cause(codes, kind, words):
    explained = explain_end(codes)
    assert type(explained) is kind and words in str(explained)


def test_exit_code_that_another_thread_reads_first_is_awaited():
    class Worker:
        codes = iter([None, None])

        def join(self, timeout):
            """Return at once."""

        @property
        def exitcode(self):
            return next(self.codes, -signal.SIGKILL)

    pool = SimpleNamespace(_processes={1: Worker()})
    assert _exit_codes(pool) == {-signal.SIGKILL}


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGTERM])
def test_signal_that_ended_a_worker_is_reported(number):
    with processes(2) as pool, pytest.raises((OSError, RuntimeError), match=number.name):
        list(as_done(pool, signal.raise_signal, [number], lambda: None))


@pytest.mark.slow
def test_pool_that_broke_before_a_task_is_reported():
    with processes(2) as pool:
        for _ in range(2):
            with pytest.raises(OSError, match="ended with status 9"):
                list(as_done(pool, os._exit, [9, 9], lambda: None))


CTRL_C = """
import os, signal, threading, time
from phy124.runtime.isolated import run
from phy124.runtime.processes import as_done, processes

def press():
    while True:
        os.killpg(0, signal.SIGINT)
        time.sleep(0.01)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, lambda *_: None)
    threading.Thread(target=press, daemon=True).start()
    with processes(2) as pool:
        found = sorted(as_done(pool, abs, [-1, -2, 3], lambda: None))
    print(found, [run(abs, -number) for number in range(4)])
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no signals of process groups")
def test_ctrl_c_of_a_terminal_does_not_end_workers(tmp_path):
    """Not even while they start: a terminal sends Ctrl-C to all processes of a command."""
    (tmp_path / "script.py").write_text(CTRL_C)
    command = [sys.executable, tmp_path / "script.py"]
    done = run_program(command, start_new_session=True)
    assert (done.stdout, done.stderr) == ("[(-2, 2), (-1, 1), (3, 3)] [0, 1, 2, 3]\n", "")


def test_a_signal_to_all_processes_interrupts():
    """Also if a worker has ended before this process asks whether to go on."""
    with processes(2) as pool:

        def interrupt() -> None:
            if pool is not None and pool._broken:
                raise Cancelled

        with pytest.raises(Cancelled):
            list(as_done(pool, signal.raise_signal, [signal.SIGTERM], interrupt))
