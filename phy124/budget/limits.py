"""Refuses runs that would take hours, or more memory than there is, before they start.

The estimate is rough on purpose (phy124/budget/cost.py). A refusal names a setting that would fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from phy124.budget.cost import Demand, demand_of, rest_substeps
from phy124.budget.remedies import accuracy, listed, plain
from phy124.errors import InputError, Remedy
from phy124.gaussians import Gaussians
from phy124.materials import AnyMaterial
from phy124.particles import Particles
from phy124.runtime.memory import free_memory
from phy124.scene import Scene, SceneObject

MUCH_STIFFER = 3.0
"""A material whose waves are this many times faster than those of all others gets a note."""
MEMORY_FRACTION = 0.8
"""Largest fraction of the free memory that a run may take."""

FARTHEST_CELLS = 1e5
"""Distance from the origin [cells] up to which float32 resolves a hundredth of a cell."""


def refuse_hopeless(
    gaussians: Gaussians,
    particles: Particles,
    scene: Scene,
    device: str = "cpu",
    *,
    keep: bool = True,
) -> Demand:
    """What the run needs, if it can be done.

    Args:
        gaussians: The object as placed in the scene.
        particles: The particles made from it.
        scene: The scene.
        device: Warp device.
        keep: Whether all frames stay in memory.

    Raises:
        InputError: It would exceed its time budget or the free memory, or the object is so high up
            that float32 cannot tell positions within a cell apart.
    """
    _refuse_far(scene)
    demand = demand_of(gaussians, particles, scene, device, keep=keep)
    budget = scene.time.budget
    if demand.seconds > budget:

        def fits(other: Scene) -> bool:
            needed = demand_of(gaussians, particles, other, device, keep=keep)
            return needed.seconds <= other.time.budget

        found = _fitting(scene, demand.seconds / budget, fits)
        raise InputError(
            "time.budget",
            f"{budget:g} s",
            f"the run is forecast to take {duration(demand.seconds)} "
            f"({demand.substeps:.2g} substeps of {len(particles):,} particles).",
            _would_fit(found),
            found,
        )
    _refuse_large(demand, scene, device)
    return demand


def _refuse_large(demand: Demand, scene: Scene, device: str) -> None:
    """Make sure that memory is there, the device's first.

    Raises:
        InputError: It is not.
    """
    on_device = math.inf if device == "cpu" else free_memory(device)
    if demand.state > MEMORY_FRACTION * on_device:
        raise InputError(
            "device",
            device,
            f"the run is forecast to take {demand.state / 1e9:.1f} GB of its memory, "
            f"{on_device / 1e9:.1f} GB are free.",
            "Use a coarser accuracy or fewer Gaussians, or choose cpu.",
        )
    free = free_memory()
    if demand.memory > MEMORY_FRACTION * free:
        most = int(scene.time.frames * MEMORY_FRACTION * free / demand.memory)
        raise InputError(
            "time.frames",
            scene.time.frames,
            f"the run is forecast to take {demand.memory / 1e9:.1f} GB of memory, "
            f"{free / 1e9:.1f} GB are free.",
            f"Use at most {most} frames, or fewer Gaussians."
            if most > 1
            else "Use fewer Gaussians or a coarser accuracy.",
            [plain("time.frames", most)] if most > 1 else [],
        )


def _refuse_far(scene: Scene) -> None:
    lift, most = scene.object.lift, _rounded(FARTHEST_CELLS * scene.dx)
    if lift <= most:
        _refuse_apart(scene, most)
        return
    raise InputError(
        "object.lift",
        f"{lift:g} m",
        f"Gaussians are float32, which resolves {np.spacing(np.float32(lift)):.2g} m there, "
        f"and a cell has {scene.dx:.2g} m.",
        f"Use at most {most:g} m, and move what it falls on by the same distance.",
        [plain("object.lift", most)],
    )


def _refuse_apart(scene: Scene, most: float) -> None:
    """Make sure that each object has a place which its numbers resolve.

    Raises:
        InputError: One is too far from the origin.
    """
    for one in scene.every_object:
        farthest = max(*map(abs, one.place), one.lift)
        if farthest > most:
            limit = f"it is farther from the origin than a cell of {scene.dx:.2g} m is resolved."
            raise InputError(f"place or lift of {one.name}", f"{farthest:g} m", limit,
                             f"Use at most {most:g} m.")  # fmt: skip


def _would_fit(found: Sequence[Remedy]) -> str:
    """What would fit, as a sentence."""
    if not found:
        return "No single change would fit: use fewer frames and a coarser accuracy."
    return f"{listed([remedy.words for remedy in found])} would fit."


def _fitting(scene: Scene, excess: float, fits: Callable[[Scene], bool]) -> tuple[Remedy, ...]:
    """Settings of which each makes a run `excess` times cheaper and passes `fits`."""
    found = []
    for remedy in _cheaper(scene, excess):
        try:
            changed = scene.replaced(remedy.changes)
        except InputError:
            continue
        if fits(changed):
            found.append(remedy)
    return tuple(found)


def _cheaper(scene: Scene, excess: float) -> Iterator[Remedy]:
    """Settings that may be enough; the one that causes the many substeps comes first."""
    timing = scene.time.model_copy(update={"substep": None})
    automatic = rest_substeps(scene.model_copy(update={"time": timing}))
    if scene.time.substep is not None and automatic < rest_substeps(scene):
        yield plain("time.substep", _rounded(1.05 * scene.time.substep * excess))
    # What a file says of the material, the scene's own fields do not change.
    by_file = scene.properties is not None
    if not scene.parts and not by_file:
        for name in ("damping", "viscosity"):
            if getattr(scene.material, name, 0) > 0:
                yield plain(
                    f"material.{name}", _rounded(0.95 * getattr(scene.material, name) / excess)
                )
    for field, section in _sections(scene):
        E = getattr(section, "simulated_E", getattr(section, "E", None))
        if E is not None and not by_file:
            yield plain(f"{field}.E", _rounded(0.95 * E / excess**2))
    yield plain("time.frames", max(1, int(0.95 * (scene.time.frames - 1) / excess) + 1))
    yield accuracy(scene, cells=max(4, int(0.95 * scene.resolution.cells / excess)))
    yield plain("time.budget", _rounded(1.05 * scene.time.budget * excess))


def _sections(scene: Scene) -> Iterator[tuple[str, AnyMaterial]]:
    """The moving materials and the fields that set them, those with the fastest waves first."""
    prefixes = ["", *(f"objects.{i}." for i in range(len(scene.objects)))]
    every = [
        found
        for prefix, one in zip(prefixes, (scene, *scene.objects), strict=True)
        if not getattr(one, "scenery", False)
        for found in _own_sections(prefix, one)
    ]
    yield from sorted(every, key=lambda item: -item[1].wave_speed())


def _own_sections(prefix: str, one: Scene | SceneObject) -> Iterator[tuple[str, AnyMaterial]]:
    """The moving materials of one object and the fields that set them."""
    yield f"{prefix}material", one.material
    for index, part in enumerate(one.parts):
        if not part.static:
            yield f"{prefix}parts.{index}.material", part.material


def _rounded(value: float) -> float:
    """A value rounded to two digits, which is enough to type."""
    return float(f"{value:.2g}")


def stiffest_part(scene: Scene) -> str | None:
    """A sentence if one material needs many more substeps than all others would; otherwise None."""
    fastest, *others = _sections(scene)
    if not others:
        return None
    field, section = fastest
    ratio = section.wave_speed() / max(others[0][1].wave_speed(), 1e-9)
    if ratio < MUCH_STIFFER:
        return None
    remedy = section.cheaper(field)
    if field != "material":
        part = field.removesuffix(".material")
        remedy += f", or {part}.static = true, if nothing rests on it,"
    return (
        f"{field} ({section.law}) is so stiff that it alone needs {rest_substeps(scene):,.0f} "
        f"substeps, {ratio:.0f} times as many as the others: {remedy} makes the run as much faster."
    )


def duration(seconds: float) -> str:
    """A time in words."""
    if seconds < 5400:
        return f"{seconds:.0f} s"
    if seconds < 2 * 86400:
        return f"{seconds / 3600:.1f} hours"
    return f"{seconds / 86400:.3g} days"
