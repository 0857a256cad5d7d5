"""Work in spawned processes: results as they come, what is killed, and what is still at work."""

import multiprocessing
import os
import time

import pytest

from phy124.errors import Cancelled
from phy124.runtime.processes import as_done, processes
from support.processes import until


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


@pytest.mark.slow
def test_killed_worker_is_reported():
    with processes(2) as pool, pytest.raises(OSError, match="a worker process was killed"):
        list(as_done(pool, os._exit, [9], lambda: None))
