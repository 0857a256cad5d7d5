"""Cases 1 to 5 and 23 to 25: conserved quantities and Gaussians in long motions."""

import numpy as np

from phy124.boundaries import Ground
from phy124.forces import Gravity
from phy124.gaussians import Gaussians, rotation_matrices
from phy124.materials import FixedCorotated, NeoHookean
from phy124.monitor.diagnostics import diagnose
from phy124.motion.deform import Deformer
from phy124.mpm import Solver
from phy124.studies.validation.bodies import block, turning
from phy124.studies.validation.stress.bodies import (
    Array,
    Meter,
    alike,
    body,
    host,
    stable_dt,
    steps,
    vibrating,
)
from phy124.studies.validation.stress.case import (
    Check,
    Setting,
    at_least,
    at_most,
    equal,
    higher,
    lower,
)


def rest(setting: Setting) -> list[Check]:
    """Check that a body at rest without forces keeps bitwise equal positions."""
    checks = []
    for law in (NeoHookean, FixedCorotated):
        s = body(block(), setting, law(E=1e4))
        start = s.state.x.numpy().copy()
        steps(s, 20_000 if setting.long else 2000, 0.6 * stable_dt(s))
        moved = not np.array_equal(s.state.x.numpy(), start) or s.state.v.numpy().any()
        checks.append(equal(f"{law.__name__} bitwise at rest", not moved))
    return checks


def units(setting: Setting) -> list[Check]:
    """Check that units do not matter: the solver has no absolute threshold."""
    paths = []
    for L, M, T in ((1.0, 1.0, 1.0), (2.0**-17, 2.0**-60, 2.0**-8)):
        x = block(middle=(0, 0, 0.25)) * L
        material = NeoHookean(E=2.0**30 * M / (L * T * T), nu=0.25, density=1024 * M / L**3)
        s = body(
            x,
            setting,
            material,
            size=0.375 * L,
            dx=0.125 * L,
            v=np.tile([3.0 * L / T, 0, -100.0 * L / T], (len(x), 1)),
            forces=[Gravity(g=(0, 0, -2048.0 * L / T**2))],
            boundaries=[Ground(contact="separate")],
        )
        s.advance(2.0**-6 * T)
        paths.append((s.clock.substeps, s.state.x.numpy() / L, s.state.F.numpy()))
    (n, x, F), (m, y, G) = paths
    return [
        equal("equal substeps", n == m and n > 50),
        alike("positions", y, x, setting),
        alike("deformations", G, F, setting),
    ]


def free_fall(setting: Setting) -> list[Check]:
    """Check that a falling body follows the exact parabola, up to rounding.

    The check fails unless the first substep advances velocities by half a substep (leapfrog).
    """
    x = block()
    s = body(x, setting, forces=[Gravity()])
    for until in (0.1, 0.23, 0.5):
        s.advance(until)
    error = host(s.state.x) - (x - [0, 0, 9.81 * 0.5**2 / 2])
    limit = 1e-12 if setting.double else 5e-5
    return [at_most("error / fall", np.abs(error).max() / (9.81 * 0.5**2 / 2), limit)]


def spin(setting: Setting) -> list[Check]:
    """Check that a body conserves angular momentum and energy during eight rotations."""
    x = block()
    s = body(x, setting, NeoHookean(E=1e5), **turning(x, (0, 0, 2 * np.pi)))
    start = diagnose(s)
    s.advance(8.0)
    end = diagnose(s)
    drift = np.linalg.norm(end.angular - start.angular) / np.linalg.norm(start.angular)
    return [
        at_most("angular momentum drift", drift, 1e-12 if setting.double else 1e-4),
        at_most("energy drift", abs(end.energy / start.energy - 1), 0.01),
    ]


def endurance(setting: Setting) -> list[Check]:
    """Check energy and momenta over many substeps of 0.5 and 0.9 of the stability limit."""
    count = 100_000 if setting.long else 2000
    precisions = ["float64"] if setting.double else ["float32", "float64"]
    checks = []
    for fraction in (0.5, 0.9):
        meters = [_endure(setting._replace(precision=p), fraction, count) for p in precisions]
        meter = meters[0]
        checks += [
            at_most(f"k {fraction}: largest / first energy", meter.max_energy, 1.001),
            at_most(f"k {fraction}: spurious momentum", meter.momentum_drift, 1e-5),
            at_most(f"k {fraction}: angular momentum drift", meter.angular_drift, 1e-4),
        ]
        if len(meters) == 2:
            apart = abs(meter.last - meters[1].last) / meters[1].first
            checks.append(at_most(f"k {fraction}: float32 against float64 energy", apart, 1e-3))
    return checks


def _endure(setting: Setting, fraction: float, count: int) -> Meter:
    x = block(8, 0.5, middle=(0.7, 0.7, 0.7))
    motion = vibrating(x, 0.3)
    turn = turning(x, (0.2, 0.5, 1.0))
    motion = {name: motion[name] + turn[name] for name in motion}
    s = body(x, setting, size=0.5, **motion)
    meter, dt = Meter(s), fraction * stable_dt(s)
    for _ in range(50):
        steps(s, count // 50 - 1, dt)
        meter.read(dt)
    return meter


def slow_drift(setting: Setting) -> list[Check]:
    """Check that rounding in float32 does not stop a very slow body."""
    x = block(2, 0.125, middle=(0.7, 0.7, 0.7))
    s = body(x, setting, size=0.125, v=np.tile([1e-3, 0, 0], (8, 1)))
    count = 100_000 if setting.long else 10_000
    before = host(s.state.x)
    steps(s, count, 1e-5)
    way = (host(s.state.x) - before)[:, 0].mean()
    return [
        at_most("relative error of the distance travelled", abs(way / (count * 1e-8) - 1), 0.01)
    ]


FLAT = (0.01, 0.01, 1e-4)
"""Scales of a flat Gaussian [m]."""
APART = 0.05
"""If the relative difference of two lengths is smaller, the directions of the axes are undefined.
"""


def _whirl(setting: Setting, scales: tuple[float, float, float]) -> tuple[Solver, Gaussians]:
    """Return a body that rotates and vibrates, and one Gaussian at each particle."""
    x = block(4, 0.25)
    spin, stretch = turning(x, (0.5, 1.0, 3.0)), vibrating(x, 1.0)
    s = body(x, setting, size=0.25, **{name: spin[name] + stretch[name] for name in spin})
    rng = np.random.default_rng(0)
    quats = rng.normal(size=(len(x), 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    grey = np.full((len(x), 3), 0.5)
    shapes = np.tile(scales, (len(x), 1))
    return s, Gaussians.from_rgb(x, quats, shapes, np.ones(len(x)), grey)


def covariances(setting: Setting) -> list[Check]:
    """Check that the covariances of flat Gaussians equal `F Sigma0 F^T` after a long motion."""
    s, flat = _whirl(setting, FLAT)
    carry = Deformer(flat, device=setting.device)
    dt, error, minimum = 0.6 * stable_dt(s), 0.0, np.inf
    for index in range(1, 11):
        steps(s, 2000 if setting.long else 100, dt)
        F = host(s.state.F)
        rendered = carry(host(s.state.x), F, index=index, time=s.clock.time).gaussians
        wanted = F @ flat.covariances() @ F.transpose(0, 2, 1)
        size = np.linalg.norm(wanted, axis=(1, 2))
        wrong = np.linalg.norm(rendered.covariances() - wanted, axis=(1, 2)) / size
        error, minimum = higher(error, wrong.max()), lower(minimum, rendered.scales.min())
    return [
        at_most("relative error of Sigma", error, 2e-5),
        at_least("smallest standard deviation [m]", minimum, 1e-6),
    ]


def continuity(setting: Setting) -> list[Check]:
    """Check that the Gaussians' quaternions are continuous from frame to frame."""
    s, gaussians = _whirl(setting, (0.01, 0.007, 0.003))
    carry = Deformer(gaussians, device=setting.device)
    last, minimum, jumps = gaussians, 1.0, []
    for index in range(1, 301 if setting.long else 61):
        s.advance(index / 30)
        frame = carry(host(s.state.x), host(s.state.F), index=index, time=s.clock.time).gaussians
        dots = (frame.quats.astype(np.float64) * last.quats).sum(axis=1)
        minimum = lower(minimum, dots.min())
        clear = _distinct(frame) & _distinct(last)
        jumps.append(_turn(frame, last)[clear])
        last = frame
    return [
        at_least("least q(t) . q(t + 1)", minimum, 0.0),
        at_most(
            "largest rotation per frame of Gaussians with three distinct axes [degrees]",
            np.concatenate(jumps).max(),
            90.0,
        ),
    ]


def _distinct(gaussians: Gaussians) -> np.ndarray:
    ordered = np.sort(gaussians.scales.astype(np.float64), axis=1)
    return np.all(np.diff(ordered, axis=1) > APART * ordered[:, 1:], axis=1)


def _turn(first: Gaussians, other: Gaussians) -> Array:
    """Return the angles between two sets of orientations [N], degrees."""
    a, b = rotation_matrices(first.quats), rotation_matrices(other.quats)
    trace = np.einsum("nij,nij->n", a, b)
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
