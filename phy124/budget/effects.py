"""Effects: which physical and numerical effects a scene calls for, and which it does not.

They are derived from the scene alone. Kernels are chosen by what the scene names, so an effect that
is left out is not compiled, allocated or launched.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

from phy124.materials import AnyMaterial
from phy124.mpm.model import form_of
from phy124.scene import Scene


class Cost(NamedTuple):
    """What an effect costs one core [ns per substep]; measured in docs/results/benchmarks.md."""

    fixed: float = 0.0
    particle: float = 0.0
    """For each particle."""
    node: float = 0.0
    """For each node of the window."""

    def of(self, particles: int, nodes: int) -> float:
        """Of one substep [ns]."""
        return self.fixed + self.particle * particles + self.node * nodes


UNKNOWN = Cost()
NODE = 1.8
"""Cost of clearing and updating one node of the grid [ns]."""
CONTACT = 20
"""Cost for each particle of sharing out what one wall gives [ns]."""
SPLINE = 157
"""Cost for each particle of the gradients of the weights, which have no form for vector units."""
DENSE = 100**3
"""Number of nodes of the dense grid that PhysGaussian's scenes use."""


class Effect(NamedTuple):
    """An effect, and what a scene says about it."""

    name: str
    called_for: bool = True
    why: str = ""
    """Why it is left out, if it is."""
    cost: Cost = UNKNOWN
    """What it would cost."""


@dataclass(frozen=True)
class Omission:
    """An effect that is left out, and why."""

    effect: str
    why: str
    cost: Cost = UNKNOWN


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
        for effect in _catalogue(
            scene, sh_degree, device, slept is not None, materials or scene.materials
        ):
            if effect.called_for:
                ran.append(effect.name + found.get(effect.name, ""))
            else:
                left_out.append(Omission(effect.name, effect.why, effect.cost))
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
        left_out = []
        for omission in self.left_out:
            row: dict[str, Any] = {"effect": omission.effect, "why": omission.why}
            saved = omission.cost.of(particles, nodes) * substeps / threads * 1e-9
            if saved > 0:
                row["saved_seconds"] = round(saved, 3)
            left_out.append(row)
        return {"ran": list(self.ran), "left_out": left_out}


def _catalogue(
    scene: Scene, sh_degree: int, device: str, rested: bool, materials: Sequence[AnyMaterial]
) -> Iterator[Effect]:
    """Every effect, in the order of the report."""
    yield from _of_materials(scene, materials)
    yield from _of_forces(scene)
    yield from _of_checks(scene, materials or scene.materials)
    for wall in scene.boundaries:
        yield Effect(f"collider {wall.kind} ({wall.contact})")
    yield Effect("colliders", bool(scene.boundaries), "the scene has no boundaries")
    if scene.objects:
        yield Effect(f"contact between {len(scene.names)} objects")
    free = [one.name for one in scene.objects if one.free]
    named = f"free rigid solid {' and '.join(free)}" if free else "free rigid solids"
    yield Effect(named, bool(free), "no shape among the objects has the motion free")
    yield from _of_rest(scene, rested)
    yield from _of_frames(scene, sh_degree)
    yield from _of_pictures(scene)
    yield from _of_numerics(scene, device)


def _of_materials(scene: Scene, materials: Sequence[AnyMaterial]) -> Iterator[Effect]:
    """Viscosity: damped stress against plain; a return mapping: metal's G2P against an elastic one;
    several materials: every particle asked for its law.
    """
    laws = sorted({section.law for section in materials})
    named = " and ".join(laws)
    plastic = any(section.device_law.project is not None for section in materials)
    rubbing = any(isfinite(section.viscous_limit(scene.dx)) for section in materials)
    yield from (Effect(f"stress {law}") for law in laws)
    yield Effect("viscosity", rubbing, "no material rubs inside", Cost(particle=2))
    yield Effect("return mapping", plastic, f"{named} is elastic", Cost(particle=70))
    yield Effect("total F beside elastic F", plastic, f"{named} keeps all deformation in F")
    loose = any(section.grains for section in materials)
    why = f"{named} does not fall apart" if scene.grains else "grains is off"
    yield Effect("grains inside", loose and scene.grains, why)
    elastic = any(section.device_law.project is None for section in materials)
    why = "nothing elastic could be torn" if scene.grains else "grains is off"
    yield Effect("inside shown once it is torn", elastic and scene.grains, why)
    several = len(laws) > 1 or len(scene.materials) > 1
    yield Effect("several materials", several, "all that moves is of one", Cost(particle=13))
    told = scene.stiffness or scene.properties
    varies = told is not None or len(materials) > len(scene.materials)
    yield Effect("stiffness per particle", varies, "E is the same everywhere")


def _of_forces(scene: Scene) -> Iterator[Effect]:
    """Particle forces: a force on a region and what it gave; time tables: to sample them."""
    pushes = [force for force in scene.acting if not force.uniform]
    timed = any(force.varies for force in scene.acting)
    moving = any(wall.moves for wall in scene.boundaries)
    uniform = len(scene.acting) > len(pushes)
    yield Effect("uniform acceleration", uniform, "no force acts on the whole body")
    yield Effect(
        "particle forces", bool(pushes), "no force names single particles or a region",
        Cost(particle=8),
    )  # fmt: skip
    yield Effect(
        "time tables", timed or moving, "no force or boundary changes in time", Cost(fixed=30e3)
    )


def _of_checks(scene: Scene, materials: Sequence[AnyMaterial]) -> Iterator[Effect]:
    """Stages that only observe; reports time them as `measure` and `external work`."""
    yield Effect(f"limits of the substep measured every {scene.checks.measure} substeps or sooner")
    why = "checks.balance is off: an explosion shows only once values are NaN"
    if scene.checks.balance:
        why = "all forces are steady: nothing has to be summed"
    unsteady = any(not force.uniform or force.varies for force in scene.acting)
    summed = scene.checks.balance and (bool(scene.boundaries) or unsteady)
    yield Effect("balance of momentum and energy", summed, why)
    lost = "checks.energy is off: what is lost is not split into its causes"
    yield Effect("work of the stress", scene.checks.energy, lost)
    elastic = any(section.device_law.project is None for section in materials)
    flows = "all that moves flows, which parts and joins as it should"
    yield Effect("search for what the grid tears, and for pieces, in each frame", elastic, flows)
    yield Effect("substeps tried first where one may be too long, and repeated shorter")


def _of_rest(scene: Scene, rested: bool) -> Iterator[Effect]:
    """What does not move is left out."""
    static = any(part.static for part in scene.parts)
    yield Effect("static Gaussians", static, "no part of the scene is static")
    restless = "it was never at rest for long enough" if scene.time.sleep else "time.sleep is off"
    yield Effect("sleep while all rests", scene.time.sleep and rested, restless)


def _of_frames(scene: Scene, sh_degree: int) -> Iterator[Effect]:
    """What frames hold besides places and shapes."""
    yield Effect("velocities", scene.velocities, "not asked for; they follow from the positions")
    walls = len(scene.boundaries)
    asked = scene.keeps_contacts and walls > 0
    cost = Cost(particle=CONTACT * walls)
    yield Effect("contact forces", asked, "not asked for, or nothing is solid", cost)
    kept = scene.keeps_wrenches and walls > 0
    yield Effect("force and torque per wall", kept, "not asked for, or nothing is solid")
    drawn = ", ".join(scene.view.outputs)
    yield Effect(f"outputs {drawn}".strip(), bool(drawn), "not asked for: only colours are drawn")
    turned = sh_degree > 0
    yield Effect("spherical-harmonic rotation", turned, "colours do not depend on the direction")


def _of_pictures(scene: Scene) -> Iterator[Effect]:
    """What pictures show besides the object."""
    stage = scene.view.stage
    why = f"view.stage is {stage}: pictures show the object alone"
    yield Effect("floor, its shadow, boundaries in pictures", stage == "studio", why)
    shiny = sorted({section.law for section in scene.materials if section.shines})
    why = "nothing is fluid or metal" if scene.view.shine else "view.shine is off"
    gloss = bool(shiny) and scene.view.shine
    yield Effect(f"shine of {' and '.join(shiny) or 'surfaces'}", gloss, why)


def _of_numerics(scene: Scene, device: str) -> Iterator[Effect]:
    """Double precision: float64 against float32; singular values: Warp's svd3."""
    own = scene.binding == "particles"
    rides = "binding is lattice: Gaussians ride on the particles inside and around them"
    yield Effect("every Gaussian a particle", own, rides)
    double = scene.resolution.precision == "float64"
    enough = "single precision is accurate enough: the grid limits it"
    yield Effect("double precision", double, enough, Cost(particle=48))
    transfer = scene.resolution.transfer
    kept = "accuracy.transfer is apic: particles keep only what the grid carries"
    yield Effect(f"transfer {transfer}".replace(" apic", " beyond apic"), transfer != "apic", kept)
    calm = scene.resolution.rpic_damping > 0
    kept = "accuracy.rpic_damping is 0: particles keep the strain rate that the grid gives them"
    yield Effect("RPIC damping", calm, kept, Cost(particle=15))
    spline = scene.resolution.gradient == "spline"
    fit = "accuracy.gradient is affine: stress and strain come from the fit around each particle"
    yield Effect("gradients of the weights", spline, fit, Cost(particle=SPLINE))
    rows = form_of(scene.resolution.precision, device, scene.resolution.gradient) == "simd"
    why = "only for float32 on the CPU with accuracy.gradient = affine"
    yield Effect("SIMD rows", rows, f"{why}, this is {device}")
    window = "a window of cells follows the particles; a dense grid has 100^3 nodes"
    yield Effect("dense grid", False, window, Cost(fixed=NODE * DENSE, node=-NODE))
    once = "shapes are decomposed once per frame"
    yield Effect("singular values in substeps", False, once, Cost(particle=337))
