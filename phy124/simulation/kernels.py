"""The kernels that a scene needs, as each part of a simulation names them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from phy124.monitor import contacts, diagnostics, dissipation, external_work, tearing, wrenches
from phy124.mpm import fluctuation, free, pairs, repair, substep, tracks
from phy124.mpm.model import PRECISIONS, form_of
from phy124.scene import Scene
from phy124.simulation import deform
from phy124.simulation.solver import scheme_of


def kernels(scene: Scene, device: str = "cpu") -> Iterator[Any]:
    """What a run of a scene launches in one thread.

    Forces on a part of the object are left out: their modules take 0.3 s each.
    """
    precision = scene.resolution.precision
    real = PRECISIONS[precision]
    form = form_of(precision, device, scene.resolution.gradient)
    laws = {section.device_law.name: section.device_law for section in scene.materials}
    yield from tracks.kernels(real)
    yield from substep.kernels(laws.values(), real, form)
    yield from fluctuation.kernels(scheme_of(scene), real, form)
    yield from repair.kernels(laws.values(), real)
    yield from deform.kernels(real, scene.binding, device)
    yield from diagnostics.kernels(laws.values(), real)
    if scene.checks.energy:
        yield from dissipation.kernels(laws.values(), real)
    yield from tearing.kernels(laws.values(), real)
    for boundary in scene.boundaries:
        yield from boundary.kernels(real, scene.dx)
    if scene.objects:
        yield from pairs.kernels(real)
    yield from free.kernels_of((one.shape or "" for one in scene.objects if one.free), real)
    if scene.boundaries and scene.checks.balance:
        yield from external_work.wall_kernels(real)
    if scene.boundaries and scene.keeps_wrenches:
        yield from wrenches.wrench_kernels(real)
    if scene.boundaries and scene.keeps_contacts:
        yield from contacts.contact_kernels(real)
