"""Projected liquids: incompressible flow on a staggered grid, with particles.

`LiquidSolver` replaces `phy124.mpm.Solver` in scenes with `accuracy.liquid = "projection"`. `Walls`
represents the scene's boundaries as shapes, and `Solids` the freely moving rigid solids. `Cells`
contains the window of the grid. `Projection` solves the pressure equation by conjugate gradients.
`Phases` records the launches of a step, and `WallImpulses` sums the impulses of walls.
docs/design/liquids.md describes the method.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # A run imports only the solver that it needs.
    from phy124.lattice.solver import LatticeSolver
    from phy124.liquid.immersed import ImmersedSolver
    from phy124.liquid.solver import LiquidSolver
    from phy124.mpm import Solver

    AnySolver = Solver | LiquidSolver | LatticeSolver | ImmersedSolver
    """Any of the solvers that a run may use."""
