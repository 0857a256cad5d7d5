"""A team does its tasks together and hands its errors over; barriers can be abandoned."""

import threading
import time
from functools import partial

import pytest

from phy124.mpm.threads import Barrier, Team

SIZES = (2, 5)


@pytest.mark.parametrize("size", SIZES)
def test_each_member_does_its_tasks_in_order(size):
    done = []
    team = Team(size)
    with team.running():
        assert team.alive
        for task in range(5):
            team.put(lambda member, task=task: done.append((member, task, threading.get_ident())))
        team.join()
        for member in range(1, size):
            assert [task for who, task, _ in done if who == member] == list(range(5))
    assert not team.alive
    threads = {thread for *_, thread in done}
    assert len(threads) == size - 1 and threading.get_ident() not in threads


@pytest.mark.parametrize("size", SIZES)
def test_tasks_begin_after_all_threads_end_the_last(size):
    done: list[int] = []

    def work(task, member):
        assert len(done) >= task * (size - 1)
        time.sleep(0.002 * (member == task))
        done.append(task)

    team = Team(size)
    with team.running():
        for task in range(size + 2):
            team.put(partial(work, task))
        team.join()
    assert sorted(done) == sorted(list(range(size + 2)) * (size - 1))


@pytest.mark.parametrize("size", SIZES)
def test_an_error_is_raised_by_the_first_thread_once(size):
    def fail(member):
        if member == size - 1:
            raise ZeroDivisionError("first")

    team = Team(size)
    with team.running():
        with pytest.raises(ZeroDivisionError, match="first"):
            team.put(fail)  # which raises it itself if the task is quick
            team.join()
        team.join()


def test_exiting_thread_releases_the_others():
    def end(member):
        raise SystemExit(f"member {member}")

    team, before = Team(4), threading.active_count()
    with pytest.raises(SystemExit, match="member"), team.running():
        team.put(end)
        team.join()
    assert threading.active_count() == before


def test_a_barrier_that_is_abandoned_lets_go():
    barrier = Barrier(2)
    barrier.abandoned = True
    assert not barrier.wait(0)


@pytest.mark.parametrize(("late", "others"), [(0.0, 1), (0.05, 1), (0.02, 4)])
def test_barrier_holds_until_all_threads_arrive(late, others):
    barrier, came = Barrier(1 + others), []

    def other(party):
        for _ in range(3):
            time.sleep(late)
            came.append(party)
            barrier.wait(party)

    helpers = [threading.Thread(target=other, args=(1 + party,)) for party in range(others)]
    for helper in helpers:
        helper.start()
    for rounds in (1, 2, 3):
        barrier.wait(0)
        assert len(came) >= rounds * others
    for helper in helpers:
        helper.join(timeout=300)
        assert not helper.is_alive()
