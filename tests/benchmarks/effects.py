"""Measures the time saved by leaving effects out: paired ratios in one process, one JSON line each.

switch: a kernel of one law, compared with kernels that contain all thirteen laws, or the ten laws
  without friction, and select a law for each particle; also compared with transfers only. Only
  scatter and gather are measured, not the grid update.
registers: registers per thread of the same kernels, compiled for a GPU (sm_90) and not run.
window: the grid around the particles, compared with the dense domain (20,000 particles in 128^3).
costs: additional time for a force on a region, time tables, a second law, stiffness per particle.
binding: one particle for each Gaussian (as in the paper), compared with Gaussians on a lattice.
scaling: particle-substeps per second and memory from 1,000 to 2,000,000 particles.

Times are CPU times of one thread, unless the row states wall time. Each is the smallest of several
repetitions.
"""

import json
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import laws
import numpy as np
import warp as wp

from phy124.boundaries import Ground
from phy124.camera import Camera
from phy124.forces import Acceleration, Gravity
from phy124.generators import make
from phy124.imaging.cutout import cut_out
from phy124.kernels import elastic, fluid, granular, hencky, plastic, transfer
from phy124.kernels.transfer import Law
from phy124.materials import FixedCorotated, NeoHookean
from phy124.metrics import psnr
from phy124.monitor.external_work import ExternalWork
from phy124.mpm import Solver
from phy124.mpm.tracks import Sine
from phy124.rendering.render import Renderer
from phy124.scene import Scene
from phy124.schema.region import Region
from phy124.simulation import Simulation, prepare

sys.path.insert(0, str(Path(__file__).parents[1]))
from phy124.studies.validation.bodies import make_solver
from support import cubin
from support.shapes import cloud

wp.config.log_level = wp.LOG_WARNING
DUCK = Path(__file__).parents[2] / "demo/examples/duck.png"


vec5 = wp.types.vector(5, float)
vec6 = wp.types.vector(6, float)
"""Parameters of whatever law, and its number: the laws of a scene in the order of `KINDS`."""
KINDS = (
    "neo_hookean", "fixed_corotated", "hencky", "rigid", "metal", "plasticine", "foam", "sand",
    "snow", "fluid", "neo_hookean_damped", "fixed_corotated_damped", "hencky_damped",
)  # fmt: skip


@wp.func
def five_of(theta: vec6):
    """Parameters of whatever law."""
    return vec5(theta[0], theta[1], theta[2], theta[3], theta[4])


@wp.func
def any_lossless(F: wp.mat33, C: wp.mat33, h: wp.vec2, theta: vec6):
    """The stress of the law, of the ten without friction, that an index selects."""
    kind = int(theta[5])
    five = five_of(theta)
    if kind == 0 or kind == 3:
        return elastic.neo_hookean(F, C, h, five)
    if kind == 1 or kind == 5:
        return elastic.fixed_corotated(F, C, h, five)
    if kind == 8:
        return granular.snow(F, C, h, five)
    if kind == 9:
        return fluid.tait(F, C, h, five)
    return hencky.hencky(F, C, h, five)


@wp.func
def any_law(F: wp.mat33, C: wp.mat33, h: wp.vec2, theta: vec6):
    """The stress of the law that an index selects, as in a program without specialised kernels."""
    kind = int(theta[5])
    if kind == 10:
        return elastic.neo_hookean_damped(F, C, h, five_of(theta))
    if kind == 11:
        return elastic.fixed_corotated_damped(F, C, h, five_of(theta))
    if kind == 12:
        return hencky.hencky_damped(F, C, h, five_of(theta))
    return any_lossless(F, C, h, theta)


@wp.func
def any_project(F: wp.mat33, h: wp.vec2, theta: vec6, dt: float):
    """The return mapping of the law that an index selects; elastic laws have none."""
    kind = int(theta[5])
    if kind == 4 or kind == 5:
        return plastic.von_mises(F, h, five_of(theta), dt)
    if kind == 6:
        return plastic.herschel_bulkley(F, h, five_of(theta), dt)
    if kind == 7:
        return granular.drucker_prager(F, h, five_of(theta), dt)
    if kind == 8:
        return granular.snow_return(F, h, five_of(theta), dt)
    if kind == 9:
        return fluid.isotropic(F, h, five_of(theta), dt)
    return F, h


@wp.func
def any_modulus(F: wp.mat33, h: wp.vec2, theta: vec6):
    """The limit of the law that is chosen below."""
    return elastic.neo_hookean_modulus(F, h, theta)


class Switched(NeoHookean):
    """The neo-Hookean law, selected by an index."""

    device_law = Law("switched", any_law, any_modulus, 6, project=any_project)

    def theta(self) -> tuple[float, ...]:
        """Lame parameters and the kind."""
        return (*self.lame, 0.0, 0.0, 0.0, float(KINDS.index("neo_hookean")))


class Fewer(Switched):
    """The same among the ten laws without friction."""

    device_law = Law("switched_lossless", any_lossless, any_modulus, 6, project=any_project)


def cube(count: int, cells: int) -> Solver:
    """Random particles in a cube of half the domain, sorted by cell."""
    x = cloud(count, size=0.3, corner=0.35, dx=1 / cells)
    volume = np.full(count, 0.3**3 / count)
    walls = [Ground(height=0.3)]
    return make_solver(
        x, volume, [NeoHookean()], dx=1 / cells, forces=[Gravity()], boundaries=walls, threads=1
    )


def cost(s: Solver, substeps: int) -> float:
    """CPU nanoseconds per particle and substep."""
    begin = time.thread_time()
    for _ in range(substeps):
        s.step(1e-5, 1e-5)
    return (time.thread_time() - begin) / substeps / len(s.model.rest) * 1e9


def paired(a: Solver, b: Solver, substeps: int, turns: int = 7) -> tuple[float, float]:
    """Least cost of each, in turns after one round of warming up."""
    spent = [(cost(a, substeps), cost(b, substeps)) for _ in range(turns + 1)][1:]
    first, second = np.min(spent, axis=0)
    return float(first), float(second)


def switch(turns: int = 40) -> None:
    for form, simd in (("SIMD rows", True), ("plain", False)):
        kinds = {
            "transfers_ns": laws.Nothing(),
            "alone_ns": NeoHookean(),
            "switch_ns": Switched(),
            "lossless_switch_ns": Fewer(),
        }
        made = {name: laws.solver(law, 0.02, simd=simd) for name, law in kinds.items()}
        one_row_each(made["switch_ns"])
        one_row_each(made["lossless_switch_ns"])
        starts = {name: s.state.snapshot() for name, s in made.items()}
        spent = [[laws.cost(s, starts[name]) for name, s in made.items()] for _ in range(turns)]
        row = dict(zip(kinds, np.min(spent, axis=0).sum(axis=1).tolist(), strict=True))
        row["alone_to_transfers"] = row["alone_ns"] / row["transfers_ns"]
        row["lossless_ratio"] = row["lossless_switch_ns"] / row["alone_ns"]
        show("switch", {"form": form, **row, "ratio": row["switch_ns"] / row["alone_ns"]})


def one_row_each(s: Solver) -> None:
    """Kind and parameters by particle: a kernel that asks cannot know that all are alike."""
    groups = []
    for group in s.model.groups:
        rows = np.tile(group.theta.numpy(), (group.stop - group.start, 1))
        theta = wp.array(rows, dtype=group.theta.dtype, device="cpu")
        groups.append(replace(group, theta=theta))
    s._record()


def costs() -> None:
    count = 60_000
    x = cloud(count, size=0.5, corner=0.2, dx=1 / 40)
    up, half = {"a": (0, 0, 1)}, (np.arange(count) >= count // 2).astype(int)
    fraction = np.random.default_rng(1).random(count) / 2 + 0.5

    def made(*forces: Acceleration, laws=None, **options) -> Solver:
        external = ExternalWork()
        volume, v = np.full(count, 0.125 / count), np.random.default_rng(2).normal(size=x.shape)
        bracketed = external.wrap_forces(forces)
        s = make_solver(
            x,
            volume,
            laws or [NeoHookean()],
            dx=1 / 40,
            v=v,
            forces=bracketed,
            accumulators=[external],
            threads=1,
            **options,
        )
        external.open(s.clock)
        return s

    runs = {
        "nothing": made(),
        "force on a region": made(Acceleration(**up, region=Region(lower=(-9, -9, -9)))),
        "time tables": made(Acceleration(**up, profile=Sine())),
        "a second law": made(laws=(NeoHookean(), FixedCorotated()), material=half),
        "stiffness per particle": made(stiffness=fraction),
    }
    spent = [{name: cost(s, 12) for name, s in runs.items()} for _ in range(13)][1:]
    minimum = {name: min(turn[name] for turn in spent) for name in runs}
    show("costs", {name: ns - minimum["nothing"] for name, ns in minimum.items()})


def registers() -> None:
    kinds = {"transfers": laws.Nothing(), "alone": NeoHookean(), "switch": Switched()}
    row = {}
    for name, material in kinds.items():
        for build in (transfer.make_p2g, transfer.make_g2p):
            kernel = build(material.device_law, wp.float32, "plain")
            row[f"{name}_{build.__name__[-3:]}"] = cubin.registers(kernel, 90)
    show("registers", row)


def window() -> None:
    near, dense = cube(20_000, 128), cube(20_000, 128)
    dense.step(1e-5, 1e-5)
    dense.grid.fit = lambda lower, upper: False  # from here on the window is the whole domain
    dense.grid.rebase(np.zeros(3, int), np.full(3, 128))
    dense._record()
    a, b = paired(near, dense, 16)
    show("window", {"window_ns": a, "dense_ns": b, "ratio": b / a})


def binding() -> None:
    cutout = cut_out(DUCK).picture
    gaussians = make("relief")(cutout, seed=0, progress=lambda *_: None)
    runs = {}
    for kind in ("particles", "lattice"):
        begin = time.process_time()
        run = Simulation(prepare(gaussians, Scene.named("press").replaced({"binding": kind})))
        runs[kind] = run, run.run(), time.process_time() - begin
    (bound, a, own_s), (field, b, field_s) = runs.values()
    draw, camera = Renderer(device="cpu"), Camera.orbit(0, 10, 1.9, 256, (0, 0, 0.35))
    images = [[draw(c.frame(i).gaussians, camera) for c in (a, b)] for i in range(len(a))]
    show(
        "binding",
        {
            "particles": len(bound.particles),
            "lattice": len(field.particles),
            "particles_cpu_s": own_s,
            "field_cpu_s": field_s,
            "rms_path_of_size": float(np.sqrt(((a.means - b.means) ** 2).sum(-1).mean())),
            "psnr_worst_frame": min(float(psnr(x, y)) for x, y in images[1:]),
        },
    )


def scaling() -> None:
    for count in (1_000, 10_000, 100_000, 1_000_000, 2_000_000):
        cells = round((count / 8) ** (1 / 3) / 0.3)
        s = cube(count, max(cells, 16))
        cost(s, 4)
        ns = min(cost(s, max(4, 400_000 // count)) for _ in range(3))
        megabytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        row = {"particles": count, "cpu_ns": ns, "million_per_s": 1e3 / ns, "peak_mb": megabytes}
        show("scaling", row)


def show(name: str, row: dict) -> None:
    """One line."""
    rounded = {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in row.items()}
    print(json.dumps({"what": name, **rounded}), flush=True)


PARTS = {
    "switch": switch,
    "registers": registers,
    "window": window,
    "costs": costs,
    "binding": binding,
    "scaling": scaling,
}

if __name__ == "__main__":
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
