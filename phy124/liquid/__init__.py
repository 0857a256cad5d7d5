"""Projected liquids: incompressible flow on a staggered grid, with particles."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # A run imports only the solver that it needs.
    from phy124.lattice.solver import LatticeSolver
    from phy124.liquid.immersed import ImmersedSolver
    from phy124.liquid.solver import LiquidSolver
    from phy124.mpm import Solver

    AnySolver = Solver | LiquidSolver | LatticeSolver | ImmersedSolver
