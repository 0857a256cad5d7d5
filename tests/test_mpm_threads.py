"""The second thread works in order and hands its errors over; barriers can be abandoned."""

import threading
import time

import pytest

from phy124.mpm.threads import Barrier, SecondThread, free_cores


def test_tasks_are_done_in_order_beside_the_first_thread():
    done = []
    second = SecondThread(lambda task: done.append((task, threading.get_ident())))
    with second.running():
        assert second.alive
        for task in range(5):
            second.put(task)
        second.join()
        assert [task for task, _ in done] == list(range(5))
    assert not second.alive
    assert {thread for _, thread in done} != {threading.get_ident()}


def test_an_error_is_raised_by_the_first_thread_once():
    def fail(task):
        raise ZeroDivisionError(task)

    second = SecondThread(fail)
    with second.running():
        with pytest.raises(ZeroDivisionError, match="first"):
            second.put("first")  # which raises it itself if the task is quick
            second.join()
        second.join()


def test_a_barrier_that_is_abandoned_lets_go():
    barrier = Barrier(2)
    barrier.abandoned = True
    assert not barrier.wait(0)


def test_cores_are_counted():
    assert isinstance(free_cores(), int)


@pytest.mark.parametrize("late", [0.0, 0.05])
def test_nobody_leaves_a_barrier_before_all_have_come(late):
    barrier, came = Barrier(2), []

    def other():
        for _ in range(3):
            time.sleep(late)
            came.append("other")
            barrier.wait(1)

    helper = threading.Thread(target=other)
    helper.start()
    for rounds in (1, 2, 3):
        barrier.wait(0)
        assert len(came) >= rounds
    helper.join(timeout=5)
    assert not helper.is_alive()
