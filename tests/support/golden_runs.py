"""The recorded runs of PhysGaussian, converted to phy124's classes."""

from typing import ClassVar, Literal

import numpy as np

from phy124.boundaries import Container, HalfSpace
from phy124.forces import Force, Gravity, ParticleForce, SetVelocity
from phy124.materials import FixedCorotated, Fluid, Material, Metal, Plasticine, Sand
from phy124.mpm import Solver
from phy124.schema.region import Region
from phy124.studies.validation.bodies import make_solver
from reference.physgaussian import Recording


class Exact(HalfSpace):
    """A plane as in PhysGaussian, which acts on all nodes behind it."""

    kind: Literal["exact"] = "exact"  # type: ignore[assignment]
    shape: ClassVar[str] = "half_space"

    def reach(self, dx: float) -> float:
        del dx
        return 0.0


class Undamped(Fluid):
    """A fluid as in PhysGaussian, without damping of sound."""

    def theta_on(self, dx: float, cfl: float) -> tuple[float, ...]:
        del dx, cfl
        return self.theta()


def material_of(params: dict) -> Material:
    """Return the phy124 material for a material of PhysGaussian."""
    common = {"density": params["density"]}
    if params["material"] == "fluid":
        # PhysGaussian's p = -K (J^-1.1 - 1) is the Tait pressure with K' = 1.1 K and gamma = 1.1.
        return Undamped(bulk_modulus=1.1 * params["bulk_modulus"], gamma=1.1, **common)
    common |= {"E": params["E"], "nu": params["nu"]}
    if params["material"] == "sand":
        return Sand(friction_angle=params["friction_angle"], **common)
    if params["material"] in ("metal", "plasticine"):
        # PhysGaussian's yield_stress is the norm of the deviatoric stress; phy124's is the uniaxial
        # stress.
        uniaxial = np.sqrt(1.5) * params["yield_stress"]
        if params["material"] == "metal":
            return Metal(yield_stress=uniaxial, **common)
        return Plasticine(yield_stress=uniaxial, softening=1.5 * params["softening"], **common)
    return FixedCorotated(**common)


def solver_of(recording: Recording, **options) -> Solver:
    """Return phy124's solver at the start of a recorded run."""
    meta, data = recording.meta, recording.data
    params, dt, dx = meta["params"], meta["dt"], meta["dx"]
    forces: list[Force] = [Gravity(g=tuple(params["g"]))]
    walls = []
    for bc in meta["bcs"]:
        if bc["type"] == "surface_collider":
            walls.append(Exact(point=bc["point"], normal=bc["normal"], contact="sticky"))
        elif bc["type"] == "bounding_box":
            inside = Region(lower=(2.5 * dx,) * 3, upper=((meta["n_grid"] - 3.5) * dx,) * 3)
            walls += [
                Exact(**wall.model_dump(exclude={"kind"}))
                for wall in Container(inside=inside, contact="separate", friction=0).sides()
            ]
        else:
            point, size = np.array(bc["point"]), np.array(bc["size"])
            region = Region(lower=tuple(point - size), upper=tuple(point + size))
            if bc["type"] == "particle_impulse":
                end = (bc["num_dt"] - 0.5) * dt
                forces.append(ParticleForce(f=bc["force"], region=region, end=end))
            else:
                end = bc["end_time"]
                forces.append(SetVelocity(v=bc["velocity"], region=region, end=end))
    return make_solver(
        data["x0"],
        data["vol"],
        [material_of(params)],
        dx=dx,
        v=data["v0"],
        forces=forces,
        boundaries=walls,
        **options,
    )


def run(solver: Solver, dt: float, steps: int) -> None:
    """Advance by symplectic Euler as PhysGaussian does, with equal lengths of kick and drift."""
    for _ in range(steps):
        solver.step(dt, dt)
