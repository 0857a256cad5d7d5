"""Lists the physical and numerical effects that a scene includes, and the effects that it omits.

An omitted effect is not compiled, has no arrays and launches no kernels.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from phy124.materials import AnyMaterial
from phy124.monitor import observers_for
from phy124.monitor.observer import UNKNOWN, Cost, Effect, Observer, Subject, find
from phy124.mpm.model import form_of
from phy124.scene import Scene
from phy124.scene.lattices import choose_solver, reason_for_mpm
from phy124.scene.liquids import reason_for_compressible

NODE = 1.8
"""Time per grid node [ns]."""
SPLINE = 157
"""Time per particle for gradients of the weights, without vectorisation [ns]."""
STATIC = "static Gaussians"
DENSE = 100**3
"""Number of nodes of the dense grid in PhysGaussian's scenes."""


@dataclass(frozen=True)
class Effects:
    """The effects that a run computes, and the effects that it omits."""

    ran: tuple[str, ...]
    left_out: tuple[Effect, ...]

    @classmethod
    def of(
        cls,
        scene: Scene,
        *,
        sh_degree: int = 0,
        device: str = "cpu",
        static: int | None = None,
        materials: Sequence[AnyMaterial] = (),
        observers: Sequence[Observer] = (),
        no_lattice: str | None = None,
    ) -> Effects:
        """Return the effects that a run computes, and the effects that it omits.

        Args:
            scene: The scene.
            sh_degree: Degree of the Gaussians' spherical harmonics.
            device: Warp device.
            static: Number of static Gaussians in a finished run; None before a run.
            materials: Materials of the particles from a file, or empty.
            observers: Observers of a finished run; empty before a run.
            no_lattice: Reason why no object of a finished run is on a lattice.
        """
        why = reason_for_mpm(scene, device) if no_lattice is None else no_lattice
        scene = choose_solver(scene, device)
        ran, left_out = [], []
        subject = Subject(scene, materials or scene.materials)
        for effect in _catalogue(subject, sh_degree, device, observers, why):
            if effect.called_for:
                counted = static if effect.name == STATIC else None
                ran.append(effect.name + (f": {counted} never enter the solver" if counted else ""))
            else:
                left_out.append(effect)
        return cls(tuple(ran), tuple(left_out))

    def data(
        self, *, particles: int = 0, substeps: int = 0, nodes: int = 0, threads: int = 1
    ) -> dict[str, Any]:
        """Return plain data for the report.

        If the counts of a run are given, the data contain the time [s] that each omitted effect
        saves.

        Args:
            particles: Number of particles.
            substeps: Number of substeps.
            nodes: Number of nodes in the grid's window.
            threads: Number of CPU threads.
        """
        left_out = []
        for effect in self.left_out:
            row: dict[str, Any] = {"effect": effect.name, "why": effect.why}
            saved = effect.cost.of(particles, nodes) * substeps / threads * 1e-9
            if saved > 0:
                row["saved_seconds"] = round(saved, 3)
            left_out.append(row)
        return {"ran": list(self.ran), "left_out": left_out}


def _catalogue(
    subject: Subject, sh_degree: int, device: str, observers: Sequence[Observer], no_lattice: str
) -> Iterator[Effect]:
    scene = subject.scene
    for effect in (*_of_materials(scene, subject.materials), *_of_forces(scene)):
        # The costs were measured with MPM.
        yield effect if _has_mpm(scene) else effect._replace(cost=UNKNOWN)
    if not scene.on_lattice:
        yield Effect("rest lattice", False, no_lattice)
    yield from _of_observers(subject, observers)
    for wall in scene.boundaries:
        yield Effect(f"collider {wall.kind} ({wall.contact})")
    yield Effect("colliders", bool(scene.boundaries), "the scene has no boundaries")
    if scene.objects:
        yield Effect(f"contact between {len(scene.names)} objects")
    free = [body.name for body in scene.objects if body.free]
    name = f"free rigid solid {' and '.join(free)}" if free else "free rigid solids"
    yield Effect(name, bool(free), "no object has the motion free")
    static = any(part.static for part in scene.parts)
    yield Effect(STATIC, static, "no part of the scene is static")
    yield from _of_frames(scene, sh_degree)
    yield from _of_pictures(scene)
    yield from _of_numerics(scene, device)


def _has_mpm(scene: Scene) -> bool:
    """Return whether MPM moves an object: not a lattice, and not a liquid by projection."""
    rows = zip(scene.object_materials, scene.on_lattices, strict=True)
    return any(
        not lattice and any(not scene.projects or each.law != "fluid" for each in sections)
        for sections, lattice in rows
    )


def _of_liquid(scene: Scene) -> Iterator[Effect]:
    yield Effect("pressure projection")
    yield Effect("density kept by moving particles")
    inviscid = (
        "the liquid is inviscid: waves lose energy only by friction at walls and by grid errors"
    )
    viscous = any(getattr(section, "viscosity", 0.0) > 0 for section in scene.materials)
    yield Effect("viscosity", viscous, inviscid)
    yield Effect("surface tension", False, "accuracy.liquid = projection does not compute it")
    grains = scene.grains and any(section.grains for section in scene.materials)
    yield Effect("grains inside", grains, "grains is off")


def _of_materials(scene: Scene, materials: Sequence[AnyMaterial]) -> Iterator[Effect]:
    """Yield the effects of the materials.

    Each cost is the difference between the times of two kernels: with and without viscosity; G2P
    for metal and for an elastic law; and for one law per particle and for a single law.
    """
    if scene.projects:
        yield from _of_liquid(scene)
        return
    if any(section.law == "fluid" for section in materials):
        yield Effect("pressure projection", False, reason_for_compressible(scene))
    laws = sorted({section.law for section in materials})
    words = " and ".join(laws)
    plastic = any(section.device_law.project is not None for section in materials)
    viscous = any(isfinite(section.viscous_limit(scene.dx)) for section in materials)
    yield from (Effect(f"stress {law}") for law in laws)
    yield Effect("viscosity", viscous, "no material is viscous", Cost(particle=2))
    yield Effect("return mapping", plastic, f"{words} is elastic", Cost(particle=70))
    yield Effect("total F in addition to elastic F", plastic, f"{words} keeps all deformation in F")
    granular = any(section.grains for section in materials)
    why = f"{words} is not granular" if scene.grains else "grains is off"
    yield Effect("grains inside", granular and scene.grains, why)
    several = len(laws) > 1 or len(scene.materials) > 1
    yield Effect(
        "several materials", several, "all moving parts have the same material", Cost(particle=13)
    )
    profile = scene.stiffness or scene.properties
    varies = profile is not None or len(materials) > len(scene.materials)
    yield Effect("stiffness per particle", varies, "E is uniform")


def _of_forces(scene: Scene) -> Iterator[Effect]:
    pushes = [force for force in scene.acting if not force.uniform]
    timed = any(force.varies for force in scene.acting)
    moving = any(wall.moves for wall in scene.boundaries)
    uniform = len(scene.acting) > len(pushes)
    yield Effect("uniform acceleration", uniform, "no force acts on the whole body")
    why = "no force acts on a region or on single particles"
    yield Effect("particle forces", bool(pushes), why, Cost(particle=8))
    yield Effect(
        "time tables", timed or moving, "no force or boundary changes in time", Cost(fixed=30e3)
    )


def _of_observers(subject: Subject, observers: Sequence[Observer]) -> Iterator[Effect]:
    """Yield the checks in each substep, and the effect of each observer."""
    every = subject.scene.checks.measure
    yield Effect(f"limits of the substep measured every {every} substeps or sooner")
    if _has_mpm(subject.scene) or subject.scene.projects:
        long = "trial substeps, which are repeated with a shorter substep if they are too long"
        yield Effect(long)
    for kind in dict.fromkeys((*observers_for(subject.scene), *map(type, observers))):
        observer = find(observers, kind)
        effect = kind.effect(subject) if observer is None else observer.finished_effect(subject)
        if effect is not None:
            yield effect


def _of_frames(scene: Scene, sh_degree: int) -> Iterator[Effect]:
    yield Effect(
        "velocities", scene.velocities, "not requested; viewers derive them from the positions"
    )
    drawn = ", ".join(scene.view.outputs)
    yield Effect(f"outputs {drawn}".strip(), bool(drawn), "not requested: only colours are drawn")
    rotated = sh_degree > 0
    yield Effect("spherical-harmonic rotation", rotated, "colours do not depend on the direction")


def _of_pictures(scene: Scene) -> Iterator[Effect]:
    stage = scene.view.stage
    why = f"view.stage is {stage}: pictures show the object alone"
    yield Effect("floor, its shadow, boundaries in pictures", stage == "studio", why)
    shiny = sorted({section.law for section in scene.materials if section.shines})
    why = "there is no fluid and no metal" if scene.view.shine else "view.shine is off"
    gloss = bool(shiny) and scene.view.shine
    yield Effect(f"shine of {' and '.join(shiny) or 'surfaces'}", gloss, why)


def _of_numerics(scene: Scene, device: str) -> Iterator[Effect]:
    bound = scene.binding == "particles"
    why = "binding is lattice: each Gaussian follows the particles inside and around it"
    yield Effect("one particle for each Gaussian", bound, why)
    double = scene.precision == "float64"
    enough, mpm = "single precision is enough: the grid error is larger", _has_mpm(scene)
    if scene.on_lattice and scene.resolution.solver == "auto":
        enough += "; float64 would also choose the solver mpm"
    yield Effect("double precision", double, enough, Cost(particle=48) if mpm else UNKNOWN)
    if not mpm:
        yield Effect("transfers between particles and a grid", False, "MPM moves no object")
        return
    transfer = scene.resolution.transfer
    why = "accuracy.transfer is apic: particles take their velocities from the grid"
    yield Effect(f"transfer {transfer}".replace(" apic", " beyond apic"), transfer != "apic", why)
    damped = scene.resolution.rpic_damping > 0
    why = "accuracy.rpic_damping is 0: particles keep the strain rate of the grid"
    yield Effect("RPIC damping", damped, why, Cost(particle=15))
    spline = scene.resolution.gradient == "spline"
    why = "accuracy.gradient is affine: stress and strain come from the affine fit"
    yield Effect("gradients of the weights", spline, why, Cost(particle=SPLINE))
    rows = form_of(scene.precision, device, scene.resolution.gradient) == "simd"
    why = "only for float32 on the CPU with accuracy.gradient = affine"
    yield Effect("SIMD rows", rows, f"{why}; the device is {device}")
    window = "a window of cells follows the particles; a dense grid has 100^3 nodes"
    yield Effect("dense grid", False, window, Cost(fixed=NODE * DENSE, node=-NODE))
    once = "shapes are decomposed once per frame"
    yield Effect("singular values in substeps", False, once, Cost(particle=337))
