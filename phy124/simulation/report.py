"""Writes the report of a run as plain data; phy124.pipeline.report_keys documents the keys."""

from collections.abc import Iterator
from typing import Any

from phy124.budget.effects import Effects
from phy124.budget.limits import note_scene
from phy124.io.clip import Clip
from phy124.monitor.sleep import Sleep
from phy124.mpm.timestep import CFL, beside_elastic
from phy124.particles.thickness import Proportions
from phy124.simulation import bodies, overlap
from phy124.simulation.setup import Setup

Run = Any
"""A `Simulation`, which cannot be imported here, because its module imports this module."""


def report_run(run: Run) -> dict[str, Any]:
    """Return the report of a run: its results, cost and notes."""
    setup, solver = run.setup, run.solver
    clock, particles = solver.clock, setup.particles
    effects = Effects.of(
        run.scene.with_solids(),
        sh_degree=setup.gaussians.sh_degree,
        device=run.device,
        static=setup.scenery.count,
        materials=setup.materials,
        observers=run.observers,
        no_lattice=setup.no_lattice,
    )
    work = {"particles": len(particles), "substeps": clock.substeps, "nodes": solver.nodes}
    report = {
        "complete": run.stopped is None and run.count == run.scene.time.frames,
        "stopped": run.stopped,
        "remedies": [remedy.changes for remedy in run.remedies],
        "gaussians": len(setup.shown),
        "grains": len(setup.shown) - len(setup.gaussians),
        "particles": len(particles),
        "mass": float(particles.mass.sum()),
        **dict.fromkeys(Proportions._fields),
        **(setup.proportions._asdict() if setup.proportions else {}),
        "cleaning": setup.cleaning,
        "crop": list(setup.crop),
        "notes": _notes(run),
        "unregistered": [*run.scene.unregistered],
        "grid": {"dx": solver.model.dx, "window": solver.grid.size.tolist()},
        "substeps": clock.substeps,
        "threads": len(solver.workers),
        "limiters": clock.limiters,
        "substep": _substep(run),
        "frames": run.count,
        "static": setup.scenery.count,
        "effects": effects.data(**work, threads=len(solver.workers)),
        "substep_stages": [
            {"name": name, "seconds": seconds, "launches": launches}
            for name, (seconds, launches) in run.timings.items()
        ],
    }
    if run.scene.objects:
        report["objects"] = _objects(run)
    for section in _sections(run):
        for key, value in section.items():
            both = isinstance(value, dict) and isinstance(report.get(key), dict)
            report[key] = {**report[key], **value} if both else value
    return report


def report_clip(setup: Setup, clip: Clip) -> dict[str, Any]:
    """Return the entries of the report about the Gaussians of the complete clip."""
    look, count = setup.appearance, len(clip.opacities)
    return {
        "gaussians": count,
        "grains": count - len(setup.gaussians),
        "shine": look.shine(setup.materials),
        "liquids": look.liquids(setup.materials),
        "matte": look.matte(setup.materials),
        "dents": look.dents(setup.materials),
        "fragments": look.fragments(setup.materials),
    }


def _sections(run: Run) -> Iterator[dict[str, Any]]:
    frames = run.frames if run.setup.keep else ()
    yield from (observer.report(frames) for observer in run.observers)
    kinds = (Sleep, *run.setup.observers)
    yield from (kind.absent for kind in kinds if run.find(kind) is None)


def _objects(run: Run) -> dict[str, Any]:
    rows, particles, shown = {}, run.setup.particles, run.setup.shown
    for index, name in enumerate(run.scene.names):
        inside, seen = particles.body == index, shown.object_id == index
        points = particles.x[inside] if inside.any() else shown.means[seen]
        rows[name] = {
            "gaussians": int(seen.sum()),
            "particles": int(inside.sum()),
            "mass": float(particles.mass[inside].sum()),
            "place": points.mean(axis=0).tolist(),
        }
    for place, body in enumerate(run.solver.free.all):
        poses = [pose[place].tolist() for pose in run.poses]
        rows[body.name] |= {"mass": body.mass, "poses": poses}
    return rows


def _substep(run: Run) -> dict[str, Any]:
    clock, asked, sleep = run.solver.clock, run.scene.time.substep, run.find(Sleep)
    taken = max(sum(clock.limiters.values()), 1)
    mean = (clock.time - (sleep.skipped if sleep else 0) / run.scene.time.fps) / taken
    return {
        "mean": mean,
        "asked": asked,
        "split": asked is not None and mean < 0.99 * asked,
        "fractions": {name: count / taken for name, count in clock.limiters.items()},
        "rejected": run.solver.rejection.rejected,
        "retried": run.retried,
    }


def _notes(run: Run) -> list[str]:
    scene = run.scene
    return [
        *_notes_of_materials(run),
        *bodies.notes(scene),
        *overlap.notes(scene, run.solver.model),
        *_cfl_note(run),
        *note_scene(scene),
        *_unregistered_notes(scene.unregistered),
        *(note for observer in run.observers for note in observer.notes()),
        *run.setup.notes,
        *run.remarks,
    ]


def _notes_of_materials(run: Run) -> Iterator[str]:
    """Yield the notes of the scene's materials. A properties file may define many materials, so
    only one material of each law gets its notes.
    """
    sections = run.scene.materials
    if run.scene.properties is not None:
        sections = {type(section): section for section in run.setup.materials}.values()
    yield from dict.fromkeys(note for section in sections for note in section.notes())


def _unregistered_notes(classes: dict[str, str]) -> Iterator[str]:
    for name, group in classes.items():
        yield (
            f"{name} is defined only in your program: the clip can be rendered again, but the run "
            f"cannot be resumed or repeated from its files. An entry point phy124.{group} gives "
            "the class a name for scene files."
        )


def _cfl_note(run: Run) -> list[str]:
    clock = run.solver.clock
    cfl, taken = run.scene.resolution.fraction, sum(clock.limiters.values())
    if cfl <= CFL or 2 * clock.limiters.get("viscous", 0) <= taken:
        return []
    gain = beside_elastic(CFL) / max(beside_elastic(cfl), 1e-9)
    return [
        "Viscosity limits the substeps, in particular if accuracy.cfl is close to 1. With "
        f"accuracy.cfl = {CFL:g} instead of {cfl:g} the substeps would be {gain:.2g} times as long."
    ]
