"""Cross-sections of round stems whose surface consists of scattered long discs.

The stems are 62 voxels long. The table compares the area and the second moment of slices one voxel
thick with exact values.

    python tests/benchmarks/gaussian_stems.py [RADIUS ...]
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from phy124.particles.solid import find_interior
from support.lattices import integration_points
from support.solids import STEM, stem_of_discs

RADII = (0.3, 0.5, 0.8)
"""Radii of the stems [voxels]."""
DIRECTIONS = ((0, 0, 1), (0.3, 0.2, 1), (1, 1, 1.2))
SCATTER = {"exact": (0, 0), "captured": (0.12, 0.25)}
"""Noise of the distances from the axis [voxels], and of the components of the normals."""
ENDS = 2
"""Parts of the stems that are not measured [voxels]."""


def measure(radius, along, noise, tilt):
    """Return the areas and second moments of slices, relative to exact values [K,2]."""
    solid = find_interior(stem_of_discs(radius, along, noise=noise, tilt=tilt))
    x, volume = integration_points(solid.resample(1 / 128), 1 / 128)
    axis = np.array(along) / np.linalg.norm(along)
    arm = 64 * x - STEM
    place = arm @ axis
    arm -= place[:, None] * axis
    inner = (place > ENDS) & (place < 62 - ENDS)
    slices, volume = np.floor(place[inner]).astype(int) - ENDS, 64**3 * volume[inner]
    area = np.bincount(slices, volume)
    second = np.bincount(slices, volume * (arm[inner] ** 2).sum(axis=1)) / 2
    return np.stack([area / (np.pi * radius**2), second / (np.pi * radius**4 / 4)], axis=1)


def main():
    """Print the 10th, 50th and 90th percentiles over all slices and directions."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("radius", type=float, nargs="*", default=RADII, help="[voxels]")
    print("| radius | Gaussians | area | second moment |\n|---|---|---|---|")
    for radius in parser.parse_args().radius:
        for name, scatter in SCATTER.items():
            values = [measure(radius, along, *scatter) for along in DIRECTIONS]
            low, middle, high = np.percentile(np.concatenate(values), [10, 50, 90], axis=0)
            row = [f"{low[k]:.2f}, {middle[k]:.2f}, {high[k]:.2f}" for k in range(2)]
            print(f"| {radius:g} | {name} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
