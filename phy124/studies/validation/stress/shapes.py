"""Cases 23 and 24: covariances and orientations over a long motion."""

from __future__ import annotations

import numpy as np

from phy124.gaussians import Gaussians, rotation_matrices
from phy124.mpm import Solver
from phy124.simulation.deform import Deformer
from phy124.studies.validation.bodies import block
from phy124.studies.validation.stress.bodies import (
    Array,
    body,
    host,
    stable_dt,
    steps,
    turning,
    vibrating,
)
from phy124.studies.validation.stress.case import Check, Setting, at_least, at_most

FLAT = (0.01, 0.01, 1e-4)
"""Scales of a flat Gaussian, 100:1 [m]."""
APART = 0.05
"""Relative difference of axes above which their directions are well defined."""


def _whirling(setting: Setting, scales: tuple[float, float, float]) -> tuple[Solver, Gaussians]:
    """A body that spins and vibrates, and a Gaussian on each of its particles."""
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
    """Sigma of flat Gaussians equals F Sigma0 F^T in double precision after a long motion."""
    s, flat = _whirling(setting, FLAT)
    carry = Deformer(flat, device=setting.device)
    dt, error, minimum = 0.6 * stable_dt(s), 0.0, np.inf
    for index in range(1, 11):
        steps(s, 2000 if setting.long else 100, dt)
        F = host(s.state.F)
        found = carry(host(s.state.x), F, index=index, time=s.clock.time).gaussians
        wanted = F @ flat.covariances() @ F.transpose(0, 2, 1)
        size = np.linalg.norm(wanted, axis=(1, 2))
        wrong = np.linalg.norm(found.covariances() - wanted, axis=(1, 2)) / size
        error, minimum = max(error, float(wrong.max())), min(minimum, float(found.scales.min()))
    return [
        at_most("relative error of Sigma", error, 2e-5),
        at_least("smallest standard deviation [m]", minimum, 1e-6),
    ]


def continuity(setting: Setting) -> list[Check]:
    """Quaternions are continuous from frame to frame."""
    s, given = _whirling(setting, (0.01, 0.007, 0.003))
    carry = Deformer(given, device=setting.device)
    last, minimum, jump = given, 1.0, 0.0
    for index in range(1, 301 if setting.long else 61):
        s.advance(index / 30)
        frame = carry(host(s.state.x), host(s.state.F), index=index, time=s.clock.time).gaussians
        dots = (frame.quats.astype(np.float64) * last.quats).sum(axis=1)
        minimum = min(minimum, float(dots.min()))
        clear = _distinct(frame) & _distinct(last)
        if clear.any():
            jump = max(jump, float(_turn(frame, last)[clear].max()))
        last = frame
    return [
        at_least("least q(t) . q(t + 1)", minimum, 0.0),
        at_most("largest turn between frames where axes differ [degrees]", jump, 90.0),
    ]


def _distinct(gaussians: Gaussians) -> np.ndarray:
    ordered = np.sort(gaussians.scales.astype(np.float64), axis=1)
    return np.all(np.diff(ordered, axis=1) > APART * ordered[:, 1:], axis=1)


def _turn(one: Gaussians, other: Gaussians) -> Array:
    """Angles between orientations [N], degrees."""
    a, b = rotation_matrices(one.quats), rotation_matrices(other.quats)
    trace = np.einsum("nij,nij->n", a, b)
    return np.degrees(np.arccos(np.clip((trace - 1) / 2, -1, 1)))
