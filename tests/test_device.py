"""The device that a user names."""

import threading
from types import SimpleNamespace

import pytest
import warp as wp

from phy124.errors import InputError
from phy124.rendering.render import Renderer
from phy124.runtime import startup
from phy124.runtime.device import Driver, lock_gpu, pick_device
from phy124.simulation import Simulation


def test_looking_for_a_device_starts_warp_quietly(monkeypatch):
    started = []
    monkeypatch.setattr(startup, "start", lambda: started.append(True))
    assert pick_device("cpu") == "cpu" and len(started) == 1
    assert pick_device("auto") in ("cpu", "cuda:0") and len(started) == 2


def test_missing_device_is_refused_with_the_available():
    with pytest.raises(InputError, match=r"no such device.*cpu"):
        pick_device("cuda:17")


OLD = Driver((12, 2), (13, 0))


def test_old_driver_is_named_with_the_needed_one(monkeypatch):
    monkeypatch.setattr(wp, "is_cuda_available", lambda: False)
    monkeypatch.setattr("phy124.runtime.device.driver", lambda: OLD)
    words = r"CUDA 12\.2, and this Warp needs 13\.0.*updated to release 580"
    with pytest.warns(UserWarning, match=words):
        assert pick_device("auto") == "cpu"
    with pytest.raises(InputError, match=words):
        pick_device("cuda:0")
    assert str(OLD) == OLD.problem


def test_a_driver_that_will_do_or_is_not_there_is_no_problem():
    for driver, words in ((Driver((13, 1), (13, 0)), "CUDA 13.1"), (Driver(None, (13, 0)), "none")):
        assert driver.problem is None and str(driver) == words


def test_freed_memory_of_a_gpu_is_kept(monkeypatch):
    kept = {}
    monkeypatch.setattr(wp, "get_devices", lambda: ["cpu", "cuda:1"])
    monkeypatch.setattr(wp, "is_mempool_enabled", lambda device: True)
    monkeypatch.setattr(wp, "set_mempool_release_threshold", kept.__setitem__)
    assert pick_device("cuda:1") == "cuda:1"
    assert kept == {"cuda:1": 2**30}


@lock_gpu
def enter(place, other) -> bool:
    """Whether another thread can enter while this one is inside."""
    if other is None:
        return True
    inside = threading.Thread(target=enter, args=(other, None), daemon=True)
    inside.start()
    inside.join(0.2 if place.device != "cpu" else 300)
    return not inside.is_alive()


def test_nothing_is_drawn_on_a_gpu_while_a_graph_is_captured():
    cpu, gpu = SimpleNamespace(device="cpu"), SimpleNamespace(device="cuda:1")
    assert enter(cpu, cpu) and not enter(gpu, gpu)
    for method in (Simulation._advance, Simulation._make_frame, Renderer.__call__):
        assert hasattr(method, "__wrapped__")
