"""The time that a job declares on ZeroGPU, with a module in place of the package `spaces`."""

import sys
from dataclasses import replace
from importlib.machinery import ModuleSpec
from types import ModuleType

import pytest

from demo import zerogpu
from demo.jobs import Studio
from demo.settings import Settings
from demo.source import Choice, Cutout
from demo.visitors import Visitors
from demo.work import Done, Order, steps
from demo.zerogpu import COMPILING, MARGIN, SHORTEST, Durations, work_on_gpu
from phy124.errors import InputError
from phy124.scene import Scene
from support.served import ROOT

DUCK = ROOT / "demo/examples/duck.png"


@pytest.fixture
def order(tmp_path) -> Order:
    return Order(tmp_path, None, Scene.named("press"), tmp_path / "stop", 180.0, 1000, expected=40)


def _install(monkeypatch, gpu) -> None:
    module = ModuleType("spaces")
    module.__spec__ = ModuleSpec("spaces", None)
    module.GPU = gpu  # pyright: ignore
    monkeypatch.setitem(sys.modules, "spaces", module)


def test_space_without_a_gpu_runs_jobs_as_they_are(monkeypatch):
    _install(monkeypatch, lambda duration: lambda task: task)
    assert work_on_gpu(180) is steps


def test_job_declares_its_forecast_and_keeps_to_it(monkeypatch, order):
    declared, limits = [], []

    def gpu(duration):
        def decorate(task):
            def run(order):
                declared.append(duration(order))
                limits.append(order.seconds)
                yield Done(order.folder, order.folder, order.folder)

            return run

        return decorate

    _install(monkeypatch, gpu)
    work = work_on_gpu(180)
    list(work(order))
    list(work(order))
    assert declared == limits == [MARGIN * 40 + COMPILING, MARGIN * 40]


def test_durations_stay_within_their_bounds(order):
    durations = Durations(120)
    durations.compiled = True
    short, long = (replace(order, expected=seconds) for seconds in (0.5, 500))
    assert durations(short) == SHORTEST and durations(long) == 120


def test_refusal_of_zero_gpu_reaches_the_visitor(monkeypatch, order):
    def gpu(duration):
        import gradio

        def run(order):
            raise gradio.Error("You have exceeded your quota (60s requested vs. 12s left).")
            yield

        return lambda task: run

    _install(monkeypatch, gpu)
    with pytest.raises(InputError, match="12s left") as refused:
        list(work_on_gpu(180)(order))
    assert refused.value.remedy == zerogpu.REMEDY


def test_finer_run_expects_more_seconds_of_gpu(tmp_path):
    orders = []

    def work(order):
        orders.append(order)
        yield Done(tmp_path, tmp_path, tmp_path)

    studio = Studio(Settings(warm_up=False), Visitors(tmp_path), work=work)
    assert studio.forks
    studio.visitors.get("a")
    picture = str(studio.visitors.store("a", DUCK.read_bytes(), ".png"))
    for accuracy in ("draft", "fine"):
        scene = Scene.named("press").replaced({"accuracy": accuracy})
        studio._run = lambda visitor, order, job: list(work(order))  # pyright: ignore
        studio.run(Choice("a", Cutout(picture, picture), scene.data())).wait(60)
    draft, fine = (order.expected for order in orders)
    assert 0 < draft < fine  # both grow with the load of the machine
