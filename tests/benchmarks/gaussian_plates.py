"""Bending of plates whose surface consists of flat Gaussians.

The solid of each plate is 24 cells long and 4 cells wide. It is clamped at the first 2 cells and
pushed at its end (linear model, Poisson's ratio 0). The table compares the volume and the curvature
of the middle part with exact values.

    python tests/benchmarks/gaussian_plates.py [THICKNESS ...]
"""

import argparse
import itertools
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from phy124.particles.solid import find_interior
from support.lattices import DX, E, Statics
from support.solids import box_of_discs, frame

THICKNESSES = (0.3, 0.5, 1.0, 1.5, 2.0, 3.0)
TURNS = ((0, 0), (20, 25), (35, 45))
"""Rotations about the plate's width and about its length [degrees]."""
HEIGHTS = (0.0, 0.3)
"""Positions of the plate's middle relative to a border between cells [cells]."""
LONG, WIDE, CLAMPED = 24, 4, 2
"""Sides of the plates, and length of the clamped part [cells]."""
APART = 0.2
"""Distance between Gaussians [cells]."""


def measure(thick, turn, height):
    """Return the volume and the curvature, relative to exact values."""
    axes, start = frame(turn), np.array([0.13, 0.27, height])
    along, _, out = axes.T
    middle = start + (LONG / 2 - CLAMPED) * along
    sides = np.array([LONG, WIDE, thick])
    gaussians = box_of_discs(sides * DX, axes, middle * DX, APART * DX)
    solid = find_interior(gaussians).resample(DX / 2, per_cell=2)
    statics = Statics(solid, lambda x: (x - start) @ along < 0)
    s, end = (statics.x - start) @ along, LONG - CLAMPED
    u = statics.solve(statics.push(s > end - 1, out)) @ out
    inner = (s > 2.5) & (s < end - 2.5)
    bent = np.polyfit(s[inner], u[inner], 3)
    curvature = (3 * bent[0] * end + 2 * bent[1]) * E * DX / (end / 2 - 0.5)
    return solid.volume / DX**3 / sides.prod(), curvature * WIDE * thick**3 / 12


def main():
    """Print the least and the largest values over all heights."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("thickness", type=float, nargs="*", default=THICKNESSES, help="[cells]")
    thicknesses = parser.parse_args().thickness
    cases = list(itertools.product(thicknesses, TURNS, HEIGHTS))
    with ProcessPoolExecutor(2) as pool:
        results = dict(zip(cases, pool.map(measure, *zip(*cases, strict=True)), strict=True))
    print("| thickness | turned by | volume | curvature |\n|---|---|---|---|")
    for thick, turn in itertools.product(thicknesses, TURNS):
        values = np.array([results[thick, turn, height] for height in HEIGHTS])
        low, high = values.min(axis=0), values.max(axis=0)
        row = [f"{low[k]:.3f} to {high[k]:.3f}" for k in range(2)]
        print(f"| {thick:g} | {turn[0]}, {turn[1]} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
