"""Runs PhysGaussian's solver and phy124's in turn on the same device: seconds per substep.

`python tests/benchmarks/gpu/physgaussian.py FOLDER --device cuda:0` expects the folder that
contains mpm_solver_warp (XPandora/PhysGaussian), which is not part of this repository. A cube of
the fixed corotated law falls on a floor with the paper's substep. The first run of each solver
compiles kernels and is not counted.

PhysGaussian's solver is written for Warp 0.10. With Warp 1.19, some of its lines must be changed in
a copy. If such lines are unchanged, this program lists them and ends with status 1. Install `h5py`,
or remove its import.
"""

import argparse
import json
import re
import sys
import time
from pathlib import Path

import numpy as np
import warp as wp

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[2]))
from device import SUBSTEP, pace
from mpm import cube

from phy124.materials import FixedCorotated
from support.shapes import cloud

COUNTS = ((20_000, 100), (65_536, 64), (65_536, 100))
SUBSTEPS = 200


OLD = {
    "warp_utils.py": (
        (r"import warp\.torch", "import warp"),
        (r"warp\.types\.(float32|array)", "warp.float32 and warp.array"),
        (r"owner=False", "leave this argument out"),
    ),
    "mpm_utils.py": (
        (r"dw? = wp\.mat33\(fx", "wp.matrix_from_cols in place of wp.mat33"),
        (r" w = wp\.mat33\(\s*$", "wp.matrix_from_cols in place of wp.mat33"),
    ),
}
"""File of that solver -> patterns of lines that Warp 1.19 refuses, and what to write.

In mpm_utils.py these are four lines: the weights `w` and their derivatives `dw`, in p2g and in g2p,
whose three vectors are columns.
"""


def outdated(folder: str) -> list[str]:
    """The lines that must be changed, with what to write."""
    results = []
    for name, rules in OLD.items():
        for number, line in enumerate((Path(folder) / name).read_text("utf-8").splitlines(), 1):
            results += [f"{name}:{number}: {new}" for old, new in rules if re.search(old, line)]
    return results


def theirs(folder: str, count: int, cells: int, device: str) -> float:
    """Seconds per substep."""
    sys.path.insert(0, folder)
    import torch
    from mpm_solver_warp import MPM_Simulator_WARP

    x = torch.as_tensor(cloud(count, size=1.0, corner=0.5, dx=2 / cells), dtype=torch.float32)
    solver = MPM_Simulator_WARP(10)
    inputs = (x.to(device), torch.full((count,), 1 / count, device=device))
    solver.load_initial_data_from_torch(*inputs, n_grid=cells, grid_lim=2.0)
    material = {"material": "jelly", "E": 1e5, "nu": 0.3, "density": 200, "g": [0, 0, -9.81]}
    solver.set_parameters_dict(material, device=device)
    solver.finalize_mu_lam(device=device)
    solver.add_surface_collider((0, 0, 0.5), (0, 0, 1), "sticky", 0.0)
    best = np.inf
    for turn in range(4):
        start = time.perf_counter()
        for substep in range(SUBSTEPS):
            solver.p2g2p(substep, SUBSTEP, device=device)
        wp.synchronize()
        if turn:
            best = min(best, (time.perf_counter() - start) / SUBSTEPS)
    return float(best)


def main(folder: str, device: str) -> None:
    """A row per size."""
    for count, cells in COUNTS:
        ours = pace(cube(count, cells, FixedCorotated, "plain", 1, device), SUBSTEPS)
        row = {"what": "physgaussian", "particles": count, "cells": cells}
        row |= {"ours_us": round(ours * 1e6, 1)}
        row |= {"theirs_us": round(theirs(folder, count, cells, device) * 1e6, 1)}
        print(json.dumps(row), flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", help="folder that holds mpm_solver_warp")
    parser.add_argument("--device", default="cuda:0")
    asked = parser.parse_args()
    old = outdated(asked.folder)
    if old:
        sys.exit("\n".join(["With this Warp, change these lines in a copy:", *old]))
    main(asked.folder, asked.device)
