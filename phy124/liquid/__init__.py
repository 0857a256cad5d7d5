"""Projected liquids: incompressible flow on a staggered grid, with particles.

`LiquidSolver` takes the place of `phy124.mpm.Solver` in scenes whose `accuracy.liquid` is
"projection". `Walls` represents the scene's boundaries as shapes for the liquid, and `Solids`
represents rigid solids that move freely in the liquid. `Cells` holds the window of the grid,
`Projection` solves the pressure equation by conjugate gradients, `Phases` records the launches of a
step, and `WallImpulses` sums the impulses of walls. docs/design/liquids.md describes the method.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # solvers are imported where they are created: most runs need only one solver
    from phy124.lattice.solver import LatticeSolver
    from phy124.liquid.solver import LiquidSolver
    from phy124.mpm import Solver

    AnySolver = Solver | LiquidSolver | LatticeSolver
    """Either kind of solver that a run may use."""
