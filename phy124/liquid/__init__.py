"""Projected liquids: incompressible flow on a staggered grid, with particles.

`LiquidSolver` takes the place of `phy124.mpm.Solver` in scenes whose `accuracy.liquid` is
"projection". `Walls` are the scene's boundaries as shapes for the liquid, and `Solids` are free
solids in the liquid. `Cells` is the window of the grid, `Projection` solves by conjugate gradients,
`Phases` records the launches of a step, and `WallImpulses` sums the impulses of walls.
docs/design/liquids.md describes the method.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # solvers are imported where one is made: most runs need only one of them
    from phy124.lattice.solver import LatticeSolver
    from phy124.liquid.solver import LiquidSolver
    from phy124.mpm import Solver

    AnySolver = Solver | LiquidSolver | LatticeSolver
    """The solver of a run."""
