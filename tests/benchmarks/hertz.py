"""Compares the force on a ball between two plates with finite elements of the whole ball.

The finite elements are in phy124/studies/validation/experiments/elastic_ball.py. Hertz (1882)
treats both bodies as half-spaces.

    python tests/benchmarks/hertz.py 48 float64      # cells across the ball: a line per depth
    python tests/benchmarks/hertz.py --convergence   # grid by grid, and the order

The force depends on the position of the plate between two nodes. Each figure is therefore the mean
for four positions.
"""

import argparse
import math
from typing import Any

from phy124.studies.validation.experiments.elastic_ball import fit_law
from phy124.studies.validation.experiments.hertz import NU, RADIUS, E, hertz, press_particles

DEPTHS = (0.02, 0.035, 0.05)
"""Depths by which each plate presses [m]."""
PHASES = (0.0, 0.25, 0.5, 0.75)
"""Positions between two nodes at which the plate comes to rest."""
GRIDS = (16, 22, 32, 44, 64)
"""Cells across the ball."""


def elements(depth: float) -> float:
    """Force by finite elements [N]."""
    return E * RADIUS**2 * fit_law(NU, whole=False).force(depth / RADIUS)


def errors(cells: int, depth: float = DEPTHS[-1], **options: Any) -> list[float]:
    """Relative errors of the force, one for each place of the plate.

    Args:
        cells: Cells across the ball.
        depth: Depth by which the plate presses [m].
        given: `per_axis` and `precision` of `pressed`.
    """
    forces = (press_particles(cells // 2, depth, phase=phase, **options) for phase in PHASES)
    return [force / elements(depth) - 1 for force in forces]


def format_errors(each: list[float]) -> str:
    """Errors and their mean."""
    return ", ".join(f"{error:+.1%}" for error in each) + f"; mean {sum(each) / len(each):+.2%}"


def order(coarse: tuple[int, float], fine: tuple[int, float]) -> float:
    """Power of the spacing with which an error falls, from two (cells, error)."""
    return math.log(abs(coarse[1] / fine[1])) / math.log(fine[0] / coarse[0])


def converging() -> None:
    """A line per grid, and the order from the first to the last."""
    means = []
    for cells in GRIDS:
        each = errors(cells)
        means.append(sum(each) / len(each))
        print(f"{cells} cells: {format_errors(each)}", flush=True)
    print(f"order {order((GRIDS[0], means[0]), (GRIDS[-1], means[-1])):.2f}")


def main() -> None:
    """One line per depth, or the convergence."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("cells", type=int, nargs="?", default=48)
    parser.add_argument("precision", nargs="?", default="float32")
    parser.add_argument("--convergence", action="store_true")
    arguments = parser.parse_args()
    if arguments.convergence:
        return converging()
    for depth in DEPTHS:
        each = errors(arguments.cells, depth, precision=arguments.precision)
        over = hertz(depth) / elements(depth)
        print(
            f"{arguments.cells} cells, depth {depth:g} m: {format_errors(each)} of finite "
            f"elements, {(1 + sum(each) / len(each)) / over - 1:+.1%} of Hertz",
            flush=True,
        )


if __name__ == "__main__":
    main()
