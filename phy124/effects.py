"""Effects: which physical and numerical effects a scene calls for, and which it does not.

They are derived from the scene alone. Kernels are chosen by what the scene names, so an effect that
is left out is not compiled, allocated or launched.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any

from phy124.materials import AnyMaterial
from phy124.scene import Scene

PARTICLE_COSTS = {
    "viscosity": 2,
    "return mapping": 70,
    "several materials": 13,
    "particle forces": 8,
    "double precision": 48,
    "singular values in substeps": 337,
}
"""What effects would cost [ns per particle and substep, on one core].

Measured in docs/results/benchmarks.md: damped stress against plain stress; metal's G2P against an
elastic one; a lookup of each particle's law; a force on a region with its external work; float64
against float32; Warp's svd3.
"""
CHECKS = {
    "measure": "limits of the substep measured",
    "external work": "balance of momentum and energy",
}
"""Stages of a substep that only observe -> the effects they belong to; reports time each stage."""
TABLE_COST = 30e3
"""Cost of sampling the time tables [ns per substep]."""
NODE_COST = 1.8
"""Cost of clearing and updating one node of the grid [ns]."""
DENSE = 100**3
"""Number of nodes of the dense grid that PhysGaussian's scenes use."""


@dataclass(frozen=True)
class Omission:
    """An effect that is left out, and why."""

    effect: str
    why: str


@dataclass(frozen=True)
class Effects:
    """What runs and what does not."""

    ran: tuple[str, ...]
    left_out: tuple[Omission, ...]

    @classmethod
    def of(
        cls,
        scene: Scene,
        *,
        sh_degree: int = 0,
        device: str = "cpu",
        static: int | None = None,
        slept: str | None = "",
        materials: Sequence[AnyMaterial] = (),
    ) -> Effects:
        """The effects a scene calls for.

        Args:
            scene: The scene.
            sh_degree: Degree of the Gaussians' spherical harmonics.
            device: Warp device.
            static: Number of static Gaussians of a finished run; None before a run.
            slept: A sentence about how a finished run slept, None if it did not; "" before a run.
            materials: The materials that a file gave the particles; empty: those of the scene.
        """
        ran, left_out = [], []
        found = {}
        if static:
            found["static Gaussians"] = f": {static} never enter the solver"
        if slept:
            found["sleep while all rests"] = f": {slept}"
        for effect, called_for, why in _catalogue(
            scene, sh_degree, device, slept is not None, materials or scene.materials
        ):
            if called_for:
                ran.append(effect + found.get(effect, ""))
            else:
                left_out.append(Omission(effect, why))
        return cls(tuple(ran), tuple(left_out))

    def data(
        self,
        *,
        particles: int = 0,
        substeps: int = 0,
        nodes: int = 0,
        threads: int = 1,
    ) -> dict[str, Any]:
        """Plain data for the report.

        Given the numbers of a run, an omission whose cost is known also states the seconds it
        saved, estimated from measured costs.

        Args:
            particles: Number of particles.
            substeps: Number of substeps.
            nodes: Number of nodes of the grid's window.
            threads: Number of CPU threads.
        """
        left_out = [asdict(omission) for omission in self.left_out]
        for omission in left_out:
            cost = _cost(omission["effect"], particles, nodes) * substeps / threads * 1e-9
            if cost > 0:
                omission["saved_seconds"] = round(cost, 3)
        return {"ran": list(self.ran), "left_out": left_out}


def _cost(effect: str, particles: int, nodes: int) -> float:
    """What an effect would cost one core [ns per substep]; 0 if that is not known."""
    if effect == "time tables":
        return TABLE_COST
    if effect == "dense grid":
        return NODE_COST * (DENSE - nodes)
    return PARTICLE_COSTS.get(effect, 0) * particles


def _catalogue(
    scene: Scene, sh_degree: int, device: str, rested: bool, materials: Sequence[AnyMaterial]
) -> Iterator[tuple[str, bool, str]]:
    """Every effect: its name, whether the scene calls for it, and if not, why."""
    laws = sorted({section.law for section in materials})
    named = " and ".join(laws)
    plastic = any(section.device_law.project is not None for section in materials)
    pushes = [force for force in scene.acting if not force.uniform]
    timed = [force for force in scene.acting if force.varies]
    moving = [wall for wall in scene.boundaries if wall.moves]
    for law in laws:
        yield f"stress {law}", True, ""
    rubbing = any(isfinite(section.viscous_limit(scene.dx)) for section in materials)
    yield "viscosity", rubbing, "no material rubs inside"
    yield "return mapping", plastic, f"{named} is elastic"
    yield "total F beside elastic F", plastic, f"{named} keeps all deformation in F"
    yield "several materials", len(laws) > 1 or len(scene.materials) > 1, "all that moves is of one"
    varies = scene.stiffness is not None or len(materials) > len(scene.materials)
    yield "stiffness per particle", varies, "E is the same everywhere"
    yield "uniform acceleration", len(scene.acting) > len(pushes), "no force acts on the whole body"
    yield "particle forces", bool(pushes), "no force names single particles or a region"
    yield "time tables", bool(timed or moving), "no force or boundary changes in time"
    every, balance = scene.checks.measure, CHECKS["external work"]
    yield f"{CHECKS['measure']} every {every} substeps or sooner", True, ""
    if scene.checks.balance:
        yield (
            balance,
            bool(scene.boundaries or pushes or timed),
            "all forces are steady: nothing has to be summed",
        )
    else:
        yield balance, False, "checks.balance is off: an explosion shows only once values are NaN"
    for wall in scene.boundaries:
        yield f"collider {wall.kind} ({wall.contact})", True, ""
    yield "colliders", bool(scene.boundaries), "the scene has no boundaries"
    static = any(part.static for part in scene.parts)
    yield "static Gaussians", static, "no part of the scene is static"
    restless = "it was never at rest for long enough" if scene.time.sleep else "time.sleep is off"
    yield "sleep while all rests", scene.time.sleep and rested, restless
    yield "velocities", scene.velocities, "not asked for; they follow from the positions"
    yield "spherical-harmonic rotation", sh_degree > 0, "colours do not depend on the direction"
    double = scene.resolution.precision == "float64"
    yield "double precision", double, "single precision is accurate enough: the grid limits it"
    native = device == "cpu" and not double
    yield "SIMD rows", native, f"only for float32 on the CPU, this is {device}"
    yield (
        "dense grid",
        False,
        "a window of cells follows the particles; a dense grid has 100^3 nodes",
    )
    yield "singular values in substeps", False, "shapes are decomposed once per frame"
