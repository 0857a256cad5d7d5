"""No result depends on what memory held before it was written to."""

import ctypes
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import warp as wp

from phy124.camera import Camera
from phy124.materials import LAWS
from phy124.monitor.watchdog import Watchdog
from phy124.rendering.render import Renderer
from phy124.rendering.stage.build import make_stage
from phy124.runtime.context import RunContext
from phy124.scene import Scene, View
from phy124.scene.scene import preset_names
from phy124.simulation import Simulation, prepare
from support.shapes import ball

pytestmark = pytest.mark.usefixtures("coarse_solids")

EMPTY = ("empty", "empty_like")
"""Functions of NumPy and of Warp that give memory as it comes."""
BYTE = 0xFF
"""In every byte: NaN in floating point numbers of any length."""


class Poisoned:
    """Number of arrays that were filled."""

    def __init__(self) -> None:
        self.warp = self.numpy = 0

    def of_warp(self, make: Callable[..., Any]) -> Callable[..., Any]:
        """Fills what Warp gives on the CPU."""

        def filled(*inputs: Any, **options: Any) -> Any:
            array = make(*inputs, **options)
            if array.ptr and array.device.is_cpu:
                ctypes.memset(
                    array.ptr, BYTE, array.size * wp.types.type_size_in_bytes(array.dtype)
                )
                self.warp += 1
            return array

        return filled

    def of_numpy(self, make: Callable[..., Any]) -> Callable[..., Any]:
        """Fills what NumPy gives to phy124."""

        def filled(*inputs: Any, **options: Any) -> Any:
            array = make(*inputs, **options)
            asks = sys._getframe(1).f_globals.get("__name__", "")
            if asks.startswith("phy124") and not array.dtype.hasobject:
                array.view(np.uint8).fill(BYTE)
                self.numpy += 1
            return array

        return filled


@contextmanager
def poisoned() -> Iterator[Poisoned]:
    """Within this context, memory that is not initialised is filled."""
    count = Poisoned()
    usual = {(module, name): getattr(module, name) for module in (wp, np) for name in EMPTY}
    try:
        for (module, name), make in usual.items():
            setattr(module, name, (count.of_warp if module is wp else count.of_numpy)(make))
        yield count
    finally:
        for (module, name), make in usual.items():
            setattr(module, name, make)


FEW = {"accuracy": {"cells": 8}, "time.frames": 3}
SPHERE = {"kind": "sphere", "centre": [0.1, 0.05, 0.1], "radius": 0.3}
REGION = {"lower": [-1, -1, 0.4], "upper": [1, 1, 2]}
EVERYTHING = {
    "one particle for each Gaussian": ("drop", {"binding": "particles", "boundaries": [SPHERE]}),
    "sand with contacts": ("sand", {"contacts": True}),
    "pushed": ("wind", {"forces": [{"kind": "wind"}, {"kind": "acceleration", "region": REGION}]}),
    **{law: ("drop", {"material": {"law": law}}) for law in LAWS.by_name},
    **{name: (name, {}) for name in preset_names()},
}
FIRST = ("drop",)
"""Runs that the default tests examine."""


def results(preset, changes) -> dict[str, np.ndarray]:
    """Numbers that a run makes, and pictures of its end."""
    run = Simulation(
        prepare(ball(300), Scene.named(preset).replaced({**FEW, **changes}), RunContext(threads=1))
    )
    clip, camera = run.run(), Camera.orbit(30, 20, 2.5, (70, 50))
    frame, balance = run.frames[-1], run.find(Watchdog).balance
    result = {"means": clip.means, "quats": clip.quats, "scales": clip.scales}
    result["balance"] = np.array([balance.energy_gain, balance.momentum_gain])
    stage = make_stage(clip, View(stage="studio"))
    for blend in ("simd", "plain", "pixel"):
        draw = Renderer(device="cpu", blend=blend)
        result[blend] = draw(frame.gaussians, camera, alpha=True)
        result[f"{blend} on a stage"] = draw(frame.gaussians, camera, stage=stage.at(frame))
    return result


@pytest.mark.parametrize(
    "name",
    [name if name in FIRST else pytest.param(name, marks=pytest.mark.slow) for name in EVERYTHING],
)
def test_memory_that_is_not_initialised_changes_nothing(name):
    usual = results(*EVERYTHING[name])
    with poisoned() as count:
        other = results(*EVERYTHING[name])
    assert count.warp > 10 and count.numpy > 0
    for what, array in usual.items():
        np.testing.assert_array_equal(other[what], array, err_msg=what)


def test_unwritten_memory_is_detected():
    """The control: without it the test above could not fail."""
    with poisoned() as count:
        taken = wp.empty(3, dtype=wp.vec3, device="cpu").numpy()
    assert np.isnan(taken).all() and count.warp == 1
    with poisoned():
        assert (wp.empty_like(wp.zeros(2, dtype=int, device="cpu")).numpy() == -1).all()
