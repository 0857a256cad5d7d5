"""The report of a run as plain data; its keys are documented in docs/reference/report.md."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from phy124.budget.effects import Effects
from phy124.budget.limits import note_stiffest_part
from phy124.io.clip import Clip
from phy124.monitor import OBSERVERS
from phy124.monitor.sleep import Sleep
from phy124.mpm.timestep import CFL, beside_elastic
from phy124.simulation import bodies, buried

Run = Any
"""A `Simulation`, which is built on this module."""


def report_of(run: Run) -> dict[str, Any]:
    """What a run did."""
    solver = run.solver
    effects = Effects.of(
        run.scene.with_solids(),
        sh_degree=run.gaussians.sh_degree,
        device=run.device,
        static=run.scenery.count,
        materials=run.materials,
        observers=run.observers,
    )
    report = {
        "complete": run.stopped is None and run.count == run.scene.time.frames,
        "stopped": run.stopped,
        "remedies": [remedy.changes for remedy in run.remedies],
        "gaussians": len(run.shown),
        "grains": len(run.shown) - len(run.gaussians),
        "particles": len(run.particles),
        "mass": float(run.particles.mass.sum()),
        "thickness": run.thickness,
        "cleaning": run.cleaning,
        "notes": _notes(run),
        "grid": {"dx": solver.model.dx, "window": solver.grid.size.tolist()},
        "substeps": solver.clock.substeps,
        "threads": len(solver.workers),
        "limiters": solver.clock.limiters,
        "substep": _substep(run),
        "frames": run.count,
        "static": run.scenery.count,
        "effects": effects.data(
            particles=len(run.particles),
            substeps=solver.clock.substeps,
            nodes=solver.nodes,
            threads=len(solver.workers),
        ),
        "substep_stages": [
            {"name": name, "seconds": seconds, "launches": launches}
            for name, (seconds, launches) in solver.timings.items()
        ],
    }
    if run.scene.objects:
        report["objects"] = _objects(run)
    for section in _sections(run):
        for key, value in section.items():
            both = isinstance(value, dict) and isinstance(report.get(key), dict)
            report[key] = {**report[key], **value} if both else value
    return report


def _sections(run: Run) -> Iterator[dict[str, Any]]:
    """Yield the section of each observer, and what stands for those that the run does not have."""
    frames = run.frames if run.keep else ()
    yield from (observer.report(frames) for observer in run.observers)
    present = {type(observer) for observer in run.observers}
    yield from (kind.absent for kind in OBSERVERS if kind not in present)


def _objects(run: Run) -> dict[str, Any]:
    """Of each object its counts, and the middle of its particles at rest [m]."""
    found = {}
    for index, name in enumerate(run.scene.names):
        own = run.particles.body == index
        shown = run.shown.object_id == index
        middle = run.particles.x[own].mean(axis=0) if own.any() else run.shown.means[shown].mean(0)
        found[name] = {
            "gaussians": int(shown.sum()),
            "particles": int(own.sum()),
            "mass": float(run.particles.mass[own].sum()),
            "place": middle.tolist(),
        }
    for place, one in enumerate(run.solver.free.all):
        poses = [pose[place].tolist() for pose in run.poses]
        found[one.name] |= {"mass": one.mass, "poses": poses}
    return found


def counted(run: Run, clip: Clip) -> dict[str, Any]:
    """What is known once the clip is whole: its Gaussians, and the shapes they took."""
    whole = len(clip.opacities)
    return {
        "gaussians": whole,
        "grains": whole - len(run.gaussians),
        "shine": run.look.shine(run.materials),
        "shapes": run.look.shapes(clip, run.materials),
    }


def _substep(run: Run) -> dict[str, Any]:
    """How long the substeps were and what limited them."""
    clock, asked = run.solver.clock, run.scene.time.substep
    taken = max(sum(clock.limiters.values()), 1)
    sleep = run.find(Sleep)
    mean = (clock.time - (sleep.skipped if sleep else 0) / run.scene.time.fps) / taken
    return {
        "mean": mean,
        "asked": asked,
        "split": asked is not None and mean < 0.99 * asked,
        "fractions": {name: count / taken for name, count in clock.limiters.items()},
        "rejected": run.solver.rejection.rejected,
        "retried": run.retried,
    }


def _too_bold(run: Run) -> list[str]:
    """A sentence if a large fraction of the elastic limit only shortened the substeps."""
    clock = run.solver.clock
    cfl, taken = run.scene.resolution.fraction, sum(clock.limiters.values())
    if cfl <= CFL or 2 * clock.limiters.get("viscous", 0) <= taken:
        return []
    gain = beside_elastic(CFL) / max(beside_elastic(cfl), 1e-9)
    return [
        "Viscosity limits the substeps, the more the nearer they may come to the elastic limit: "
        f"with accuracy.cfl = {CFL:g} instead of {cfl:g} they would be {gain:.2g} times as long."
    ]


def _notes(run: Run) -> list[str]:
    """What the user should know about the materials and about how the run went."""
    notes = [note for section in run.scene.materials for note in section.notes()]
    stiff = note_stiffest_part(run.scene)
    coarse = bodies.notes(run.scene) + buried.notes(run.scene.boundaries, run.solver.model)
    coarse += _too_bold(run)
    observed = [note for observer in run.observers for note in observer.notes()]
    return notes + coarse + ([stiff] if stiff else []) + observed + run.remarks
