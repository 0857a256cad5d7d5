"""The material point method: explicit MLS-MPM with APIC transfers on a window of grid nodes.

`State` changes every substep, `Grid` is scratch, `Solver` steps. A substep reads as
push, clear, p2g, update, collide, g2p; only stages that the scene calls for exist.
"""

from phy124.mpm.grid import MARGIN, Grid
from phy124.mpm.solver import CHECK_EVERY, Attachable, Solver, Stage, Unstable
from phy124.mpm.state import Group, State

__all__ = [
    "CHECK_EVERY",
    "MARGIN",
    "Attachable",
    "Grid",
    "Group",
    "Solver",
    "Stage",
    "State",
    "Unstable",
]
