"""The substep of PhysGaussian's solver in NumPy, float64, from the description next to the golden
data.

Explicit APIC with B-spline gradients (not MLS): F evolves with sum v gradW, which is not C.
PhysGaussian's errors are reproduced: a slip plane is sticky, the StVK stress lacks 1 / sigma, snow
has no stress.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reference.oracle import EYE, from_axes, signed_svd, spread

Array = NDArray[np.float64]
OFFSETS = np.stack(np.meshgrid(*[np.arange(3)] * 3, indexing="ij"), -1).reshape(27, 3)


@dataclass
class Recording:
    """A golden file."""

    meta: dict[str, Any]
    data: dict[str, NDArray]

    @classmethod
    def load(cls, folder: Path, case: str) -> Recording:
        """Read one case by the name of its file."""
        with np.load(folder / "mpm" / f"{case}.npz") as file:
            data = {key: file[key] for key in file.files}
        return cls(json.loads(str(data.pop("meta"))), data)

    def at(self, key: str, step: int) -> Array:
        """An array at a saved step."""
        index = self.data["steps"].tolist().index(step)
        return self.data[key][index % len(self.data[key])].astype(np.float64)


def strains(F: Array, minimum: float) -> tuple[Array, Array, Array]:
    U, s, Vt = signed_svd(F)
    return U, np.log(np.maximum(s, minimum)), Vt


def yields(e: Array, mu: Array, limit: Array) -> tuple[Array, Array, Array]:
    """Return where von Mises material yields, the deviator, and its norm plus 1e-6, as in
    PhysGaussian."""
    dev = e - e.mean(1, keepdims=True)
    size = np.linalg.norm(dev, axis=1)
    return 2 * mu * size > limit, dev, size + 1e-6


def metal_map(s: Original, F: Array) -> Array:
    U, e, Vt = strains(F, 0.01)
    flows, dev, norm = yields(e, s.mu, s.limit)
    fraction = (norm - s.limit / (2 * s.mu)) / norm
    return np.where(flows[:, None, None], spread(U, np.exp(e - fraction[:, None] * dev), Vt), F)


def sand_map(s: Original, F: Array) -> Array:
    U, sigma, Vt = signed_svd(F)
    e = np.log(np.maximum(np.abs(sigma), 1e-14))
    dev, trace = e - e.mean(1, keepdims=True), e.sum(1)
    size = np.linalg.norm(dev, axis=1)
    sine = np.sin(np.radians(s.params["friction_angle"]))
    alpha = np.sqrt(2 / 3) * 2 * sine / (3 - sine)
    flow = size + (3 * s.lam + 2 * s.mu) / (2 * s.mu) * trace * alpha
    fraction = np.divide(flow, size, out=np.zeros_like(size), where=size > 0)
    pressed = spread(U, np.exp(e - fraction[:, None] * dev), Vt)
    loose = np.where((trace > 0)[:, None, None], U @ Vt, pressed)
    return np.where((flow <= 0)[:, None, None], F, loose)


def plasticine_map(s: Original, F: Array) -> Array:
    U, e, Vt = strains(F, 0.01)
    flows, dev, norm = yields(e, np.maximum(s.mu, 1e-30), s.limit)
    flows &= s.limit > 0
    fraction = (norm - s.limit / (2 * np.maximum(s.mu, 1e-30))) / norm
    new = np.where(flows[:, None, None], spread(U, np.exp(e - fraction[:, None] * dev), Vt), F)
    lost = s.params["softening"] * np.linalg.norm(fraction[:, None] * dev, axis=1)
    s.limit = s.limit - np.where(flows, lost, 0)
    broken = flows & (s.limit <= 0)
    s.mu, s.lam = np.where(broken, 0, s.mu), np.where(broken, 0, s.lam)
    return new


def jelly_stress(s: Original, F: Array) -> Array:
    U, sigma, _ = signed_svd(F)
    J = sigma.prod(1, keepdims=True)
    mu, lam = s.mu[:, None], s.lam[:, None]
    return from_axes(U, 2 * mu * (sigma - 1) * sigma + lam * J * (J - 1))


def stvk_stress(s: Original, F: Array) -> Array:
    """Return PhysGaussian's StVK stress, which is the Kirchhoff stress times the stretch."""
    U, sigma, _ = signed_svd(F)
    sigma = np.maximum(sigma, 0.01)
    e = np.log(sigma)
    value = 2 * s.mu[:, None] * e + s.lam[:, None] * e.sum(1, keepdims=True)
    return from_axes(U, value * sigma)


def sand_stress(s: Original, F: Array) -> Array:
    U, sigma, _ = signed_svd(F)
    e = np.log(sigma)
    return from_axes(U, 2 * s.mu[:, None] * e + s.lam[:, None] * e.sum(1, keepdims=True))


def no_stress(s: Original, F: Array) -> Array:
    return np.zeros_like(F)


def fluid_stress(s: Original, F: Array) -> Array:
    J = np.linalg.det(F)[:, None, None]
    return -J * s.params["bulk_modulus"] * (J**-1.1 - 1) * EYE


MAPS: dict[str, Callable[[Original, Array], Array]] = {
    "metal": metal_map,
    "sand": sand_map,
    "plasticine": plasticine_map,
}
STRESSES = {
    "jelly": jelly_stress,
    "metal": stvk_stress,
    "sand": sand_stress,
    "snow": no_stress,
    "plasticine": jelly_stress,
    "fluid": fluid_stress,
}


class Original:
    """State and substep of PhysGaussian's solver."""

    def __init__(self, recording: Recording, step: int = 0, *, mls: bool = False) -> None:
        """Begin at a saved step; with `mls`, the gradients of MLS-MPM replace the B-spline
        gradients."""
        self.mls = mls
        meta, at = recording.meta, recording.at
        self.params, self.bcs, self.dt = meta["params"], meta["bcs"], meta["dt"]
        self.n, self.dx, self.count = meta["n_grid"], meta["dx"], step
        self.material = self.params["material"]
        self.mass = recording.data["mass"].astype(np.float64)
        self.volume = recording.data["vol"].astype(np.float64)
        self.x0 = recording.data["x0"].astype(np.float64)
        self.x, self.v, self.C = at("x", step), at("v", step), at("C", step)
        self.F_trial = at("F_trial", step)
        self.mu, self.lam = at("mu", step), at("lam", step)
        self.limit = at("yield_stress", step)
        self.F = self.stress = np.zeros_like(self.F_trial)

    def run(self, until: int) -> None:
        """Take substeps up to a step."""
        while self.count < until:
            self.step()

    def constitute(self) -> None:
        """Compute F = map(F_trial) and its stress for the next substep."""
        self.F = MAPS.get(self.material, lambda _, F: F)(self, self.F_trial)
        self.stress = STRESSES[self.material](self, self.F)

    def step(self) -> None:
        """Take one substep, in the order of the description."""
        time = self.count * self.dt
        self._push(time)
        self.constitute()
        g = self.x / self.dx
        base = np.trunc(g - 0.5).astype(int)
        f = g - base
        w = np.stack([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1) ** 2, 0.5 * (f - 0.5) ** 2], 1)
        dw = np.stack([f - 1.5, -2 * (f - 1), f - 0.5], 1) / self.dx
        i, j, k = OFFSETS.T
        weight = w[:, i, 0] * w[:, j, 1] * w[:, k, 2]
        slope = np.stack(
            [
                dw[:, i, 0] * w[:, j, 1] * w[:, k, 2],
                w[:, i, 0] * dw[:, j, 1] * w[:, k, 2],
                w[:, i, 0] * w[:, j, 1] * dw[:, k, 2],
            ],
            -1,
        )
        d = (OFFSETS[None] - f[:, None]) * self.dx
        nodes = base[:, None] + OFFSETS[None]
        flat = (nodes[..., 0] * self.n + nodes[..., 1]) * self.n + nodes[..., 2]
        rpic = self.params.get("rpic_damping", 0.0)
        C = (1 - rpic) * self.C + rpic / 2 * (self.C - self.C.swapaxes(1, 2))
        if rpic < -0.001:
            C = np.zeros_like(self.C)
        moving = self.v[:, None] + np.einsum("pab,pnb->pna", C, d)
        if self.mls:
            slope = 4 / self.dx**2 * weight[..., None] * d
        push = np.einsum("p,pab,pnb->pna", self.dt * self.volume, self.stress, slope)
        momentum = weight[..., None] * self.mass[:, None, None] * moving - push
        v = self._grid(flat, weight * self.mass[:, None], momentum, time)[flat]
        self.v = np.einsum("pn,pna->pa", weight, v)
        self.C = 4 / self.dx**2 * np.einsum("pn,pna,pnb->pab", weight, v, d)
        gradient = np.einsum("pna,pnb->pab", v, slope)
        self.x = self.x + self.dt * self.v
        self.F_trial = (EYE + self.dt * gradient) @ self.F
        self.count += 1

    def _push(self, time: float) -> None:
        """Impulses and prescribed velocities of the particles."""
        for bc in self.bcs:
            if "size" not in bc:
                continue
            inside = np.all(np.abs(self.x0 - bc["point"]) < bc["size"], axis=1)[:, None]
            start = bc["start_time"]
            if bc["type"] == "particle_impulse":
                if start <= time < start + self.dt * bc["num_dt"]:
                    self.v += inside * np.array(bc["force"]) / self.mass[:, None] * self.dt
            elif start <= np.float32(time) < bc["end_time"]:
                self.v = np.where(inside, bc["velocity"], self.v)

    def _grid(self, flat: NDArray, mass: Array, momentum: Array, time: float) -> Array:
        """Grid velocities after gravity and boundaries."""
        total = np.zeros(self.n**3)
        np.add.at(total, flat, mass)
        v = np.zeros((self.n**3, 3))
        np.add.at(v, flat, momentum)
        full = total > 1e-15
        v[full] = v[full] / total[full, None] + self.dt * np.array(self.params["g"])
        v[~full] = 0
        place = np.stack(np.meshgrid(*[np.arange(self.n)] * 3, indexing="ij"), -1).reshape(-1, 3)
        for bc in self.bcs:
            if bc["type"] == "surface_collider" and bc["start_time"] <= time < bc["end_time"]:
                v[((place * self.dx - bc["point"]) @ np.array(bc["normal"])) < 0] = 0
            if bc["type"] == "bounding_box":
                v = np.where((place < 3) & (v < 0), 0, v)
                v = np.where((place >= self.n - 3) & (v > 0), 0, v)
        return v
