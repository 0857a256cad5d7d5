"""Every constitutive law in NumPy, float64, by singular values as in the papers.

Each takes F [N,3,3], the velocity gradient C [N,3,3], history h [N,2] and one row theta, and shares
nothing with the device code: no series, no closed-form eigenvalues, no Newton iteration.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]
EYE = np.eye(3)
SMALLEST_J = 1e-4
SMALLEST_STRETCH = 1e-4
MIN_J = 1e-4
HARDEST = 4.0
LOOSEST = 1e6


class Twin(NamedTuple):
    """The host side of a law."""

    energy: Callable[[Array, Array, Array], Array]
    stress: Callable[[Array, Array, Array, Array], Array]
    project: Callable[[Array, Array, Array, float], tuple[Array, Array]] | None = None


def signed_svd(F: Array) -> tuple[Array, Array, Array]:
    """Return U, s and V^T with rotations U and V; the smallest s has the sign of det F."""
    U, s, Vt = np.linalg.svd(F)
    for M in (U, Vt):
        flip = np.linalg.det(M) < 0
        if M is U:
            M[flip, :, 2] *= -1
        else:
            M[flip, 2, :] *= -1
        s[flip, 2] *= -1
    return U, s, Vt


def spread(U: Array, d: Array, W: Array) -> Array:
    """U diag(d) W."""
    return np.einsum("nij,nj,njk->nik", U, d, W)


def from_axes(U: Array, d: Array) -> Array:
    """U diag(d) U^T."""
    return spread(U, d, U.transpose(0, 2, 1))


def log_volume(J: Array) -> Array:
    safe = np.log(np.maximum(J, SMALLEST_J))
    return np.where(J > SMALLEST_J, safe, np.log(SMALLEST_J) + (J - SMALLEST_J) / SMALLEST_J)


def neo_hookean_energy(F: Array, h: Array, t: Array) -> Array:
    logJ = log_volume(np.linalg.det(F))
    return t[0] / 2 * ((F**2).sum((1, 2)) - 3) - t[0] * logJ + t[1] / 2 * logJ**2


def neo_hookean(F: Array, C: Array, h: Array, t: Array) -> Array:
    logJ = log_volume(np.linalg.det(F))[:, None, None]
    return t[0] * (F @ F.transpose(0, 2, 1) - EYE) + t[1] * logJ * EYE


def neo_hookean_damped(F: Array, C: Array, h: Array, t: Array) -> Array:
    J = np.clip(np.linalg.det(F), 0, 1)[:, None, None]
    return neo_hookean(F, C, h, t[:2]) + J * t[2] * (C + C.transpose(0, 2, 1))


def fixed_corotated_energy(F: Array, h: Array, t: Array) -> Array:
    _, s, _ = signed_svd(F)
    return t[0] * ((s - 1) ** 2).sum(1) + t[1] / 2 * (s.prod(1) - 1) ** 2


def fixed_corotated(F: Array, C: Array, h: Array, t: Array) -> Array:
    U, s, _ = signed_svd(F)
    J = s.prod(1, keepdims=True)
    return from_axes(U, 2 * t[0] * (s - 1) * s + t[1] * J * (J - 1))


def strains(F: Array) -> tuple[Array, Array, Array]:
    """U, log stretches, and V^T with the signs of the stretches."""
    U, s, Vt = signed_svd(F)
    signs = np.where(s < 0, -1, 1)
    return U, np.log(np.maximum(np.abs(s), SMALLEST_STRETCH)), signs[:, :, None] * Vt


def hencky_energy(F: Array, h: Array, t: Array) -> Array:
    _, e, _ = strains(F)
    return t[0] * (e**2).sum(1) + t[1] / 2 * e.sum(1) ** 2


def hencky(F: Array, C: Array, h: Array, t: Array) -> Array:
    U, e, _ = strains(F)
    return from_axes(U, 2 * t[0] * e + t[1] * e.sum(1, keepdims=True))


def radial(F: Array, h: Array, flow_of: Callable[[float, float], float]) -> tuple[Array, Array]:
    """Shrink the deviatoric strain by flow_of(its norm, plastic strain so far)."""
    U, e, Vt = strains(F)
    dev = e - e.mean(1, keepdims=True)
    size = np.linalg.norm(dev, axis=1)
    flow = np.array([flow_of(n, k) for n, k in zip(size, h[:, 0], strict=True)])
    fraction = np.divide(flow, size, out=np.zeros_like(size), where=size > 0)
    new = e - fraction[:, None] * dev
    return spread(U, np.exp(new), Vt), np.column_stack([h[:, 0] + flow, h[:, 1]])


def von_mises(F: Array, h: Array, t: Array, dt: float) -> tuple[Array, Array]:
    mu, _, limit, slope, minimum = t

    def flow(size: float, past: float) -> float:
        def excess(f: float) -> float:
            return 2 * mu * (size - f) - max(limit + slope * (past + f), minimum)

        return 0.0 if excess(0.0) <= 0 else brentq(excess, 0, size, xtol=1e-15, rtol=1e-14)

    return radial(F, h, flow)


def herschel_bulkley(F: Array, h: Array, t: Array, dt: float) -> tuple[Array, Array]:
    mu, _, limit, eta, n = t

    def flow(size: float, past: float) -> float:
        def residual(f: float) -> float:
            left = max(2 * mu * (size - f) - limit, 0.0)
            return f - dt * (left / eta) ** (1 / n)

        most = size - limit / (2 * mu)
        return 0.0 if most <= 0 else brentq(residual, 0, most, xtol=1e-15, rtol=1e-14)

    return radial(F, h, flow)


def drucker_prager(F: Array, h: Array, t: Array, dt: float) -> tuple[Array, Array]:
    mu, lam, alpha = t
    U, e, Vt = strains(F)
    corrected = e + h[:, :1] / 3
    trace = corrected.sum(1)
    dev = e - e.mean(1, keepdims=True)
    size = np.linalg.norm(dev, axis=1)
    flow = np.maximum(size + (3 * lam + 2 * mu) / (2 * mu) * trace * alpha, 0)
    fraction = np.divide(flow, size, out=np.zeros_like(size), where=size > 0)
    new = np.where(trace[:, None] >= 0, 0, corrected - fraction[:, None] * dev)
    volume = h[:, 0] + e.sum(1) - new.sum(1)
    return spread(U, np.exp(new), Vt), np.column_stack([volume, h[:, 1]])


def snow_factor(h: Array, t: Array) -> Array:
    return np.exp(np.clip(-t[4] * h[:, 0], -HARDEST, HARDEST))


def snow_energy(F: Array, h: Array, t: Array) -> Array:
    return snow_factor(h, t) * fixed_corotated_energy(F, h, t)


def snow(F: Array, C: Array, h: Array, t: Array) -> Array:
    return snow_factor(h, t)[:, None, None] * fixed_corotated(F, C, h, t)


def snow_return(F: Array, h: Array, t: Array, dt: float) -> tuple[Array, Array]:
    U, s, Vt = signed_svd(F)
    largest = 1 + (t[3] - 1) * (1 + h[:, 1:])
    new = np.clip(np.abs(s), t[2], largest) * np.where(s < 0, -1, 1)
    volume = np.minimum((1 + h[:, 0]) * s.prod(1) / new.prod(1), LOOSEST) - 1
    after = np.column_stack([volume, h[:, 1]])

    def energy(s: Array, h: Array) -> Array:
        return snow_factor(h, t) * (t[0] * ((s - 1) ** 2).sum(1) + t[1] / 2 * (s.prod(1) - 1) ** 2)

    flows = energy(new, after) <= energy(s, h)
    return np.where(flows[:, None, None], spread(U, new, Vt), F), np.where(flows[:, None], after, h)


def squeezed(F: Array) -> tuple[Array, Array]:
    """Return J, but at least 0.8, and the logarithm of any compression beyond 0.8."""
    J = np.maximum(np.linalg.det(F), MIN_J)
    return np.maximum(J, 0.8), np.log(np.minimum(J / 0.8, 1))


def lag(F: Array, h: Array) -> Array:
    """Return the logarithm of J divided by its value about one relaxation time ago."""
    return np.log(np.maximum(np.linalg.det(F), MIN_J) / np.maximum(h[:, 0], MIN_J))


def tait_energy(F: Array, h: Array, t: Array) -> Array:
    J, more = squeezed(F)
    K, g, _, _, sudden, _ = t
    psi = K / g * (J - 1 + (J ** (1 - g) - 1) / (g - 1))
    slope = K / g * ((g - 1) * J ** (1 - g) + J)
    psi += sudden * lag(F, h) ** 2 / 2
    return psi - J * K / g * (J**-g - 1) * more + slope * more**2 / 2


def tait(F: Array, C: Array, h: Array, t: Array) -> Array:
    J, more = (values[:, None, None] for values in squeezed(F))
    K, g, eta, zeta, sudden, _ = t
    rate = C + C.transpose(0, 2, 1)
    growth = np.trace(rate, axis1=1, axis2=2)[:, None, None] / 2 * EYE
    slope = K / g * ((g - 1) * J ** (1 - g) + J)
    mean = J * K / g * (J**-g - 1) - slope * more - zeta * (J < 1) * growth
    mean = mean - sudden * lag(F, h)[:, None, None]
    return np.minimum(J, 1) * eta * (rate - 2 / 3 * growth) - mean * EYE


def isotropic(F: Array, h: Array, t: Array, dt: float) -> tuple[Array, Array]:
    j = np.maximum(np.trace(F, axis1=1, axis2=2) / 3, 0)
    late = h[:, 0] - np.expm1(-dt * t[5]) * (j**3 - h[:, 0])
    return j[:, None, None] * EYE, np.column_stack([late, h[:, 1]])


TWINS = {
    "neo_hookean": Twin(neo_hookean_energy, neo_hookean),
    "neo_hookean_damped": Twin(neo_hookean_energy, neo_hookean_damped),
    "fixed_corotated": Twin(fixed_corotated_energy, fixed_corotated),
    "hencky": Twin(hencky_energy, hencky),
    "metal": Twin(hencky_energy, hencky, von_mises),
    "plasticine": Twin(fixed_corotated_energy, fixed_corotated, von_mises),
    "foam": Twin(hencky_energy, hencky, herschel_bulkley),
    "sand": Twin(hencky_energy, hencky, drucker_prager),
    "snow": Twin(snow_energy, snow, snow_return),
    "fluid": Twin(tait_energy, tait, isotropic),
}
"""By the name of the device law."""
