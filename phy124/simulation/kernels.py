"""The kernels that a scene needs, as each part of a simulation names them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from phy124.monitor import OBSERVERS
from phy124.monitor.observer import Subject
from phy124.mpm import fluctuation, free, pairs, repair, substep, tracks
from phy124.mpm.model import PRECISIONS, form_of
from phy124.scene import Scene
from phy124.simulation import deform
from phy124.simulation.solver import scheme_of


def kernels(scene: Scene, device: str = "cpu") -> Iterator[Any]:
    """Yield the kernels that a run of a scene launches in one thread.

    Forces on a part of the object are left out: their modules take 0.3 s each.
    """
    precision = scene.resolution.precision
    real = PRECISIONS[precision]
    form = form_of(precision, device, scene.resolution.gradient)
    subject = Subject(scene, scene.materials)
    yield from tracks.kernels(real)
    yield from substep.kernels(subject.laws, real, form)
    yield from fluctuation.kernels(scheme_of(scene), real, form)
    yield from repair.kernels(subject.laws, real)
    yield from deform.kernels(real, scene.binding, device)
    for observer in OBSERVERS:
        if observer.called_for(subject):
            yield from observer.kernels(subject, real)
    for boundary in scene.boundaries:
        yield from boundary.kernels(real, scene.dx)
    if scene.objects:
        yield from pairs.kernels(real)
    yield from free.kernels_of((one.shape or "" for one in scene.objects if one.free), real)
