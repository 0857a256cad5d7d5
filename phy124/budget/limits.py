"""Refuses runs beyond the limits of time or memory, and suggests cheaper settings."""

import math
from collections.abc import Callable, Iterator

import numpy as np

from phy124.budget.cost import (
    USUAL,
    Estimate,
    Work,
    count_substeps,
    estimate,
    largest_speed,
    rest_substeps,
)
from phy124.budget.remedies import change_accuracy, change_field, join_alternatives
from phy124.errors import InputError, Remedy, TooFine
from phy124.gaussians import Gaussians
from phy124.materials import AnyMaterial
from phy124.particles import Particles
from phy124.runtime.memory import MEMORY_FRACTION, free_memory
from phy124.scene import Scene
from phy124.scene.liquids import note_compressible

MUCH_STIFFER = 3.0
"""If the ratio of the two largest wave speeds is larger, a note names the stiffest part."""
MANY, LONG = 5.0, 20.0
"""A note about speed is printed if the run needs at least `MANY` times as many substeps as at rest,
and at least `LONG` seconds on a CPU.
"""
FARTHEST_CELLS = 1e5
"""Largest distance [cells] at which float32 resolves a hundredth of a cell."""


def check_limits(
    gaussians: Gaussians,
    particles: Particles,
    scene: Scene,
    device: str = "cpu",
    *,
    keep: bool = True,
) -> Estimate:
    """Check that a run stays within the limits, and return its estimated time and memory.

    Args:
        gaussians: The object's Gaussians in the scene.
        particles: The object's particles.
        scene: The scene.
        device: Warp device.
        keep: Whether all frames stay in memory.

    Raises:
        TooFine: The run would exceed its time budget or the free memory, or an object is so far
            from the origin that float32 cannot resolve positions within a cell.
    """
    _check_distance(scene)
    need = estimate(gaussians, particles, scene, device, keep=keep)
    budget = scene.time.budget
    if need.seconds > budget:

        def fits(other: Scene) -> bool:
            changed = estimate(gaussians, particles, other, device, keep=keep)
            return changed.seconds <= other.time.budget

        fitting = _find_remedies(scene, need.seconds / budget, fits)
        words = join_alternatives([remedy.words for remedy in fitting]) if fitting else ""
        raise TooFine(
            "time.budget",
            f"{budget:g} s",
            f"the run is estimated to take {duration(need.seconds)} "
            f"({need.substeps:.2g} substeps of {len(particles):,} particles).",
            f"{words} would fit."
            if words
            else "No single change is enough: use both fewer frames and a coarser accuracy.",
            fitting,
        )
    _check_memory(need, scene, device)
    return need


def _check_memory(need: Estimate, scene: Scene, device: str) -> None:
    on_device = math.inf if device == "cpu" else free_memory(device)
    if need.state > MEMORY_FRACTION * on_device:
        raise TooFine(
            "device",
            device,
            f"the run is estimated to need {need.state / 1e9:.1f} GB of its memory, and "
            f"{on_device / 1e9:.1f} GB are free.",
            "Use a coarser accuracy or fewer Gaussians, or choose cpu.",
        )
    free = free_memory()
    if need.memory > MEMORY_FRACTION * free:
        raise TooFine(
            "accuracy.cells",
            scene.resolution.cells,
            f"the run is estimated to need {need.memory / 1e9:.1f} GB of memory, and "
            f"{free / 1e9:.1f} GB are free.",
            "Use a coarser accuracy or fewer Gaussians.",
        )


def _check_distance(scene: Scene) -> None:
    """Refuse objects so far away that float32 does not resolve a hundredth of a cell."""
    lift, most = scene.object.lift, _round(FARTHEST_CELLS * scene.dx)
    if lift > most:
        raise TooFine(
            "object.lift",
            f"{lift:g} m",
            "Gaussian positions are float32. At this height, their resolution is "
            f"{np.spacing(np.float32(lift)):.2g} m, too coarse for cells {scene.dx:.2g} m wide.",
            f"Use at most {most:g} m, and lower all other objects and walls by the same distance.",
            [change_field("object.lift", most)],
        )
    for body in scene.every_object:
        farthest = max(*map(abs, body.place), body.lift)
        if farthest > most:
            limit = f"at this distance float32 does not resolve a cell of {scene.dx:.2g} m."
            remedy = f"Use at most {most:g} m."
            raise TooFine(f"place or lift of {body.name}", f"{farthest:g} m", limit, remedy)


def _find_remedies(
    scene: Scene, excess: float, fits: Callable[[Scene], bool]
) -> tuple[Remedy, ...]:
    """Return the changes for which `fits` is true; the run needs `excess` times its budget."""
    fitting = []
    for remedy in _propose_remedies(scene, excess):
        try:
            changed = scene.replaced(remedy.changes)
        except InputError:
            continue
        if fits(changed):
            fitting.append(remedy)
    return tuple(fitting)


def _propose_remedies(scene: Scene, excess: float) -> Iterator[Remedy]:
    """Yield changes that may suffice, beginning with a longer substep."""
    timing = scene.time.model_copy(update={"substep": None})
    automatic = rest_substeps(scene.model_copy(update={"time": timing}))
    if scene.time.substep is not None and automatic < rest_substeps(scene):
        yield change_field("time.substep", _round(1.05 * scene.time.substep * excess))
    # The scene's fields do not change materials that come from a file.
    from_file = scene.properties is not None
    if not scene.parts and not from_file:
        for name in ("damping", "viscosity"):
            value = getattr(scene.material, name, 0)
            if value > 0:
                yield change_field(f"material.{name}", _round(0.95 * value / excess))
    for field, section in _list_materials(scene):
        E = getattr(section, "simulated_E", getattr(section, "E", None))
        if E is not None and not from_file:
            yield change_field(f"{field}.E", _round(0.95 * E / excess**2))
    yield change_field("time.frames", max(1, int(0.95 * (scene.time.frames - 1) / excess) + 1))
    yield change_accuracy(scene, cells=max(4, int(0.95 * scene.resolution.cells / excess)))
    yield change_field("time.budget", _round(1.05 * scene.time.budget * excess))


def _list_materials(scene: Scene) -> list[tuple[str, AnyMaterial]]:
    """Return field and material of each moving part, by decreasing wave speed."""
    materials = []
    prefixes = ["", *(f"objects.{i}." for i in range(len(scene.objects)))]
    for prefix, body in zip(prefixes, (scene, *scene.objects), strict=True):
        if getattr(body, "scenery", False):
            continue
        materials.append((f"{prefix}material", body.material))
        for index, part in enumerate(body.parts):
            if not part.static:
                materials.append((f"{prefix}parts.{index}.material", part.material))
    return sorted(materials, key=lambda item: -item[1].wave_speed())


def _round(value: float) -> float:
    """Round to two significant digits, so that the number is short to type."""
    return float(f"{value:.2g}")


def note_scene(scene: Scene) -> list[str]:
    """Return notes about the solver of a liquid, and about the causes of a long run time."""
    notes = note_compressible(scene), _note_stiffest_part(scene), _note_speed(scene)
    return [note for note in notes if note]


def _note_speed(scene: Scene) -> str | None:
    substeps, seconds = count_substeps(scene), USUAL["cpu"].seconds(Work.of(scene))["simulate"]
    ratio = substeps / max(rest_substeps(scene), scene.time.frames)
    if ratio < MANY or seconds < LONG:
        return None
    return (
        f"Forces, walls and initial speeds may accelerate material to {largest_speed(scene):,.2g} "
        f"m/s. The run may then need {substeps:,} substeps, {ratio:.0f} times as many as at "
        f"rest, and take about {duration(seconds)} on a CPU. To make the run faster, use "
        "smaller forces and speeds, or larger cells."
    )


def _note_stiffest_part(scene: Scene) -> str | None:
    """Return a note if one material needs many more substeps than the others.

    The steps of projected liquids do not depend on a stiffness.
    """
    listed = _list_materials(scene)
    stiff = [item for item in listed if not scene.projects or item[1].law != "fluid"]
    if len(stiff) < 2:
        return None
    (field, section), *others = stiff
    ratio = section.wave_speed() / max(others[0][1].wave_speed(), 1e-9)
    if ratio < MUCH_STIFFER:
        return None
    remedy = section.cheaper(field)
    if field != "material":
        part = field.removesuffix(".material")
        remedy += f", or {part}.static = true, if nothing rests on it,"
    return (
        f"{field} ({section.law}) is so stiff that it needs {rest_substeps(scene):,.0f} substeps, "
        f"{ratio:.0f} times as many as the other materials: {remedy} makes the run faster by this "
        "factor."
    )


def duration(seconds: float) -> str:
    """Format a duration [s] in seconds, hours or days."""
    if seconds < 10:
        return f"{seconds:.2g} s"
    if seconds < 5400:
        return f"{seconds:.0f} s"
    if seconds < 2 * 86400:
        return f"{seconds / 3600:.1f} hours"
    return f"{seconds / 86400:.3g} days"
