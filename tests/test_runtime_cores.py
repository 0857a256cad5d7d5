"""Cores are counted once: those of this process, physical ones, and those nobody else wants."""

import math
import os

import pytest

from phy124.runtime import cores


def test_there_are_no_more_free_cores_than_cores():
    assert 1 <= cores.free_cores() <= cores.physical_cores() <= cores.cores()


def test_two_hardware_threads_of_one_core_count_once(monkeypatch, tmp_path):
    if not hasattr(os, "sched_getaffinity"):
        pytest.skip("this system does not say which cores a process may use")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0, 1, 4, 5})
    monkeypatch.setattr(cores, "SIBLINGS", str(tmp_path / "{}"))
    for first, siblings in ((0, "0,4"), (1, "1,5"), (4, "0,4"), (5, "1,5")):
        (tmp_path / str(first)).write_text(siblings)
    assert cores.physical_cores() == 2 and cores.cores() == 4


@pytest.mark.parametrize(("others", "free"), [(0, 2), (1, 2), (3, 1), (9, 1)])
def test_other_processes_use_hardware_threads_first(monkeypatch, others, free):
    monkeypatch.setattr(cores, "_hardware_threads", lambda: 4)
    monkeypatch.setattr(cores, "physical_cores", lambda: 2)
    monkeypatch.setattr(cores, "_others_running", lambda: others)
    assert cores.free_cores() == free


@pytest.mark.parametrize(("quota", "threads"), [(math.inf, 8), (3.0, 3), (2.5, 2), (0.3, 1)])
def test_no_more_threads_than_the_quota_pays_for(monkeypatch, quota, threads):
    monkeypatch.setattr(cores, "_hardware_threads", lambda: 8)
    monkeypatch.setattr(cores, "SIBLINGS", "/nowhere/{}")
    monkeypatch.setattr(cores, "cpu_quota", lambda: quota)
    assert cores.cores() == cores.physical_cores() == threads


def test_a_busy_machine_does_not_use_up_the_quota(monkeypatch):
    monkeypatch.setattr(cores, "_hardware_threads", lambda: 64)
    monkeypatch.setattr(cores, "SIBLINGS", "/nowhere/{}")
    monkeypatch.setattr(cores, "cpu_quota", lambda: 4.0)
    monkeypatch.setattr(cores, "_others_running", lambda: 30)
    assert cores.free_cores() == 4


def test_unknown_topology_counts_all_cores_as_physical(monkeypatch):
    monkeypatch.setattr(cores, "SIBLINGS", "/nowhere/{}")
    assert cores.physical_cores() == cores.cores()
