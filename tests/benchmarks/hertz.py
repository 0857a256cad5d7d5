"""Force of a ball pressed between two plates, against finite elements of the whole ball.

They are those of phy124/experiments/elastic_ball.py; Hertz (1882) takes both bodies for
half-spaces.

    python tests/benchmarks/hertz.py 48 float64      # cells across the ball: a line per depth
    python tests/benchmarks/hertz.py --convergence   # over places of the plate, grid by grid
"""

import argparse
import math

from phy124.experiments.elastic_ball import law
from phy124.experiments.hertz import NU, RADIUS, E, hertz, pressed

DEPTHS = (0.02, 0.035, 0.05)
"""How far each plate presses [m]."""
PHASES = (0.0, 0.25, 0.5, 0.75)
"""Where it comes to rest between two nodes."""
GRIDS = {2: (16, 22, 32, 44, 64), 3: (16, 22, 32, 44)}
"""Particles per cell and axis -> cells across the ball."""


def elements(depth: float) -> float:
    """Force by finite elements [N]."""
    return E * RADIUS**2 * law(NU, whole=False).force(depth / RADIUS)


def errors(cells: int, per_axis: int, depth: float = DEPTHS[-1]) -> list[float]:
    """Relative errors of the force, one for each place of the plate.

    Args:
        cells: Cells across the ball.
        per_axis: Particles per cell and axis.
        depth: How far the plate presses [m].
    """
    found = (pressed(cells // 2, depth, per_axis=per_axis, phase=phase) for phase in PHASES)
    return [force / elements(depth) - 1 for force in found]


def order(coarse: tuple[int, float], fine: tuple[int, float]) -> float:
    """Power of the spacing with which an error falls, from two (cells, error)."""
    return math.log(coarse[1] / fine[1]) / math.log(fine[0] / coarse[0])


def converging() -> None:
    """A line per grid, and the order from the first to the last."""
    for per_axis, grids in GRIDS.items():
        means = {}
        for cells in grids:
            each = errors(cells, per_axis)
            means[cells] = sum(each) / len(each)
            told = ", ".join(f"{error:+.1%}" for error in each)
            print(
                f"{per_axis} per axis, {cells} cells: {told}; mean {means[cells]:+.2%}", flush=True
            )
        print(f"order {order((grids[0], means[grids[0]]), (grids[-1], means[grids[-1]])):.2f}")


def main() -> None:
    """One line per depth, or the convergence."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("cells", type=int, nargs="?", default=48)
    parser.add_argument("precision", nargs="?", default="float32")
    parser.add_argument("--convergence", action="store_true")
    given = parser.parse_args()
    if given.convergence:
        return converging()
    for depth in DEPTHS:
        force = pressed(given.cells // 2, depth, precision=given.precision)
        print(
            f"{given.cells} cells, depth {depth:g} m: {force:.1f} N, "
            f"{force / elements(depth) - 1:+.1%} of finite elements, "
            f"{force / hertz(depth) - 1:+.1%} of Hertz"
        )


if __name__ == "__main__":
    main()
