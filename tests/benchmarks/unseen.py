"""Counts promised errors that do not hold on objects that `promises.py` has not measured.

Each object is moved by each preset's beginning on three grids, as `phy124 accuracy` does, and the
errors of draft and standard are compared with what is promised.

    python tests/benchmarks/unseen.py --presets press sway --objects torus mug
"""

import argparse
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import trimesh
import warp as wp
from trimesh import Trimesh, creation

from phy124.gaussians import Gaussians
from phy124.generators.mesh import mesh
from phy124.studies.validation.accuracy.study import Study

sys.path.insert(0, str(Path(__file__).parent))
from presets import beginning

LEVELS = (16, 24, 32)
COLOUR = (0.6, 0.4, 0.3)


def ball(radius: float, *centre: float) -> Trimesh:
    """A ball around a point."""
    return creation.icosphere(radius=radius).apply_translation(centre)


def rod(radius: float, height: float, *centre: float) -> Trimesh:
    """An upright rod around a point."""
    return creation.cylinder(radius=radius, height=height).apply_translation(centre)


def box(*sides: float, centre: tuple[float, float, float] = (0, 0, 0)) -> Trimesh:
    """A box around a point."""
    return creation.box(sides).apply_translation(centre)


def bush() -> Trimesh:
    """A stem with a cluster of balls."""
    rng = np.random.default_rng(11)
    centres = rng.normal(0, 0.18, (25, 3)) + (0, 0, 0.5)
    balls = [ball(r, *c) for r, c in zip(rng.uniform(0.06, 0.16, 25), centres, strict=True)]
    return join(*[rod(0.06, 0.5, 0, 0, 0.2), *balls])


def join(*pieces: Trimesh) -> Trimesh:
    """One mesh of several."""
    return trimesh.util.concatenate(list(pieces))


SHAPES: dict[str, Callable[[], Trimesh]] = {
    "torus": lambda: creation.torus(0.35, 0.13),
    "cone": lambda: creation.cone(radius=0.35, height=0.9),
    "capsule": lambda: creation.capsule(height=0.6, radius=0.18),
    "tablet": lambda: box(0.6, 0.8, 0.12),
    "sheet": lambda: box(0.03, 0.7, 1.0),
    "bracket": lambda: join(
        box(0.3, 0.9, 0.15, centre=(0, 0, 0.075)), box(0.3, 0.15, 0.8, centre=(0, -0.37, 0.4))
    ),
    "table": lambda: join(
        box(0.8, 0.8, 0.1, centre=(0, 0, 0.65)),
        *(rod(0.06, 0.6, x, y, 0.3) for x in (-0.3, 0.3) for y in (-0.3, 0.3)),
    ),
    "snowman": lambda: join(ball(0.3, 0, 0, 0.3), ball(0.22, 0, 0, 0.75), ball(0.15, 0, 0, 1.05)),
    "mug": lambda: join(creation.annulus(0.28, 0.35, 0.7), rod(0.35, 0.07, 0, 0, -0.33)),
    "bush": bush,
}


def gaussians_of(shape: Trimesh) -> Gaussians:
    """Cover a mesh with Gaussians."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "shape.stl"
        shape.export(path)
        return mesh(path, COLOUR)


def main() -> None:
    """Print a line for each promise, and how many do not hold."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--presets", nargs="+", default=["press", "drop", "sway", "spin"])
    parser.add_argument("--objects", nargs="+", default=list(SHAPES), choices=list(SHAPES))
    args = parser.parse_args()
    wp.config.log_level = wp.LOG_ERROR
    kept, broken = 0, 0
    for name in args.objects:
        gaussians = gaussians_of(SHAPES[name]())
        for preset in args.presets:
            report = Study(gaussians, beginning(preset), levels=LEVELS, thorough=False).run()
            for level in ("draft", "standard"):
                verdict = report.promises[level]
                kept, broken = kept + (": holds" in verdict), broken + ("DOES NOT HOLD" in verdict)
                print(f"{name} {preset} {level}: {verdict}", flush=True)
    print(f"{broken} of {kept + broken} promises do not hold")


if __name__ == "__main__":
    main()
