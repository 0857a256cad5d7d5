"""Liquids by pressure projection: incompressible flow on a staggered grid, carried by particles.

`LiquidSolver` takes the place of `phy124.mpm.Solver` in scenes whose `accuracy.liquid` is
"projection". `Walls` are the scene's boundaries as the liquid meets them, `Solids` a free solid in
it, `Cells` the window of the grid, `Projection` the conjugate gradients, `Phases` the launches of a
step, and `WallImpulses` the impulses of walls. docs/design/liquids.md has the method.
"""

from phy124.lattice import LatticeSolver
from phy124.liquid.solver import LiquidSolver, kernels
from phy124.mpm import Solver

AnySolver = Solver | LiquidSolver | LatticeSolver
"""The solver of a run."""

__all__ = ["AnySolver", "LiquidSolver", "kernels"]
