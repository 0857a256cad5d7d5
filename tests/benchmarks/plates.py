"""Bending of thin plates on lattices, for thicknesses, places and orientations.

Each plate is 14 cells long, is clamped 2 cells from its start, and is pushed
at its end (linear model, Poisson's ratio 0). The curvature of the middle part is divided by the
exact curvature. Plates are built from voxels of half a cell, as in the pipeline, and from voxels of
a tenth of a cell, whose moments are nearly exact. The difference is the error of the voxels.

    python tests/benchmarks/plates.py [THICKNESS ...] [--wide 5] [--coarse]
"""

import argparse
import itertools
import math
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from phy124.particles.solid import Solid
from support.lattices import DX, E, Statics
from support.plates import frame

THICKNESSES = (0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0)
TURNS = ((0, 0), (15, 0), (30, 0), (45, 0), (20, 25), (35, 45))
"""Rotations about the plate's width and about its length [degrees]."""
HEIGHTS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Positions of the plate's middle relative to a border between cells [cells]."""
SAMPLES = 40
"""Number of samples per cell, along each axis, for the filled fractions of voxels."""


def plate(thick, turn, height, per, wide):
    """Return a plate whose axis starts at `start`, and `start` [cells]."""
    axes, start = frame(turn), np.array([0.13, 0.27, height])
    half, middle = np.array([7, wide / 2, thick / 2]), start + 5 * axes[:, 0]
    reach = np.abs(axes) @ half

    first = np.floor((middle - reach) * per).astype(int)
    counts = np.ceil((middle + reach) * per).astype(int) - first
    centres = (np.stack([*np.indices(counts)], axis=-1) + first + 0.5) / per
    inside = half - np.abs((centres - middle) @ axes)
    # Half the extent of a voxel in the directions of the plate.
    extent = np.abs(axes).sum(axis=0) / per / 2
    fraction = (inside > extent).all(axis=-1).astype(np.float32)
    cut = np.argwhere((inside > -extent).all(axis=-1) & (fraction == 0))
    parts = math.ceil(SAMPLES / per)
    line = ((np.arange(parts) + 0.5) / parts - 0.5) / per
    sample = np.stack(np.meshgrid(line, line, line), axis=-1).reshape(-1, 3)
    for some in np.array_split(cut, len(cut) * len(sample) // 2_000_000 + 1):
        away = half - np.abs((centres[tuple(some.T)][:, None] + sample - middle) @ axes)
        # A sample at a surface counts with the fraction inside.
        share = np.clip(0.5 + away * parts * per / np.abs(axes).sum(axis=0), 0, 1)
        fraction[tuple(some.T)] = share.prod(axis=-1).mean(axis=1)
    return Solid(first, DX / per, fraction), start, middle


def measure(thick, turn, per, height, wide):
    """Return the second moment across the plate and the curvature, relative to exact values."""
    solid, start, middle = plate(thick, turn, height, per, wide)
    axes = frame(turn)
    along, _, out = axes.T
    statics = Statics(solid, lambda x: (x - start) @ along < 0)
    s = (statics.x - start) @ along
    u = statics.solve(statics.push(s > 11, out)) @ out
    inner = (s > 2.5) & (s < 9.5)
    bent = np.polyfit(s[inner], u[inner], 3)
    curvature = (36 * bent[0] + 2 * bent[1]) * E * DX / (11.5 - 6)
    across, share = ((statics.x - middle) @ out)[inner], statics.volume[inner]
    share = share / share.sum()
    moment = share @ (across - share @ across) ** 2
    return moment * 12 / thick**2, curvature * wide * thick**3 / 12


def main():
    """Print the least and the largest value over all heights."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("thickness", type=float, nargs="*", default=THICKNESSES, help="[cells]")
    parser.add_argument("--wide", type=float, default=2.0, help="width of the plates [cells]")
    parser.add_argument("--coarse", action="store_true", help="only voxels of half a cell")
    arguments = parser.parse_args()
    voxels = (2,) if arguments.coarse else (2, 10)
    cases = list(itertools.product(arguments.thickness, TURNS, voxels, HEIGHTS))
    with ProcessPoolExecutor(2) as pool:
        figures = pool.map(partial(measure, wide=arguments.wide), *zip(*cases, strict=True))
        results = dict(zip(cases, figures, strict=True))
    headings = [f"moments (voxels 1/{per}) | curvature" for per in voxels]
    print(f"| thickness | turned by | {' | '.join(headings)} |")
    print("|---" * (2 + 2 * len(voxels)) + "|")
    for thick, turn in itertools.product(arguments.thickness, TURNS):
        row = []
        for per in voxels:
            values = np.array([results[thick, turn, per, height] for height in HEIGHTS])
            low, high = values.min(axis=0), values.max(axis=0)
            row += [f"{low[k]:.3f} to {high[k]:.3f}" for k in range(2)]
        print(f"| {thick:g} | {turn[0]}, {turn[1]} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
