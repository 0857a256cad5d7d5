"""Makes a large .splat file: each Gaussian is replaced by smaller ones spread over its disc.

    python tests/benchmarks/finer.py ../shared/objects/koala.splat koala5m.splat --times 500

The copies are on a sunflower spiral (Vogel, Math. Biosci. 44, 1979) in the plane of the two longest
axes, within two standard deviations. The picture therefore stays nearly the same. The third axis of
a copy is a quarter of its other axes. The file has 32 bytes per Gaussian: 10,000 x 500 Gaussians
take 160 MB.
"""

import argparse

import numpy as np

from phy124.gaussians import rotation_matrices

RECORD = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("quat", "u1", 4)])
REACH = 2.0
"""Radius of the disc over which the copies are spread, in standard deviations."""
SPACING = 1.9
"""Distance between neighbours on the spiral, in units of its radius over the root of the number."""
BLOCK = 256
"""Number of Gaussians that are replaced at a time."""


def spread(rows: np.ndarray, times: int) -> np.ndarray:
    """Replace each row by `times` rows."""
    radius = np.sqrt((np.arange(times) + 0.5) / times) * REACH
    angle = np.arange(times) * np.pi * (3 - np.sqrt(5))
    disc = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    order = np.argsort(-rows["scale"], axis=1, kind="stable")
    axes = rotation_matrices(rows["quat"].astype(float) - 128)
    axes = np.take_along_axis(axes, order[:, None, :2], axis=2)
    axes *= np.take_along_axis(rows["scale"], order[:, :2], axis=1)[:, None]
    many = np.repeat(rows, times).reshape(len(rows), times)
    many["mean"] += np.einsum("nij,tj->nti", axes, disc)
    finest = rows["scale"].max(axis=1) * REACH * SPACING / np.sqrt(times) / 2
    many["scale"] = np.minimum(many["scale"], finest[:, None, None])
    np.put_along_axis(many["scale"], order[:, None, 2:], finest[:, None, None] / 4, axis=2)
    return many.reshape(-1)


def main() -> None:
    """Read the arguments and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("source", help="file with records of 32 bytes (.splat)")
    parser.add_argument("out", help="file to write (.splat)")
    parser.add_argument("--times", type=int, default=500, help="Gaussians per Gaussian")
    args = parser.parse_args()
    rows = np.fromfile(args.source, RECORD)
    with open(args.out, "wb") as file:
        for start in range(0, len(rows), BLOCK):
            spread(rows[start : start + BLOCK], args.times).tofile(file)


if __name__ == "__main__":
    main()
