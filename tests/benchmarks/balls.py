"""Compares the force between two pressed balls with finite elements of the whole ball.

Each particle has the volume that the ball cuts out of its cell, so that the ball's surface is as
smooth as the grid permits. Shells of particles or whole cells would cause errors of up to 0.2
cells.

    python tests/benchmarks/balls.py 12 16 24        # cells across a ball: a line per depth
    python tests/benchmarks/balls.py 16 --per-axis 3
    python tests/benchmarks/balls.py 12 16 24 --box  # one ball on a free box
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from support.balls import elements, pressed, pressed_on_box

DEPTHS = (0.02, 0.035, 0.05)
"""Depths by which each ball is pressed at the contact [m]."""
PHASES = (0.0, 0.25, 0.5, 0.75)
"""Positions of the contact between two nodes."""


def main() -> None:
    """One line per grid and depth."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("cells", type=int, nargs="*", default=[12, 16, 24])
    parser.add_argument("--per-axis", type=int, default=2)
    parser.add_argument("--box", action="store_true")
    arguments = parser.parse_args()
    force = pressed_on_box if arguments.box else pressed
    for cells in arguments.cells:
        for depth in DEPTHS:
            forces = [force(cells, depth, phase, arguments.per_axis) for phase in PHASES]
            errors = [match / elements(depth) - 1 for match in forces]
            text = ", ".join(f"{error:+.1%}" for error in errors)
            print(f"{cells} cells, depth {depth:g} m: {text}; mean {np.mean(errors):+.1%}")


if __name__ == "__main__":
    main()
