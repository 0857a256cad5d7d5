"""Force of a ball pressed between two plates; prints one line per depth.

Against finite elements of the whole ball (phy124/experiments/elastic_ball.py), and against Hertz
(1882), who takes both bodies for half-spaces.
Run `python tests/benchmarks/hertz.py CELLS [float64]`, with the cells across the ball.
"""

import sys

from phy124.experiments.elastic_ball import law
from phy124.experiments.hertz import NU, RADIUS, E, hertz, pressed

DEPTHS = (0.02, 0.035, 0.05)
"""How far each plate presses [m]."""


def elements(depth: float) -> float:
    """Force by finite elements [N]."""
    return E * RADIUS**2 * law(NU, whole=False).force(depth / RADIUS)


def main() -> None:
    """One line per depth."""
    cells, precision = int(sys.argv[1]), (sys.argv[2:] or ["float32"])[0]
    for depth in DEPTHS:
        force = pressed(cells // 2, depth, precision=precision)
        print(
            f"{cells} cells, depth {depth:g} m: {force:.1f} N, {force / elements(depth) - 1:+.1%} "
            f"of finite elements, {force / hertz(depth) - 1:+.1%} of Hertz"
        )


if __name__ == "__main__":
    main()
