"""Evaluates a law for many states at once, without particles or a grid."""

from typing import Any, NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from phy124 import materials
from phy124.kernels.arguments import types
from phy124.kernels.diagnostics import make_probe
from phy124.materials import Fluid, Material, NeoHookean, Rigid

REALS = {"float32": wp.float32, "float64": wp.float64}


EYE = np.eye(3)
KINDS: dict[str, type[Material]] = materials.LAWS.by_name
"""Every law a scene can name."""
OPTIONS: dict[str, dict[str, float]] = {"metal": {"hardening": 1e4}, "fluid": {"viscosity": 3.0}}
"""Values of fields that are not tested with their defaults."""
LAWS: list[Material] = [
    *(kind(**OPTIONS.get(law, {})) for law, kind in KINDS.items() if kind is not Rigid),
    NeoHookean(damping=3.0),
]
"""One material of each law; a rigid body is a stiff neo-Hookean solid."""
SOLIDS = [law for law in LAWS if not isinstance(law, Fluid)]
PLASTIC = [law for law in SOLIDS if law.device_law.project is not None]


def name(material: Material) -> str:
    return material.device_law.name


def deformations(rng: np.random.Generator, amount: float, count: int = 300) -> NDArray:
    """Random F [N,3,3] with det F > 0.3, away from the identity."""
    F = EYE + amount * rng.standard_normal((4 * count, 3, 3))
    return F[np.linalg.det(F) > 0.3][:count]


def rotations(rng: np.random.Generator, count: int) -> NDArray:
    q, _ = np.linalg.qr(rng.standard_normal((count, 3, 3)))
    return q * np.sign(np.linalg.det(q))[:, None, None]


def transposed(a: NDArray) -> NDArray:
    return np.swapaxes(a, 1, 2)


def relative(a: NDArray, b: NDArray, floor: float) -> float:
    """Return the largest difference of N matrices, relative to the norm of the second or to
    `floor`."""
    size = np.maximum(np.abs(b).reshape(len(b), -1).max(1), floor)
    return float((np.abs(a - b).reshape(len(b), -1).max(1) / size).max())


def deviator(a: NDArray) -> NDArray:
    return a - np.trace(a, axis1=1, axis2=2)[:, None, None] / 3 * EYE


class Point(NamedTuple):
    """Results of a law for N states."""

    stress: NDArray
    """tau [N,3,3], Pa."""
    modulus: NDArray
    """A [N], Pa."""
    energy: NDArray
    """psi [N], J/m^3."""
    F: NDArray
    """F after the return mapping [N,3,3]."""
    history: NDArray
    """History after the return mapping [N,2]."""


def evaluate(
    material: Material,
    F: NDArray,
    *,
    C: NDArray | None = None,
    h: NDArray | None = None,
    dt: float = 1e-3,
    precision: str = "float64",
    theta: NDArray | None = None,
) -> Point:
    """Evaluate the device law of a material for the states F [N,3,3]."""
    real, law = REALS[precision], material.device_law
    t, scalar, n = types(real), np.dtype(precision), len(F)
    C = np.zeros((n, 3, 3)) if C is None else C
    h = np.tile(material.history(), (n, 1)) if h is None else h
    theta = np.array(material.theta()) if theta is None else theta

    def array(values: object, dtype: Any) -> wp.array:
        return wp.array(np.ascontiguousarray(values, dtype=scalar), dtype=dtype)

    outputs = [wp.zeros(n, dtype=d) for d in (t.mat33, real, real, t.mat33, t.vec2)]
    inputs = [
        array([theta], wp.types.vector(law.width, real)),
        dt,
        array(F, t.mat33),
        array(C, t.mat33),
        array(h, t.vec2),
    ]
    wp.launch(make_probe(law, real), n, inputs=inputs, outputs=outputs)
    return Point(*(out.numpy().astype(np.float64) for out in outputs))
