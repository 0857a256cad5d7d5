"""Work in spawned processes: results as they come, what is killed, and what is still at work."""

import multiprocessing
import os
import time

import pytest

from phy124.errors import Cancelled
from phy124.runtime.processes import as_done, processes
from support.waiting import until


def test_tasks_return_results_and_running_ones_stop():
    with processes(1) as pool:
        assert dict(as_done(pool, abs, [-1, -2, 3], lambda: None)) == {-1: 1, -2: 2, 3: 3}

        def cancel() -> None:
            raise Cancelled

        with pytest.raises(Cancelled):
            list(as_done(pool, time.sleep, [600.0], cancel))
        (worker,) = multiprocessing.active_children()
    # Not `worker.join`: the pool's own thread may have taken its exit status already.
    process = worker.pid
    assert process is not None
    until(lambda: not exists(process))


def exists(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.slow
def test_killed_worker_is_reported():
    with processes(1) as pool, pytest.raises(OSError, match="a worker process was killed"):
        list(as_done(pool, os._exit, [9], lambda: None))
