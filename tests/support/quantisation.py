"""Bounds on the quantisation errors of a format, derived from the steps in its layout."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from phy124.gaussians import SH_C0, Gaussians

BYTE = 0.5 / 255
"""Error of rounding a number in 0..1 to a byte."""
FLOAT = 3e-6
"""Rounding error of logarithms and exponentials in float32."""


@dataclass(frozen=True)
class Errors:
    """Largest differences between two sets of Gaussians, or bounds on these differences."""

    means: float
    """Difference of the centres along an axis, m."""
    angle: float
    """Angle between the orientations, rad."""
    scales: float
    """Difference of the logarithms."""
    opacities: float
    first: float
    """Difference of the coefficients of degree 0."""
    rest: float
    """Difference of the coefficients of higher degrees, where both sets have them."""

    def within(self, bound: Errors) -> list[str]:
        """Return the differences that are larger than their bounds."""
        return [
            f"{name} {value:.3g} > {getattr(bound, name):.3g}"
            for name, value in vars(self).items()
            if value > getattr(bound, name)
        ]


def smallest_three(step: float) -> float:
    """Return a bound on the angle [rad] by which rounding three components to `step / 2` rotates.

    The error of the three smaller components together is sqrt(3) step / 2. The largest component
    follows from the unit length; its error is at most sqrt(3) times as large, since no other
    component is larger. The distance of two quaternions is half the angle between them.
    """
    return 2 * np.sqrt(3) * step / 2 * np.sqrt(1 + 3)


def bound(name: str, g: Gaussians, data: bytes = b"") -> Errors:
    """Return the bounds of a format for some Gaussians; those of SOG depend on the codebooks in the
    file."""
    reach = float(np.abs(g.means).max())
    if name in ("ply", "glb"):
        return Errors(FLOAT * reach, 1e-6, FLOAT, 1e-6, FLOAT, FLOAT)
    if name == "splat":  # 1 is written as 255, so the error of a component may be a whole step
        angle = 2 * 2 / 128
        return Errors(FLOAT * reach, angle, FLOAT, BYTE + 1e-6, BYTE / SH_C0 + FLOAT, 0)
    if name.startswith("spz"):
        bits = 12 if "foreign" in name else min(16, int(np.floor(np.log2((1 << 23) / reach))))
        angle = smallest_three(1 / (511 * np.sqrt(2)))
        if "v2" in name:  # w follows from x, y, z and the unit length, even if it is small
            angle = 4 * np.sqrt(2 * np.sqrt(3) * 0.5 / 127.5)
        return Errors(
            0.5 / 2**bits + FLOAT,
            angle + 1e-6,
            0.5 / 16 + FLOAT,
            BYTE + 1e-6,
            BYTE / 0.15 + FLOAT,
            (8 + 0.5) / 128 + FLOAT,
        )
    if name == "compressed-ply":
        box, logs = np.ptp(g.means, axis=0).max(), np.ptp(np.log(g.scales), axis=0).max()
        colours = np.ptp(g.sh[:, 0], axis=0).max()
        angle = smallest_three(np.sqrt(2) / 1023)
        return Errors(
            0.5 * box / 1023 + FLOAT,
            angle + 1e-6,
            0.5 * logs / 1023 + FLOAT,
            BYTE + 1e-6,
            0.5 * colours / 255 + FLOAT,
            8 / 256 + FLOAT,
        )
    assert name == "sog"
    return _sog(g, data)


def _sog(g: Gaussians, data: bytes) -> Errors:
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        meta = json.loads(archive.read("meta.json"))
    ends = np.array([meta["means"]["mins"], meta["means"]["maxs"]])
    far = float(np.expm1(np.abs(ends)).max())
    codes = {
        name: np.array(meta[name]["codebook"]) for name in ("scales", "sh0", "shN") if name in meta
    }
    rest = _nearest(codes["shN"], g.sh[:, 1:]) if "shN" in codes else 0.0
    return Errors(
        0.5 * float(np.ptp(ends, axis=0).max()) / 65535 * (1 + far) + FLOAT,
        smallest_three(2 / 255 / np.sqrt(2)) + 1e-6,
        _nearest(codes["scales"], np.log(g.scales)) + FLOAT,
        2 * BYTE,  # some programs truncate instead of rounding
        _nearest(codes["sh0"], g.sh[:, 0]) + FLOAT,
        rest + FLOAT,
    )


def _nearest(codes: NDArray, values: NDArray) -> float:
    """Return the largest distance of a value from its nearest code."""
    return float(cKDTree(codes[:, None]).query(values.reshape(-1, 1))[0].max())


def errors(result: Gaussians, wanted: Gaussians, *, ordered: bool = True) -> Errors:
    """Return the largest differences; unless `ordered`, Gaussians are matched by their centres."""
    assert len(result) == len(wanted)
    if not ordered:
        result = result.select(cKDTree(result.means).query(wanted.means)[1])
    k = min(result.sh.shape[1], wanted.sh.shape[1])
    a, b = (g.quats.astype(np.float64) for g in (result, wanted))
    apart = np.minimum(np.linalg.norm(a - b, axis=1), np.linalg.norm(a + b, axis=1))
    return Errors(
        float(np.abs(result.means - wanted.means).max()),
        float((4 * np.arcsin(apart / 2)).max()),
        float(np.abs(np.log(result.scales) - np.log(wanted.scales)).max()),
        float(np.abs(result.opacities - wanted.opacities).max()),
        float(np.abs(result.sh[:, 0] - wanted.sh[:, 0]).max()),
        float(np.abs(result.sh[:, 1:k] - wanted.sh[:, 1:k]).max(initial=0)),
    )


def many(rng: np.random.Generator, count: int, degree: int) -> Gaussians:
    """Return Gaussians of many sizes and orientations, with colours that fit into bytes."""
    quats = rng.normal(size=(count, 4))
    sh = rng.normal(size=(count, (degree + 1) ** 2, 3)) * 0.2
    return Gaussians(
        rng.normal(size=(count, 3)) * 0.4,
        quats / np.linalg.norm(quats, axis=1, keepdims=True),
        np.exp(rng.normal(size=(count, 3)) * 0.7 - 4),
        rng.uniform(0.02, 0.98, count),
        sh.clip(-0.5, 0.5),
    )
